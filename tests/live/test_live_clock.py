"""A sender's clock, where the thread that reads its packets seldom gets its turn."""

import numpy as np
import pytest
from test_live_markers import gathering, packet

from jaxmocap.capture.streams.udp import MarkerSocket, OscTable
from jaxmocap.formats.files.addresses import Address

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
