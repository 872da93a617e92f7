"""A recording's videos with their backgrounds made flat, so that edges are left before them alone.

What a pixel shows fades into a blurred background as far as it does not differ from what the camera
sees there without the person. Where that was not learned the pixel stays as it is.

INPUTS: a recording, its videos, poses of every frame. OUTPUTS: the recording, videos in memory.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import cv2
import jax
import numpy as np

from jaxmocap.body.model import Model, marker_sites
from jaxmocap.capture.video import FrameSource
from jaxmocap.evidence.appearance.learned import ROWS, Drawing, learn_appearance
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.geometry.cameras import Camera
from jaxmocap.images.background_model import Background, exposure, regained, spread
from jaxmocap.images.foreground import shrink
from jaxmocap.smoothing.batch import CameraFrames
from jaxmocap.smoothing.problem import FirstPass

# Differences, in deviations of the sensor's noise, from which a pixel begins to differ, and does.
ALIKE, DIFFERENT = 2.0, 5.0
# Pixels of the shrunk images by which the background is blurred, and the difference.
FLAT_PX, SOFT_PX = 12.0, 1.5


def flattened(
    recording: Recording, videos: Sequence[FrameSource], first_pass: FirstPass
) -> Recording:
    """The recording with videos whose backgrounds are flat; one that tells none is left as it is.

    Args:
        recording: to be tracked again.
        videos: its own.
        first_pass: whose poses tell where the person covers the background.
    """
    sources = []
    for camera, (source, video) in enumerate(zip(recording.videos, videos, strict=True)):
        background = learned(recording, source.camera, camera, video, first_pass)
        if background is not None:
            frames = video.times, list(_flat_frames(video, background))
            source = replace(source, path=None, frames=frames, offset=0.0)
        sources.append(source)
    return replace(recording, videos=tuple(sources))


def learned(
    recording: Recording, lens: Camera, camera: int, video: FrameSource, first_pass: FirstPass
) -> Background | None:
    """What a camera sees without the person, in its shrunk frames; as the second pass learns it."""
    column = first_pass.frame_index[:, camera]
    events = np.flatnonzero(column >= 0)
    if not len(events):
        return None
    own, chosen = CameraFrames(camera, events, column[events], video), spread(len(events))
    poses = jax.tree.map(lambda part: np.asarray(part)[events], first_pass.poses)
    drawing = Drawing.of(recording.skeleton, lens, video.size, poses)
    sites = marker_sites(recording.skeleton, recording.places)
    feet_astray = Model.create(recording.skeleton, sites).no_foot_is_marked
    appearance = learn_appearance(drawing, chosen, own.images(chosen), feet_astray)
    return None if appearance is None else appearance.background


def _flat_frames(video: FrameSource, background: Background) -> Iterator[np.ndarray | None]:
    """Grey (H, W) uint8."""
    for _, image in video.frames():
        yield None if image is None else flat_frame(image, background)


def flat_frame(image: np.ndarray, background: Background) -> np.ndarray:
    """One frame (H, W, 3) uint8, grey, before its background (h, w) made flat."""
    small = shrink(image, ROWS)
    gains, agreement = exposure(small, background)
    away = (
        np.abs(regained(small, gains).astype(np.float32) - background.colour).max(-1)
        / background.noise
    )
    differs = np.clip((away - ALIKE) / (DIFFERENT - ALIKE), 0, 1)
    # Where the background was not learned, or this is not that room, nothing is alike.
    share = 1 - agreement * background.certainty * (1 - differs)
    size, grey = image.shape[1::-1], cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    share = cv2.resize(cv2.GaussianBlur(share, (0, 0), SOFT_PX), size)
    flat = cv2.cvtColor(cv2.GaussianBlur(background.colour, (0, 0), FLAT_PX), cv2.COLOR_BGR2GRAY)
    mixed = share * grey + (1 - share) * cv2.resize(flat, size)
    return np.rint(mixed).astype(np.uint8)
