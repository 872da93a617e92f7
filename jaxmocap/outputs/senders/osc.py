"""OSC bundles whose texts are fixed and whose numbers change: built once, filled at every frame.

INPUTS: addresses and arguments; numbers; a table of the live file. OUTPUTS: datagrams.

A protocol is a file beside this one with a SenderTable and a Sender, and its name in
``pipelines/live/setup.py``.
"""

import socket
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message_builder import OscMessageBuilder

from jaxmocap.formats.files.addresses import Address, read_address, resolve_address
from jaxmocap.formats.files.toml import TomlTable
from jaxmocap.outputs.senders.unity import Joints, UnityBody

# Where nothing states how sure the elbows are.
UNSTATED = np.full(2, np.nan)


class Sender(ABC):
    """Makes datagrams of one person's poses."""

    @abstractmethod
    def frame(
        self, time: float, local: Joints, deviations: np.ndarray = UNSTATED
    ) -> Sequence[bytes]:
        """Those of a pose, by its joints in their parents.

        The deviations (2,) are those of left and right elbow, metres; NaN unstated.
        """

    def lost_messages(self, time: float) -> Sequence[bytes]:
        """Those for a moment at which nobody is tracked."""
        return ()


@dataclass(frozen=True)
class SenderTable:
    """A table of the live file that asks for a sender; one that ``is_default`` does without it."""

    send: Address
    kind: ClassVar[Callable[..., Sender]]
    title: ClassVar[str]
    keys: ClassVar[tuple[str, ...]] = ("send",)
    is_default: ClassVar[bool] = False

    @classmethod
    def read(cls, fields: TomlTable) -> "SenderTable":
        """Read a table, empty where the file has none; InputError where a field does not fit."""
        return cls(read_address(fields, "send", cls.send))

    def sender(self, body: UnityBody) -> Sender:
        """What makes datagrams of this person's poses."""
        return self.kind(self, body)


# Bytes of a word, to which OSC aligns everything.
_WORD = 4
# Bytes of a bundle's header.
_HEADER = 16


class Bundle:
    """A bundle "at once" of messages whose floats, which come last in each, can be changed."""

    def __init__(self, messages: Sequence[tuple[str, Sequence[str | int | float]]]):
        """Build it of each message's address and arguments."""
        builder, places, end = OscBundleBuilder(IMMEDIATELY), [], _HEADER
        for address, arguments in messages:
            message = OscMessageBuilder(address)
            for argument in arguments:
                message.add_arg(argument, {str: "s", int: "i", float: "f"}[type(argument)])
            built = message.build()
            builder.add_content(built)
            end += _WORD + built.size
            floats = sum(isinstance(argument, float) for argument in arguments)
            places += range(end // _WORD - floats, end // _WORD)
        self._datagram = bytearray(builder.build().dgram)
        self._words = np.frombuffer(self._datagram, ">f4")
        self._places = np.array(places, int)

    def fill(self, *numbers: np.ndarray | float) -> bytes:
        """The datagram with these floats in the order of the messages."""
        self._words[self._places] = np.concatenate([np.ravel(part) for part in numbers])
        return bytes(self._datagram)


class DatagramSender:
    """Sends datagrams to one address, and counts those that were sent or that failed."""

    def __init__(self, address: Address):
        """Open a socket.

        Raises:
            InputError: no such host.
        """
        # Resolved once: to look a name up at every frame would delay the frames.
        family, self._address = resolve_address(address)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        # An address may be that of everybody in a network.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        self.sent = self.failed = 0

    def send(self, datagrams: Sequence[bytes]) -> None:
        """Send, or count failures of the system; an address without a listener is none."""
        for datagram in datagrams:
            try:
                self._socket.sendto(datagram, self._address)
                self.sent += 1
            except OSError:
                self.failed += 1

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
