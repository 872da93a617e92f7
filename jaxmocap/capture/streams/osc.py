"""OSC datagrams to markers: VMC's devices and VRChat's trackers.

    /VMC/Ext/Hmd/Pos  Con  Tra     serial, position (3), quaternion (4); .../Pos/Local as tracked
    /VMC/Ext/T                     the sender's seconds
    /tracking/trackers/1/position  position (3), by number or "head"
    /tracking/trackers/1/rotation  degrees (3) about x, y, z; about z first, then x, then y

INPUTS: datagrams, whoever sent them. OUTPUTS: Packets; BadPacketError for what is no OSC, is cut
off or says what cannot be.

Bundles are taken apart here, for python-osc never comes back from one whose element has a negative
size; messages are read by it.
"""

import math
import struct
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from pythonosc.osc_message import OscMessage
from pythonosc.osc_message import ParseError as MessageError
from pythonosc.parsing.osc_types import ParseError as TypesError

# Farther from the origin no room is, metres.
MAX_DISTANCE_M = 100.0
# Bundles within bundles: more is an attack, as are more messages and longer names.
MAX_DEPTH = 3
MAX_MESSAGES = 256
MAX_NAME_BYTES = 64
_BUNDLE = b"#bundle\0"
_BUNDLE_HEADER_BYTES = 16
# The time tag that stands for no time.
_IMMEDIATELY = 1
# OSC counts seconds from 1900, in parts of 2**32.
_FRACTIONS = 2.0**32
_DEVICES = (b"/VMC/Ext/Hmd/", b"/VMC/Ext/Con/", b"/VMC/Ext/Tra/")
_TRACKERS = b"/tracking/trackers/"
_POSITION = b"/position"
_ROTATION = b"/rotation"
_TIME = b"/VMC/Ext/T"


class BadPacketError(Exception):
    """A datagram that is to be ignored; the message is one word of why."""


class MarkerMessage(NamedTuple):
    """One marker of a packet.

    Attributes:
        names: what it may be called, the first that is a marker's counts.
        position: (x, y, z) metres, the sender's axes; None where only its orientation is sent.
        orientation: quaternion (x, y, z, w) from its own axes to the sender's, or None.
    """

    names: tuple[str, ...]
    position: tuple[float, float, float] | None
    orientation: tuple[float, float, float, float] | None = None


class Packet(NamedTuple):
    """What one datagram holds.

    Attributes:
        markers: its markers; none where it is about something else.
        stamp: the sender's seconds, or None where it does not say.
        is_bundle: whether it is a bundle, which holds all that belongs together.
    """

    markers: tuple[MarkerMessage, ...]
    stamp: float | None
    is_bundle: bool


def parse_packet(datagram: bytes, raw: bool = False) -> Packet:
    """Read one datagram.

    Args:
        datagram: as it came.
        raw: take VMC's devices as tracked (``Pos/Local``) in place of scaled to an avatar.

    Raises:
        BadPacketError: "malformed" or "absurd".
    """
    markers, stamp = [], None
    for message in _messages(datagram, MAX_DEPTH):
        address = message[: max(message.find(b"\0"), 0)]
        if address == _TIME:
            stamp = _numbers(message, 1, 0)[0]
        elif address.startswith(_DEVICES) and address.endswith(b"/Pos/Local" if raw else b"/Pos"):
            markers.append(_device(message, address))
        elif address.startswith(_TRACKERS) and address.endswith((_POSITION, _ROTATION)):
            markers.append(_tracker(message, address))
    is_bundle = datagram.startswith(_BUNDLE)
    return Packet(
        tuple(markers), _time_tag(datagram) if stamp is None and is_bundle else stamp, is_bundle
    )


def _messages(content: bytes, deepest: int, budget: list[int] | None = None) -> Iterator[bytes]:
    """The messages of a datagram, bundles taken apart."""
    budget = [MAX_MESSAGES] if budget is None else budget
    if content.startswith(b"/") and len(content) % 4 == 0:
        budget[0] -= 1
        if budget[0] < 0:
            raise BadPacketError("malformed")
        yield content
        return
    if not content.startswith(_BUNDLE) or len(content) < _BUNDLE_HEADER_BYTES or not deepest:
        raise BadPacketError("malformed")
    position = _BUNDLE_HEADER_BYTES
    while position < len(content):
        if len(content) - position < 4:
            raise BadPacketError("malformed")
        (size,) = struct.unpack_from(">i", content, position)
        if size <= 0 or size % 4 or size > len(content) - position - 4:
            raise BadPacketError("malformed")
        yield from _messages(content[position + 4 : position + 4 + size], deepest - 1, budget)
        position += 4 + size


def _numbers(message: bytes, count: int, texts: int) -> list[float]:
    """The last ``count`` arguments of a message that has ``texts`` texts before them."""
    values = _arguments(message)
    numbers = values[texts:]
    # VRChat's senders may add more; VMC's later versions do.
    if len(numbers) < count or not all(isinstance(v, (int, float)) for v in numbers[:count]):
        raise BadPacketError("malformed")
    if not all(map(math.isfinite, numbers[:count])):
        raise BadPacketError("absurd")
    return [float(value) for value in numbers[:count]]


def _arguments(message: bytes) -> list:
    start = (message.find(b"\0") // 4 + 1) * 4
    tags = message[start : message.find(b"\0", start)]
    # python-osc writes to the log about every other tag.
    if not tags.startswith(b",") or not set(tags[1:]) <= set(b"ifhdsTF"):
        raise BadPacketError("malformed")
    try:
        return OscMessage(message).params
    except (MessageError, TypesError, ValueError, struct.error, IndexError):
        raise BadPacketError("malformed") from None


def _device(message: bytes, address: bytes) -> MarkerMessage:
    """One of VMC's devices; a headset is called Hmd as well, whatever its serial is."""
    numbers = _numbers(message, 7, 1)
    serial = _arguments(message)[0]
    if not isinstance(serial, str) or len(serial) > MAX_NAME_BYTES:
        raise BadPacketError("malformed")
    kind = address.split(b"/")[3].decode()
    names = (serial, kind) if kind == "Hmd" else (serial,)
    return MarkerMessage(names, _position(numbers[:3]), unit_quaternion(numbers[3:]))


def _tracker(message: bytes, address: bytes) -> MarkerMessage:
    """One of VRChat's trackers: its position, or its orientation."""
    number, _, kind = address[len(_TRACKERS) :].rpartition(b"/")
    if len(number) > MAX_NAME_BYTES:
        raise BadPacketError("malformed")
    name, values = number.decode("ascii", "replace"), _numbers(message, 3, 0)
    if b"/" + kind == _POSITION:
        return MarkerMessage((name,), _position(values))
    return MarkerMessage((name,), None, _euler(values))


def _euler(degrees: list[float]) -> tuple[float, float, float, float]:
    """The quaternion of Unity's Euler angles."""
    halves = [math.radians(math.remainder(angle, 720.0)) / 2 for angle in degrees]
    (sx, sy, sz), (cx, cy, cz) = map(math.sin, halves), map(math.cos, halves)
    return (
        cy * sx * cz + sy * cx * sz,
        sy * cx * cz - cy * sx * sz,
        cy * cx * sz - sy * sx * cz,
        cy * cx * cz + sy * sx * sz,
    )


def unit_quaternion(numbers: Sequence[float]) -> tuple[float, float, float, float] | None:
    """A quaternion (x, y, z, w) of length 1, or None for anything else.

    Senders without orientations send zeros.
    """
    length = math.sqrt(sum(number**2 for number in numbers))
    if not abs(length - 1) <= 0.01:
        return None
    x, y, z, w = (number / length for number in numbers)
    return x, y, z, w


def _position(numbers: list[float]) -> tuple[float, float, float]:
    if max(map(abs, numbers)) > MAX_DISTANCE_M:
        raise BadPacketError("absurd")
    x, y, z = numbers
    return x, y, z


def _time_tag(bundle: bytes) -> float | None:
    """A bundle's seconds; None for "at once"."""
    (tag,) = struct.unpack_from(">Q", bundle, 8)
    return None if tag == _IMMEDIATELY else tag / _FRACTIONS
