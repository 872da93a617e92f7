"""glTF 2.0 in its binary form: JSON and one block of numbers, in one file.

INPUTS: a .glb file; or a glTF document and the arrays that its accessors stand for, of which some
rows at a time may come while the file is written.
OUTPUTS: the other. The container is 12 bytes of header and two chunks, so that the standard
library's json and struct write it; the libraries there are would bring seven more packages.
"""

import json
import math
import struct
from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.formats.armatures.armature import BeyondFormatError
from jaxmocap.formats.files.errors import InputError, short_repr
from jaxmocap.formats.files.json_text import JsonPart, parse_json
from jaxmocap.formats.files.reading import read_bytes
from jaxmocap.formats.files.writing import replacing

# A .glb file begins with this, and with its version.
_MAGIC = b"glTF"
_VERSION = 2
_MOST_BYTES = 2**32 - 1
# Kinds of its chunks.
_JSON = b"JSON"
_BINARY = b"BIN\0"
_TYPES = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
_SHAPES = {name: shape for shape, name in _TYPES.items()}
_COMPONENTS = {"<i1": 5120, "<u1": 5121, "<i2": 5122, "<u2": 5123, "<u4": 5125, "<f4": 5126}
_DTYPES = {code: np.dtype(name) for name, code in _COMPONENTS.items()}
_CHUNKS = (_JSON, _BINARY)
# That are read from one file: keys of half an hour at 200 Hz for two dozen joints.
MAX_NUMBERS = 40_000_000


class BinaryChunk:
    """Arrays of a document, one after the other in one block."""

    def __init__(self):
        self.accessors: list[dict[str, Any]] = []
        self.views: list[dict[str, Any]] = []
        # Where each begins; what is not here yet is written at the end.
        self.parts: dict[int, bytes] = {}
        self.size = 0

    def add(
        self,
        array: np.ndarray,
        dtype: str = "<f4",
        bounded: bool = False,
        target: int | None = None,
    ) -> int:
        """Append (N, ...) scalars, vectors or (4, 4) matrices; the index of their accessor.

        Positions and times must be ``bounded``; ``target`` is glTF's for vertices or triangles.
        """
        # Matrices are stored column by column.
        stored = np.asarray(array, np.dtype(dtype))
        held = stored.swapaxes(1, 2) if stored.ndim == 3 else stored
        view = self.add_bytes(held.tobytes())
        if target is not None:
            self.views[view]["target"] = target
        bounds: dict[str, Any] = {}
        if bounded:
            rows = stored.reshape(len(stored), -1).astype(float)
            bounds = {"min": rows.min(0).tolist(), "max": rows.max(0).tolist()}
        return self._add_accessor(view, stored.shape, dtype, bounds)

    def add_bytes(self, data: bytes) -> int:
        """Append a file's content; the index of its view."""
        self.parts[self.size] = data
        return self._add_view(len(data))

    def reserve(self, shape: tuple[int, ...]) -> tuple[int, int]:
        """Room for float32 numbers that come later: their accessor's index, and their place."""
        start = self.size
        view = self._add_view(4 * math.prod(shape))
        return self._add_accessor(view, shape, "<f4", {}), start

    def _add_view(self, length: int) -> int:
        self.views.append({"buffer": 0, "byteOffset": self.size, "byteLength": length})
        self.size += length + -length % 4
        return len(self.views) - 1

    def _add_accessor(
        self, view: int, shape: tuple[int, ...], dtype: str, bounds: dict[str, Any]
    ) -> int:
        accessor = {"bufferView": view, "componentType": _COMPONENTS[dtype]}
        self.accessors.append(accessor | {"count": shape[0], "type": _TYPES[shape[1:]]} | bounds)
        return len(self.accessors) - 1


def write_document(
    path: str | Path,
    document: dict[str, Any],
    binary: BinaryChunk,
    later: Iterable[tuple[int, bytes]] = (),
) -> None:
    """Write a document with its arrays; ``later`` comes what room was reserved for, by place.

    Raises:
        BeyondFormatError: it would be larger than the format's 4 GiB.
    """
    complete = document | {
        "accessors": binary.accessors,
        "bufferViews": binary.views,
        "buffers": [{"byteLength": binary.size}],
    }
    text = json.dumps(complete, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    start = 12 + 8 + len(text) + 8
    if start + binary.size > _MOST_BYTES:
        size = f"{(start + binary.size) / 2**30:.1f} GiB"
        raise BeyondFormatError(path, f"glTF holds less than 4 GiB, this would be {size}")
    head = struct.pack("<4sII", _MAGIC, _VERSION, start + binary.size)
    head += struct.pack("<I4s", len(text), _JSON) + text + struct.pack("<I4s", binary.size, _BINARY)
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(head)
        file.truncate(start + binary.size)
        for at, data in chain(binary.parts.items(), later):
            file.seek(start + at)
            file.write(data)


def read_document(path: str | Path) -> tuple[JsonPart, bytes]:
    """The document of a .glb file and its numbers; InputError where it is not binary glTF 2.0."""
    content = read_bytes(path)
    if content[:4] != _MAGIC or len(content) < 20:
        raise InputError(path, "not a binary glTF file, which begins with 'glTF'")
    _, version, length = struct.unpack_from("<4sII", content)
    if version != _VERSION:
        raise InputError(path, f"glTF version {version}, expected {_VERSION}")
    if len(content) < length:
        raise InputError(path, f"cut off, {len(content)} of {length} bytes are there")
    chunks, start = {}, 12
    while start + 8 <= length and len(chunks) < len(_CHUNKS):
        size, kind = struct.unpack_from("<I4s", content, start)
        if kind in _CHUNKS:
            chunks.setdefault(kind, content[start + 8 : min(start + 8 + size, length)])
        start += 8 + size
    if _JSON not in chunks:
        raise InputError(path, "holds no readable JSON, which every glTF file needs")
    document = JsonPart(path, "", parse_json(path, chunks[_JSON]))
    if not isinstance(document.value, dict):
        raise InputError(path, f"found {short_repr(document.value)}, expected a JSON table")
    return document, chunks.get(_BINARY, b"")


class Accessors:
    """The arrays of a document.

    However often the same bytes are asked for by other names, what is read has a limit.
    """

    def __init__(self, document: JsonPart, content: bytes):
        self._document, self._content, self._numbers_left = document, content, MAX_NUMBERS

    def read(self, accessor: int, shape: tuple[int, ...]) -> np.ndarray:
        """(N, *shape) float64 numbers of an accessor; InputError without such finite ones."""
        stated = self._document["accessors"][accessor]
        if stated.has("sparse"):
            raise stated.error("found sparse numbers, which are not read")
        dtype = _DTYPES[stated["componentType"].choice(list(_DTYPES))]
        element = _SHAPES[stated["type"].choice(list(_SHAPES))]
        if element != shape:
            raise stated["type"].error(f"found {_TYPES[element]}, expected {_TYPES[shape]}")
        size = math.prod(shape)
        count = stated["count"].integer()
        self._numbers_left -= count * size
        if self._numbers_left < 0:
            most = f"expected at most {MAX_NUMBERS} in one file"
            raise stated["count"].error(f"found {count * size} numbers more, {most}")
        array = self._view(stated, dtype, count, size).astype(float)
        if stated.has("normalized") and stated["normalized"].value is True and dtype.kind != "f":
            array = np.maximum(array / np.iinfo(dtype).max, -1.0)
        if not np.isfinite(array).all():
            raise stated.error("found what is no number")
        return array.reshape(count, *shape)

    def _view(self, stated: JsonPart, dtype: np.dtype, count: int, size: int) -> np.ndarray:
        """(count, size) numbers as they stand in the block, nothing copied."""
        views = self._document["bufferViews"]
        view = views[stated["bufferView"].index(views)]
        buffers = self._document["buffers"]
        if view["buffer"].index(buffers) or buffers[0].has("uri"):
            raise view["buffer"].error("found numbers in another file, which are not read")
        at, length = view.get("byteOffset", 0).integer(), view["byteLength"].integer()
        if at + length > len(self._content):
            there = f"the file holds {len(self._content)}"
            raise view.error(f"found bytes {at} to {at + length}, {there}")
        row, start = size * dtype.itemsize, stated.get("byteOffset", 0).integer()
        stride = view.get("byteStride", row).integer(row)
        if count and start + (count - 1) * stride + row > length:
            problem = f"found {count} times {row} bytes from {start} on, {stride} apart"
            raise stated.error(f"{problem}, its view has {length}")
        offset, steps = at + start if count else 0, (stride, dtype.itemsize)
        return np.ndarray((count, size), dtype, self._content, offset, steps)
