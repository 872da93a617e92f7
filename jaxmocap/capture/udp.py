"""A socket that listens: OSC packets to marker samples, in a thread of its own.

INPUTS: an address, whatever is sent there. OUTPUTS: samples; counts of what was ignored and why.
"""

import select
import socket
from collections import Counter
from collections.abc import Callable
from threading import Event, Thread
from time import monotonic

from jaxmocap.capture.gathering import Gathering
from jaxmocap.capture.osc import BadPacketError, parse
from jaxmocap.capture.stream_clock import StreamClock
from jaxmocap.formats.errors import InputError
from jaxmocap.formats.live import Address

# So many packets a second are read, so many of them at a stroke; older ones beyond are dropped.
MOST_A_SECOND, BURST = 4000, 400
# Larger than what UDP carries.
LARGEST = 65536


class MarkerSocket:
    """Listens for markers.

    Attributes:
        ignored: why -> how many packets: "malformed", "absurd" (no number, or a place that no room
            has), "flood" (more than can be read), "foreign" (nothing about markers).
        packets: that came in.
        heard: when a marker came in last, ``monotonic`` seconds; None before.
        clock: the sender's.
        problem: None; nothing keeps a socket from being used once it is there.
    """

    problem: str | None = None

    def __init__(
        self,
        address: Address,
        gathering: Gathering,
        raw: bool = False,
        now: Callable[[], float] = monotonic,
    ):
        """Open the socket.

        Args:
            address: where to listen; port 0 takes a free one.
            gathering: takes the markers.
            raw: see ``osc.parse``.
            now: seconds.

        Raises:
            InputError: the address cannot be had.
        """
        self.ignored: Counter[str] = Counter()
        self.packets, self.heard = 0, None
        self.clock = StreamClock()
        self._gathering, self._raw, self._now = gathering, raw, now
        self._tokens, self._filled = float(BURST), now()
        self._stop = Event()
        self._socket = _bound(address)
        self.address = Address(address.host, self._socket.getsockname()[1])
        self._thread = Thread(target=self._listen, name="markers", daemon=True)

    def start(self) -> None:
        """Listen from now on; what came before is old."""
        self._waiting()
        self._filled = self._now()
        self._thread.start()

    def stop(self) -> None:
        """Listen no more."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(1.0)
        self._socket.close()

    def _listen(self) -> None:
        while not self._stop.is_set():
            if select.select([self._socket], [], [], 0.1)[0]:
                self.take(self._waiting())

    def _waiting(self) -> list[tuple[float, bytes]]:
        """All datagrams that wait, and when they were fetched."""
        waiting = []
        while len(waiting) < MOST_A_SECOND:
            try:
                waiting.append((self._now(), self._socket.recv(LARGEST)))
            except BlockingIOError:
                break
            except OSError:
                # What some systems say where an answer of ours found nobody.
                continue
        return waiting

    def take(self, datagrams: list[tuple[float, bytes]]) -> None:
        """Read datagrams, the newest where there are too many.

        Args:
            datagrams: when each came in, seconds, and what it holds.
        """
        now = self._now()
        self._tokens = min(self._tokens + MOST_A_SECOND * (now - self._filled), BURST)
        self._filled = now
        allowed = min(len(datagrams), int(self._tokens))
        self._tokens -= allowed
        self.packets += len(datagrams)
        self.ignored["flood"] += len(datagrams) - allowed
        for arrived, datagram in datagrams[len(datagrams) - allowed :]:
            self._read(arrived, datagram)

    def _read(self, arrived: float, datagram: bytes) -> None:
        try:
            packet = parse(datagram, self._raw)
        except BadPacketError as why:
            self.ignored[str(why)] += 1
            return
        if not packet.placed:
            self.ignored["foreign"] += 1
            return
        self.heard = arrived
        time = self.clock.time(arrived, packet.stamp)
        self._gathering.add(packet.placed, time, arrived, packet.whole)


def _bound(address: Address) -> socket.socket:
    family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_DGRAM)
    try:
        listening.bind((address.host, address.port))
    except OSError as error:
        listening.close()
        raise InputError(str(address), f"cannot listen there ({error.strerror})") from None
    listening.setblocking(False)
    return listening
