"""Who sends: for each sender a clock and a share of what can be read, of a few senders at a time.

INPUTS: hosts and ports that datagrams come from; the networks whose packets count.
OUTPUTS: Senders with their clocks; which of the datagrams that wait are read.

A sender is a host and a port, for two programs on one machine have two clocks; whether it may send
at all is decided by its host. Beyond ``MOST_SENDERS`` at a time the rest share one entry, whose
stamps are not used: their packets count when they arrive.
"""

import math
from collections.abc import Mapping, Sequence
from typing import TypeVar

from jaxmocap.capture.streams.stream_clock import StreamClock
from jaxmocap.formats.files.addresses import LOOPBACK, Address, Network, is_among

# Senders with a clock of their own at a time; one that was silent for so many seconds makes room.
MOST_SENDERS = 16
FORGOTTEN_S = 10.0
# So many packets a second are read of one sender, so many of them at a stroke.
SENDER_A_SECOND = 3000
SENDER_BURST = 300
# Hosts whose right to send is remembered, and of those without it how many are named.
MOST_HOSTS = 256
MOST_STRANGERS = 16
Who = TypeVar("Who")


class Share:
    """So many packets a second, a burst of them at a stroke."""

    def __init__(self, a_second: float, burst: int, now: float):
        """Begin with a whole burst."""
        self._a_second, self._burst = a_second, burst
        self._left, self._filled = float(burst), now

    def left(self, now: float) -> int:
        """How many may be read now."""
        passed = max(now - self._filled, 0.0)
        self._left = min(self._left + self._a_second * passed, self._burst)
        self._filled = now
        return int(self._left)

    def take(self, count: int) -> None:
        """So many were read."""
        self._left -= count


class Sender:
    """One host and port.

    Attributes:
        name: for figures.
        clock: its own; None where several senders share this entry.
        packets: that came in from there.
        heard: when, seconds.
        share: of what can be read.
    """

    def __init__(self, name: str, clock: StreamClock | None, now: float):
        self.name, self.clock, self.packets, self.heard = name, clock, 0, now
        self.share = Share(SENDER_A_SECOND, SENDER_BURST, now)

    def time(self, arrival: float, stamp: float | None) -> float:
        """When a packet was sent, as far as that is known; see ``StreamClock``."""
        return arrival if self.clock is None else self.clock.time(arrival, stamp)


class Senders:
    """All of them.

    Attributes:
        strangers: hosts that are in none of the networks, the first of them.
    """

    def __init__(self, allowed: Sequence[Network] = LOOPBACK):
        """Nobody has sent yet; only these networks' packets count."""
        self._allowed = tuple(allowed)
        self._admitted: dict[str, bool] = {}
        self._own: dict[tuple[str, int], Sender] = {}
        self._rest: Sender | None = None
        self._earlier_jumps = 0
        self.strangers: set[str] = set()

    def admits(self, host: str) -> bool:
        """May this host send?"""
        if host not in self._admitted:
            if len(self._admitted) >= MOST_HOSTS:
                self._admitted.clear()
            self._admitted[host] = is_among(host, self._allowed)
        if not self._admitted[host] and len(self.strangers) < MOST_STRANGERS:
            self.strangers.add(host)
        return self._admitted[host]

    def of(self, host: str, port: int, now: float) -> Sender:
        """The sender there."""
        sender = self._own.get((host, port)) or self._made(host, port, now)
        sender.packets += 1
        sender.heard = now
        return sender

    @property
    def clock_jumps(self) -> int:
        """How often a sender's clock was set."""
        clocks = [sender.clock for sender in self._own.values()]
        return self._earlier_jumps + sum(clock.jumps for clock in clocks if clock)

    def packets(self) -> dict[str, int]:
        """Sender -> packets that came in from there, of the present ones."""
        rest = [] if self._rest is None else [self._rest]
        return {sender.name: sender.packets for sender in [*self._own.values(), *rest]}

    def _made(self, host: str, port: int, now: float) -> Sender:
        """A new sender, or the one that the rest share."""
        if len(self._own) >= MOST_SENDERS:
            oldest = min(self._own, key=lambda key: self._own[key].heard)
            if now - self._own[oldest].heard < FORGOTTEN_S:
                self._rest = self._rest or Sender("others", None, now)
                return self._rest
            gone = self._own.pop(oldest)
            self._earlier_jumps += gone.clock.jumps if gone.clock else 0
        self._own[host, port] = Sender(str(Address(host, port)), StreamClock(), now)
        return self._own[host, port]


def shared_out(counts: Mapping[Who, int], most: int) -> dict[Who, int]:
    """How many of each may be read where all together may not: who asks for less is served first.

    Args:
        counts: who -> how many wait.
        most: of all together.
    """
    served: dict[Who, int] = {}
    for i, who in enumerate(sorted(counts, key=lambda key: counts[key])):
        served[who] = min(counts[who], math.ceil(most / (len(counts) - i)))
        most -= served[who]
    return served
