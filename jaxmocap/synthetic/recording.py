"""Synthetic recordings on disk, which capture reads like any other.

INPUTS: a folder, a duration, a seed.
OUTPUTS: in that folder ``recording.toml``, ``markers.trc`` (headset and two controllers at 90 Hz),
``video.mp4`` (640 x 480 at 30 Hz), ``calibration.toml``, and ``truth.trc`` with every landmark at
the markers' times, world, metres, Z up.
"""

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import av
import numpy as np

from jaxmocap.body.skeleton import WINTER
from jaxmocap.formats.cameras.calibration import write_calibration
from jaxmocap.formats.cameras.video_out import replacing_video
from jaxmocap.formats.recordings.recording import write_recording
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.geometry.cameras import Camera
from jaxmocap.synthetic.drawing_camera import look_at
from jaxmocap.synthetic.movements import motions
from jaxmocap.synthetic.movements.motions import Performance
from jaxmocap.synthetic.people.clothed_person import MARKERS, clothed_actor
from jaxmocap.synthetic.renderer import Progress, RotatedMover, Scene, camera_at, render_frames

# Samples a second of the markers.
MARKER_RATE = 90
# Frames a second of the video.
VIDEO_RATE = 30
# Marker time of the first frame's middle of exposure: the two clocks never tick together.
VIDEO_OFFSET_S = 0.0073
CAMERA = "webcam"
# Errors of a consumer headset: white noise, standard deviation on each axis, metres.
JITTER_M = 0.001
# And a drift, its root mean square, metres.
DRIFT_M = 0.005
# No error is larger, metres.
LARGEST_ERROR_M = 0.013
# Shortest and longest period of the drift, seconds.
DRIFT_PERIODS_S = (2.5, 15.0)
# Waves of each axis that make the drift.
DRIFT_WAVES = 4


class RecordingParts(NamedTuple):
    """What the files of a recording hold, but for its video."""

    times: np.ndarray  # (T,) of the markers, seconds
    markers: dict[str, np.ndarray]  # name -> (T, 3) without noise, world, metres
    landmarks: dict[str, np.ndarray]  # name -> (T, 3) the truth
    camera: Camera  # of the video
    places: Mapping[str, Mapping[str, Any]]  # the table [markers.on]
    subject: Mapping[str, Any]  # the table [subject]


def write_table_tennis(
    directory: str | Path,
    seconds: float = 6.0,
    seed: int = 0,
    strokes: Sequence[str] = ("forehand", "backhand", "serve"),
    height: float = 1.75,
    progress: Progress | None = None,
    azimuth: float | None = None,
    furnished: bool = True,
    detail: int = 1,
) -> Path:
    """Write a recording of table-tennis strokes.

    Args:
        directory: is made where missing.
        seconds: duration.
        seed: of person, clothes, room, strokes and noise.
        strokes: played in turn.
        height: of the person, as the recording states it, metres.
        progress: called with the frames done and their total.
        azimuth: where the camera stands, degrees from frontal, positive to the person's left;
            None is ``webcam()``.
        furnished: a room full of edges; or a bare one.
        detail: of the person, see ``clothed_actor``.

    Returns:
        The path of ``recording.toml``.
    """
    performance = motions.table_tennis(seconds, seed, strokes, height)
    shown = progress, azimuth, furnished, detail
    return write_performance(directory, performance, seconds, seed, *shown)


def write_performance(
    directory: str | Path,
    performance: Performance,
    seconds: float,
    seed: int = 0,
    progress: Progress | None = None,
    azimuth: float | None = None,
    furnished: bool = True,
    detail: int = 1,
) -> Path:
    """Write the recording of any performance, seen by one camera; see ``write_table_tennis``."""
    camera = webcam() if azimuth is None else camera_at(azimuth)
    parts = recording_parts(performance, seconds, camera)
    shown = scene(performance, seed, azimuth, furnished, detail)
    frames = render_frames(shown, video_times(seconds), progress)
    return write_parts(Path(directory), parts, frames, seed)


def recording_parts(performance: Performance, seconds: float, camera: Camera) -> RecordingParts:
    """What headset and controllers measure of a performance that a camera films."""
    times = np.arange(int(seconds * MARKER_RATE)) / MARKER_RATE
    bones, figure = performance.bones(times), performance.figure
    return RecordingParts(
        times,
        markers={name: figure.points(bones, *on) for name, on in MARKERS.items()},
        landmarks=figure.landmarks(bones),
        camera=camera,
        places=marker_places(),
        subject={"height": figure.height, "proportions": WINTER},
    )


def webcam() -> Camera:
    """In front of the person, a little to the side, at 3 m."""
    return look_at((3.0, 0.75, 1.30), (0.1, 0.0, 1.12))


def scene(
    performance: Performance,
    seed: int = 0,
    azimuth: float | None = None,
    furnished: bool = True,
    detail: int = 1,
) -> Scene:
    """A performance before the camera at that azimuth; None is ``webcam()``."""
    actor = clothed_actor(performance, seed, detail)
    if azimuth is None:
        return Scene.in_room(webcam(), actor, seed, furnished)
    return Scene.in_room(camera_at(0.0), RotatedMover(actor, azimuth), seed, furnished)


def video_times(seconds: float) -> np.ndarray:
    """Marker times (F,) of the video's frames."""
    return VIDEO_OFFSET_S + np.arange(int(seconds * VIDEO_RATE)) / VIDEO_RATE


def marker_places() -> dict[str, dict[str, Any]]:
    """The table [markers.on] of headset and controllers."""
    return {
        name: {"bone": bone, "at": at, "offset": list(offset)}
        for name, (bone, at, offset) in MARKERS.items()
    }


def write_parts(
    directory: Path, parts: RecordingParts, frames: Iterable[np.ndarray], seed: int
) -> Path:
    """Write every file of a recording; the path of its ``recording.toml``.

    Frames (H, W, 3), BGR uint8, are at ``video_times``; the seed is of the markers' noise.
    """
    directory.mkdir(parents=True, exist_ok=True)
    noise = marker_noise(parts.times, len(parts.markers), np.random.default_rng([seed, 4]))
    measured = {name: path + noise[:, i] for i, (name, path) in enumerate(parts.markers.items())}
    write_trc(directory / "markers.trc", parts.times, measured, rate=MARKER_RATE)
    write_trc(directory / "truth.trc", parts.times, parts.landmarks, rate=MARKER_RATE)
    write_calibration(directory / "calibration.toml", {CAMERA: parts.camera})
    write_video(directory / "video.mp4", frames)
    return write_recording(
        directory,
        "markers.trc",
        parts.places,
        videos=[{"file": "video.mp4", "camera": CAMERA, "offset": VIDEO_OFFSET_S}],
        calibration_file="calibration.toml",
        subject=parts.subject,
    )


def marker_noise(times: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Errors (T, count, 3) of a consumer headset, metres, never above ``LARGEST_ERROR_M``."""
    shape = (1, count, 3, DRIFT_WAVES)
    frequencies = 2 * np.pi / rng.uniform(*DRIFT_PERIODS_S, shape)
    phases = rng.uniform(0, 2 * np.pi, shape)
    # Three axes of so many waves, each of mean square 1/2.
    amplitude = DRIFT_M / np.sqrt(1.5 * DRIFT_WAVES)
    drift = amplitude * np.cos(times[:, None, None, None] * frequencies + phases).sum(-1)
    error = drift + rng.normal(0, JITTER_M, drift.shape)
    size = np.linalg.norm(error, axis=-1, keepdims=True)
    return error * np.minimum(1.0, LARGEST_ERROR_M / np.maximum(size, 1e-12))


def write_video(path: Path, frames: Iterable[np.ndarray], rate: int = VIDEO_RATE) -> None:
    """Encode frames (H, W, 3), BGR uint8, as H.264 that any player plays."""
    with replacing_video(path) as file:
        stream: av.VideoStream = file.container.add_stream("libx264", rate=rate)
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "18", "preset": "veryfast"}
        for i, image in enumerate(frames):
            if i == 0:
                stream.height, stream.width = image.shape[:2]
            frame = av.VideoFrame.from_ndarray(image, format="bgr24")
            frame.pts, frame.time_base = i, Fraction(1, rate)
            file.write(stream.encode(frame))
        file.write(stream.encode())
