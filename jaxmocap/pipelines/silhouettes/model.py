"""Four photographs to a person's own model, with pictures of every step.

INPUTS: photographs from the front, the side, of bent arms and of stretched arms; a calibration
with sections ``front``, ``side`` and, where another camera took them, ``joint`` and ``arm_side``:
in its world z is up and the person faces +x.
OUTPUTS: a Modelled; ``model.npz`` (rings, mesh, joints), ``report.json`` and pictures in a folder;
the person for other commands and programs, as ``silhouette_person`` has it.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np

from jaxmocap.capture.photographs import read_photograph, write_picture
from jaxmocap.formats.cameras.calibration import camera_of, read_sections
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.output_folder import OutputFolder
from jaxmocap.formats.files.writing import replacing
from jaxmocap.outputs.report import write_figures
from jaxmocap.pipelines.silhouettes.person import PERSON_FILES, write_person
from jaxmocap.silhouette.modelling.measurements import girths
from jaxmocap.silhouette.modelling.person import PersonModel, StanceError, person_model
from jaxmocap.silhouette.modelling.personal import PersonalModel, personal_model
from jaxmocap.silhouette.modelling.pictures import drawing
from jaxmocap.silhouette.modelling.pictures.backdrop import PhotographError, person_mask
from jaxmocap.silhouette.modelling.pictures.drawing import joined_meshes
from jaxmocap.silhouette.modelling.pictures.medial_axis import medial_axis
from jaxmocap.silhouette.modelling.pictures.views import PhotographView
from jaxmocap.silhouette.modelling.readings import READINGS

PHOTOGRAPHS = ("front", "side", "joint", "arm_side")
FILES = ("model.npz", "report.json", "model.png")
REFUSED = "_refused"
# Of the rings, every so many are drawn.
DRAWN = 3


class ModelResult(NamedTuple):
    """What four photographs gave."""

    model: PersonModel
    images: dict[str, np.ndarray]  # photograph -> (H, W, 3) BGR uint8
    views: dict[str, PhotographView]  # photograph -> mask and camera
    person: PersonalModel  # the same as the tracker wants it
    reading: str  # by which, a name of ``READINGS``
    seconds: float  # from the files to the model

    def figures(self) -> dict:
        """Lengths, girths and joints, metres, and how long it took, seconds."""
        joints = {
            f"{name}_{side}": np.round(getattr(bones, name), 4).tolist()
            for bones, side in zip(self.model.bent, "lr", strict=True)
            for name in bones._fields
        }
        lengths = {name: round(length, 4) for name, length in self.model.lengths().items()}
        around = {name: section.to_millimetres() for name, section in girths(self.model).items()}
        seconds = round(self.seconds, 2)
        return {
            "reading": self.reading, "lengths_m": lengths, "girths_m": around, "joints_m": joints,
            "seconds": seconds,
        }  # fmt: skip


def model_from(
    files: Mapping[str, str | Path],
    calibration: str | Path,
    out: str | Path,
    bottom: int | None = None,
    height: float | None = None,
    reading: str = "own",
) -> ModelResult:
    """Make a model of the four ``PHOTOGRAPHS``, with the options of ``silhouette model``.

    Raises:
        InputError: a photograph or the calibration cannot be used.
    """
    start = perf_counter()
    # The front's also took the arms where they have no section.
    sections, needed = read_sections(calibration), ("front", "side")
    cameras = {
        name: camera_of(calibration, sections, name if name in (*sections, *needed) else "front")
        for name in PHOTOGRAPHS
    }
    images = {name: read_photograph(files[name], cameras[name].size) for name in PHOTOGRAPHS}
    views = {}
    for name, image in images.items():
        try:
            views[name] = PhotographView(person_mask(image), cameras[name])
        except PhotographError as error:
            # What is wrong with it, as a picture beside whatever the folder holds.
            file, picture = f"{name}{REFUSED}.png", error.picture
            with OutputFolder(out, "refused photograph", [file]).writing() as stage:
                write_picture(stage / file, picture)
            raise InputError(files[name], f"{error.problem} (see {Path(out) / file})") from None
    try:
        model = person_model(views, bottom, READINGS[reading])
    except StanceError as error:
        raise InputError(files[error.view], error.problem) from None
    try:
        person = personal_model(model, height)
    except ValueError as error:
        raise InputError(files["front"], str(error)) from None
    return ModelResult(model, images, views, person, reading, perf_counter() - start)


def model_folder(directory: str | Path, inputs: Iterable[str | Path] = ()) -> OutputFolder:
    """The folder for a person's model, checked before any work; see ``OutputFolder``."""
    pictures = [f"{name}{kind}.png" for name in PHOTOGRAPHS for kind in ("", REFUSED)]
    return OutputFolder(directory, "model", [*FILES, *pictures, *PERSON_FILES], inputs)


def write_model(modelled: ModelResult, directory: Path) -> list[Path]:
    """Write model, report and pictures into a folder that is there; their paths."""
    model = modelled.model
    vertices, faces = joined_meshes([model.trunk.rings, *model.arms])
    files = [directory / "model.npz", directory / "report.json"]
    with replacing(files[0]) as beside, beside.open("wb") as file:
        np.savez_compressed(
            file,
            trunk=model.trunk.rings,
            arm_l=model.arms[0],
            arm_r=model.arms[1],
            joints=np.array(model.bent),
            joint_names=np.array(model.bent[0]._fields),
            vertices=vertices,
            faces=faces,
        )
    write_figures(modelled.figures(), files[1])
    for name, picture in pictures(modelled).items():
        files.append(write_picture(directory / f"{name}.png", picture))
    views = [drawing.shade_mesh(vertices, faces, turn) for turn in (0.0, 0.8)]
    tall = max(len(view) for view in views)
    views = [np.pad(v, ((0, tall - len(v)), (0, 0), (0, 0)), constant_values=245) for v in views]
    files.append(write_picture(directory / "model.png", np.hstack(views)))
    return [*files, *write_person(modelled.person, modelled.images, modelled.views, directory)]


def pictures(modelled: ModelResult) -> dict[str, np.ndarray]:
    """Photograph -> what was found in it: rim, skeletons, joints, slices."""
    model, views = modelled.model, modelled.views
    drawn = {
        name: drawing.draw_outline(image, views[name].mask)
        for name, image in modelled.images.items()
    }
    for name in ("front", "side"):
        rings = [views[name].pixels(ring) for ring in model.trunk.rings[::DRAWN]]
        drawn[name] = drawing.with_lines(drawn[name], rings, drawing.RING, closed=True)
    marks = model.front
    width = drawn["front"].shape[1]
    levels = [np.array([[0.0, row], [width, row]]) for row in (marks.neck, marks.bottom)]
    drawn["front"] = drawing.with_lines(drawn["front"], levels, drawing.POINT, closed=False)
    drawn["front"] = drawing.with_points(drawn["front"], marks.pits)
    for name in ("joint", "arm_side"):
        axis = medial_axis(views[name].mask).pixels_xy
        drawn[name][axis[:, 1], axis[:, 0]] = drawing.AXIS
    bent = np.concatenate(
        [[arm.shoulder, arm.elbow, arm.wrist, arm.tip] for arm in model.arm_pixels]
    )
    drawn["joint"] = drawing.with_points(drawn["joint"], bent)
    arm_side = replace(views["arm_side"], shift=model.shifts["arm_side"])
    straight = arm_side.pixels(np.concatenate([np.array(bones) for bones in model.stretched]))
    drawn["arm_side"] = drawing.with_points(drawn["arm_side"], straight)
    return drawn


def model_text(modelled: ModelResult, files: list[Path]) -> str:
    """For the terminal."""
    figures = modelled.figures()
    lines = [f"{name:12} {100 * length:6.1f} cm" for name, length in figures["lengths_m"].items()]
    lines += [""] + [
        f"{name:12} {100 * s['girth']:6.1f} cm around, {100 * s['width']:5.1f} cm wide, "
        f"{100 * s['depth']:5.1f} cm deep"
        for name, s in figures["girths_m"].items()
    ]
    lines += ["", f"made in {modelled.seconds:.1f} s", *(f"written  {path}" for path in files)]
    return "\n".join(lines)
