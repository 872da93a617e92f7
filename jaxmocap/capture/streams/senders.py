"""Who sends: for each sender a clock and a share of what can be read, of a few senders at a time.

INPUTS: hosts and ports that datagrams come from; the networks whose packets count.
OUTPUTS: PacketSenders with their clocks; which of the datagrams that wait are read.

A sender is a host and a port, for two programs on one machine have two clocks; whether it may send
at all is decided by its host. Beyond ``MAX_SENDERS`` at a time the rest share one entry, whose
stamps are not used: their packets count when they arrive.
"""

import math
from collections.abc import Mapping, Sequence
from typing import TypeVar

from jaxmocap.capture.streams.stream_clock import StreamClock
from jaxmocap.formats.files.addresses import LOOPBACK, Address, Network, is_in_networks

# Senders with a clock of their own at a time; one that was silent for so many seconds makes room.
MAX_SENDERS = 16
FORGET_AFTER_S = 10.0
# So many packets a second are read of one sender, so many of them at a stroke.
SENDER_PACKETS_HZ = 3000
SENDER_BURST = 300
# Hosts whose right to send is remembered, and of those without it how many are named.
MAX_HOSTS = 256
MAX_REFUSED_NAMED = 16
Key = TypeVar("Key")


class TokenBucket:
    """A rate limit: so many packets a second, a burst of them at a stroke."""

    def __init__(self, rate: float, burst: int, now: float):
        """Begin with a full bucket."""
        self._rate, self._burst = rate, burst
        self._tokens, self._filled_at = float(burst), now

    def available(self, now: float) -> int:
        """How many may be read now."""
        elapsed = max(now - self._filled_at, 0.0)
        self._tokens = min(self._tokens + self._rate * elapsed, self._burst)
        self._filled_at = now
        return int(self._tokens)

    def take(self, count: int) -> None:
        """So many were read."""
        self._tokens -= count


class PacketSender:
    """One host and port.

    Attributes:
        name: for figures.
        clock: its own; None where several senders share this entry.
        packets: that came in from there.
        last_arrival: when, seconds.
        bucket: of what can be read.
    """

    def __init__(self, name: str, clock: StreamClock | None, now: float):
        self.name, self.clock, self.packets, self.last_arrival = name, clock, 0, now
        self.bucket = TokenBucket(SENDER_PACKETS_HZ, SENDER_BURST, now)

    def time(self, arrival: float, stamp: float | None, is_prompt: bool = True) -> float:
        """When a packet was sent, as far as its clock allows; see ``StreamClock``."""
        return arrival if self.clock is None else self.clock.time(arrival, stamp, is_prompt)


class PacketSenders:
    """All of them.

    Attributes:
        refused_hosts: hosts that are in none of the networks, the first of them.
    """

    def __init__(self, allowed: Sequence[Network] = LOOPBACK):
        """Nobody has sent yet; only these networks' packets count."""
        self._allowed = tuple(allowed)
        self._is_allowed: dict[str, bool] = {}
        self._senders: dict[Address | str, PacketSender] = {}
        self._others: PacketSender | None = None
        self._earlier_jumps = 0
        self.refused_hosts: set[str] = set()

    def is_allowed(self, host: str) -> bool:
        """May this host send?"""
        if host not in self._is_allowed:
            if len(self._is_allowed) >= MAX_HOSTS:
                self._is_allowed.clear()
            self._is_allowed[host] = is_in_networks(host, self._allowed)
        if not self._is_allowed[host] and len(self.refused_hosts) < MAX_REFUSED_NAMED:
            self.refused_hosts.add(host)
        return self._is_allowed[host]

    def sender_at(self, place: Address | str, now: float) -> PacketSender:
        """The sender there, or of that name."""
        sender = self._senders.get(place) or self._new_sender(place, now)
        sender.packets += 1
        sender.last_arrival = now
        return sender

    @property
    def clock_jumps(self) -> int:
        """How often a sender's clock was set."""
        clocks = [sender.clock for sender in list(self._senders.values())]
        return self._earlier_jumps + sum(clock.jumps for clock in clocks if clock)

    @property
    def clock_rate(self) -> float | None:
        """Of the first sender whose clock runs too fast or too slowly; see ``StreamClock``."""
        clocks = [sender.clock for sender in list(self._senders.values())]
        return next((clock.rate for clock in clocks if clock and clock.rate is not None), None)

    def packets(self) -> dict[str, int]:
        """Sender -> packets that came in from there, of the present ones."""
        rest = [] if self._others is None else [self._others]
        return {sender.name: sender.packets for sender in [*self._senders.values(), *rest]}

    def _new_sender(self, place: Address | str, now: float) -> PacketSender:
        """A new sender, or the one that the rest share."""
        if len(self._senders) >= MAX_SENDERS:
            oldest = min(self._senders, key=lambda key: self._senders[key].last_arrival)
            if now - self._senders[oldest].last_arrival < FORGET_AFTER_S:
                self._others = self._others or PacketSender("others", None, now)
                return self._others
            gone = self._senders.pop(oldest)
            self._earlier_jumps += gone.clock.jumps if gone.clock else 0
        self._senders[place] = PacketSender(str(place), StreamClock(), now)
        return self._senders[place]


def fair_shares(counts: Mapping[Key, int], total: int) -> dict[Key, int]:
    """How many of those that wait may be read of so many: who asks for less is served first."""
    served: dict[Key, int] = {}
    for i, who in enumerate(sorted(counts, key=lambda key: counts[key])):
        served[who] = min(counts[who], math.ceil(total / (len(counts) - i)))
        total -= served[who]
    return served
