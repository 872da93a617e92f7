"""A small recording of somebody who sways before a striped wall: in memory, and as files."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import jax
import numpy as np

from jaxmocap.body.kinematics import forward, landmark_sites, site_positions
from jaxmocap.body.pose import relaxed_pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.formats.cameras.calibration import write_calibration
from jaxmocap.formats.recordings.recording import (
    MarkerPlace,
    Recording,
    VideoSource,
    write_recording,
)
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.synthetic.drawing_camera import look_at
from jaxmocap.synthetic.recording import write_video

# The five end effectors of the paper, as the real recording names and places them.
PLACES = {
    "Head": ("head", "vertex"),
    "LWrist": ("radius_l", "wrist_l"),
    "RWrist": ("radius_r", "wrist_r"),
    "LAnkle": ("tibia_l", "ankle_l"),
    "RAnkle": ("tibia_r", "ankle_r"),
}
SIZE = (96, 72)
HEIGHT = 1.75
SAMPLES, MARKER_RATE, FRAMES, VIDEO_RATE = 24, 60, 12, 30
# What tracking it writes.
OUTPUTS = {"joints.trc", "angles.mot", "motion.npz", "motion.bvh", "motion.glb"}
OUTPUTS |= {"angles_isb.mot", "report.json", "overlay_cam.mp4", "recording.rrd", "outputs.json"}
CAMERA = look_at((3.0, 0.6, 1.3), (0.0, 0.0, 0.95), size=SIZE, focal=95.0, distortion=())


@cache
def standing() -> np.ndarray:
    """(M, 3) places of the markers on somebody who stands on the floor, world, metres."""
    skeleton = Skeleton.human(HEIGHT)
    sites = landmark_sites(skeleton, tuple(landmark for _, landmark in PLACES.values()))
    places = jax.jit(lambda pose: site_positions(skeleton, forward(skeleton, pose), sites))
    points = np.asarray(places(relaxed_pose(skeleton)))
    return points - [0, 0, points[:, 2].min() - 0.08]


def image(seed: int) -> np.ndarray:
    """A frame (H, W, 3), BGR uint8: stripes, noise, and a bright upright shape."""
    rng = np.random.default_rng(seed)
    frame = rng.integers(60, 90, (SIZE[1], SIZE[0], 3))
    frame[:, ::12] += 60
    frame[18:60, 40 + seed % 3 : 56 + seed % 3] += 110
    return frame.astype(np.uint8)


def small_recording() -> Recording:
    """Markers at 60 Hz and frames in memory at 30 Hz, some milliseconds out of step."""
    times = np.arange(SAMPLES) / MARKER_RATE
    sway = 0.04 * np.sin(4 * times)[:, None, None] * [0.0, 1.0, 0.0]
    positions = standing() + np.where(standing()[:, 2:] > 0.3, sway, 0.0)
    places = tuple(MarkerPlace(name, bone) for name, (bone, _) in PLACES.items())
    frames = (np.arange(FRAMES) / VIDEO_RATE, [image(i) for i in range(FRAMES)])
    video = VideoSource("cam", CAMERA, offset=0.004, frames=frames)
    return Recording(Skeleton.human(HEIGHT), times, positions, places, (video,), "small")


def with_outlier_and_gap() -> Recording:
    """The small recording, one sample of a wrist far off, three of the other missing."""
    recording = small_recording()
    recording.positions_world[5, 1] += 0.4
    recording.positions_world[10:13, 2] = np.nan
    return recording


def with_frames(recording: Recording, times: np.ndarray, images: list) -> Recording:
    """The recording with other frames in its one video."""
    return replace(recording, videos=(replace(recording.videos[0], frames=(times, images)),))


@cache
def compiled() -> HybridTracker:
    """The tracker of the small recording: all who use it share its compilation."""
    return HybridTracker.from_recording(small_recording())


def write_small_recording(folder: Path) -> Path:
    """The small recording as files; the path of its ``recording.toml``."""
    recording = small_recording()
    source = recording.videos[0]
    points = dict(zip(PLACES, np.moveaxis(recording.positions_world, 1, 0), strict=True))
    write_trc(folder / "markers.trc", recording.times, points)
    write_calibration(folder / "calibration.toml", {"cam": source.camera})
    assert source.frames is not None
    write_video(folder / "cam.mp4", iter(source.frames[1]), VIDEO_RATE)
    return write_recording(
        folder,
        "markers.trc",
        {name: {"bone": bone} for name, (bone, _) in PLACES.items()},
        videos=[{"file": "cam.mp4", "camera": "cam", "offset": source.offset}],
        calibration_file="calibration.toml",
        subject={"height": HEIGHT},
    )
