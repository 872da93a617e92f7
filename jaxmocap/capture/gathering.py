"""Markers that arrive one by one, gathered into samples.

INPUTS: names and positions as a sender has them. OUTPUTS: Samples: all markers of one moment.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxmocap.capture.osc import Placed

# A marker that was not sent for so long is not waited for, seconds.
ALIVE_S = 0.25
# Of one moment are markers that come within so many seconds.
TOGETHER_S = 0.005


class Sample(NamedTuple):
    """All markers at one time.

    Attributes:
        time: seconds.
        positions_world: (M, 3) metres; NaN where missing.
        arrived: when its last packet came in, seconds on the same clock.
    """

    time: float
    positions_world: np.ndarray
    arrived: float


class Gathering:
    """Gives out a sample when every marker that is still sent has come, or one comes again.

    Attributes:
        unknown: names that were sent and are no markers of ours, at most ``MOST_UNKNOWN``.
    """

    MOST_UNKNOWN = 16

    def __init__(
        self,
        markers: Sequence[str],
        aliases: Mapping[str, str],
        R_world_source: np.ndarray,
        give: Callable[[Sample], None],
    ):
        """Begin with no marker.

        Args:
            markers: names of the M markers.
            aliases: a sender's name -> marker.
            R_world_source: (3, 3) to the world's axes.
            give: called with every sample.
        """
        self._index = {name: i for i, name in enumerate(markers)}
        self._index |= {name: self._index[marker] for name, marker in aliases.items()}
        self._names, self._R, self._give = tuple(markers), R_world_source, give
        self._heard = np.full(len(markers), -np.inf)
        self._points: dict[int, tuple[float, float, float]] = {}
        self._time, self._arrived, self._last = 0.0, 0.0, -np.inf
        self.unknown: set[str] = set()

    def add(self, placed: Iterable[Placed], time: float, arrived: float, whole: bool) -> None:
        """Take what one packet brought.

        Args:
            placed: its markers.
            time: seconds, when it was sent.
            arrived: seconds, when it came in.
            whole: whether nothing else belongs to it.
        """
        if self._points and (whole or time - self._time > TOGETHER_S):
            self._flush()
        for each in placed:
            marker = next((self._index[name] for name in each.names if name in self._index), None)
            if marker is None:
                if len(self.unknown) < self.MOST_UNKNOWN:
                    self.unknown.add(each.names[0])
                continue
            if marker in self._points:
                self._flush()
            if not self._points:
                self._time = time
            self._points[marker], self._heard[marker] = each.position, arrived
            self._arrived = arrived
        alive = np.flatnonzero(arrived - self._heard < ALIVE_S)
        if self._points and (whole or len(self._points) >= len(alive)):
            self._flush()

    def missing(self, now: float) -> list[str]:
        """Markers that do not come in while others do."""
        silent = now - self._heard > ALIVE_S
        return [] if silent.all() else [self._names[i] for i in np.flatnonzero(silent)]

    def _flush(self) -> None:
        """Give out what is there, at a time that is later than the last one's."""
        positions = np.full((len(self._heard), 3), np.nan)
        positions[list(self._points)] = list(self._points.values())
        self._last = max(self._time, self._last + 1e-4)
        self._points = {}
        self._give(Sample(self._last, positions @ self._R.T, self._arrived))
