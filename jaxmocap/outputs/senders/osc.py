"""OSC bundles whose texts are fixed and whose numbers change: built once, filled at every frame.

INPUTS: addresses and arguments; numbers. OUTPUTS: datagrams.
"""

import socket
from collections.abc import Sequence

import numpy as np
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message_builder import OscMessageBuilder

from jaxmocap.formats.files.addresses import Address, resolve_address

Argument = str | int | float
# Bytes of a word, to which OSC aligns everything.
_WORD = 4
# Bytes of a bundle's header.
_HEADER = 16


class Bundle:
    """A bundle "at once" of messages whose floats, which come last in each, can be changed."""

    def __init__(self, messages: Sequence[tuple[str, Sequence[Argument]]]):
        """Build it.

        Args:
            messages: address and arguments of each.
        """
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

    def filled(self, *numbers: np.ndarray | float) -> bytes:
        """The datagram with these floats in the order of the messages."""
        self._words[self._places] = np.concatenate([np.ravel(part) for part in numbers])
        return bytes(self._datagram)


class DatagramSender:
    """Sends datagrams to one address.

    Attributes:
        sent: how many.
        failed: how many the system did not take.
    """

    def __init__(self, address: Address):
        """Open a socket.

        Raises:
            InputError: no such host.
        """
        # Resolved once: to look a name up at every frame would delay the frames.
        family, self._address = resolve_address(address)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
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
