"""Markers that come in live: packets of every kind, clocks, samples, queues."""

import socket
from contextlib import contextmanager, suppress
from functools import cache

import numpy as np
import pytest
from conftest import wait_for
from hypothesis import given
from hypothesis import strategies as st
from pythonosc.osc_bundle_builder import OscBundleBuilder
from pythonosc.osc_message_builder import OscMessageBuilder
from scipy.spatial.transform import Rotation

from jaxmocap.capture.markers import RecentMarkers
from jaxmocap.capture.streams.inbox import Inbox, LiveFrame
from jaxmocap.capture.streams.osc import (
    MAX_MARKER_MESSAGES,
    MAX_MESSAGES,
    BadPacketError,
    MarkerMessage,
    parse_packet,
)
from jaxmocap.capture.streams.sample_assembly import (
    OVERTAKEN_S,
    SENT_WITHIN_S,
    MarkerSample,
    SampleAssembler,
)
from jaxmocap.capture.streams.senders import SENDER_BURST
from jaxmocap.capture.streams.stream_clock import JUMP_S, StreamClock
from jaxmocap.capture.streams.udp import MAX_BURST, Datagram, MarkerSocket, OscTable
from jaxmocap.formats.files.addresses import Address
from jaxmocap.formats.time_series.axes import R_WORLD_UNITY

MARKERS = ("Hmd", "LeftController", "RightController")


def message(address: str, *arguments):
    built = OscMessageBuilder(address)
    for argument in arguments:
        built.add_arg(argument)
    return built.build()


def device(kind: str, serial: str, *place: float, local: bool = False):
    numbers = [*map(float, place), 0.0, 0.0, 0.0, 1.0]
    return message(f"/VMC/Ext/{kind}/Pos{'/Local' if local else ''}", serial, *numbers)


def bundle(*messages, stamp: float = 0) -> bytes:
    built = OscBundleBuilder(stamp)
    for each in messages:
        built.add_content(each)
    return built.build().dgram


VALID = bundle(
    message("/VMC/Ext/T", 12.5),
    device("Hmd", "LHR-1", 0.1, 1.7, 0.2),
    device("Con", "LeftController", -0.3, 1.0, 0.4),
)


# Packets -----------------------------------------------------------------------------------------


def test_devices_of_vmc_are_read_from_messages_and_from_bundles():
    single = parse_packet(device("Tra", "waist", 1, 2, 3).dgram)
    turn = (0.0, 0.0, 0.0, 1.0)
    assert single == ((MarkerMessage(("waist",), (1.0, 2.0, 3.0), turn),), None, False, ())
    packet = parse_packet(VALID)
    assert packet.stamp == 12.5 and packet.is_bundle
    assert [placed.names for placed in packet.markers] == [("LHR-1", "Hmd"), ("LeftController",)]
    np.testing.assert_allclose(packet.markers[1].position, (-0.3, 1.0, 0.4), rtol=1e-6)


def test_places_as_tracked_are_taken_in_place_of_scaled_ones_where_that_is_asked():
    both = bundle(device("Hmd", "h", 0, 1, 0), device("Hmd", "h", 0, 2, 0, local=True))
    assert [placed.position[1] for placed in parse_packet(both).markers] == [1.0]
    assert [placed.position[1] for placed in parse_packet(both, raw=True).markers] == [2.0]


def test_trackers_of_vrchat_are_read():
    placed = parse_packet(message("/tracking/trackers/head/position", 0.0, 1.6, 0.5).dgram).markers
    assert placed == (MarkerMessage(("head",), (0.0, 1.6000000238418579, 0.5)),)
    assert parse_packet(message("/tracking/trackers/3/position", 1.0, 2.0, 3.0).dgram).markers[
        0
    ].names == ("3",)


@given(st.lists(st.floats(-400, 400), min_size=3, max_size=3))
def test_turns_of_vrchats_trackers_are_unitys_euler_angles(degrees):
    (placed,) = parse_packet(message("/tracking/trackers/3/rotation", *degrees).dgram).markers
    assert placed.position is None and placed.orientation is not None
    # About its own axes y, x, z in turn, which is about fixed axes z, x, y.
    expected = Rotation.from_euler("YXZ", np.array(degrees)[[1, 0, 2]], degrees=True)
    away = Rotation.from_quat(placed.orientation) * expected.inv()
    assert away.magnitude() < 1e-4


def test_a_bundles_time_tag_is_a_stamp_unless_it_says_at_once():
    point = device("Tra", "a", 0, 0, 0)
    first, second = (parse_packet(bundle(point, stamp=at)).stamp for at in (1000.0, 1000.25))
    assert second - first == pytest.approx(0.25, abs=1e-6)
    from pythonosc.osc_bundle_builder import IMMEDIATELY

    assert parse_packet(bundle(point, stamp=IMMEDIATELY)).stamp is None


@pytest.mark.parametrize("place", [(np.nan, 0, 0), (0, np.inf, 0), (1e9, 0, 0)])
def test_what_cannot_be_a_place_is_absurd_and_others_in_its_bundle_count(place):
    packet = parse_packet(bundle(device("Tra", "a", *place), device("Tra", "b", 1, 2, 3)))
    assert packet.ignored == ("absurd",)
    assert [placed.names for placed in packet.markers] == [("b",)]


@pytest.mark.parametrize(
    "datagram",
    [b"", b"hello", b"#bundle\0", VALID[:-4], VALID[:16] + b"\xff\xff\xff\xfc" + VALID[20:]],
)
def test_what_is_cut_off_or_no_osc_is_malformed(datagram):
    with pytest.raises(BadPacketError, match="malformed"):
        parse_packet(datagram)


@pytest.mark.parametrize(
    "bad",
    [
        message("/VMC/Ext/Tra/Pos", "short", 1.0),
        message("/VMC/Ext/Tra/Pos", 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0, 1.0),
        message("/VMC/Ext/Tra/Pos", "flags", *[True] * 7),
        message("/VMC/Ext/Tra/Pos", "n" * 65, *[0.0] * 7),
        message("/tracking/trackers/1/position", "a", "b", "c"),
        message("/VMC/Ext/T", "now"),
    ],
)
def test_a_message_that_does_not_fit_is_ignored_alone(bad):
    packet = parse_packet(bundle(bad, device("Tra", "b", 1, 2, 3)))
    assert packet.ignored == ("malformed",)
    assert [placed.position for placed in packet.markers] == [(1.0, 2.0, 3.0)]


@given(st.binary(max_size=200))
def test_no_bytes_whatever_do_more_than_be_ignored(datagram):
    for start in (b"", b"/VMC/Ext/Tra/Pos\0\0\0\0", b"#bundle\0" + bytes(8)):
        with suppress(BadPacketError):
            assert parse_packet(start + datagram).markers is not None


@given(st.lists(st.tuples(st.integers(0, len(VALID) - 1), st.integers(0, 255)), max_size=8))
def test_a_valid_packet_with_broken_bytes_is_read_or_ignored(changes):
    broken = bytearray(VALID)
    for place, value in changes:
        broken[place] = value
    with suppress(BadPacketError):
        for placed in parse_packet(bytes(broken)).markers:
            assert np.abs(placed.position).max() <= 100


def test_a_stamp_that_is_too_coarse_for_a_rhythm_is_not_used():
    """VMC's seconds are 32-bit floats, which step by 4 ms after nine hours."""
    at = [parse_packet(bundle(message("/VMC/Ext/T", t))).stamp for t in (32767.0, 32768.0)]
    assert at == [32767.0, None]


def test_only_so_many_messages_are_about_markers():
    point = device("Tra", "a", 0, 0, 0)
    assert len(parse_packet(bundle(*[point] * MAX_MARKER_MESSAGES)).markers) == MAX_MARKER_MESSAGES
    for count in (MAX_MARKER_MESSAGES + 1, MAX_MESSAGES + 1):
        with pytest.raises(BadPacketError, match="malformed"):
            parse_packet(bundle(*[point if count < 1000 else message("/a")] * count))


def test_bundles_in_bundles_end_somewhere():
    nested = VALID
    for _ in range(50):
        nested = VALID[:16] + len(nested).to_bytes(4, "big") + nested
    with pytest.raises(BadPacketError):
        parse_packet(nested)


# Clocks ------------------------------------------------------------------------------------------


def test_a_senders_rhythm_is_kept_though_packets_come_late_by_chance():
    clock, rng = StreamClock(), np.random.default_rng(0)
    stamps = 500 + np.arange(300) / 90
    arrivals = stamps - 480 + 0.002 + rng.exponential(0.004, 300)
    times = np.array([clock.time(*pair) for pair in zip(arrivals, stamps, strict=True)])
    assert (times <= arrivals).all() and clock.jumps == 0
    assert np.diff(arrivals).std() > 4e-3 and np.diff(times)[100:].std() < 2e-4


@pytest.mark.parametrize("jump", [1.0, -1.0])
def test_a_clock_that_jumps_is_noticed_and_times_go_on(jump):
    clock = StreamClock()
    arrivals = np.arange(200) / 90
    stamps = arrivals + np.where(np.arange(200) < 100, 0.0, jump)
    times = np.array([clock.time(*pair) for pair in zip(arrivals, stamps, strict=True)])
    assert clock.jumps == 1
    np.testing.assert_allclose(times, arrivals, atol=1e-3)


def test_packets_that_were_held_up_keep_their_rhythm_and_are_no_clock_that_was_set():
    """A machine that compiles fetches nothing for a second, and then all of it."""
    clock, stamps = StreamClock(), np.arange(300) / 90
    held_up = (stamps > 1.0) & (stamps < 2.0)
    times = [clock.time(2.0 if late else at, at) for at, late in zip(stamps, held_up, strict=True)]
    assert clock.jumps == 0
    np.testing.assert_allclose(times, stamps, atol=1e-3)


def test_a_sender_that_was_paused_with_its_clock_goes_on_as_its_packets_come():
    clock, stamps = StreamClock(), np.arange(200) / 90
    arrivals = stamps + np.where(np.arange(200) < 100, 0.0, 10.0)
    times = np.array([clock.time(*pair) for pair in zip(arrivals, stamps, strict=True)])
    assert clock.jumps == 1 and (times <= arrivals).all()
    np.testing.assert_allclose(times[130:], arrivals[130:], atol=1e-3)


def test_a_clock_that_stands_tells_nothing():
    clock = StreamClock()
    times = [clock.time(arrival, 7.0) for arrival in np.arange(50) / 50]
    assert clock.jumps == 0
    np.testing.assert_allclose(times, np.arange(50) / 50, atol=JUMP_S * 1e-2)


# Samples -----------------------------------------------------------------------------------------


def gathering(aliases=None):
    given_out: list[MarkerSample] = []
    gathers = SampleAssembler(MARKERS, aliases or {}, R_WORLD_UNITY, given_out.append)
    return gathers, given_out


def round_of(gathers, at: float, names=MARKERS, height: float = 1.0):
    for i, name in enumerate(names):
        placed = MarkerMessage((name,), (0.0, height, float(i)))
        gathers.add([placed], at + 1e-4 * i, at + 1e-4 * i, False)


def test_markers_sent_one_by_one_make_one_sample_as_soon_as_all_have_come():
    gathers, out = gathering()
    for i in range(2):
        round_of(gathers, i / 90)  # at first nobody knows who will come
    out.clear()
    for i in range(2, 5):
        round_of(gathers, i / 90, height=float(i))
        assert len(out) == i - 1 and np.isfinite(out[-1].positions_world).all()
        assert out[-1].time == pytest.approx(i / 90) and out[-1].arrived >= out[-1].time
    # Unity's left-handed frame: x right, y up, z ahead; the world: x ahead, y left, z up.
    np.testing.assert_allclose(out[-1].positions_world[2], [2.0, 0.0, 4.0])


def test_a_marker_that_is_lost_is_missing_and_not_waited_for_long():
    gathers, out = gathering()
    for i in range(90):
        round_of(gathers, i / 90, MARKERS if i < 30 else MARKERS[:2])
    assert len(out) >= 89
    late = [sample for sample in out if sample.time > 30 / 90 + SENT_WITHIN_S + 0.02]
    assert all(np.isnan(sample.positions_world[2]).all() for sample in late)
    assert all(sample.arrived - sample.time < 1e-3 for sample in late)
    assert gathers.missing(89 / 90) == ["RightController"]


def test_packets_of_others_are_no_markers_of_ours():
    gathers, out = gathering()
    assert not gathers.add([MarkerMessage(("Toy",), (0.0, 1.0, 0.0))], 0.0, 0.0, True)
    assert gathers.add([MarkerMessage(("Hmd",), (0.0, 1.0, 0.0))], 0.1, 0.1, True)
    assert len(out) == 1


@pytest.mark.parametrize("together", [True, False])
def test_a_tracker_is_turned_by_its_own_message(together):
    """In one bundle, or in messages one by one, where the last turn is a sample old."""
    gathers, out = gathering()
    about_up = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))
    for i in range(3):
        place = MarkerMessage(("Hmd",), (0.0, 1.0, 0.0))
        oriented = MarkerMessage(("Hmd",), None, about_up)
        packets = [[place, oriented]] if together else [[place], [oriented]]
        for packet in packets:
            gathers.add(packet, i / 90, i / 90, together)
    assert len(out) == 3
    # A quarter to the right in Unity's frame is one in ours, where it counts as negative.
    R = out[-1].measurements.orientations_world[0]
    np.testing.assert_allclose(R @ [1.0, 0.0, 0.0], [0.0, -1.0, 0.0], atol=1e-6)
    assert np.isnan(out[-1].measurements.orientations_world[1]).all()
    # A bundle without a rotation has none, however lately one came: SlimeVR sends the head's alone,
    # at a reset.
    gathers.add([MarkerMessage(("Hmd",), (0.0, 1.0, 0.0))], 2.5 / 90, 2.5 / 90, True)
    assert np.isnan(out[-1].measurements.orientations_world[0]).all()


def test_a_bundle_is_a_sample_though_not_every_marker_is_in_it():
    gathers, out = gathering({"LHR-7": "LeftController"})
    gathers.add([MarkerMessage(("LHR-7",), (1.0, 2.0, 3.0))], 0.5, 0.5, True)
    np.testing.assert_allclose(out[0].positions_world[1], [3.0, -1.0, 2.0])
    assert np.isnan(out[0].positions_world[[0, 2]]).all()


def test_names_that_are_no_markers_are_remembered_a_few_of_them():
    gathers, out = gathering()
    for i in range(1000):
        gathers.add([MarkerMessage((f"who {i}",), (0.0, 0.0, 0.0))], 0.0, 0.0, True)
    assert not out and len(gathers.unknown_names) == SampleAssembler.MAX_UNKNOWN


@given(st.lists(st.floats(0, 1), min_size=1, max_size=30))
def test_samples_ascend_in_time_whatever_the_stamps_say(stamps):
    gathers, out = gathering()
    for stamp in stamps:
        gathers.add([MarkerMessage(("Hmd",), (0.0, 0.0, 0.0))], stamp, 1.0, True)
    assert (np.diff([sample.time for sample in out]) > 0).all()
    kept = [stamp for i, stamp in enumerate(stamps) if not _is_overtaken(stamp, stamps[:i])]
    assert len(out) == len(kept)


def _is_overtaken(stamp: float, before: list[float]) -> bool:
    """Whether it is a little older than the last one that counted."""
    last = -np.inf
    for each in before:
        last = last if last - OVERTAKEN_S < each < last else each
    return last - OVERTAKEN_S < stamp < last


def test_who_was_overtaken_is_no_sample_and_a_clock_that_was_set_is_followed():
    gathers, out = gathering()
    times = [0.0, 0.011, 0.033, 0.022, 0.044, -5.0, -4.99]
    for i, time in enumerate(times):
        gathers.add([MarkerMessage(("Hmd",), (time, 0.0, 0.0))], time, 1.0 + 0.01 * i, True)
    found = [float(np.abs(each.positions_world[0]).sum()) for each in out]
    np.testing.assert_allclose(found, np.abs([*times[:3], *times[4:]]))


def test_between_samples_markers_are_known_and_a_little_beyond_each_at_its_own_rate():
    trail = RecentMarkers(2)
    for i in range(10):
        fast, slow = [i / 90, 0, 0], [i / 90, 1, 0] if i % 3 == 0 else [np.nan] * 3
        trail.add(i / 90, np.array([fast, slow]))
    actual = trail.at(8.5 / 90)
    np.testing.assert_allclose(actual, [[8.5 / 90, 0, 0], [8.5 / 90, 1, 0]], atol=1e-9)
    ahead = trail.at(11.5 / 90)
    assert np.isnan(ahead[0]).all()
    np.testing.assert_allclose(ahead[1], [11.5 / 90, 1, 0], atol=1e-9)


# Queues ------------------------------------------------------------------------------------------


def sample_at(seconds: float) -> MarkerSample:
    return MarkerSample(seconds, np.zeros((3, 3)), seconds)


def frame_at(seconds: float, camera: int = 0) -> LiveFrame:
    return LiveFrame(camera, seconds, np.zeros((2, 2), np.uint8), seconds)


def test_the_newest_win_and_no_backlog_grows():
    inbox = Inbox(max_samples=4)
    for i in range(100):
        inbox.put_sample(sample_at(i / 90))
        inbox.put_frame(frame_at(2.0 + i / 30))
    assert (inbox.dropped_samples, inbox.dropped_frames) == (96, 99)
    taken = [inbox.take(0.0) for _ in range(5)]
    assert [each.time for each in taken[:4]] == [i / 90 for i in range(96, 100)]
    assert [frame.time for frame in taken[4]] == [2.0 + 99 / 30]
    assert inbox.take(0.0) is None


def test_frames_wait_for_their_turn_and_newer_ones_replace_them():
    inbox = Inbox(max_samples=4)
    inbox.put_frame(frame_at(0.0))
    inbox.put_sample(sample_at(0.01))
    inbox.put_frame(frame_at(0.02))
    inbox.put_frame(frame_at(0.03, camera=1))
    assert [frame.time for frame in inbox.take(0.0)] == [0.02, 0.03]
    assert inbox.take(0.0).time == 0.01
    inbox = Inbox(max_samples=4, keep_turns=False)
    inbox.put_frame(frame_at(0.0))
    inbox.put_sample(sample_at(0.01))
    inbox.put_frame(frame_at(0.02))
    assert inbox.take(0.0).time == 0.01
    assert [frame.time for frame in inbox.take(0.0)] == [0.02]
    inbox = Inbox(max_samples=4)
    inbox.put_frame(frame_at(0.0))
    inbox.put_sample(sample_at(0.01))
    assert inbox.take(0.0, with_frames=False).time == 0.01
    inbox.put_frame(frame_at(0.02))
    assert inbox.take(0.0, with_frames=False) is None
    assert [frame.time for frame in inbox.take(0.0)] == [0.02]


def test_for_smoothing_a_frame_gets_its_turn_however_many_samples_wait():
    inbox = Inbox(max_samples=4, keep_turns=False)
    taken = []
    for i in range(40):
        for k in range(3):
            inbox.put_sample(sample_at(i / 30 + k / 90))
        inbox.put_frame(frame_at(i / 30 + 0.03))
        # Two are taken of every four that come in: samples never run out.
        taken += [inbox.take(0.0), inbox.take(0.0)]
    frames = [each for each in taken if isinstance(each, list)]
    assert len(frames) > 8
    assert inbox.dropped_frames + len(frames) >= 39


# Sockets -----------------------------------------------------------------------------------------


@contextmanager
def listening(give, markers=MARKERS, aliases=None):
    gathers = SampleAssembler(markers, aliases or {}, R_WORLD_UNITY, give)
    marker_socket = MarkerSocket(OscTable(Address(port=0)), gathers)
    marker_socket.start()
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        yield marker_socket, lambda datagram: sender.sendto(datagram, tuple(marker_socket.address))
    finally:
        sender.close()
        marker_socket.stop()


def test_a_socket_counts_what_it_ignores_and_takes_the_rest():
    out: list[MarkerSample] = []
    with listening(out.append) as (marker_socket, send):
        assert marker_socket.address.host == "127.0.0.1"
        for datagram in (
            b"garbage",
            device("Tra", "Hmd", 1e9, 0, 0).dgram,
            message("/chatbox/input", "hello").dgram,
            bundle(*(device("Tra", name, 0, 1, 0) for name in MARKERS)),
        ):
            send(datagram)
        wait_for(lambda: out)
        assert marker_socket.packets == 4 and marker_socket.last_arrival is not None
        ((name, count),) = marker_socket.senders.packets().items()
        assert name.startswith("127.0.0.1:") and count == 4
        assert dict(marker_socket.ignored) == {
            "malformed": 1,
            "absurd": 1,
            "foreign": 1,
            "flood": 0,
        }


def packet(ahead: float, port: int = 5000, host: str = "127.0.0.1", at: float = 0.0, stamp=None):
    """One marker so far ahead, from some sender."""
    return Datagram(at, one_marker(ahead, stamp), host, port)


@cache
def one_marker(ahead: float, stamp: float | None) -> bytes:
    """A packet's content: python-osc builds it more slowly than it is read."""
    parts = [message("/VMC/Ext/T", stamp)] if stamp is not None else []
    return bundle(*parts, device("Tra", "Hmd", 0, 0, ahead))


def test_of_a_flood_the_newest_are_read():
    out: list[MarkerSample] = []
    gathers = SampleAssembler(MARKERS, {}, R_WORLD_UNITY, out.append)
    marker_socket = MarkerSocket(OscTable(Address(port=0)), gathers, now=lambda: 0.0)
    flood = [packet(i / 100) for i in range(2 * MAX_BURST)]
    marker_socket.take(flood)
    marker_socket.stop()
    assert len(out) == SENDER_BURST
    assert marker_socket.ignored["flood"] == 2 * MAX_BURST - SENDER_BURST
    assert out[-1].positions_world[0, 0] == pytest.approx((2 * MAX_BURST - 1) / 100)
