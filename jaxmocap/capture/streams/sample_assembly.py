"""Markers that arrive one by one, assembled into samples.

INPUTS: names, positions and orientations as a sender has them. OUTPUTS: MarkerSamples: all
markers of one moment, and the points on bones that oriented markers measure.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxmocap.body.orientations import matrices
from jaxmocap.capture.frozen_markers import frozen_step, initial_state
from jaxmocap.capture.streams.osc import MarkerMessage

# A marker that was not sent for so long is not waited for, seconds.
SENT_WITHIN_S = 0.25
# Of one moment are markers that come within so many seconds.
TOGETHER_S = 0.005
# A message that is older than its marker's last by less was overtaken; by more, a clock was set.
OVERTAKEN_S = 0.1
# Where orientations come in messages of their own, the last one counts for so many seconds.
ORIENTATION_VALID_S = 0.05


class MarkerMeasurements(NamedTuple):
    """What the senders measured of M markers."""

    positions_world: np.ndarray  # (M, 3) metres; NaN where missing
    # (M, 3, 3) from their own axes, taken to the world's as the sender's are; NaN where missing.
    orientations_world: np.ndarray


class MarkerSample(NamedTuple):
    """All points at one time."""

    time: float  # seconds
    positions_world: np.ndarray  # (P, 3) metres of the points on bones; NaN where missing
    arrived: float  # when its last packet came in, seconds on the same clock
    # What they were made of; None where markers are the points.
    measurements: MarkerMeasurements | None = None


class SampleAssembler:
    """Gives out a sample when every marker that is still sent has come, or one comes again.

    Attributes:
        unknown_names: names that were sent and are no markers of ours, at most ``MAX_UNKNOWN``.
    """

    MAX_UNKNOWN = 16

    def __init__(
        self,
        markers: Sequence[str],
        aliases: Mapping[str, str],
        R_world_source: np.ndarray,
        on_sample: Callable[[MarkerSample], None],
        bind: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
    ):
        """Begin with no marker.

        Args:
            markers: names of the M markers.
            aliases: a sender's name -> marker.
            R_world_source: (3, 3) to the world's axes.
            on_sample: called with every sample.
            bind: positions (M, 3) and orientations (M, 3, 3) to points on bones (P, 3); without it
                the markers are the points.
        """
        self._index = {name: i for i, name in enumerate(markers)}
        self._index |= {name: self._index[marker] for name, marker in aliases.items()}
        self._names, self._R_world_source = tuple(markers), R_world_source
        self._on_sample, self._bind = on_sample, bind
        self._last_arrivals = np.full(len(markers), -np.inf)
        self._last_sent = np.full(len(markers), -np.inf)
        self._messages: dict[int, MarkerMessage] = {}
        self._orientations: dict[int, tuple[float, MarkerMessage]] = {}
        self._time, self._arrived, self._last_time = 0.0, 0.0, -np.inf
        self._frozen_state = initial_state(len(markers))
        self._is_frozen = np.zeros(len(markers), bool)
        self.unknown_names: set[str] = set()

    def add(
        self, messages: Iterable[MarkerMessage], time: float, arrived: float, is_complete: bool
    ) -> bool:
        """Take what one packet brought, by when it was sent and when it came in, seconds.

        Where it ``is_complete``, nothing else belongs to it, no earlier orientation either.
        Whether any of it is about a marker of ours.
        """
        found = [(each, self._marker(each)) for each in messages]
        if self._messages and (is_complete or time - self._time > TOGETHER_S):
            self._flush()
        if is_complete:
            # Nobody who looks meanwhile misses one that comes again.
            again = {marker for each, marker in found if each.orientation is not None}
            for each, marker in found:
                if each.position is not None and marker is not None and marker not in again:
                    self._orientations.pop(marker, None)
        for each, marker in found:
            if marker is None:
                continue
            if each.orientation is not None:
                self._orientations[marker] = arrived, each
            if each.position is None:
                continue
            # Networks change the order of packets: where it was before, it is no more.
            if self._last_sent[marker] - OVERTAKEN_S < time < self._last_sent[marker]:
                continue
            self._last_sent[marker] = time
            if marker in self._messages:
                self._flush()
            if not self._messages:
                self._time = time
            self._messages[marker], self._last_arrivals[marker] = each, arrived
            self._arrived = arrived
        alive = np.flatnonzero(arrived - self._last_arrivals < SENT_WITHIN_S)
        if self._messages and (is_complete or len(self._messages) >= len(alive)):
            self._flush()
        return any(marker is not None for _, marker in found)

    def has_marker(self, name: str) -> bool:
        """Whether a sender's name is a marker's."""
        return name in self._index

    def oriented_markers(self) -> set[str]:
        """Markers that have come with an orientation."""
        return {self._names[i] for i in tuple(self._orientations)}

    def placed_markers(self) -> set[str]:
        """Markers that have come with a position."""
        return {self._names[i] for i in np.flatnonzero(np.isfinite(self._last_arrivals))}

    def _marker(self, message: MarkerMessage) -> int | None:
        """The marker that a message is about; names of others are remembered, a few of them."""
        marker = next((self._index[name] for name in message.names if name in self._index), None)
        if marker is None and len(self.unknown_names) < self.MAX_UNKNOWN:
            self.unknown_names.add(message.names[0])
        return marker

    def missing(self, now: float) -> list[str]:
        """Markers that do not come in while others do."""
        silent = now - self._last_arrivals > SENT_WITHIN_S
        return [] if silent.all() else [self._names[i] for i in np.flatnonzero(silent)]

    def frozen_markers(self) -> list[str]:
        """Markers that come in and repeat their last place, as those that a device has lost."""
        return [self._names[i] for i in np.flatnonzero(self._is_frozen)]

    def _flush(self) -> None:
        """Give out what is there, in the world's axes, at a time later than the last one's.

        Frozen markers, see ``frozen_markers``, measure no point.
        """
        positions = np.full((len(self._last_arrivals), 3), np.nan)
        quaternions = np.full((len(self._last_arrivals), 4), np.nan)
        for marker, message in self._messages.items():
            positions[marker] = message.position
            arrived, latest = self._orientations.get(marker, (-np.inf, message))
            if latest.orientation is not None and self._arrived - arrived < ORIENTATION_VALID_S:
                x, y, z, w = latest.orientation
                quaternions[marker] = w, x, y, z
        measurements = MarkerMeasurements(
            positions @ self._R_world_source.T,
            self._R_world_source @ matrices(quaternions) @ self._R_world_source.T,
        )
        self._last_time = max(self._time, self._last_time + 1e-4)
        self._messages = {}
        self._frozen_state, self._is_frozen = frozen_step(
            self._frozen_state, self._last_time, positions
        )
        points = np.where(self._is_frozen[:, None], np.nan, measurements.positions_world)
        if self._bind is not None:
            points = self._bind(points, measurements.orientations_world)
        self._on_sample(MarkerSample(self._last_time, points, self._arrived, measurements))
