"""A socket that listens: OSC packets to marker samples, in a thread of its own.

INPUTS: ``[osc]`` of a live file; whatever is sent to its address, by whomever.
OUTPUTS: samples; counts of what was ignored and why.
"""

import select
import socket
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from time import monotonic
from typing import ClassVar, NamedTuple

from jaxmocap.capture.streams.osc import BadPacketError, Packet, parse_packet
from jaxmocap.capture.streams.sample_assembly import SampleAssembler
from jaxmocap.capture.streams.senders import PacketSender, PacketSenders, TokenBucket, fair_shares
from jaxmocap.capture.streams.source import MarkerSource, SourceTable
from jaxmocap.formats.files.addresses import (
    LOOPBACK,
    Address,
    Network,
    read_address,
    read_allowed_networks,
    resolve_address,
)
from jaxmocap.formats.files.errors import InputError, comma_list, short_repr
from jaxmocap.formats.files.toml import TomlTable
from jaxmocap.formats.time_series.axes import R_WORLD_UNITY

# Packets a second that are read; older ones beyond are dropped.
MAX_PACKETS_HZ = 4000
# Packets that are read at a stroke.
MAX_BURST = 400
# So many seconds they are fetched at a stroke: each may wait for a thread that computes.
FETCH_S = 0.05
# Larger than what UDP carries.
MAX_DATAGRAM_BYTES = 65536
# The port that VMC's senders use.
DEFAULT_LISTEN = Address(port=39540)
# What VMC's senders and VRChat's call a headset.
HEADSETS = {"Hmd", "head"}


class Datagram(NamedTuple):
    """What was fetched when, seconds, and the host's number and port that it says it is from."""

    arrived: float
    content: bytes
    host: str
    port: int


class MarkerSocket(MarkerSource):
    """Listens for markers.

    What is ignored is "malformed", "absurd" (no number, or a place that no room has), "flood" (more
    than can be read), "foreign" (nothing about markers), "stranger" (from a host that may not
    send), or "scaled" (see ``osc.Packet``).
    """

    hints: ClassVar = MarkerSource.hints | {
        "scaled": "; devices come as .../Pos without .../Pos/Local: leave out 'raw' in [osc]"
    }
    who_may_send = "[osc] from = [...] lists who may send"

    def __init__(
        self, table: "OscTable", assembler: SampleAssembler, now: Callable[[], float] = monotonic
    ):
        """Open the socket, the clock in seconds; InputError where the address cannot be had."""
        self._socket = _bound_socket(table.listen)
        address = Address(table.listen.host, self._socket.getsockname()[1])
        super().__init__(address, 1.0, PacketSenders(table.allowed))
        self._assembler, self._raw, self._now = assembler, table.raw, now
        self._bucket = TokenBucket(MAX_PACKETS_HZ, MAX_BURST, now())

    def start(self) -> None:
        """Listen from now on; what came before is old."""
        self._waiting()
        self._bucket = TokenBucket(MAX_PACKETS_HZ, MAX_BURST, self._now())
        super().start()

    def stop(self) -> None:
        """Listen no more; returns within about a second."""
        super().stop()
        self._socket.close()

    def _listen(self) -> None:
        while not self._stop.is_set():
            try:
                looked = self._now()
                if select.select([self._socket], [], [], 0.1)[0]:
                    self.take(*self._waiting())
                else:
                    self.last_look = looked
            except (OSError, ValueError):
                # The socket was closed meanwhile.
                return

    def _waiting(self) -> tuple[list[Datagram], bool]:
        """The datagrams that wait, as many as a moment fetches, and whether more may wait."""
        waiting, end = [], self._now() + FETCH_S
        while len(waiting) < MAX_BURST and self._now() < end:
            try:
                content, source = self._socket.recvfrom(MAX_DATAGRAM_BYTES)
            except BlockingIOError:
                return waiting, False
            except OSError:
                # What some systems say where an answer of ours found nobody.
                continue
            waiting.append(Datagram(self._now(), content, source[0], source[1]))
        return waiting, True

    def take(self, datagrams: Sequence[Datagram], more_wait: bool = False) -> None:
        """Read datagrams as they came in: of each sender, and of all together, the newest."""
        now = self._now()
        self.packets += len(datagrams)
        waiting: dict[PacketSender, list[Datagram]] = {}
        for datagram in datagrams:
            if self.senders.is_allowed(datagram.host):
                sender = self.senders.sender_at(Address(datagram.host, datagram.port), now)
                waiting.setdefault(sender, []).append(datagram)
            else:
                self.ignored["stranger"] += 1
        counts = {
            sender: min(len(queue), sender.bucket.available(now))
            for sender, queue in waiting.items()
        }
        counts = fair_shares(counts, self._bucket.available(now))
        chosen = []
        for sender, queue in waiting.items():
            sender.bucket.take(counts[sender])
            chosen += [(datagram, sender) for datagram in queue[len(queue) - counts[sender] :]]
            self.ignored["flood"] += len(queue) - counts[sender]
        self._bucket.take(len(chosen))
        in_order = sorted(chosen, key=lambda pair: pair[0].arrived)
        read = [(*each, packet) for each in in_order if (packet := self._parse_datagram(each[0]))]
        newest = {} if more_wait else {sender: datagram for datagram, sender, _ in read}
        for datagram, sender, packet in read:
            is_prompt = newest.get(sender) is datagram
            time = sender.time(datagram.arrived, packet.stamp, is_prompt)
            if self._assembler.add(packet.markers, time, datagram.arrived, packet.is_bundle):
                self.last_arrival = datagram.arrived
                self.packets_used += 1
        # Only now, so that nobody who looks meanwhile misses what came with them.
        self.last_look = now

    def _parse_datagram(self, datagram: Datagram) -> Packet | None:
        """What it says about markers; None where that is nothing, which is counted."""
        try:
            packet = parse_packet(datagram.content, self._raw)
        except BadPacketError as why:
            self.ignored[str(why)] += 1
            return None
        self.ignored.update(packet.ignored)
        if packet.markers:
            return packet
        self.ignored["foreign"] += not packet.ignored
        return None


def _bound_socket(address: Address) -> socket.socket:
    family, socket_address = resolve_address(address)
    bound = None
    try:
        bound = socket.socket(family, socket.SOCK_DGRAM)
        bound.bind(socket_address)
    except OSError as error:
        if bound is not None:
            bound.close()
        raise InputError(str(address), f"cannot listen there ({error.strerror})") from None
    bound.setblocking(False)
    return bound


@dataclass(frozen=True)
class OscTable(SourceTable):
    """``[osc]``."""

    kind, keys = MarkerSocket, ("listen", "from", "names", "raw")
    R_world_source = R_WORLD_UNITY
    listen: Address = DEFAULT_LISTEN  # where it comes in
    # Networks whose packets count; what other hosts send is counted and ignored.
    allowed: tuple[Network, ...] = LOOPBACK
    aliases: Mapping[str, str] = field(default_factory=dict)
    raw: bool = False  # see ``osc.parse_packet``

    @classmethod
    def read(cls, fields: TomlTable, markers: Collection[str]) -> "OscTable":
        """Read it."""
        names = TomlTable(fields.path, "[osc.names]", fields.entries.get("names", {}))
        for sent in names.entries:
            if (marker := names.text(sent)) not in markers:
                found = f"no marker {short_repr(marker)} in [markers.on]"
                raise names.error(sent, f"{found}, found {comma_list(markers)}")
        raw, listen = fields.flag("raw"), read_address(fields, "listen", cls.listen)
        return cls(listen, read_allowed_networks(fields, listen), names.entries, raw)

    @property
    def headsets(self) -> set[str]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Markers that are a headset."""
        return HEADSETS | {marker for sent, marker in self.aliases.items() if sent in HEADSETS}
