"""Who may send to a live run, how much, and by which clock; and what of it is reported and kept."""

from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from conftest import complaint, wait_for
from test_live_markers import gathering, listening, packet

from jaxmocap.capture.streams.senders import (
    MAX_REFUSED_NAMED,
    MAX_SENDERS,
    SENDER_PACKETS_HZ,
    fair_shares,
)
from jaxmocap.capture.streams.stream_clock import StreamClock
from jaxmocap.capture.streams.udp import MAX_PACKETS_HZ, MarkerSocket, OscTable
from jaxmocap.formats.files.addresses import LOOPBACK, Address
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.recording import LIVE_TABLES
from jaxmocap.outputs.senders.osc import DatagramSender
from jaxmocap.pipelines.live.loop import THREAD_SWITCH_S
from jaxmocap.pipelines.live.setup import SENDERS, SOURCES, load_live
from jaxmocap.pipelines.live.status import (
    FIRST_KEPT,
    NEWEST_KEPT,
    SILENT_S,
    LiveStatus,
    stream_states,
)


def live_file(folder: Path, more: str) -> Path:
    """A live run of the headset's marker, with more in its file."""
    path = folder / "live.toml"
    path.write_text(f"[markers.on]\nHmd = {{ bone = 'head' }}\n{more}")
    return path


class Line:
    """A socket that nobody sends to, and a clock that is set by hand."""

    def __init__(self, allowed=LOOPBACK):
        self.at = 0.0
        self.gathers, self.samples = gathering()
        table = OscTable(Address(port=0), allowed)
        self.socket = MarkerSocket(table, self.gathers, now=lambda: self.at)
        self.socket.stop()

    def bring(self, *packets):
        self.at = packets[-1].arrived
        self.socket.take(packets)

    def report_to(self, status: LiveStatus) -> None:
        for of, state in stream_states(self.socket, self.gathers, [], self.at):
            status.set_state(self.at, of, state)


@pytest.fixture
def line():
    return Line()


# Clocks ------------------------------------------------------------------------------------------


def test_two_senders_with_two_clocks_are_no_clock_that_jumps(line):
    """One clock for both printed 54 lines a second."""
    status = LiveStatus(StringIO())
    for i in range(900):
        at = i / 90
        line.bring(packet(0.0, 5000, at=at, stamp=at + 1000), packet(0.0, 5001, at=at, stamp=at))
        line.report_to(status)
    assert line.socket.senders.clock_jumps == 0
    assert line.socket.senders.packets() == {"127.0.0.1:5000": 900, "127.0.0.1:5001": 900}
    assert not [each for each in status.messages if "clock" in each["what"]]


def test_each_of_two_senders_keeps_its_own_rhythm(line):
    rng = np.random.default_rng(0)
    for i in range(300):
        late = np.minimum(rng.exponential(0.002, 2), 0.004)
        first = packet(0.0, 5000, at=i / 90 + late[0], stamp=500 + i / 90)
        second = packet(0.0, 5001, at=i / 90 + 0.005 + late[1], stamp=i / 90 + 0.005)
        line.bring(*sorted([first, second], key=lambda each: each.arrived))
    times = np.array([sample.time for sample in line.samples])
    assert np.diff(times[::2])[100:].std() < 3e-4


def test_a_clock_that_is_set_at_every_packet_is_reported_at_every_tenfold(line):
    output = StringIO()
    status = LiveStatus(output)
    for i in range(20_000):
        at = i / 1000
        line.bring(packet(0.0, at=at, stamp=float(i % 7) * 100))
        line.report_to(status)
        if line.socket.senders.clock_jumps > 10_000:
            break
    assert line.socket.senders.clock_jumps > 10_000
    lines = [each["what"] for each in status.messages if "clock" in each["what"]]
    assert lines == [
        f"the sender's clock: was set, {10**digits} or more times" for digits in range(5)
    ]


@pytest.mark.parametrize("stamp", [1e300, -1e300, 1e17])
def test_stamps_too_large_for_a_rhythm_are_left_out(stamp):
    clock = StreamClock()
    assert [clock.time(at, stamp) for at in (1.0, 2.0, 3.0)] == [1.0, 2.0, 3.0]


# Who may send ------------------------------------------------------------------------------------


def test_strangers_are_counted_named_and_otherwise_ignored(line):
    line.bring(*(packet(1.0, host=f"10.0.0.{i}") for i in range(200)), packet(2.0))
    assert line.socket.ignored["stranger"] == 200 and len(line.samples) == 1
    assert len(line.socket.senders.refused_hosts) == MAX_REFUSED_NAMED
    states = dict(stream_states(line.socket, line.gathers, [], 0.0))
    assert states["stranger packets ignored"] == "100 or more"
    assert "10.0.0.0" in states["strangers"] and "[osc] from" in states["strangers"]


def test_the_hosts_and_networks_that_may_send_are_stated(tmp_path):
    stated = "[osc]\nlisten = '0.0.0.0:5000'\nfrom = ['10.0.0.7', '192.168.1.0/24']"
    line = Line(load_live(live_file(tmp_path, stated)).source.allowed)
    hosts = ("10.0.0.7", "::ffff:10.0.0.7", "192.168.1.99", "10.0.0.8", "127.0.0.1", "::1", "who")
    line.bring(*(packet(0.0, host=host) for host in hosts))
    assert len(line.samples) == 3 and line.socket.ignored["stranger"] == 4


@pytest.mark.parametrize("listen", ["127.0.0.1:5000", "[::1]:5000", "localhost:5000", "5000", ""])
def test_where_this_machine_alone_can_send_nobody_needs_to_be_stated(tmp_path, listen):
    path = live_file(tmp_path, f"[osc]\nlisten = '{listen}'" if listen else "")
    assert load_live(path).source.allowed == LOOPBACK


@pytest.mark.parametrize("listen", ["0.0.0.0:5000", "[::]:5000", "192.168.1.2:5000", "studio:5000"])
def test_where_others_can_send_it_must_be_stated_who_may(tmp_path, listen):
    path = live_file(tmp_path, f"[osc]\nlisten = '{listen}'")
    with pytest.raises(InputError, match=r"'from' is missing.*\['192\.168\.1\.20'\]"):
        load_live(path)


@pytest.mark.parametrize(
    "stated", ["'127.0.0.1'", "[]", "['studio']", "[5]", "['10.0.0.1/99']", "['\\u001b[2J']"]
)
def test_senders_that_are_no_addresses_are_refused(tmp_path, stated):
    path = live_file(tmp_path, f"[osc]\nfrom = {stated.replace(chr(39), chr(34))}")
    assert "from: found" in complaint(load_live, path)


# Addresses ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "port",
    [
        *("0", "65536", "-1", "1.5", "true", "[1]", "{}", "9" * 4300),
        *("'9" + "9" * 4299 + "'", "'٤٠٠٠'", "'host:٤'", "'0'", "':'", "'x:1:2'"),
        *("'a b:80'", "'a\\u0000b:80'", f"'{'h' * 300}:80'"),
    ],
)
@pytest.mark.parametrize("table", ["osc]\nlisten", "vmc]\nsend", "vrchat]\nsend"])
def test_what_is_no_port_is_refused_in_one_sentence(tmp_path, table, port):
    path = live_file(tmp_path, f"[{table} = {port.replace(chr(39), chr(34))}\n")
    assert "found" in complaint(load_live, path)


def test_a_host_that_is_not_there_is_refused_before_the_run_begins():
    for opens in (lambda at: MarkerSocket(OscTable(at), gathering()[0]), DatagramSender):
        assert "no such address" in complaint(opens, Address("no.such.host.invalid", 5000))


def test_poses_may_go_to_everybody_in_a_network():
    sender = DatagramSender(Address("127.255.255.255", 39599))
    sender.send([b"pose"])
    sender.close()
    assert (sender.sent, sender.failed) == (1, 0)


# Shares ------------------------------------------------------------------------------------------


def test_one_sender_does_not_crowd_out_another(line):
    heard = 0
    for i in range(90):
        at = i / 90
        flood = [packet(1.0, 6666, at=at) for _ in range(1000)]
        line.bring(*flood[:500], packet(2.0, 5000, at=at), *flood[500:])
        heard += sum(sample.positions_world[0, 0] == 2.0 for sample in line.samples)
        line.samples.clear()
    assert heard == 90
    read = line.socket.packets - line.socket.ignored["flood"]
    assert read <= MAX_PACKETS_HZ + 400 and read - 90 <= SENDER_PACKETS_HZ + 300


def test_under_a_flood_markers_come_in_all_the_time(line):
    """Each packet waits for a thread that compiles, until Python switches threads."""

    class Flooded:
        def recvfrom(self, size):
            line.at += THREAD_SWITCH_S
            return packet(0.0, stamp=line.at).content, ("127.0.0.1", 5000)

    line.socket._socket = Flooded()
    for _ in range(100):
        waiting, more_wait = line.socket._waiting()
        line.socket.take(waiting, more_wait)
        assert more_wait and waiting and line.at - waiting[0].arrived < SILENT_S / 2
    assert line.socket.senders.clock_jumps == 0


def test_a_thread_that_has_to_wait_does_not_say_that_nothing_comes_in(line):
    """Under a flood, or while programs compile, it may wait for more than ``SILENT_S``."""

    def state(now: float) -> str:
        return dict(stream_states(line.socket, line.gathers, [], now))["markers"]

    line.bring(packet(0.0, at=1.0))
    # Nobody has looked since.
    assert state(1.0 + 3 * SILENT_S) == "coming in"
    line.bring(packet(0.0, at=3.0))
    assert state(3.0) == "coming in"
    # Packets came in, none of them with a marker.
    line.bring(packet(0.0, at=3.1 + SILENT_S)._replace(content=b"garbage!"))
    assert state(3.2 + SILENT_S) == "nothing comes in"


def test_a_socket_that_nobody_sends_to_is_silent_soon():
    samples = []
    with listening(samples.append) as (marker_socket, send):
        send(packet(0.0).content)

        def state() -> str:
            return dict(stream_states(marker_socket, gathering()[0], [], 0.0))["markers"]

        wait_for(lambda: state() == "coming in")
        wait_for(lambda: state() == "nothing comes in")


def test_of_what_may_be_read_who_sends_little_gets_all():
    assert fair_shares({"a": 1000, "b": 3, "c": 1000}, 103) == {"b": 3, "a": 50, "c": 50}
    assert fair_shares({"a": 5, "b": 5}, 1) == {"a": 1, "b": 0}
    assert fair_shares({}, 5) == {} and fair_shares({"a": 2}, 0) == {"a": 0}


def test_many_senders_share_what_few_have_alone(line):
    """A sender that opens a port for every packet is heard as well, without a clock."""
    for i in range(1000):
        line.bring(packet(float(i % 7), 1024 + i, at=i / 90, stamp=1e4 - i))
    assert len(line.samples) == 1000 and line.socket.senders.clock_jumps == 0
    sent = line.socket.senders.packets()
    assert len(sent) <= MAX_SENDERS + 1 and sent["others"] > 900
    # Who falls silent makes room for somebody new.
    line.bring(packet(0.0, 9999, at=1000.0))
    assert "127.0.0.1:9999" in line.socket.senders.packets()


# Messages ---------------------------------------------------------------------------------------


def test_names_that_come_in_are_no_commands_to_a_terminal(line):
    output = StringIO()
    status = LiveStatus(output)
    for name in ("\x1b[2J\x1b]0;owned\x07", "a\nb", "\u202egnp.exe"):
        line.gathers.unknown_names.add(name)
    line.report_to(status)
    status.log(0.0, "\x1b[2J" + "x" * 10_000)
    status.update_line(0.0, {"\x1b[2Jcam": 0.1}, {}, np.zeros(2))
    text = output.getvalue()
    assert all(each.isprintable() for each in text.split("\n"))
    assert "\\x1b[2J" in text and "'a\\nb'" in text and max(map(len, text.split("\n"))) < 600


def test_what_changes_all_the_time_is_reported_from_time_to_time_and_as_it_then_is():
    output = StringIO()
    status = LiveStatus(output)
    for i in range(100_000):
        status.set_state(i / 100, "markers", "coming in" if i % 2 else "nothing comes in")
    assert 100 < len(status.messages) < 200
    status.set_state(2000.0, "markers", "waiting")
    assert status.messages[-1]["what"] == "markers: waiting"


def test_that_nothing_is_missing_is_a_message_only_after_something_was():
    status = LiveStatus(StringIO())
    for second, state in enumerate(("none", "none", "Hmd", "none")):
        status.set_state(float(second), "missing", state)
    assert [message["what"] for message in status.messages] == ["missing: Hmd", "missing: none"]


def test_of_the_warnings_the_first_and_the_newest_are_kept():
    status = LiveStatus(StringIO())
    for i in range(5000):
        status.log(float(i), f"sentence {i}")
    kept = [message["what"] for message in status.messages]
    assert len(kept) == FIRST_KEPT + NEWEST_KEPT
    assert kept[0] == "sentence 0" and kept[-1] == "sentence 4999"
    figures = status.figures(1.0)
    assert len(figures["warnings"]) == len(kept) and figures["message_count"] == 5000


def test_a_log_on_a_full_disk_ends_no_run():
    class Full(StringIO):
        def write(self, text):
            raise OSError(28, "No space left on device")

    status = LiveStatus(Full())
    status.log(0.0, "goes on")
    status.update_line(0.0, {}, {}, np.zeros(2))
    assert status.messages[0]["what"] == "goes on"


def test_a_name_of_thousands_of_letters_is_no_marker():
    from jaxmocap.capture.streams.osc import parse_packet

    address = b"/tracking/trackers/" + b"x" * 5000 + b"/position"
    datagram = address + b"\0" * (4 - len(address) % 4) + b",fff\0\0\0\0" + b"\0" * 12
    assert parse_packet(datagram) == ((), None, False, ("malformed",))


# Clocks that are read seldom ----------------------------------------------------------------------


SENT = np.arange(0.0, 30.0, 1 / 90)
# A packet is fetched within so many seconds where nothing is in the way.
AT_ONCE_S = 2e-3


class SlowReader:
    """A socket whose packets wait while nobody fetches them.

    Attributes:
        at: the reader's clock, seconds.
        each_s: so long it takes to fetch a packet.
    """

    def __init__(self, stamps: np.ndarray, room: int = 10**6):
        """Packets with these stamps, sent at ``SENT``; of what waits, all beyond the room is lost.

        So a system's own buffer has it: the oldest stay.
        """
        self.at, self.each_s, self._room = 0.0, AT_ONCE_S, room
        self._coming = list(zip(SENT, stamps, strict=True))
        self._there: list[float] = []
        self.gathers, self.samples = gathering()
        self.socket = MarkerSocket(OscTable(Address(port=0)), self.gathers, now=lambda: self.at)
        self.socket.stop()
        self.socket._socket = self

    def recvfrom(self, _):
        self.at += self.each_s
        while self._coming and self._coming[0][0] <= self.at:
            stamp = self._coming.pop(0)[1]
            if len(self._there) < self._room:
                self._there.append(stamp)
        if not self._there:
            raise BlockingIOError
        made = packet(0.0, stamp=float(self._there.pop(0)))
        return made.content, (made.host, made.port)

    def fetch_until(self, end: float, each_s: float = AT_ONCE_S) -> None:
        """Fetch whatever comes."""
        self.each_s = each_s
        while self.at < end:
            datagrams, more_wait = self.socket._waiting()
            if datagrams:
                self.socket.take(datagrams, more_wait)


@pytest.mark.parametrize("begins", [0.0, 3.0])
@pytest.mark.parametrize("room", [10**6, 270])
@pytest.mark.parametrize("each_s", [0.004, 0.0105, 0.016])
def test_a_thread_that_is_held_up_finds_no_clock_that_was_set(each_s, room, begins):
    """Programs are traced beside it, from the start or later, and it fetches slowly meanwhile."""
    reader = SlowReader(SENT, room)
    reader.fetch_until(begins)
    reader.at += 5.0
    reader.fetch_until(20.0, each_s)
    reader.fetch_until(29.0)
    assert reader.socket.senders.clock_jumps == 0 and reader.socket.senders.clock_rate is None
    # Whatever it thought of the clock meanwhile, it has found the rhythm again.
    steps = np.diff([sample.time for sample in reader.samples[-200:]])
    np.testing.assert_allclose(steps, 1 / 90, atol=1e-3)
    assert reader.at - reader.samples[-1].time < 0.03


@pytest.mark.parametrize("each_s", [AT_ONCE_S, 0.007])
@pytest.mark.parametrize("jump", [5.0, 0.6, -0.6, -5.0])
def test_a_clock_that_is_set_is_found_though_it_is_read_slowly(jump, each_s):
    reader = SlowReader(SENT + jump * (SENT > 18))
    reader.fetch_until(5.0)
    reader.at += 3.0
    reader.fetch_until(29.0, each_s)
    assert reader.socket.senders.clock_jumps == 1
    assert reader.at - reader.samples[-1].time < 0.03


@pytest.mark.parametrize("each_s", [AT_ONCE_S, 0.007])
def test_a_sender_that_was_paused_with_its_clock_goes_on_as_its_packets_come(each_s):
    reader = SlowReader(SENT - 4.0 * (SENT > 10))
    reader._coming = [pair for pair in reader._coming if not 10 < pair[0] < 14.5]
    reader.fetch_until(29.0, each_s)
    assert reader.socket.senders.clock_jumps == 1
    assert reader.at - reader.samples[-1].time < 0.03


def test_a_recordings_reader_names_every_table_that_live_files_alone_have():
    assert set(LIVE_TABLES) == {*SOURCES, *SENDERS}
