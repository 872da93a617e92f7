"""A synthetic recording by four cameras, tracked by silhouettes and compared with the truth.

INPUTS: a folder, a duration, a seed; somebody's rigged mesh where there is one.
OUTPUTS: in that folder the recording and everything that ``silhouette track`` writes.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxmocap.body.motion import Motion
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.evaluation.errors import Errors
from jaxmocap.evaluation.motions import evaluate
from jaxmocap.evaluation.tables import format_table
from jaxmocap.formats.recording import Recording
from jaxmocap.formats.trc import read_trc
from jaxmocap.run.silhouette import follow, whole_body
from jaxmocap.run.silhouette_writing import write_followed
from jaxmocap.run.summary import frames_per_second
from jaxmocap.run.timing import progress_bar
from jaxmocap.run.writing import make_folder
from jaxmocap.silhouette.start import pose_at
from jaxmocap.synthetic import motions
from jaxmocap.synthetic.exercises import exercise
from jaxmocap.synthetic.four_cameras import Performer, bends, write_four_cameras
from jaxmocap.synthetic.person import dressed
from jaxmocap.synthetic.rigged_mesh import load_rig

HEIGHT = 1.75
JOINTS = {
    f"{joint}_{side}": f"{joint}_{side}"
    for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    for side in "lr"
}


@dataclass(frozen=True)
class Shown:
    """What the demo shows.

    Attributes:
        motion: by silhouettes.
        errors: of the joints' places.
        bend_errors_deg: hinge -> mean error of how far it is bent, degrees.
        files: that were written.
    """

    motion: Motion
    errors: Errors
    bend_errors_deg: dict[str, float]
    files: list[Path]

    @property
    def frames_per_second(self) -> float:
        """Once compiled; NaN if nothing was timed."""
        report = self.motion.report
        return float("nan") if report is None else frames_per_second(report)

    def text(self) -> str:
        """Errors, and the rate."""
        bends = ", ".join(f"{name} {off:.1f}" for name, off in self.bend_errors_deg.items())
        rate = f"{self.frames_per_second:.1f} frames per second of all cameras, once compiled"
        return f"{format_table(self.errors)}\n\nbent, degrees off: {bends}\n{rate}"

    def as_dict(self) -> dict:
        """What JSON takes."""
        return {
            "errors": self.errors.as_dict(),
            "bend_errors_deg": self.bend_errors_deg,
            "frames_per_second": self.frames_per_second,
            "files": [str(path) for path in self.files],
        }


def demonstrate(
    directory: str | Path,
    seconds: float = 2.0,
    seed: int = 0,
    person: str | None = None,
    kind: str = "arm_raises",
    progress: bool = False,
) -> Shown:
    """Make a recording, track it, compare it with the truth, and write it all down.

    Args:
        directory: is made where missing; the recording goes to ``recording`` in it.
        seconds: duration.
        seed: of rooms, movement and noise.
        person: file of a rigged mesh; a simple person made here squats without it.
        kind: the mesh's exercise.
        progress: show bars on stderr.
    """
    folder = make_folder(directory)
    with progress_bar("rendering", progress) as show:
        performer = performing(seconds, seed, person, kind)
        path = write_four_cameras(folder / "recording", performer, seconds, seed, HEIGHT, show)
    recording, truth = Recording.load(path), folder / "recording" / "truth.trc"
    known = read_trc(truth)
    places = dict(zip(known.names, np.moveaxis(known.positions, 1, 0), strict=True))
    first = np.array([places[n][0] if n in places else np.full(3, np.nan) for n in LANDMARKS])
    start = pose_at(whole_body(recording.skeleton), first)
    followed = follow(recording, start, progress=progress)
    files = write_followed(followed, recording, folder, progress)
    errors = evaluate(followed.motion, truth, JOINTS)
    found, expected = bends(followed.motion.joints()), bends(places)
    off = {
        name: float(np.degrees(np.abs(found[name] - expected[name]).mean())) for name in expected
    }
    return Shown(followed.motion, errors, off, files)


def performing(seconds: float, seed: int, person: str | None, kind: str) -> Performer:
    """Who moves."""
    if person is None:
        return dressed(motions.squat(seconds, seed, HEIGHT), seed)
    return exercise(load_rig(person, seed=seed), kind, seconds, seed)
