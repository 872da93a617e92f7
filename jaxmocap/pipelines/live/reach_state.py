"""Whether markers that come in live can be on one body.

INPUTS: a skeleton, the places of markers on it, samples. OUTPUTS: a sentence.
"""

from collections.abc import Sequence

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.capture.checks.body_reach import ReachCounts
from jaxmocap.capture.streams.sample_assembly import MarkerSample
from jaxmocap.formats.files.short_repr import short_name
from jaxmocap.formats.recordings.marker_places import MarkerPlace
from jaxmocap.pipelines.live.stream_states import tenfold

# Fewer samples beyond reach are worth no line.
MIN_SAMPLES = 10


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
        measured = sample.measurements
        positions = sample.positions_world if measured is None else measured.positions_world
        worst = self._counts.worst() if self._counts.add(positions[None]) else None
        if worst is None or worst.samples < self._next:
            return
        self._next *= 10
        marker, other = (short_name(self._names[i]) for i in (worst.marker, worst.other))
        reach = f"this body reaches {worst.allowed_m:.2f} m"
        self.state = (
            f"{marker} is up to {worst.farthest_m:.2f} m from {other}, {reach} "
            f"({tenfold(worst.samples)} samples)"
        )
