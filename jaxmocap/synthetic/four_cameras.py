"""A recording by four synchronous cameras around a person who wears no markers.

Each camera looks into a room of its own seed: the clutter behind the person differs from side to
side, and the cameras share clocks and the world only.

INPUTS: a folder, someone who moves, a duration, a seed.
OUTPUTS: in that folder ``recording.toml`` without [markers], ``cam_1.mp4`` to ``cam_4.mp4``
(640 x 480 at 30 Hz, with one clock), ``calibration.toml``; ``truth.trc`` with every landmark at
the frames' times, world, metres, Z up; ``truth_angles.npz`` with elbows and knees, radians; and
``truth_masks.npz`` with the person's true pixels, which ``read_masks`` reads.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from jaxmocap.formats.cameras.calibration import write_calibration
from jaxmocap.formats.files.arrays import BYTES, ArraySpec, NpzArrays
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.writing import replacing
from jaxmocap.formats.recordings.recording import write_recording
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.geometry.cameras import Camera, on_host, project
from jaxmocap.synthetic.drawing_camera import look_around
from jaxmocap.synthetic.movements.exerciser import Exerciser
from jaxmocap.synthetic.people.clothed_person import Actor
from jaxmocap.synthetic.recording import VIDEO_RATE, write_video
from jaxmocap.synthetic.renderer import (
    Mover,
    Progress,
    RotatedMover,
    Scene,
    render_frames,
    silhouette,
)

# Hinge -> the landmarks on either side of it.
HINGES = {
    f"{hinge}_{s}": (f"{near}_{s}", f"{far}_{s}")
    for near, hinge, far in (("shoulder", "elbow", "wrist"), ("hip", "knee", "ankle"))
    for s in "lr"
}
# Azimuths about the person who faces +x, degrees, positive to the person's left.
AZIMUTHS_DEG = (6.0, 82.0, 171.0, 262.0)
# Of the cameras, metres.
HEIGHTS_M = (1.25, 1.75, 1.1, 1.95)
# From the person, metres.
DISTANCE_M = 3.7
# Share of half an image that the movement fills.
IMAGE_SHARE = 0.94
# Seconds between the times at which that is evaluated.
SAMPLING_S = 0.1


# Someone who moves, with true joints.
Performer = Actor | Exerciser


@dataclass(frozen=True)
class RoomCamera:
    """One of the cameras, and the room that it looks into."""

    number: int  # of the camera, from 1
    azimuth: float  # degrees
    height: float  # metres
    target: np.ndarray  # (3,) what it looks at, world, metres
    focal: float  # pixels

    @property
    def name(self) -> str:
        """In the calibration file."""
        return f"cam_{self.number}"

    @property
    def camera(self) -> Camera:
        """In the world."""
        return self._at(self.azimuth, self.target)

    def scene(self, mover: Mover, seed: int) -> Scene:
        """Someone before the camera, rotated to where its room is."""
        turned = RotatedMover(mover, self.azimuth)
        camera = self._at(0.0, turned.turn @ self.target)
        return Scene.in_room(camera, turned, 10 * seed + self.number)

    def mask(self, mover: Mover, time: float) -> np.ndarray:
        """(H, W) bool, the pixels of someone at a time."""
        vertices = mover.vertices(np.array([time]))[0]
        return silhouette(mover.mesh, self.camera, vertices)

    def _at(self, azimuth: float, target: np.ndarray) -> Camera:
        at = (target[0], target[1], target[2])
        return look_around(azimuth, DISTANCE_M, self.height, at, focal=self.focal)


def cameras_around(mover: Mover, seconds: float) -> tuple[RoomCamera, ...]:
    """The four cameras, each as near as lets the whole movement fit into its image."""
    vertices = [mover.vertices(np.array([time]))[0] for time in np.arange(0, seconds, SAMPLING_S)]
    low, high = (pick([pick(v, axis=0) for v in vertices], axis=0) for pick in (np.min, np.max))
    cameras = []
    for number, (azimuth, height) in enumerate(zip(AZIMUTHS_DEG, HEIGHTS_M, strict=True), 1):
        view = RoomCamera(number, azimuth, height, (low + high) / 2, 1000.0)
        camera = on_host(view.camera)
        reach = max(
            np.max(np.abs(project(camera, v) - camera.matrix[:2, 2]) / np.divide(camera.size, 2))
            for v in vertices
        )
        cameras.append(replace(view, focal=IMAGE_SHARE * view.focal / reach))
    return tuple(cameras)


def write_four_cameras(
    directory: str | Path,
    performer: Performer,
    seconds: float,
    seed: int = 0,
    height: float = 1.75,
    progress: Progress | None = None,
    proportions: str | None = None,
) -> Path:
    """Write the recording of someone seen by the cameras of ``cameras_around``.

    Args:
        directory: is made where missing.
        performer: who moves.
        seconds: duration.
        seed: of rooms and sensor noise.
        height: of the person, as the recording states it, metres.
        progress: called with the frames done and their total.
        proportions: of the person, as the recording states them; None for those of most people.

    Returns:
        The path of ``recording.toml``.

    Raises:
        InputError: a duration of less than a frame.
    """
    directory, times = Path(directory), frame_times(seconds)
    if not len(times):
        problem = f"{seconds:g} s hold no frame, expected at least {1 / VIDEO_RATE:.2g} s"
        raise InputError("--seconds", problem)
    directory.mkdir(parents=True, exist_ok=True)
    views = cameras_around(performer, seconds)
    for i, view in enumerate(views):

        def count(done: int, total: int, before: int = i * len(times)) -> None:
            if progress:
                progress(before + done, len(views) * total)

        frames = render_frames(view.scene(performer, seed), times, count)
        write_video(directory / f"{view.name}.mp4", frames)
    write_truth(directory, performer, times, views)
    write_calibration(directory / "calibration.toml", {view.name: view.camera for view in views})
    videos = [{"file": f"{view.name}.mp4", "camera": view.name} for view in views]
    subject = {"height": height} | ({} if proportions is None else {"proportions": proportions})
    return write_recording(directory, None, {}, videos, "calibration.toml", subject)


def frame_times(seconds: float) -> np.ndarray:
    """(F,) seconds of the frames' middles of exposure, and of the videos."""
    return np.arange(round(seconds * VIDEO_RATE)) / VIDEO_RATE


def write_truth(
    directory: Path, performer: Performer, times: np.ndarray, views: tuple[RoomCamera, ...]
) -> None:
    """Write the true landmarks, angles and masks."""
    landmarks = performer.landmarks(times)
    write_trc(directory / "truth.trc", times, landmarks, rate=VIDEO_RATE)
    with replacing(directory / "truth_angles.npz") as beside:
        np.savez(beside, times=times, **flexion_angles(landmarks))  # type: ignore[arg-type]
    masks = {
        view.name: np.stack(
            [np.packbits(view.mask(performer, float(time)), axis=-1) for time in times]
        )
        for view in views
    }
    with replacing(directory / "truth_masks.npz") as beside:
        np.savez_compressed(beside, **masks)  # type: ignore[arg-type]


def flexion_angles(landmarks: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """``elbow_l`` and so on -> (T,) how far it is bent, radians; 0 is straight."""
    angles = {}
    for hinge, (near, far) in HINGES.items():
        upper, lower = landmarks[hinge] - landmarks[near], landmarks[far] - landmarks[hinge]
        across = np.linalg.norm(np.cross(upper, lower), axis=-1)
        angles[hinge] = np.arctan2(across, np.sum(upper * lower, -1))
    return angles


def read_masks(path: str | Path, size: tuple[int, int] = (640, 480)) -> dict[str, np.ndarray]:
    """Camera name -> (F, H, W) bool, of a ``truth_masks.npz`` of images of that width, height.

    Raises:
        InputError: no such file, or not one of masks of that size.
    """
    arrays, (width, height) = NpzArrays(path), size
    packed = ArraySpec(("F", height, -(-width // 8)), BYTES)
    return {
        name: np.unpackbits(mask, axis=-1, count=width).astype(bool)
        for name, mask in arrays.read(dict.fromkeys(arrays.names, packed)).items()
    }
