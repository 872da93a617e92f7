"""A synthetic recording by four cameras, tracked by silhouettes and compared with the truth.

Who has a mesh of their own is photographed first, and tracked without and with the model that the
photographs give.

INPUTS: a folder, a duration, a seed; somebody's rigged mesh where there is one.
OUTPUTS: in that folder the recording, everything that ``silhouette track`` writes, and errors.png;
of a mesh photographs and model as well.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from jaxmocap.body.motion import Motion
from jaxmocap.body.skeleton import LANDMARKS, WINTER, with_joints
from jaxmocap.evaluation.errors import Errors, evaluate
from jaxmocap.evaluation.plots import plot_joint_errors
from jaxmocap.evaluation.tables import format_table
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.output_folder import OutputFolder
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.trc import read_trc
from jaxmocap.pipelines.demo import MOST_S
from jaxmocap.pipelines.progress import progress_bar
from jaxmocap.pipelines.silhouettes.model import PHOTOGRAPHS, model_folder, model_from, write_model
from jaxmocap.pipelines.silhouettes.person import Person, with_model
from jaxmocap.pipelines.silhouettes.track import SilhouetteResult, track_silhouettes
from jaxmocap.pipelines.silhouettes.writing import VIDEO_KINDS, write_into
from jaxmocap.pipelines.summary import frames_per_second
from jaxmocap.pipelines.writing import MOTION, MOTION_FILES
from jaxmocap.silhouette.first_pose import pose_at_landmarks
from jaxmocap.silhouette.settings import Settings
from jaxmocap.synthetic.four_cameras import Performer, flexion_angles, write_four_cameras
from jaxmocap.synthetic.movements import motions
from jaxmocap.synthetic.movements.exercises import exercise
from jaxmocap.synthetic.people.clothed_person import clothed_actor
from jaxmocap.synthetic.people.rigged_mesh import load_rig
from jaxmocap.synthetic.photographs import write_photographs

HEIGHT = 1.75
CAMERAS = tuple(f"cam_{number}" for number in range(1, 5))
RECORDING_FILES = (
    *("recording.toml", "calibration.toml", "truth.trc", "truth_angles.npz", "truth_masks.npz"),
    *(f"{camera}.mp4" for camera in CAMERAS),
)
PLOT_FILE = "errors.png"
FILES = (
    *(*MOTION_FILES, "report.json", "recording.rrd", PLOT_FILE),
    *(f"{kind}_{camera}.mp4" for kind in VIDEO_KINDS for camera in CAMERAS),
)
# Lines of the plot where the person has a model: tracked without it, and with it.
MODEL_RUNS = ("generic body", "own model")
JOINTS = {
    f"{joint}_{side}": f"{joint}_{side}"
    for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    for side in "lr"
}


@dataclass(frozen=True)
class SilhouetteDemo:
    """What the demo shows: errors of joints and of hinges' bends, and both before the model."""

    motion: Motion
    errors: Errors
    bend_errors_deg: dict[str, float]
    before: tuple[Errors, dict[str, float]] | None
    files: list[Path]

    def text(self) -> str:
        """Errors, and the rate."""
        errors, bent = (None, {}) if self.before is None else self.before
        table = format_table(self.errors, errors)
        bends = ", ".join(
            f"{name} {f'{bent[name]:.1f} -> ' if bent else ''}{off:.1f}"
            for name, off in self.bend_errors_deg.items()
        )
        rate = f"{frames_per_second(self.motion.report):.1f} frames of all cameras a second"
        with_model = "without -> with the person's own model\n\n" if bent else ""
        return f"{with_model}{table}\n\nbend errors, degrees: {bends}\n{rate}, compilation included"

    def as_dict(self) -> dict:
        """What JSON takes."""
        return {
            "errors": self.errors.as_dict(),
            "bend_errors_deg": self.bend_errors_deg,
            "without_model": self.before
            and {"errors": self.before[0].as_dict(), "bend_errors_deg": self.before[1]},
            "frames_per_second": frames_per_second(self.motion.report),
            "files": [str(path) for path in self.files],
        }


def demonstrate_silhouettes(
    directory: str | Path,
    seconds: float = 2.0,
    seed: int = 0,
    person: str | None = None,
    kind: str = "arm_raises",
    progress: bool = False,
) -> SilhouetteDemo:
    """Make a recording, track it, compare it with the truth; see ``silhouette demo``."""
    if seconds > MOST_S:
        raise InputError("--seconds", f"found {seconds:g}, expected at most {MOST_S:g}")
    folder = Path(directory)
    recording_folder = OutputFolder(folder / "recording", "recording", RECORDING_FILES)
    outputs = OutputFolder(folder, MOTION, FILES)
    with recording_folder.writing() as stage, progress_bar("rendering", progress) as show:
        performer = performer_of(seconds, seed, person, kind)
        proportions = WINTER if person is None else None
        write_four_cameras(stage, performer, seconds, seed, HEIGHT, show, proportions)
    recording = Recording.load(recording_folder.path / "recording.toml")
    truth = recording_folder.path / "truth.trc"
    before, files, own = None, [], None
    if person is not None:
        motion = track_from_truth(recording, truth, progress).motion
        before = evaluate(motion, truth, JOINTS), bend_errors_deg(motion, truth)
        files += photograph_and_model(folder, person, seed)
        recording, own = with_model(recording, folder / "model")
    result = track_from_truth(recording, truth, progress, own)
    errors = evaluate(result.motion, truth, JOINTS)
    off = bend_errors_deg(result.motion, truth)

    def write(stage: Path) -> list[Path]:
        written = write_into(result, recording, stage, progress, own)
        runs = [errors] if before is None else [before[0], errors]
        named: dict[str, Errors] = dict(zip(MODEL_RUNS, runs, strict=False))
        plot_joint_errors(stage / PLOT_FILE, named)
        return [*written, stage / PLOT_FILE]

    files += outputs.write(write)
    return SilhouetteDemo(result.motion, errors, off, before, files)


def photograph_and_model(folder: Path, person: str, seed: int) -> list[Path]:
    """Photograph a mesh and make the person's model, in ``photographs`` and ``model``."""
    pictures = [f"{name}.png" for name in PHOTOGRAPHS]
    taken = OutputFolder(folder / "photographs", "photographs", [*pictures, "calibration.toml"])
    with taken.writing() as stage:
        write_photographs(stage, load_rig(person, seed=seed), seed)
    files = {name: taken.path / f"{name}.png" for name in PHOTOGRAPHS}
    calibration, model = taken.path / "calibration.toml", model_folder(folder / "model")
    return model.write(partial(write_model, model_from(files, calibration, model.path)))


def track_from_truth(
    recording: Recording, truth: Path, progress: bool, own: Person | None = None
) -> SilhouetteResult:
    """Track from the truth's first pose, with the person's own model where there is one."""
    points = read_trc(truth).points()
    first = np.array([points[n][0] if n in points else np.full(3, np.nan) for n in LANDMARKS])
    start = pose_at_landmarks(with_joints(recording.skeleton, Settings.body), first)
    return track_silhouettes(recording, start, surface=own and own.surface, progress=progress)


def bend_errors_deg(motion: Motion, truth: Path) -> dict[str, float]:
    """Hinge -> mean error of how far it is bent, degrees."""
    actual, expected = flexion_angles(motion.joints()), flexion_angles(read_trc(truth).points())
    return {
        name: float(np.degrees(np.abs(actual[name] - expected[name]).mean())) for name in expected
    }


def performer_of(seconds: float, seed: int, person: str | None, kind: str) -> Performer:
    """Who moves."""
    if person is None:
        return clothed_actor(motions.squat(seconds, seed, HEIGHT), seed)
    return exercise(load_rig(person, seed=seed), kind, seconds, seed)
