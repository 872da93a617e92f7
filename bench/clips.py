"""The recordings that the protocol tracks: real ones, and synthetic ones rendered once.

INPUTS: the folder of real recordings and of people as rigged meshes; seeds, azimuths, names of
exercises and a folder to keep what is rendered in.
OUTPUTS: Clips.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.pipelines.progress import progress_bar
from jaxmocap.synthetic.four_cameras import write_four_cameras
from jaxmocap.synthetic.movements.exercises import exercise
from jaxmocap.synthetic.movements.motions import MOTIONS, Performance
from jaxmocap.synthetic.people.rigged_mesh import load_rig
from jaxmocap.synthetic.people.shoulder_girdle import Girdle
from jaxmocap.synthetic.recording import write_performance

ELBOWS = ("elbow_l", "elbow_r")
# Landmark -> its marker in the reference.
REAL_LANDMARKS = {"neck": "Neck", "vertex": "Head"} | {
    f"{part}_{side}": f"{side.upper()}{'BigToe' if part == 'toe' else part.capitalize()}"
    for part in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle", "toe")
    for side in "lr"
}


@dataclass(frozen=True)
class Clip:
    """One recording with its reference.

    Attributes:
        group: recordings of one kind share one row of means.
        name: of the recording.
        path: of its ``recording.toml``; ``truth`` lies beside it.
        landmarks: landmark -> its marker in the reference.
        seed: of noise that is added to its markers.
        azimuth: of a synthetic recording's camera, degrees from frontal.
    """

    group: str
    name: str
    path: Path
    landmarks: dict[str, str]
    seed: int = 0
    azimuth: float = 0.0

    @property
    def truth(self) -> Path:
        """The reference."""
        return self.path.with_name("truth.trc")

    @property
    def pairs(self) -> dict[str, str]:
        """The elbows -> their markers in the reference."""
        return {name: self.landmarks[name] for name in ELBOWS}


def real(folder: Path) -> list[Clip]:
    """Each camera of the real recording by itself."""
    paths = sorted((folder / "balancing").glob("recording_cam_0*.toml"))
    names = [path.stem.removeprefix("recording_") for path in paths]
    return [
        Clip("balancing", name, path, REAL_LANDMARKS, seed)
        for seed, (name, path) in enumerate(zip(names, paths, strict=True))
    ]


def performed(motion: str, seconds: float, seed: int, azimuth: float) -> Performance:
    """A motion; a thrust goes at a camera at that azimuth, degrees from frontal."""
    return MOTIONS[motion](seconds, seed, **({"azimuth": azimuth} if motion == "thrust" else {}))


def synthetic(
    motion: str, seeds: Iterable[int], azimuths: Sequence[float], seconds: float, keep: Path
) -> list[Clip]:
    """A recording for each seed, rendered where ``keep`` does not hold it yet.

    Args:
        motion: of ``MOTIONS``.
        seeds: each of its own person, room and movement.
        azimuths: of the camera, degrees from frontal: seed s is seen from the (s mod n)-th.
        seconds: of each.
        keep: holds a folder for each, such as ``tennis_003_-30_6s``.
    """
    clips = []
    for seed in seeds:
        azimuth = azimuths[seed % len(azimuths)]
        name = f"{motion}_{seed:03d}_{azimuth:+03.0f}_{seconds:g}s"
        path = keep / name / "recording.toml"
        # Written last: where it is, all is.
        if not path.is_file():
            performance = performed(motion, seconds, seed, azimuth)
            write_performance(path.parent, performance, seconds, seed, azimuth=azimuth)
        clips.append(Clip(motion, name, path, {mark: mark for mark in LANDMARKS}, seed, azimuth))
    return clips


def exercises(
    file: Path,
    names: Iterable[str],
    seeds: Iterable[int],
    people: Sequence[str],
    seconds: float,
    keep: Path,
    girdle: Girdle | None = None,
) -> list[Clip]:
    """Rigged meshes at exercises, seen by four cameras, rendered where ``keep`` has them not yet.

    Args:
        file: of the people, ``person.npz``.
        names: of the exercises.
        seeds: each of its own clothes, rooms and movement.
        people: of the file.
        seconds: of each recording.
        keep: holds a folder for each, such as ``push_ups_000_man_3s``.
        girdle: how far shoulders go with raised arms; without it they stay on the chest.
    """
    clips = []
    for kind, who, seed in product(names, people, seeds):
        name = f"{kind}_{seed:03d}_{who}_{seconds:g}s" + ("_girdle" if girdle else "")
        path = keep / name / "recording.toml"
        # Written last: where it is, all is.
        if not path.is_file():
            performer = exercise(load_rig(file, who, seed), kind, seconds, seed, girdle)
            with progress_bar(f"rendering {name}", True) as show:
                write_four_cameras(path.parent, performer, seconds, seed, progress=show)
        clips.append(Clip(kind, name, path, {mark: mark for mark in LANDMARKS}, seed))
    return clips
