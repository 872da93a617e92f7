"""Where the markers were of late.

INPUTS: samples, as they come. OUTPUTS: positions at any time near the newest.
"""

from collections import deque

import numpy as np

from jaxmocap.capture.markers import interpolate_markers, median_interval

# So many samples of each marker are remembered.
KEPT_SAMPLES = 12
# Who is late by less of an interval still comes; until then it is where one interval led.
LATE_INTERVALS = 1.6


class RecentMarkers:
    """The newest samples of M markers, each at its own rate."""

    def __init__(self, markers: int):
        """Of so many markers, without a sample yet."""
        self._times = [deque[float](maxlen=KEPT_SAMPLES) for _ in range(markers)]
        self._points = [deque[np.ndarray](maxlen=KEPT_SAMPLES) for _ in range(markers)]

    def add(self, time: float, positions_world: np.ndarray) -> None:
        """A sample (M, 3), later than the last; NaN where missing."""
        for marker, point in enumerate(positions_world):
            if np.isfinite(point).all():
                self._times[marker].append(time)
                self._points[marker].append(point)

    def at(self, time: float) -> np.ndarray:
        """(M, 3) metres: between samples on a line, which is followed for one interval."""
        positions = np.full((len(self._times), 3), np.nan)
        for marker, (times, points) in enumerate(zip(self._times, self._points, strict=True)):
            if times:
                samples = np.array(times), np.array(points)[:, None]
                ahead = time - times[-1]
                if 0 < ahead <= LATE_INTERVALS * (interval := median_interval(samples[0])):
                    time_there = times[-1] + min(ahead, (1 - 1e-6) * interval)
                else:
                    time_there = time
                at = np.array([time_there])
                positions[marker] = interpolate_markers(*samples, at, causal=ahead > 0)[0, 0]
        return positions
