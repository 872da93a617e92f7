"""Synthetic headset and controllers with orientations.

INPUTS: a performance, a duration, a seed.
OUTPUTS: in a folder ``markers.csv`` (places and quaternions at 90 Hz), ``truth.trc`` with every
landmark, and ``recording.toml``, which uses the quaternions or leaves them alone. No video: what
orientation tells of a wrist needs none.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from jaxmocap.formats.cameras.calibration import write_calibration
from jaxmocap.formats.recordings.recording import write_recording
from jaxmocap.formats.time_series.csv import write_csv
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.synthetic import recording as synthetic
from jaxmocap.synthetic.movements import motions
from jaxmocap.synthetic.movements.motions import Performance
from jaxmocap.synthetic.recording import MARKER_RATE, marker_noise
from jaxmocap.synthetic.renderer import render_frames

# White noise of a device's orientation, radians about each axis.
JITTER_RAD = np.deg2rad(0.3)


class Device(NamedTuple):
    """A device held in the hand or worn.

    Attributes:
        bone: that it is fixed to, at the bone's joint.
        offset_bone: (3,) metres, from there to the device, in the bone's axes.
        R_bone_device: (3, 3) how it is held.
    """

    bone: str
    offset_bone: np.ndarray
    R_bone_device: np.ndarray


def _device(bone: str, offset_bone: tuple[float, float, float], *turns: float) -> Device:
    held = Rotation.from_euler("ZYX", turns, degrees=True).as_matrix()
    return Device(bone, np.array(offset_bone), held)


# The grips lie 10 cm from the wrists, in the palm, and point along the thumb.
DEVICES = {
    "Headset": _device("head", (0.10, 0.0, 0.07), 0, 8, 0),
    "LeftController": _device("hand_l", (0.02, -0.015, -0.0968), 10, -35, 5),
    "RightController": _device("hand_r", (0.02, 0.015, -0.0968), -10, -35, -5),
}


def write_controllers(
    directory: str | Path,
    performance: Performance,
    seconds: float,
    seed: int = 0,
    oriented: bool = True,
) -> Path:
    """Write the recording of a performance by a head-set and two controllers.

    Args:
        directory: is made where missing.
        performance: any.
        seconds: duration.
        seed: of the noise.
        oriented: whether the recording uses the quaternions; without them the controllers' places
            are tied to hands that are stiff at the wrist.

    Returns:
        The path of ``recording.toml``.
    """
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    times = np.arange(int(seconds * MARKER_RATE)) / MARKER_RATE
    points, turns = device_samples(performance, times, seed)
    figure = performance.figure
    write_csv(directory / "markers.csv", times, points, turns)
    truth = figure.landmarks(performance.bones(times))
    write_trc(directory / "truth.trc", times, truth, rate=MARKER_RATE)
    subject: dict[str, Any] = {"height": figure.height, "proportions": "winter", "wrists": oriented}
    return write_recording(directory, "markers.csv", device_places(oriented), subject=subject)


def device_samples(
    performance: Performance, times: np.ndarray, seed: int = 0
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """What the devices tell at (T,) seconds: (T, 3) places and (T, 3, 3) turns, with noise."""
    bones, figure = performance.bones(times), performance.figure
    rng = np.random.default_rng([seed, 5])
    noise = marker_noise(times, len(DEVICES), rng)
    points, turns = {}, {}
    for i, (name, device) in enumerate(DEVICES.items()):
        offset: Any = device.offset_bone
        points[name] = figure.points(bones, device.bone, 0.0, offset) + noise[:, i]
        R = bones.R_world_bone[:, figure.skeleton.tree.bone(device.bone)] @ device.R_bone_device
        shake = Rotation.from_rotvec(rng.normal(0, JITTER_RAD, (len(times), 3)))
        turns[name] = shake.as_matrix() @ R
    return points, turns


def pivoting(
    times: np.ndarray,
    seed: int = 0,
    swing_deg: tuple[float, float, float] = (30.0, 25.0, 15.0),
    stray_m: float = 0.003,
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """What devices tell at (T,) seconds that turn about joints which nearly rest.

    Args:
        times: seconds.
        seed: of motion and noise.
        swing_deg: how far each turns about its bone's left, forward and upright axes.
        stray_m: how far each joint wanders, metres.

    Returns:
        (T, 3) places and (T, 3, 3) turns, with noise.
    """
    rng = np.random.default_rng([seed, 6])
    noise = marker_noise(times, len(DEVICES), rng)
    joints = {"head": (0.0, 0.0, 1.5), "hand_l": (0.3, 0.2, 0.8), "hand_r": (0.3, -0.2, 0.8)}
    points, turns = {}, {}
    for i, (name, device) in enumerate(DEVICES.items()):
        paces, starts = rng.uniform(2.0, 5.0, (2, 3)), rng.uniform(0, 6, (2, 3))
        swings = np.radians(swing_deg) * np.sin(times[:, None] * paces[0] + starts[0])
        R = Rotation.from_euler("YXZ", swings).as_matrix() @ device.R_bone_device
        offset = device.R_bone_device.T @ device.offset_bone
        joint = joints[device.bone] + stray_m * np.sin(times[:, None] * paces[1] / 3 + starts[1])
        points[name] = joint + R @ offset + noise[:, i]
        shake = Rotation.from_rotvec(rng.normal(0, JITTER_RAD, (len(times), 3)))
        turns[name] = shake.as_matrix() @ R
    return points, turns


def device_places(oriented: bool) -> dict[str, dict[str, Any]]:
    """The table [markers.on] of the devices."""
    places: dict[str, dict[str, Any]] = {}
    for name, device in DEVICES.items():
        place = {"bone": device.bone, "at": 0.0, "offset": device.offset_bone.tolist()}
        if oriented:
            held = Rotation.from_matrix(device.R_bone_device)
            place["offset"] = held.inv().apply(device.offset_bone).tolist()
            place |= {"offset_in": "marker"}
            place |= {"turn": held.as_quat(scalar_first=True).tolist()}
        places[name] = place
    return places


# A head that turns --------------------------------------------------------------------------------


# Seconds, and where the head looks then, degrees.
LOOKS_S = (0.0, 1.0, 1.4, 2.4, 2.8, 3.6, 4.0, 5.0, 5.4, 60.0)
LOOKS_DEG = (0.0, 0.0, 60.0, 60.0, 0.0, 0.0, -60.0, -60.0, 0.0, 0.0)
# The channel of the head's yaw.
GAZE = 8


@dataclass(frozen=True)
class TurningHead:
    """Posture channels with the head turned."""

    curves: Any

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """(T, 22) at (T,) seconds."""
        channels = np.array(self.curves(times))
        channels[:, GAZE] += np.radians(PchipInterpolator(LOOKS_S, LOOKS_DEG)(times))
        return channels


def write_turning_head(
    folder: Path, seconds: float = 3.0, seed: int = 0, oriented: bool = True, filmed: bool = True
) -> tuple[Path, np.ndarray]:
    """Write it; the recording, and (T, 3, 3) the head's orientation at each sample."""
    base = motions.reaching(seconds, seed)
    performance = Performance(base.figure, TurningHead(base.curves), base.starts)  # type: ignore[arg-type]
    times = np.arange(int(seconds * synthetic.MARKER_RATE)) / synthetic.MARKER_RATE
    points, turns = device_samples(performance, times, seed)
    write_csv(folder / "markers.csv", times, points, turns)
    bones = performance.bones(times)
    truth = performance.figure.landmarks(bones)
    write_trc(folder / "truth.trc", times, truth, rate=synthetic.MARKER_RATE)
    videos = []
    if filmed:
        frames = render_frames(synthetic.scene(performance, seed), synthetic.video_times(seconds))
        synthetic.write_video(folder / "video.mp4", frames)
        write_calibration(folder / "calibration.toml", {synthetic.CAMERA: synthetic.webcam()})
        offset = synthetic.VIDEO_OFFSET_S
        videos = [{"file": "video.mp4", "camera": synthetic.CAMERA, "offset": offset}]
    # The controllers by their positions, as before anybody has measured how they are held.
    places = device_places(False)
    if oriented:
        places["Headset"] = device_places(True)["Headset"]
    subject = {"height": performance.figure.height, "wrists": oriented, "proportions": "winter"}
    path = write_recording(
        folder, "markers.csv", places, videos=videos,
        calibration_file="calibration.toml" if filmed else None, subject=subject,
    )  # fmt: skip
    head = performance.figure.skeleton.tree.bone("head")
    return path, bones.R_world_bone[:, head]
