"""How large a picture is, from the first bytes of its file, before it is decoded.

INPUTS: an image file's content, or its beginning.
OUTPUTS: width and height in pixels, as the header states them; or that it is no picture.
"""

import re
import struct
from collections.abc import Callable

PICTURE_FORMATS = "PNG, JPEG, BMP, TIFF, WebP, GIF or PNM"
# Bytes by which a file is recognised as a picture.
SIGNATURE_BYTES = 32
# Segments of a JPEG file before its picture: an album of metadata has some hundred.
_MAX_JPEG_SEGMENTS = 10_000
# JPEG's markers of frames are these, but for those of tables among them.
_JPEG_FRAME_MARKERS = set(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
# TIFF's tags of width and height.
_WIDTH = 256
_HEIGHT = 257
# TIFF's types of 16 and 32 bits, as ``struct`` names them.
_TYPES = {3: "H", 4: "I"}
_PNM = re.compile(rb"P[1-6](?:\s|#[^\n]*\n)+(\d{1,9})(?:\s|#[^\n]*\n)+(\d{1,9})\s")

Size = tuple[int, int]


def is_picture(start: bytes) -> bool:
    """Whether a file that begins so says that it is a picture."""
    return _reader(start) is not None


def picture_size(content: bytes) -> Size | None:
    """Width and height; None of what is no picture, or cut off in its header."""
    read = _reader(content)
    try:
        return read(content) if read else None
    except (struct.error, IndexError):
        return None


def _reader(start: bytes) -> Callable[[bytes], Size | None] | None:
    """What reads the header of a file that begins so."""
    if start[:4] == b"RIFF" and start[8:12] == b"WEBP":
        return _webp
    beginnings = {
        b"\x89PNG\r\n\x1a\n": lambda content: struct.unpack_from(">II", content, 16),
        b"\xff\xd8\xff": _jpeg,
        b"BM": _bmp,
        b"II*\0": lambda content: _tiff(content, "<"),
        b"MM\0*": lambda content: _tiff(content, ">"),
        b"GIF87a": lambda content: struct.unpack_from("<HH", content, 6),
        b"GIF89a": lambda content: struct.unpack_from("<HH", content, 6),
    }
    readers = [read for beginning, read in beginnings.items() if start.startswith(beginning)]
    return readers[0] if readers else (_pnm if re.match(rb"P[1-6][\s#]", start) else None)


def _jpeg(content: bytes) -> Size | None:
    at = 2
    for _ in range(_MAX_JPEG_SEGMENTS):
        marker, length = struct.unpack_from(">HH", content, at)
        if marker == 0xFFFF:
            # Bytes to fill up with, as many as one likes.
            match = re.compile(rb"\xff*").match(content, at)
            at = (match.end() if match else at) - 1
            continue
        if marker >> 8 != 0xFF:
            return None
        if marker & 0xFF in _JPEG_FRAME_MARKERS:
            height, width = struct.unpack_from(">HH", content, at + 5)
            return width, height
        at += 2 + length
    return None


def _bmp(content: bytes) -> Size:
    if content[14] == 12:
        return struct.unpack_from("<HH", content, 18)
    width, height = struct.unpack_from("<ii", content, 18)
    # Rows from the top have a negative height.
    return width, abs(height)


def _tiff(content: bytes, order: str) -> Size | None:
    at = struct.unpack_from(f"{order}I", content, 4)[0]
    tags = {}
    for entry in range(struct.unpack_from(f"{order}H", content, at)[0]):
        place = at + 2 + 12 * entry
        tag, kind = struct.unpack_from(f"{order}HH", content, place)
        if tag in (_WIDTH, _HEIGHT) and kind in _TYPES:
            tags[tag] = struct.unpack_from(order + _TYPES[kind], content, place + 8)[0]
    return (tags[_WIDTH], tags[_HEIGHT]) if len(tags) == 2 else None


def _webp(content: bytes) -> Size | None:
    kind = content[12:16]
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", content, 26)
        return width & 0x3FFF, height & 0x3FFF
    if kind == b"VP8L":
        bits = struct.unpack_from("<I", content, 21)[0]
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8X":
        sides = [int.from_bytes(content[at : at + 3], "little") + 1 for at in (24, 27)]
        return sides[0], sides[1]
    return None


def _pnm(content: bytes) -> Size | None:
    match = _PNM.match(content)
    return (int(match[1]), int(match[2])) if match else None
