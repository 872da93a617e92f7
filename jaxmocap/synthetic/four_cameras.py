"""A recording by four synchronous cameras around a person who wears no markers.

Each camera looks into a room of its own seed: the clutter behind the person differs from side to
side, and the cameras share clocks and the world only.

INPUTS: a folder, someone who moves, a duration, a seed.
OUTPUTS: in that folder ``recording.toml`` without [markers], ``cam_1.mp4`` to ``cam_4.mp4``
(640 x 480 at 30 Hz, with one clock), ``calibration.toml``; ``truth.trc`` with every landmark at
the frames' times, world, metres, Z up; ``truth_angles.npz`` with elbows and knees, radians; and
``truth_masks.npz`` with the person's true pixels.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from jaxmocap.formats.calibration import write_calibration
from jaxmocap.formats.recording import write_recording
from jaxmocap.formats.trc import write_trc
from jaxmocap.geometry.cameras import Camera
from jaxmocap.synthetic.lens import Lens, look_at
from jaxmocap.synthetic.placement import Turned
from jaxmocap.synthetic.recording import VIDEO_RATE, write_video
from jaxmocap.synthetic.renderer import Mover, Progress, Scene, render_frames, silhouette

# Hinge -> the landmarks on either side of it.
HINGES = {
    f"{hinge}_{s}": (f"{near}_{s}", f"{far}_{s}")
    for near, hinge, far in (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle"))
    for s in "lr"
}
# Azimuths about the person who faces +x, degrees, positive to the person's left; and heights.
AROUND_DEG, HEIGHTS_M = (6.0, 82.0, 171.0, 262.0), (1.25, 1.75, 1.1, 1.95)
DISTANCE_M, TARGET_M, FOCAL_PX = 3.7, 0.98, 690.0


class Performer(Mover, Protocol):
    """Someone whose joints are known."""

    def landmarks(self, times: np.ndarray) -> dict[str, np.ndarray]:
        """Landmark name -> (T, 3), world, metres."""
        ...


@dataclass(frozen=True)
class View:
    """One of the cameras, and the room that it looks into.

    Attributes:
        name: of the camera.
        azimuth: degrees.
        height: metres.
    """

    name: str
    azimuth: float
    height: float

    def camera(self, turned: bool = False) -> Camera:
        """In the world; or, turned to azimuth 0, in its room."""
        turn = 0.0 if turned else np.deg2rad(self.azimuth)
        position = (DISTANCE_M * np.cos(turn), DISTANCE_M * np.sin(turn), self.height)
        return look_at(position, (0.0, 0.0, TARGET_M), focal=FOCAL_PX)

    def scene(self, mover: Mover, seed: int) -> Scene:
        """What it sees of someone."""
        number = [view.name for view in VIEWS].index(self.name)
        camera = self.camera(turned=True)
        return Scene.in_room(camera, Turned(mover, self.azimuth), 10 * seed + number)

    def mask(self, mover: Mover, time: float) -> np.ndarray:
        """(H, W) bool, where it sees someone at a time."""
        vertices = mover.vertices(np.array([time]))[0]
        return silhouette(mover.mesh, Lens.of(self.camera()), vertices)


VIEWS = tuple(
    View(f"cam_{i}", azimuth, height)
    for i, (azimuth, height) in enumerate(zip(AROUND_DEG, HEIGHTS_M, strict=True), 1)
)


def write_four_cameras(
    directory: str | Path,
    performer: Performer,
    seconds: float,
    seed: int = 0,
    height: float = 1.75,
    progress: Progress | None = None,
) -> Path:
    """Write the recording of someone seen by ``VIEWS``.

    Args:
        directory: is made where missing.
        performer: who moves.
        seconds: duration.
        seed: of rooms and sensor noise.
        height: what the recording says of the person, metres.
        progress: called with the frames done and their total.

    Returns:
        The path of ``recording.toml``.
    """
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    times = frame_times(seconds)
    for i, view in enumerate(VIEWS):
        frames = render_frames(view.scene(performer, seed), times)
        counted = _counted(frames, progress, i * len(times), len(VIEWS) * len(times))
        write_video(directory / f"{view.name}.mp4", counted)
    write_truth(directory, performer, times)
    write_calibration(directory / "calibration.toml", {view.name: view.camera() for view in VIEWS})
    videos = [{"file": f"{view.name}.mp4", "camera": view.name} for view in VIEWS]
    subject = {"height": height}
    return write_recording(directory, None, {}, videos, "calibration.toml", subject)


def frame_times(seconds: float) -> np.ndarray:
    """(F,) seconds of the frames' middles of exposure, and of the videos."""
    return np.arange(round(seconds * VIDEO_RATE)) / VIDEO_RATE


def write_truth(directory: Path, performer: Performer, times: np.ndarray) -> None:
    """Write where someone was, and was seen."""
    landmarks = performer.landmarks(times)
    write_trc(directory / "truth.trc", times, landmarks, rate=VIDEO_RATE)
    np.savez(directory / "truth_angles.npz", times=times, **bends(landmarks))  # type: ignore[arg-type]
    masks = {
        view.name: np.packbits([view.mask(performer, float(time)) for time in times], axis=-1)
        for view in VIEWS
    }
    np.savez_compressed(directory / "truth_masks.npz", **masks)  # type: ignore[arg-type]


def bends(landmarks: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """``elbow_l`` and so on -> (T,) how far it is bent, radians; 0 is straight."""
    found = {}
    for hinge, (near, far) in HINGES.items():
        upper, lower = landmarks[hinge] - landmarks[near], landmarks[far] - landmarks[hinge]
        across = np.linalg.norm(np.cross(upper, lower), axis=-1)
        found[hinge] = np.arctan2(across, np.sum(upper * lower, -1))
    return found


def read_masks(path: str | Path, size: tuple[int, int] = (640, 480)) -> dict[str, np.ndarray]:
    """Camera name -> (F, H, W) bool, of a ``truth_masks.npz`` of images of that width, height."""
    with np.load(path) as data:
        return {
            name: np.unpackbits(data[name], axis=-1, count=size[0]).astype(bool) for name in data
        }


def _counted(
    frames: Iterator[np.ndarray], progress: Progress | None, before: int, total: int
) -> Iterator[np.ndarray]:
    for i, frame in enumerate(frames, 1):
        yield frame
        if progress:
            progress(before + i, total)
