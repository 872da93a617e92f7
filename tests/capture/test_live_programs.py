"""Streams as VirtualMotionCapture, SlimeVR and VRChat's trackers have them, taken in."""

import re
import time
from importlib.resources import files

import numpy as np
import pytest
import vmc_programs as programs
from conftest import wait_for
from scipy.spatial.transform import Rotation
from test_live_markers import listening

from jaxmocap.capture.streams.osc import parse_packet
from jaxmocap.capture.streams.sample_assembly import MarkerSample, SampleAssembler
from jaxmocap.capture.streams.udp import Datagram, MarkerSocket, OscTable
from jaxmocap.formats.files.addresses import Address
from jaxmocap.formats.time_series.axes import R_WORLD_UNITY
from jaxmocap.pipelines.live.setup import load_live
from jaxmocap.pipelines.live.status import stream_states

RATE, FRAMES = 90.0, 40
SERIALS = {"Hmd": "LHR-ヘッド", "Con": "LHR-FDF3A8C1", "Tra": "LHR-0E3D9A55"}
SCALE = 0.9


def motion(kind: int, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Where a device is in Unity's frame, and its quaternion xyzw."""
    t = frame / RATE
    place = 0.3 * kind - 0.3 + 0.1 * np.sin(5 * t), 1.0 + 0.2 * kind, 0.4 * np.cos(3 * t)
    turn = Rotation.from_rotvec([0.3 * kind + t, 1.2 * np.sin(2 * t), -0.5])
    return np.array(place), turn.as_quat()


def devices(frame: int) -> list[programs.Device]:
    return [
        programs.Device(kind, serial, *motion(i, frame))
        for i, (kind, serial) in enumerate(SERIALS.items())
    ]


class Taken:
    """A socket that is given datagrams, and what comes out."""

    def __init__(self, markers=("Hmd", "Left", "Waist"), aliases=None, raw=False):
        aliases = {SERIALS["Con"]: "Left", SERIALS["Tra"]: "Waist"} if aliases is None else aliases
        self.samples: list[MarkerSample] = []
        assembler = SampleAssembler(markers, aliases, R_WORLD_UNITY, self.samples.append)
        self.now = 0.0
        self.assembler = assembler
        self.socket = MarkerSocket(
            OscTable(Address(port=0), raw=raw), assembler, now=lambda: self.now
        )

    def give(self, at: float, datagrams, port: int = 5000) -> None:
        self.now = at
        arrived = [at + 1e-5 * i for i in range(len(datagrams))]
        self.socket.take(
            [Datagram(a, d, "127.0.0.1", port) for a, d in zip(arrived, datagrams, strict=True)]
        )

    def done(self) -> list[MarkerSample]:
        self.socket.stop()
        return self.samples


def check_motion(samples: list[MarkerSample], first: int = 0, scale: float = 1.0) -> None:
    """One sample a frame, every device where it was and as it was turned."""
    assert len(samples) == FRAMES - first
    for frame, sample in enumerate(samples, first):
        measured = sample.measurements
        assert measured is not None
        for i in range(3):
            place, turn = motion(i, frame)
            np.testing.assert_allclose(
                measured.positions_world[i], R_WORLD_UNITY @ place * scale, atol=1e-6
            )
            R = R_WORLD_UNITY @ Rotation.from_quat(turn).as_matrix() @ R_WORLD_UNITY.T
            np.testing.assert_allclose(measured.orientations_world[i], R, atol=1e-6)


@pytest.mark.parametrize("raw", [False, True])
def test_virtual_motion_capture_is_one_sample_a_frame_among_all_that_it_sends(raw):
    taken, jitter = Taken(raw=raw), np.random.default_rng(3).exponential(2e-3, FRAMES)
    for frame in range(FRAMES):
        datagrams = programs.virtual_motion_capture(devices(frame), 1234.5 + frame / RATE)
        # Late by chance, with keys and settings before the last bundle.
        others = programs.virtual_motion_capture_now_and_then() if frame % 10 == 0 else []
        taken.give(frame / RATE + jitter[frame], [*datagrams[:-1], *others, datagrams[-1]])
    samples = taken.done()
    check_motion(samples, scale=1.0 if raw else SCALE)
    assert set(taken.socket.ignored) <= {"foreign", "flood"} and not taken.socket.ignored["flood"]
    assert not taken.assembler.unknown_names and taken.socket.senders.clock_jumps == 0
    # The sender's rhythm, not the network's.
    intervals = np.diff([sample.time for sample in samples])[10:]
    np.testing.assert_allclose(intervals, 1 / RATE, atol=2e-4)


def test_an_avatar_of_many_expressions_costs_no_packet():
    for datagram in programs.virtual_motion_capture(devices(0), 1.0, expressions=1400):
        assert len(datagram) < 65507 and not parse_packet(datagram).ignored


@pytest.mark.parametrize("datagram", programs.virtual_motion_capture_now_and_then())
def test_what_is_about_something_else_is_not_malformed(datagram):
    assert parse_packet(datagram) == ((), None, datagram.startswith(b"#"), ())


@pytest.mark.parametrize(
    "odd",
    [
        programs.message("/VMC/Thru/Any/Blob", b"12345", True, None),
        b"/tags\0\0\0,ctrmIN[ff]\0" + bytes(32),
        programs.message("/VMC/Ext/Con/Pos/Local/Later", 1, "x"),
        programs.message("/VMC/Ext/T/Later", "x"),
    ],
)
def test_arguments_of_every_kind_do_not_cost_the_bundle(odd):
    packet = parse_packet(programs.bundle([odd, *map(programs.device, devices(0)), odd]))
    assert len(packet.markers) == 3 and packet.ignored == ()


def test_what_later_versions_add_to_a_device_is_ignored():
    added = programs.device(devices(0)[2]).replace(b",sfffffff\0\0\0", b",sfffffffsb\0") + bytes(8)
    assert [placed.names for placed in parse_packet(added).markers] == [(SERIALS["Tra"],)]


def test_slimevr_is_one_sample_a_bundle():
    taken = Taken(aliases={SERIALS["Con"]: "Left", SERIALS["Tra"]: "Waist"})
    for frame in range(FRAMES):
        taken.give(frame / RATE, [programs.slimevr_vmc(devices(frame), 7.0 + frame / RATE)])
    check_motion(taken.done())
    assert not +taken.socket.ignored


def test_devices_that_come_scaled_only_are_explained_where_they_are_wanted_as_tracked():
    """SlimeVR sends no ``Pos/Local``, with which ``raw = true`` waits for ever."""
    taken = Taken(raw=True)
    taken.give(0.0, [programs.slimevr_vmc(devices(0), 7.0)])
    states = dict(stream_states(taken.socket, taken.assembler, (), 0.1))
    taken.done()
    assert "leave out 'raw' in [osc]" in states["scaled packets ignored"]


def test_slimevrs_newer_server_sends_no_devices_by_vmc():
    taken = Taken()
    for frame in range(FRAMES):
        taken.give(frame / RATE, programs.slimevr_vmc_without_devices(frame / RATE))
    assert taken.done() == [] and +taken.socket.ignored == {"foreign": 2 * FRAMES}
    assert taken.socket.last_arrival is None


def test_slimevrs_trackers_for_vrchat_are_one_sample_a_bundle_and_a_reset_is_no_orientation():
    numbers = tuple(map(str, range(1, 9)))
    taken = Taken((*numbers, "head"), {})
    rng = np.random.default_rng(4)
    places = rng.uniform(-1, 2, (FRAMES, 9, 3)).astype(np.float32)
    degrees = rng.uniform(-180, 180, (FRAMES, 8, 3))
    for frame in range(FRAMES):
        at = frame / RATE
        taken.give(
            at, [programs.slimevr_trackers(places[frame, :8], degrees[frame], places[frame, 8])]
        )
        if frame % 7 == 0:
            taken.give(at + 0.004, [programs.slimevr_reset(30.0)])
    samples = taken.done()
    assert len(samples) == FRAMES and not +taken.socket.ignored
    for frame, sample in enumerate(samples):
        measured = sample.measurements
        assert measured is not None and sample.time == pytest.approx(frame / RATE, abs=1e-3)
        np.testing.assert_allclose(
            measured.positions_world, places[frame] @ R_WORLD_UNITY.T, atol=1e-6
        )
        # Unity's angles: about z, then x, then y.
        R = Rotation.from_euler("zxy", degrees[frame][:, [2, 0, 1]], degrees=True).as_matrix()
        np.testing.assert_allclose(
            measured.orientations_world[:8], R_WORLD_UNITY @ R @ R_WORLD_UNITY.T, atol=1e-5
        )
        assert np.isnan(measured.orientations_world[8]).all()


def test_trackers_that_send_messages_one_by_one_make_one_sample_together():
    """The protocol's sample, once for each device: whole samples after the first moments."""
    taken = Taken()
    for frame in range(FRAMES):
        datagrams = [d for each in devices(frame) for d in programs.sample_tracker_sender(each)]
        taken.give(frame / RATE, datagrams)
    samples = taken.done()
    whole = [s for s in samples if np.isfinite(s.positions_world).all()]
    assert len(samples) - len(whole) <= 2 and len(whole) >= FRAMES - 2
    check_motion(whole, first=FRAMES - len(whole))


def test_two_programs_that_send_at_once_bring_all_markers():
    """Headset and controller from one, a tracker from the other."""
    taken = Taken()
    for frame in range(FRAMES):
        *first, tracker = devices(frame)
        taken.give(frame / RATE, programs.virtual_motion_capture(first, frame / RATE, 4, 1.0))
        taken.give(frame / RATE + 0.003, [programs.slimevr_vmc([tracker], 50 + frame / RATE)], 5001)
    samples = taken.done()
    finite = np.isfinite([s.positions_world[:, 0] for s in samples])
    assert (finite.sum(0) == FRAMES).all() and (finite.sum(1) > 0).all()
    assert (np.diff([s.time for s in samples]) > 0).all() and taken.socket.senders.clock_jumps == 0


def test_virtual_motion_capture_over_a_real_socket():
    samples: list[MarkerSample] = []
    aliases = {SERIALS["Con"]: "Left", SERIALS["Tra"]: "Waist"}
    markers = "Hmd", "Left", "Waist"
    with listening(samples.append, markers, aliases) as (marker_socket, send):
        for frame in range(FRAMES):
            for datagram in programs.virtual_motion_capture(devices(frame), frame / RATE):
                send(datagram)
            time.sleep(0.002)
        wait_for(lambda: len(samples) >= FRAMES)
    check_motion(samples, scale=SCALE)
    assert set(+marker_socket.ignored) == {"foreign"}


def test_bones_and_settings_are_worth_a_line_only_while_no_marker_comes():
    taken = Taken()
    taken.give(0.0, programs.virtual_motion_capture((), 0.0))
    before = dict(stream_states(taken.socket, taken.assembler, (), 0.0))
    taken.give(0.1, programs.virtual_motion_capture(devices(0), 0.1))
    after = dict(stream_states(taken.socket, taken.assembler, (), 0.1))
    taken.done()
    assert "foreign packets ignored" in before and before["markers"] == "waiting for the first"
    assert "foreign packets ignored" not in after and after["markers"] == "coming in"


# The page ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("program", ["VirtualMotionCapture", "SlimeVR"])
def test_the_live_file_on_the_page_takes_what_its_program_sends(program, tmp_path):
    page = files("jaxmocap").joinpath("docs", "programs.md").read_text("utf-8")
    (block,) = re.findall(rf"^## {program}$.*?^```toml\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    path = tmp_path / "live.toml"
    path.write_text(block, "utf-8")
    setup = load_live(path)
    taken = Taken(setup.marker_names, setup.source.aliases, setup.source.raw)
    for frame in range(FRAMES):
        if program == "SlimeVR":
            places = np.full((9, 3), frame / RATE)
            datagrams = [programs.slimevr_trackers(places[:8], places[:8], places[8])]
        else:
            hmd, left, tracker = devices(frame)
            held = [hmd, left, tracker._replace(kind="Con")]
            datagrams = programs.virtual_motion_capture(held, frame / RATE)
        taken.give(frame / RATE, datagrams)
    samples = taken.done()
    assert len(samples) == FRAMES and np.isfinite([s.positions_world for s in samples]).all()
