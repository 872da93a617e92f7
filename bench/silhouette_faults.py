"""What goes wrong with cameras, done to good recordings: torn, black, exchanged, hidden, gone.

INPUTS: videos in memory with their cameras, and where the joints truly are.
OUTPUTS: Faulty videos, with what was done to them and when.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxmocap.capture.video import open_video
from jaxmocap.formats.recordings.recording import VideoSource
from jaxmocap.geometry.cameras import Camera, project

# One frame of so many is corrupted, and which of a second's frames a limb is hidden from.
EVERY, HIDDEN_FROM, HIDDEN_S = 10, 0.2, 1.0
# Around a hidden limb, pixels; the box is of a plain grey.
AROUND, GREY = 22, 128
LIMB = ("elbow_l", "wrist_l", "hand_l")
# Joints whose angles nobody can tell while that limb is hidden.
HIDDEN_JOINTS = ("elbow_flex_l",)


class Span(NamedTuple):
    """A fault of frames ``start`` to ``stop`` (excluded).

    Attributes:
        start: the first frame.
        stop: the frame after the last, or after the first of a fault that stays.
        cameras: names of those that show nothing of use.
        joints: that no camera can show.
    """

    start: int
    stop: int
    cameras: tuple[str, ...] = ()
    joints: tuple[str, ...] = ()


class Faulty(NamedTuple):
    """Videos with faults.

    Attributes:
        videos: one of each camera.
        spans: in order of time.
        fewer: cameras that are left from the fault on, where it stays.
    """

    videos: tuple[VideoSource, ...]
    spans: tuple[Span, ...]
    fewer: tuple[str, ...] = ()


Truth = dict[str, np.ndarray]
Fault = Callable[[Sequence[VideoSource], Truth], Faulty]


def in_memory(source: VideoSource) -> VideoSource:
    """A video whose frames were all decoded."""
    times, images = zip(*open_video(source).frames(), strict=True)
    return replace(source, path=None, offset=0.0, frames=(np.array(times), list(images)))


def one_corrupted(videos: Sequence[VideoSource], truth: Truth) -> Faulty:
    """Every tenth frame of one camera after the other is torn, black or another camera's."""
    return _corrupted(videos, lambda number: [number % len(videos)])


def all_corrupted(videos: Sequence[VideoSource], truth: Truth) -> Faulty:
    """The same of all cameras at once."""
    return _corrupted(videos, lambda number: range(len(videos)))


def _corrupted(
    videos: Sequence[VideoSource], which: Callable[[int], Sequence[int] | range]
) -> Faulty:
    images, spans = [list(_images(video)) for video in videos], []
    old = [list(each) for each in images]
    for number, frame in enumerate(range(EVERY, len(images[0]), EVERY)):
        broken = which(number // 3 if len(which(0)) == 1 else number)
        for camera in broken:
            image, other = old[camera][frame], old[(camera + 1) % len(old)][frame]
            images[camera][frame] = (torn(image), np.zeros_like(image), other)[number % 3]
        spans.append(Span(frame, frame + 1, tuple(videos[c].camera_name for c in broken)))
    return Faulty(_with(videos, images), tuple(spans))


def torn(image: np.ndarray) -> np.ndarray:
    """The lower part of an image shifted by a third of its width, as of a frame that came late."""
    cut = image.shape[0] * 2 // 5
    return np.concatenate([image[:cut], np.roll(image[cut:], image.shape[1] // 3, 1)])


def camera_lost(videos: Sequence[VideoSource], truth: Truth) -> Faulty:
    """The second camera ends midway."""
    middle = len(_images(videos[0])) // 2
    gone = videos[1 % len(videos)]
    assert gone.frames is not None
    times, images = gone.frames
    cut = replace(gone, frames=(times[:middle], images[:middle]))
    left = tuple(video.camera_name for video in videos if video is not gone)
    span = Span(middle, middle + 1, (gone.camera_name,))
    return Faulty(tuple(cut if video is gone else video for video in videos), (span,), left)


def limb_hidden(videos: Sequence[VideoSource], truth: Truth) -> Faulty:
    """A box lies over the left forearm and hand in every camera for a second."""
    assert videos[0].frames is not None
    times = np.asarray(videos[0].frames[0])
    start = int(np.searchsorted(times, times[0] + HIDDEN_FROM))
    stop = min(int(np.searchsorted(times, times[start] + HIDDEN_S)), len(times) - 1)
    points = np.stack([truth[name] for name in LIMB], 1)
    images = [list(_images(video)) for video in videos]
    for video, shown in zip(videos, images, strict=True):
        for frame in range(start, stop):
            shown[frame] = _boxed(shown[frame], video.camera, points[frame])
    return Faulty(_with(videos, images), (Span(start, stop, (), HIDDEN_JOINTS),))


def walking_out(videos: Sequence[VideoSource], truth: Truth) -> Faulty | None:
    """The camera across whose image the person walks farthest sees the first part of the way only.

    None where nobody walks.
    """
    ways = [_pixels(video.camera, truth["pelvis"])[:, 0] for video in videos]
    camera = int(np.argmax([abs(way[-1] - way[0]) for way in ways]))
    video, way = videos[camera], ways[camera]
    reach = 0.5 * np.median([_width(each, video.camera) for each in _bodies(truth)])
    edge = round(float(np.median(way)))
    if abs(way[-1] - way[0]) < 3 * reach:
        return None
    rightwards = way[-1] > way[0]
    beyond = way - reach > edge if rightwards else way + reach < edge
    out = int(np.argmax(beyond))
    columns = slice(0, edge) if rightwards else slice(edge, None)
    cut = [image[:, columns].copy() for image in _images(video)]
    shifted = replace(_windowed(video, columns), frames=(_times(video), cut))
    left = tuple(each.camera_name for each in videos if each is not video)
    span = Span(out, out + 1, (video.camera_name,))
    return Faulty(tuple(shifted if v is video else v for v in videos), (span,), left)


FAULTS = {
    "one camera corrupted": one_corrupted,
    "all cameras corrupted": all_corrupted,
    "a camera lost": camera_lost,
    "a limb hidden": limb_hidden,
    "out of a camera": walking_out,
}


def _windowed(video: VideoSource, columns: slice) -> VideoSource:
    """A video of these columns alone."""
    camera, first = video.camera, columns.start or 0
    width = (columns.stop or int(camera.size[0])) - first
    matrix = np.array(camera.matrix)
    matrix[0, 2] -= first
    size = np.array([width, float(camera.size[1])], matrix.dtype)
    cut = replace(camera, matrix=camera.matrix.at[:].set(matrix), size=camera.size.at[:].set(size))
    return replace(video, camera=cut)


def _boxed(image: np.ndarray, camera: Camera, points_world: np.ndarray) -> np.ndarray:
    """An image with a grey box over points (N, 3)."""
    pixels = _pixels(camera, points_world)
    low = np.maximum(np.floor(pixels.min(0) - AROUND).astype(int), 0)
    high = np.maximum(np.ceil(pixels.max(0) + AROUND).astype(int), 0)
    shown = image.copy()
    shown[low[1] : high[1], low[0] : high[0]] = GREY
    return shown


def _bodies(truth: Truth) -> np.ndarray:
    """(T, L, 3) all true joints."""
    return np.stack(list(truth.values()), 1)


def _width(points_world: np.ndarray, camera: Camera) -> float:
    """Pixels from the leftmost to the rightmost of points (L, 3)."""
    return float(np.ptp(_pixels(camera, points_world)[:, 0]))


def _pixels(camera: Camera, points_world: np.ndarray) -> np.ndarray:
    return np.asarray(project(camera, jnp.asarray(points_world, camera.matrix.dtype)))


def _times(video: VideoSource) -> np.ndarray:
    assert video.frames is not None
    return np.asarray(video.frames[0])


def _images(video: VideoSource) -> list[np.ndarray]:
    assert video.frames is not None
    return list(video.frames[1])  # type: ignore[arg-type]


def _with(videos: Sequence[VideoSource], images: list[list]) -> tuple[VideoSource, ...]:
    """The videos with other images."""
    return tuple(
        replace(video, frames=(_times(video), shown))
        for video, shown in zip(videos, images, strict=True)
    )
