"""What is wrong with the markers that come in, while they come.

INPUTS: samples of markers. OUTPUTS: sentences; "" where nothing is wrong.
"""

from collections.abc import Sequence

import numpy as np

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.capture.checks.body_reach import ReachCounts
from jaxmocap.capture.checks.markers import check_up
from jaxmocap.capture.streams.sample_assembly import MarkerSample
from jaxmocap.formats.files.errors import short_name
from jaxmocap.formats.recordings.marker_places import MarkerPlace
from jaxmocap.pipelines.live.status import tenfold

# Fewer samples beyond reach are worth no line.
MIN_SAMPLES = 10
# The vertical is that of so many samples, some seconds of a headset's.
UPRIGHT_SAMPLES = 300


class ReachState:
    """Counts the samples whose markers are too far from one another.

    Attributes:
        state: which marker is, how far and how often; "" where none is. It changes with every
            tenfold of their number.
    """

    def __init__(self, skeleton: Skeleton, places: Sequence[MarkerPlace]):
        """Of markers at these places; no sample yet."""
        self._counts, self._names = ReachCounts(skeleton, places), [p.name for p in places]
        self._next, self.state = MIN_SAMPLES, ""

    def add(self, sample: MarkerSample) -> None:
        """Take a sample."""
        worst = self._counts.worst() if self._counts.add(_measured(sample)[None]) else None
        if worst is None or worst.samples < self._next:
            return
        self._next *= 10
        marker, other = (short_name(self._names[i]) for i in (worst.marker, worst.other))
        reach = f"this body reaches {worst.allowed_m:.2f} m"
        self.state = (
            f"{marker} is up to {worst.farthest_m:.2f} m from {other}, {reach} "
            f"({tenfold(worst.samples)} samples)"
        )


class UprightState:
    """Whether the person stands along another axis than the world's vertical.

    Attributes:
        state: along which, by the first samples in which that is so; "" where it is not.
    """

    def __init__(self, skeleton: Skeleton, places: Sequence[MarkerPlace]):
        """Of markers at these places; no sample yet."""
        self._skeleton, self._places, self.state = skeleton, places, ""
        self._positions: list[np.ndarray] = []

    def add(self, sample: MarkerSample) -> None:
        """Take a sample."""
        self._positions.append(_measured(sample))
        if len(self._positions) < UPRIGHT_SAMPLES:
            return
        positions = np.stack(self._positions)
        self._positions = []
        finding = next(check_up(self._skeleton, self._places, positions), None)
        self.state = "" if finding is None else self.state or finding.sentence


def _measured(sample: MarkerSample) -> np.ndarray:
    """(M, 3) the markers as they came, metres."""
    measured = sample.measurements
    return sample.positions_world if measured is None else measured.positions_world
