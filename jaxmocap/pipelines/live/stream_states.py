"""What there is to say of a live run's streams: a few things, each in one of a few states.

INPUTS: the streams as they are. OUTPUTS: (what, state) pairs, as ``LiveStatus.state`` takes them.

A count is news at every tenfold, not at every packet; names come as they print, shortened.
"""

from collections.abc import Iterator, Sequence

from jaxmocap.capture.streams.cameras import LiveCamera
from jaxmocap.capture.streams.lsl import MarkerStream
from jaxmocap.capture.streams.sample_assembly import Gathering
from jaxmocap.capture.streams.udp import MarkerSocket
from jaxmocap.formats.files.short_repr import listed, name_shown

# A stream that was silent for so long is said to be; poses are then no news, seconds.
SILENT_S = 0.3


def stream_states(
    markers: MarkerSocket | MarkerStream,
    gathering: Gathering,
    cameras: Sequence[LiveCamera],
    now: float,
) -> Iterator[tuple[str, str]]:
    """What there is to say of every stream.

    Args:
        markers: where they come from.
        gathering: what they become.
        cameras: all of them.
        now: seconds.
    """
    yield "markers", _markers_state(markers, now)
    yield "missing", listed(gathering.missing(now)) or "none"
    if jumps := markers.clock_jumps:
        yield "the sender's clock", f"was set, {tenfold(jumps)} times"
    for why, count in list(markers.ignored.items()):
        if count:
            yield f"{why} packets ignored", tenfold(count)
    if markers.strangers:
        hosts = listed(sorted(markers.strangers.copy()))
        yield "strangers", f"{hosts}; [osc] from = [...] lists who may send"
    if gathering.unknown:
        yield "no markers of ours", listed(sorted(gathering.unknown.copy()))
    for camera in cameras:
        reason = f" ({camera.reason})" if camera.reason else ""
        yield name_shown(camera.name), camera.problem or f"{camera.status}{reason}"


def _markers_state(markers: MarkerSocket | MarkerStream, now: float) -> str:
    if markers.problem is not None:
        return markers.problem
    if markers.heard is None:
        return "waiting for the first"
    return "nothing comes in" if now - markers.heard > SILENT_S else "coming in"


def tenfold(count: int) -> str:
    """A count by the place of its first digit."""
    return f"{10 ** (len(str(count)) - 1)} or more"
