"""OSC datagrams to markers: VMC's devices and VRChat's trackers.

    /VMC/Ext/Hmd/Pos  Con  Tra     serial, position (3), quaternion (4); .../Pos/Local as tracked
    /VMC/Ext/T                     the sender's seconds
    /tracking/trackers/1/position  position (3), by number or "head"
    /tracking/trackers/1/rotation  degrees (3) about x, y, z; about z first, then x, then y

INPUTS: datagrams, whoever sent them. OUTPUTS: Packets; BadPacketError for what is no OSC or is cut
off.

Of a message only the arguments that we need are read, whatever follows them. A message that cannot
be used is ignored without the others of its bundle, as the protocol's specification asks
(https://protocol.vmc.info/english, "Communication format").
"""

import math
import struct
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from scipy.spatial.transform import Rotation

# Farther from the origin no room is, metres.
MAX_DISTANCE_M = 100.0
# Bundles within bundles: more is an attack, as are more messages and longer names. A datagram has
# room for some 1800 of the shortest that programs send, an avatar's expressions.
MAX_DEPTH = 3
MAX_MESSAGES = 2048
# Messages about markers.
MAX_MARKER_MESSAGES = 256
MAX_NAME_BYTES = 64
# From here on, after 9 hours, a 32-bit float steps by 4 ms: too coarse for a stamp, seconds.
COARSE_STAMP_S = 2.0**15
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
# Tags of numbers, and how they are packed.
_NUMBERS = {"i": ">i", "f": ">f", "h": ">q", "d": ">d"}


class BadPacketError(Exception):
    """A datagram that is to be ignored; the message is one word of why."""


class MarkerMessage(NamedTuple):
    """One marker of a packet."""

    names: tuple[str, ...]  # what it may be called, the first that is a marker's counts
    # (x, y, z) metres, the sender's axes; None where only its orientation is sent.
    position: tuple[float, float, float] | None
    # Quaternion (x, y, z, w) from its own axes to the sender's, or None.
    orientation: tuple[float, float, float, float] | None = None


class Packet(NamedTuple):
    """What one datagram holds."""

    markers: tuple[MarkerMessage, ...]  # its markers; none where it is about something else
    stamp: float | None  # the sender's seconds, or None where it does not say
    is_bundle: bool  # whether it is a bundle, which holds all that belongs together
    # Why messages about markers are ignored: "malformed", "absurd", and "scaled" where devices come
    # scaled to an avatar only, and are wanted as tracked; each once.
    ignored: tuple[str, ...] = ()


def parse_packet(datagram: bytes, raw: bool = False) -> Packet:
    """Read one datagram; BadPacketError for no OSC. ``raw`` takes VMC's devices as tracked."""
    markers: list[MarkerMessage] = []
    stamp, ignored, budget = None, set[str](), MAX_MARKER_MESSAGES
    has_scaled = False
    for message in _messages(datagram, MAX_DEPTH):
        address = message[: max(message.find(b"\0"), 0)]
        is_device = address.startswith(_DEVICES) and address.endswith(
            b"/Pos/Local" if raw else b"/Pos"
        )
        is_tracker = address.startswith(_TRACKERS) and address.endswith((_POSITION, _ROTATION))
        if not (is_device or is_tracker or address == _TIME):
            has_scaled |= raw and address.startswith(_DEVICES) and address.endswith(b"/Pos")
            continue
        budget -= 1
        if budget < 0:
            raise BadPacketError("malformed")
        try:
            if address == _TIME:
                (stamp,) = _arguments(message, 0, 1)[1]
                # Such seconds are too coarse to keep a rhythm.
                if _tags(message)[0][0] == "f" and abs(stamp) >= COARSE_STAMP_S:
                    stamp = None
            else:
                markers.append((_device if is_device else _tracker)(message, address))
        except BadPacketError as why:
            ignored.add(str(why))
    if has_scaled and not markers:
        ignored.add("scaled")
    is_bundle = datagram.startswith(_BUNDLE)
    if stamp is None and is_bundle:
        (tag,) = struct.unpack_from(">Q", datagram, 8)
        stamp = None if tag == _IMMEDIATELY else tag / _FRACTIONS
    return Packet(tuple(markers), stamp, is_bundle, tuple(sorted(ignored)))


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


def _arguments(message: bytes, texts: int, numbers: int) -> tuple[list[str], list[float]]:
    """The first arguments of a message: so many texts, then so many numbers; more may follow."""
    tags, at = _tags(message)
    if len(tags) < texts + numbers:
        raise BadPacketError("malformed")
    names, values = [], []
    for i, tag in enumerate(tags[: texts + numbers]):
        if i < texts:
            end = message.find(b"\0", at)
            if tag != "s" or end < 0:
                raise BadPacketError("malformed")
            names.append(message[at:end].decode("utf-8", "replace"))
            at = (end // 4 + 1) * 4
        else:
            packed = _NUMBERS.get(tag)
            if packed is None or at + struct.calcsize(packed) > len(message):
                raise BadPacketError("malformed")
            values.append(float(struct.unpack_from(packed, message, at)[0]))
            at += struct.calcsize(packed)
    if not all(map(math.isfinite, values)):
        raise BadPacketError("absurd")
    return names, values


def _tags(message: bytes) -> tuple[str, int]:
    """The tags of a message's arguments, and where these begin."""
    start = (message.find(b"\0") // 4 + 1) * 4
    end = message.find(b"\0", start)
    if end < 0 or message[start : start + 1] != b",":
        raise BadPacketError("malformed")
    return message[start + 1 : end].decode("ascii", "replace"), (end // 4 + 1) * 4


def _device(message: bytes, address: bytes) -> MarkerMessage:
    """One of VMC's devices; a headset is called Hmd as well, whatever its serial is."""
    (serial,), numbers = _arguments(message, 1, 7)
    if len(serial.encode()) > MAX_NAME_BYTES:
        raise BadPacketError("malformed")
    kind = address.split(b"/")[3].decode()
    names = (serial, kind) if kind == "Hmd" else (serial,)
    return MarkerMessage(names, _position(numbers[:3]), unit_quaternion(numbers[3:]))


def _tracker(message: bytes, address: bytes) -> MarkerMessage:
    """One of VRChat's trackers: its position, or its orientation."""
    number, _, kind = address[len(_TRACKERS) :].rpartition(b"/")
    if len(number) > MAX_NAME_BYTES:
        raise BadPacketError("malformed")
    name, values = number.decode("ascii", "replace"), _arguments(message, 0, 3)[1]
    if b"/" + kind == _POSITION:
        return MarkerMessage((name,), _position(values))
    about_x, about_y, about_z = (math.remainder(angle, 720.0) for angle in values)
    turn = Rotation.from_euler("YXZ", [about_y, about_x, about_z], degrees=True)
    return MarkerMessage((name,), None, tuple(turn.as_quat().tolist()))


def unit_quaternion(numbers: Sequence[float]) -> tuple[float, float, float, float] | None:
    """A quaternion (x, y, z, w) of length 1; None for others, such as zeros for no orientation."""
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
