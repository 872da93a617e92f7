"""The states of a live run's streams.

INPUTS: the streams. OUTPUTS: (subject, state) pairs, as ``LiveStatus.set_state`` takes them.

A count changes its state at every tenfold, not at every packet. Names are shortened and printable.
"""

from collections.abc import Iterator, Sequence

from jaxmocap.capture.streams.cameras import LiveCamera
from jaxmocap.capture.streams.sample_assembly import SampleAssembler
from jaxmocap.capture.streams.source import MarkerSource
from jaxmocap.formats.files.errors import comma_list, short_name
from jaxmocap.formats.recordings.marker_places import MarkerPlace

# A stream that received nothing for so many seconds is silent; no pose is sent then.
SILENT_S = 0.3


def stream_states(
    markers: MarkerSource,
    gathering: SampleAssembler,
    cameras: Sequence[LiveCamera],
    now: float,
    places: Sequence[MarkerPlace] = (),
) -> Iterator[tuple[str, str]]:
    """The state of every stream.

    Args:
        markers: their source.
        gathering: that makes samples of them.
        cameras: all of them.
        now: seconds.
        places: of the markers.
    """
    yield "markers", _markers_state(markers)
    yield "missing", comma_list(gathering.missing(now)) or "none"
    yield from _orientation_states(gathering, places)
    if (rate := markers.clock_rate) is not None:
        how = f"runs {rate:.2g} times as fast as this machine's"
        yield "the sender's clock", f"{how}; its stamps are not used"
    elif jumps := markers.clock_jumps:
        yield "the sender's clock", f"was set, {tenfold(jumps)} times"
    for why, count in list(markers.ignored.items()):
        # Who sends markers sends bones, expressions and settings as well: that is worth a line only
        # while no marker comes.
        if count and not (why in ("foreign", "scaled") and markers.last_arrival is not None):
            yield f"{why} packets ignored", f"{tenfold(count)}{markers.hints.get(why, '')}"
    if markers.refused_hosts:
        hosts = comma_list(sorted(markers.refused_hosts.copy()))
        yield "strangers", f"{hosts}; {markers.who_may_send}"
    if gathering.unknown_names:
        yield "no markers of ours", comma_list(sorted(gathering.unknown_names.copy()))
    for camera in cameras:
        reason = f" ({camera.reason})" if camera.reason else ""
        yield short_name(camera.name), camera.problem or f"{camera.status}{reason}"


def _orientation_states(
    gathering: SampleAssembler, places: Sequence[MarkerPlace]
) -> Iterator[tuple[str, str]]:
    """Orientations that come and are not used, and those that are and do not come."""
    placed, oriented = gathering.placed(), gathering.oriented()
    unused = [p.name for p in places if not p.needs_orientation and p.name in oriented]
    if unused:
        how = "'jaxmocap live LIVE.toml --calibrate' measures how they are held"
        yield "orientations not used", f"{comma_list(unused)}; {how}"
    absent = [p.name for p in places if p.needs_orientation and p.name in placed - oriented]
    if any(place.needs_orientation for place in places):
        yield "orientations missing", comma_list(absent) or "none"


def _markers_state(markers: MarkerSource) -> str:
    if markers.problem is not None:
        return markers.problem
    if markers.last_arrival is None:
        return "waiting for the first"
    is_silent = markers.last_look - markers.last_arrival > SILENT_S
    return "nothing comes in" if is_silent else "coming in"


def tenfold(count: int) -> str:
    """A count by its power of ten."""
    return f"{10 ** (len(str(count)) - 1)} or more"
