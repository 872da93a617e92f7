"""A tracked motion played by another person.

INPUTS: a folder that ``track`` or ``silhouette track`` wrote, or its motion.npz; a subject file, or
a folder of ``silhouette model``.
OUTPUTS: that person's motion in every format, with their skin where it was measured; recording.rrd;
retargeted.png, a picture of both.
"""

from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxmocap.body.motion import Motion
from jaxmocap.body.surfaces.surface import Surface
from jaxmocap.capture.photographs import picture_of
from jaxmocap.evaluation.plots import plot_stick_figures
from jaxmocap.fitting.retarget import FEET, feet, grounded, leg_length, retargeted, scaled_by_legs
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.output_folder import OutputFolder
from jaxmocap.formats.motion_npz import load_motion
from jaxmocap.formats.recordings.subject import read_subject
from jaxmocap.outputs.viewer import write_rerun
from jaxmocap.pipelines.silhouettes.person import person_files, read_person
from jaxmocap.pipelines.writing import MOTION, MOTION_FILES, Warn, ignore_warning, write_motion

MOTION_NPZ = "motion.npz"
VIEWER_FILE = "recording.rrd"
PICTURE_FILE = "retargeted.png"


class RetargetedMotion(NamedTuple):
    """A motion before and after it was retargeted.

    Attributes:
        tracked: as it was tracked.
        retargeted: as the other body moves.
        surface: of the other body, or None.
        picture: a PNG file's content, the surface's colours; or None.
    """

    tracked: Motion
    retargeted: Motion
    surface: Surface | None
    picture: bytes | None

    def figures(self) -> dict:
        """Lengths of the legs, metres; errors of feet on the ground, metres (per second)."""
        before, after = self.tracked, self.retargeted
        feet_before, feet_after = (
            feet(motion.skeleton, motion.poses) for motion in (before, after)
        )
        on_ground = grounded(feet_before)
        errors = feet_after - scaled_by_legs(before, after.skeleton, feet_before)
        speeds = np.linalg.norm(np.diff(errors, axis=0), axis=-1) / np.diff(before.times)[:, None]
        return {
            "legs_before_m": round(leg_length(before.skeleton), 4),
            "legs_after_m": round(leg_length(after.skeleton), 4),
            "on_the_ground_share": dict(
                zip(FEET, on_ground.mean(0).round(3).tolist(), strict=True)
            ),
            "slide_m_s": _mean(speeds[on_ground[1:] & on_ground[:-1]]),
            "height_error_m": _mean(np.abs(errors[..., 2])[on_ground]),
        }

    def text(self, files: list[Path]) -> str:
        """The same figures, and the files, as lines of text."""
        figures = self.figures()
        slide, height = (_centimetres(figures[name]) for name in ("slide_m_s", "height_error_m"))
        lines = [
            f"legs           {_centimetres(figures['legs_before_m'])} before, "
            f"{_centimetres(figures['legs_after_m'])} now",
            f"on the ground  error of the feet's height {height}; they slide {slide} a second more",
        ]
        return "\n".join([*lines, *(f"written        {path}" for path in files)])


def retarget(source: str | Path, onto: str | Path) -> RetargetedMotion:
    """Play a motion with another person's body.

    From a motion.npz, or the folder that holds it, onto a subject file, or a folder that
    ``silhouette model`` wrote.

    Raises:
        InputError: a file cannot be used, or the bodies have other bones.
    """
    before, onto = load_motion(_motion_file(source)), Path(onto)
    surface = picture = None
    if onto.is_dir():
        skeleton, surface, picture = read_person(onto)
    else:
        skeleton = read_subject(onto, "", {"file": onto.name})
    try:
        return RetargetedMotion(before, retargeted(before, skeleton), surface, picture)
    except ValueError as error:
        raise InputError(source, str(error)) from None


def retargeted_folder(directory: str | Path, source: str | Path, onto: str | Path) -> OutputFolder:
    """The folder for a retargeted motion, checked before any work; see ``tracked_folder``."""
    person = Path(onto)
    inputs = [_motion_file(source), *(person_files(person) if person.is_dir() else [person])]
    return OutputFolder(directory, MOTION, [*MOTION_FILES, VIEWER_FILE, PICTURE_FILE], inputs)


def write_retargeted(
    motions: RetargetedMotion, folder: OutputFolder, warn: Warn = ignore_warning
) -> list[Path]:
    """Write the motion and the picture; see ``write_outputs``.

    Returns:
        What was written.

    Raises:
        OutputError: the disk is full; every file that is there is complete.
    """
    motion, skin = motions.retargeted, (motions.surface, motions.picture)
    files = folder.write(lambda stage: write_motion(motion, stage, *skin, warn), more_follows=True)
    return files + folder.write(partial(_write_pictures, motions))


def _write_pictures(motions: RetargetedMotion, folder: Path) -> list[Path]:
    """The viewer's recording and the picture."""
    files, picture = [folder / VIEWER_FILE, folder / PICTURE_FILE], motions.picture
    colours = None if picture is None else picture_of(folder, picture)
    write_rerun(files[0], motions.retargeted, surface=motions.surface, picture=colours)
    people = {"as tracked": motions.tracked, "as played": motions.retargeted}
    plot_stick_figures(files[1], people)
    return files


def _motion_file(source: str | Path) -> Path:
    """The motion.npz of a folder, or the file itself."""
    path = Path(source)
    if path.is_dir():
        path = path / MOTION_NPZ
        if not path.is_file():
            raise InputError(source, f"found no {MOTION_NPZ} in this folder, expected one")
    return path


def _mean(values: np.ndarray) -> float | None:
    return round(float(values.mean()), 4) if len(values) else None


def _centimetres(metres: float | None) -> str:
    return "never measured" if metres is None else f"{100 * metres:.1f} cm"
