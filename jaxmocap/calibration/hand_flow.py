"""How the image moves where the hands are, next to how the hands move.

INPUTS: a video's frames; marker paths, a camera, and by how much the clocks may differ.
OUTPUTS: optical flow of each frame to the next; at any lag, the measured flow and the one that the
markers predict, pixels per frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice, pairwise
from typing import NamedTuple

import cv2
import numpy as np
from scipy.interpolate import CubicSpline

from jaxmocap.capture.filters import butterworth_low_pass
from jaxmocap.capture.markers import GAP_INTERVALS
from jaxmocap.capture.video import FrameSource
from jaxmocap.formats.time_series.tables import usual_step
from jaxmocap.geometry.cameras import Camera, depth, on_host, pixels_per_metre, visible_pixels

# Flow is computed on images of at most so many pixels a side,
MAX_SIDE_PX = 640
# and kept for every second pixel.
STRIDE = 2
# Coarse steps of lags, seconds.
COARSE_STEP_S = 0.01
# Half the side of the square about a hand, metres.
HAND_HALF_SIDE_M = 0.03
# Points along its side: their median is what the hand does, whatever background lies between.
POINTS_PER_SIDE = 5
# Markers are low-passed here, Hz,
SMOOTHING_CUTOFF_HZ = 8.0
# or at this share of their rate where that is less.
SMOOTHING_CUTOFF_SHARE = 0.25


class FlowPair(NamedTuple):
    """Measured and predicted flow at one lag, for K frames and H hands."""

    measured: np.ndarray  # (K, H, 2) flow at the hands, pixels of the image, to the next frame
    predicted: np.ndarray  # (K, H, 2) the same by the markers. Both are NaN where one is missing.


@dataclass(frozen=True)
class MarkerPath:
    """A marker over time, between its samples as well."""

    spline: CubicSpline  # positions over seconds
    times: np.ndarray  # (N,) of the samples that it goes through
    max_interval: float  # seconds between two of them that count as a gap

    @classmethod
    def through(cls, times: np.ndarray, positions: np.ndarray) -> "MarkerPath | None":
        """Through (T, 3) positions at (T,) seconds, NaN where missing; None through too few.

        They are low-passed: a millimetre of jitter from sample to sample would outweigh the hand's
        own acceleration, and the lag would follow the samples' clock.
        """
        present = np.flatnonzero(np.isfinite(positions).all(-1))
        if len(present) < 4:
            return None
        interval = usual_step(times)
        cutoff = min(SMOOTHING_CUTOFF_HZ, SMOOTHING_CUTOFF_SHARE / interval)
        smoothed = butterworth_low_pass(times, positions[:, None], cutoff)[present, 0]
        return cls(CubicSpline(times[present], smoothed), times[present], GAP_INTERVALS * interval)

    def at(self, times: np.ndarray) -> np.ndarray:
        """(K, 3) positions at (K,) seconds; NaN outside the samples and in gaps."""
        after = np.searchsorted(self.times, times).clip(1, len(self.times) - 1)
        is_valid = (times >= self.times[0]) & (times <= self.times[-1])
        is_valid &= self.times[after] - self.times[after - 1] <= self.max_interval
        return np.where(is_valid[:, None], self.spline(times), np.nan)


@dataclass(frozen=True)
class HandFlow:
    """Flow of one stretch of a video, and the hands that it shows."""

    times: np.ndarray  # (K + 1,) marker time of the frames, as the recording has it
    fields: np.ndarray  # (K, H', W', 2) flow to the next frame, pixels of the image
    spacing: float  # pixels of the image between a field's entries
    camera: Camera  # that took them, on the host
    paths: Sequence[MarkerPath]  # of the hands

    @classmethod
    def of_frames(
        cls,
        camera: Camera,
        video: FrameSource,
        paths: Sequence[MarkerPath],
        first: int,
        count: int,
    ) -> "HandFlow":
        """Of ``count`` frames of a camera's video; see ``flow_fields``."""
        fields, spacing = flow_fields(video, first, count)
        # On the host: a few points are projected thousands of times.
        return cls(video.times[first : first + count], fields, spacing, on_host(camera), paths)

    def flow_pair(self, lag: float, place_lag: float | None = None) -> FlowPair:
        """Flow and markers' motion if the video ran ``lag`` seconds later than stated.

        Args:
            lag: seconds to add to the frames' times.
            place_lag: seconds to add for where in the image to look; the lag where None.
        """
        predicted, measured = [], []
        for path in self.paths:
            xy, _ = self._project_hand(path, lag)
            at_xy, radius = self._project_hand(path, lag if place_lag is None else place_lag)
            measured.append(self._around(at_xy[:-1], radius[:-1]))
            predicted.append(np.diff(xy, axis=0))
        pair = FlowPair(np.stack(measured, 1), np.stack(predicted, 1))
        is_valid = np.isfinite(pair.measured + pair.predicted).all(-1, keepdims=True)
        return FlowPair(*(np.where(is_valid, part, np.nan) for part in pair))

    def _project_hand(self, path: MarkerPath, lag: float) -> tuple[np.ndarray, np.ndarray]:
        """(K + 1, 2) pixels of a hand, and (K + 1,) half the side of the square about it."""
        points = path.at(self.times + lag)
        is_valid = np.isfinite(points).all(-1)
        xy = np.full((len(points), 2), np.nan)
        if is_valid.any():
            xy[is_valid] = visible_pixels(self.camera, points[is_valid])
        metre = pixels_per_metre(self.camera, depth(self.camera, points))
        return xy, HAND_HALF_SIDE_M * np.asarray(metre)

    def _around(self, xy: np.ndarray, radius: np.ndarray) -> np.ndarray:
        """(K, 2) median of each field in the square about (K, 2) pixels; NaN outside the image."""
        side = np.linspace(-1, 1, POINTS_PER_SIDE)
        square = np.stack(np.meshgrid(side, side), -1).reshape(-1, 2)
        cells = (xy[:, None] + square * radius[:, None, None]) / self.spacing
        height, width = self.fields.shape[1:3]
        within = (cells > -0.5) & (cells < [width - 0.5, height - 0.5])
        inside = np.asarray(within.all((1, 2)))
        columns, rows = np.moveaxis(np.rint(np.where(inside[:, None, None], cells, 0)), -1, 0)
        frames = np.arange(len(xy))[:, None]
        values = self.fields[frames, rows.astype(int), columns.astype(int)].astype(float)
        return np.where(inside[:, None], np.median(values, 1), np.nan)


def correlations(flow: HandFlow, search: float) -> tuple[np.ndarray, np.ndarray]:
    """Lags (K,), seconds, and the correlation at each; -1 where neither moves."""
    lags = np.arange(-search, search + COARSE_STEP_S / 2, COARSE_STEP_S)
    scores = np.array([correlation(flow.flow_pair(lag)) for lag in lags])
    return lags, np.nan_to_num(scores, nan=-1.0)


def correlation(pair: FlowPair) -> float:
    """Of flow and markers' motion, as vectors about zero; NaN where neither moves."""
    measured, predicted = (np.nan_to_num(part) for part in pair)
    size = np.sqrt((measured**2).sum() * (predicted**2).sum())
    return float((measured * predicted).sum() / size) if size > 0 else float("nan")


def flow_fields(video: FrameSource, first: int, count: int) -> tuple[np.ndarray, float]:
    """Dense flow between ``count`` frames from the ``first`` one on.

    Returns:
        (count - 1, H', W', 2) pixels of the image, NaN where a frame cannot be read, and the
        spacing of its entries in pixels of the image.
    """
    scale = min(1.0, MAX_SIDE_PX / max(video.size))
    width, height = (round(side * scale) for side in video.size)
    solver = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    images = (
        image if image is None else cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        for _, image in islice(video.frames(luma=True), first, first + count)
    )
    fields = []
    for last, image in pairwise(images):
        if last is None or image is None:
            flow = np.full((height, width, 2), np.nan)
        else:
            flow = solver.calc(last, image, np.zeros((height, width, 2), np.float32))
        fields.append((flow[::STRIDE, ::STRIDE] / scale).astype(np.float16))
    return np.stack(fields), STRIDE / scale
