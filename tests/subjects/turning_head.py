"""Somebody who reaches about and turns the head by 60°, to either side, for 1.4 seconds each.

INPUTS: a folder, a seed. OUTPUTS: a recording by headset and controllers with one video, or
without; the head's true orientation.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from held_devices import device_places, device_samples
from scipy.interpolate import PchipInterpolator

from jaxmocap.formats.cameras.calibration import write_calibration
from jaxmocap.formats.recordings.recording import write_recording
from jaxmocap.formats.time_series.csv import write_csv
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.synthetic import recording as synthetic
from jaxmocap.synthetic.movements import motions
from jaxmocap.synthetic.movements.motions import Performance
from jaxmocap.synthetic.renderer import render_frames

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
