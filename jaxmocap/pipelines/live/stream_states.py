"""What there is to say of a live run's streams: a few things, each in one of a few states.

INPUTS: the streams as they are. OUTPUTS: (what, state) pairs, as ``LiveStatus.state`` takes them.

A count is news at every tenfold, not at every packet; names come as they print, shortened.
"""

from collections.abc import Iterator, Sequence

from jaxmocap.capture.streams.cameras import LiveCamera
from jaxmocap.capture.streams.lsl import MarkerStream
from jaxmocap.capture.streams.sample_assembly import SampleAssembler
from jaxmocap.capture.streams.udp import MarkerSocket
from jaxmocap.formats.files.short_repr import comma_list, short_name

# A stream that was silent for so long is said to be; poses are then no news, seconds.
SILENT_S = 0.3


def stream_states(
    markers: MarkerSocket | MarkerStream,
    gathering: SampleAssembler,
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
    yield "missing", comma_list(gathering.missing(now)) or "none"
    if jumps := markers.clock_jumps:
        yield "the sender's clock", f"was set, {tenfold(jumps)} times"
    for why, count in list(markers.ignored.items()):
        if count:
            yield f"{why} packets ignored", tenfold(count)
    if markers.refused_hosts:
        hosts = comma_list(sorted(markers.refused_hosts.copy()))
        yield "strangers", f"{hosts}; [osc] from = [...] lists who may send"
    if gathering.unknown:
        yield "no markers of ours", comma_list(sorted(gathering.unknown.copy()))
    for camera in cameras:
        reason = f" ({camera.reason})" if camera.reason else ""
        yield short_name(camera.name), camera.problem or f"{camera.status}{reason}"


def _markers_state(markers: MarkerSocket | MarkerStream, now: float) -> str:
    if markers.problem is not None:
        return markers.problem
    if markers.last_arrival is None:
        return "waiting for the first"
    return "nothing comes in" if now - markers.last_arrival > SILENT_S else "coming in"


def tenfold(count: int) -> str:
    """A count by the place of its first digit."""
    return f"{10 ** (len(str(count)) - 1)} or more"
