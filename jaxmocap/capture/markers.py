"""Markers at any time, between the samples that were taken.

INPUTS: sample times (T,) in seconds, positions (T, M, 3) with NaN where missing, times to look at.
OUTPUTS: positions (K, M, 3) at those times; NaN where they are missing.
"""

from bisect import bisect_right

import numpy as np

from jaxmocap.formats.time_series.tables import usual_step

# Neighbouring samples further apart than this many median intervals are a gap, not a motion.
GAP_INTERVALS = 3.0
# So is a step that would be faster than this, metres per second: no hand is.
MAX_SPEED_M_S = 50.0


def interpolate_markers(
    times: np.ndarray, positions: np.ndarray, at: np.ndarray, causal: bool = False
) -> np.ndarray:
    """Linear in time between samples (T, M, 3), metres; at a sample's own time that sample.

    Unknown, and NaN, where either neighbour is missing, where the neighbours lie further apart
    than three median intervals or than a marker can go meanwhile, and further than half an
    interval outside the samples. With ``causal`` the line goes through the newest two samples that
    are not later and is followed for one interval at most.

    Returns:
        (K, M, 3) metres at (K,) times, seconds, in any order.
    """
    times, positions, at = (np.asarray(a, float) for a in (times, positions, at))
    newest = np.searchsorted(times, at, side="right") - 1
    exact = (newest >= 0) & (times[newest] == at)
    if len(times) < 2:
        return np.where(exact[:, None, None], positions[newest], np.nan)
    interval = usual_step(times)
    first = np.clip(newest - 1 if causal else newest, 0, len(times) - 2)
    start, end = times[first], times[first + 1]
    if causal:
        is_valid = (newest >= 1) & (at - end <= interval)
    else:
        is_valid = (at - times[-1] <= interval / 2) & (times[0] - at <= interval / 2)
    is_valid &= end - start <= GAP_INTERVALS * interval
    weight, step = (at - start) / (end - start), positions[first + 1] - positions[first]
    is_valid = is_valid[:, None] & (
        np.linalg.norm(step, axis=-1) <= MAX_SPEED_M_S * (end - start)[:, None]
    )
    line = positions[first] + weight[:, None, None] * step
    line = np.where(is_valid[..., None], line, np.nan)
    return np.where(exact[:, None, None], positions[newest], line)


# Samples of each marker are remembered for so many seconds, and so many at least, of which so many
# about a time tell the marker's rate there.
KEPT_S, KEPT_SAMPLES = 1.0, 12
# Who is late by less of an interval still comes; until then it is where one interval led.
LATE_INTERVALS = 1.6


class RecentMarkers:
    """The newest samples of M markers, each at its own rate."""

    def __init__(self, markers: int, delay_s: float = 0.0):
        """Of so many markers, without a sample yet; asked for times so long ago, too."""
        self._kept_s = KEPT_S + delay_s
        self._times: list[list[float]] = [[] for _ in range(markers)]
        self._points: list[list[np.ndarray]] = [[] for _ in range(markers)]

    def add(self, time: float, positions_world: np.ndarray) -> None:
        """A sample (M, 3), later than the last; NaN where missing."""
        for marker, point in enumerate(positions_world):
            if np.isfinite(point).all():
                times, points = self._times[marker], self._points[marker]
                times.append(time)
                points.append(point)
                if len(times) > KEPT_SAMPLES and times[0] < time - self._kept_s:
                    del times[0], points[0]

    def at(self, time: float) -> np.ndarray:
        """(M, 3) metres: between samples on a line, which is followed for one interval."""
        positions = np.full((len(self._times), 3), np.nan)
        for marker, (times, points) in enumerate(zip(self._times, self._points, strict=True)):
            if times:
                newest = bisect_right(times, time)
                first = max(0, min(newest - KEPT_SAMPLES // 2, len(times) - KEPT_SAMPLES))
                about = slice(first, first + KEPT_SAMPLES)
                samples = np.array(times[about]), np.array(points[about])[:, None]
                ahead = time - times[-1]
                if 0 < ahead <= LATE_INTERVALS * (interval := usual_step(samples[0])):
                    time_there = times[-1] + min(ahead, (1 - 1e-6) * interval)
                else:
                    time_there = time
                at = np.array([time_there])
                positions[marker] = interpolate_markers(*samples, at, causal=ahead > 0)[0, 0]
        return positions
