"""How the image moves where the hands are, next to how the hands move.

INPUTS: a video's frames; marker paths, a camera, and by how much the clocks may differ.
OUTPUTS: optical flow of each frame to the next; at any lag, what was seen to move and what the
markers say, pixels per frame.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from scipy.interpolate import CubicSpline

from jaxmocap.capture.checks.cameras import pixels_of
from jaxmocap.capture.filters import low_pass
from jaxmocap.capture.markers import GAP_INTERVALS, median_interval
from jaxmocap.capture.video import FrameSource
from jaxmocap.geometry.cameras import Camera, depth, on_host, pixels_per_metre

# Flow is computed on images of at most so many pixels a side, and kept for every second one.
LARGEST_SIDE, STRIDE = 640, 2
# Half the side of the square about a hand, metres, and how many points of it a side has: their
# median is what the hand does, whatever of the background lies between.
HAND_M, POINTS = 0.03, 5
# Markers are low-passed here, Hz, or at this share of their rate where that is less.
SMOOTH_HZ, SMOOTH_SHARE = 8.0, 0.25


class Terms(NamedTuple):
    """What is compared at one lag, for K frames and H hands.

    Attributes:
        seen: (K, H, 2) flow at the hands, pixels of the image, to the next frame.
        told: (K, H, 2) the same by the markers. Both are NaN where one is not known.
    """

    seen: np.ndarray
    told: np.ndarray


@dataclass(frozen=True)
class Path:
    """A marker over time, between its samples as well.

    Attributes:
        spline: positions over seconds.
        times: (N,) of the samples that it goes through.
        longest: seconds between two of them that count as a gap.
    """

    spline: CubicSpline
    times: np.ndarray
    longest: float

    @classmethod
    def through(cls, times: np.ndarray, positions: np.ndarray) -> "Path | None":
        """Through (T, 3) positions at (T,) seconds, NaN where missing; None through too few.

        They are low-passed: a millimetre of jitter from sample to sample would outweigh the hand's
        own acceleration, and the lag would follow the samples' clock.
        """
        seen = np.flatnonzero(np.isfinite(positions).all(-1))
        if len(seen) < 4:
            return None
        interval = median_interval(times)
        cutoff = min(SMOOTH_HZ, SMOOTH_SHARE / interval)
        calm = low_pass(times, positions[:, None], cutoff)[seen, 0]
        return cls(CubicSpline(times[seen], calm), times[seen], GAP_INTERVALS * interval)

    def at(self, times: np.ndarray) -> np.ndarray:
        """(K, 3) positions at (K,) seconds; NaN outside the samples and in gaps."""
        after = np.searchsorted(self.times, times).clip(1, len(self.times) - 1)
        known = (times >= self.times[0]) & (times <= self.times[-1])
        known &= self.times[after] - self.times[after - 1] <= self.longest
        return np.where(known[:, None], self.spline(times), np.nan)


@dataclass(frozen=True)
class HandFlow:
    """Flow of one stretch of a video, and the hands that it shows.

    Attributes:
        times: (K + 1,) marker time of the frames, as the recording has it.
        fields: (K, H', W', 2) flow to the next frame, pixels of the image.
        spacing: pixels of the image between a field's entries.
        camera: that took them.
        paths: of the hands.
    """

    times: np.ndarray
    fields: np.ndarray
    spacing: float
    camera: Camera
    paths: Sequence[Path]

    def terms(self, lag: float, place_lag: float | None = None) -> Terms:
        """Flow and markers' motion if the video ran ``lag`` seconds later than stated.

        Args:
            lag: seconds to add to the frames' times.
            place_lag: seconds to add for where in the image to look; the lag where None.
        """
        told, seen = [], []
        for path in self.paths:
            xy, _ = self._projected(path, lag)
            at_xy, radius = self._projected(path, lag if place_lag is None else place_lag)
            seen.append(self._around(at_xy[:-1], radius[:-1]))
            told.append(np.diff(xy, axis=0))
        terms = Terms(np.stack(seen, 1), np.stack(told, 1))
        known = np.isfinite(terms.seen + terms.told).all(-1, keepdims=True)
        return Terms(*(np.where(known, part, np.nan) for part in terms))

    def _projected(self, path: Path, lag: float) -> tuple[np.ndarray, np.ndarray]:
        """(K + 1, 2) pixels of a hand, and (K + 1,) half the side of the square about it."""
        points = path.at(self.times + lag)
        known = np.isfinite(points).all(-1)
        xy = np.full((len(points), 2), np.nan)
        if known.any():
            xy[known] = pixels_of(self.camera, points[known])
        camera = on_host(self.camera)
        return xy, HAND_M * np.asarray(pixels_per_metre(camera, depth(camera, points)))

    def _around(self, xy: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """(K, 2) median of each field in the square about (K, 2) pixels; NaN outside the image."""
        side = np.linspace(-1, 1, POINTS)
        square = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
        cells = (xy[:, None] + square * radius[:, None, None]) / self.spacing
        height, width = self.fields.shape[1:3]
        within = (cells > -0.5) & (cells < [width - 0.5, height - 0.5])
        inside = np.asarray(within.all((1, 2)))
        columns, rows = np.moveaxis(np.rint(np.where(inside[:, None, None], cells, 0)), -1, 0)
        frames = np.arange(len(xy))[:, None]
        values = self.fields[frames, rows.astype(int), columns.astype(int)].astype(float)
        return np.where(inside[:, None], np.median(values, 1), np.nan)


def flow_fields(video: FrameSource, first: int, count: int) -> tuple[np.ndarray, float]:
    """Dense flow between ``count`` frames from the ``first`` one on.

    Returns:
        (count - 1, H', W', 2) pixels of the image, NaN where a frame cannot be read, and the
        spacing of its entries in pixels of the image.
    """
    scale = min(1.0, LARGEST_SIDE / max(video.size))
    width, height = (round(side * scale) for side in video.size)
    solver = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    images, fields = _small(video, first, count, (width, height)), []
    for last, image in pairwise(images):
        if last is None or image is None:
            flow = np.full((height, width, 2), np.nan)
        else:
            flow = solver.calc(last, image, np.zeros((height, width, 2), np.float32))
        fields.append((flow[::STRIDE, ::STRIDE] / scale).astype(np.float16))
    return np.stack(fields), STRIDE / scale


def _small(
    video: FrameSource, first: int, count: int, size: tuple[int, int]
) -> Iterator[np.ndarray | None]:
    """Grey frames of that width and height, None where one cannot be read."""
    for i, (_, image) in enumerate(video.frames(luma=True)):
        if i >= first + count:
            return
        if i >= first:
            yield None if image is None else cv2.resize(image, size, interpolation=cv2.INTER_AREA)
