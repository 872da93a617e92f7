"""glTF 2.0 in its binary form: JSON and one block of numbers, in one file.

INPUTS: a .glb file; or a glTF document and the arrays that its accessors stand for.
OUTPUTS: the other. The container is 12 bytes of header and two chunks, so that the standard
library's json and struct write it; the libraries there are would bring seven more packages.
"""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.formats.errors import InputError
from jaxmocap.formats.reading import read_bytes
from jaxmocap.formats.writing import replacing

_MAGIC, _VERSION, _JSON, _BINARY = b"glTF", 2, b"JSON", b"BIN\0"
_TYPES = {(): "SCALAR", (2,): "VEC2", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
_SHAPES = {name: shape for shape, name in _TYPES.items()}
_COMPONENTS = {"<i1": 5120, "<u1": 5121, "<i2": 5122, "<u2": 5123, "<u4": 5125, "<f4": 5126}
_DTYPES = {code: np.dtype(name) for name, code in _COMPONENTS.items()}


class Binary:
    """Arrays of a document, one after the other in one block."""

    def __init__(self):
        self.accessors: list[dict[str, Any]] = []
        self.views: list[dict[str, Any]] = []
        self.content = bytearray()

    def add(
        self,
        array: np.ndarray,
        dtype: str = "<f4",
        bounded: bool = False,
        target: int | None = None,
    ) -> int:
        """Append (N, ...) numbers; the index of their accessor.

        Args:
            array: scalars, vectors or (4, 4) matrices, rows before columns.
            dtype: in which they are held.
            bounded: say their smallest and largest, as positions and times must.
            target: glTF's number for what they are to a mesh: its vertices or its triangles.
        """
        # Matrices are held column by column.
        stored = np.asarray(array, np.dtype(dtype))
        held = stored.swapaxes(1, 2) if stored.ndim == 3 else stored
        view = self.add_bytes(held.tobytes())
        if target is not None:
            self.views[view]["target"] = target
        accessor = {"bufferView": view, "componentType": _COMPONENTS[dtype]}
        accessor |= {"count": len(stored), "type": _TYPES[stored.shape[1:]]}
        if bounded:
            rows = stored.reshape(len(stored), -1).astype(float)
            accessor |= {"min": rows.min(0).tolist(), "max": rows.max(0).tolist()}
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def add_bytes(self, data: bytes) -> int:
        """Append a file's content; the index of its view."""
        self.views.append({"buffer": 0, "byteOffset": len(self.content), "byteLength": len(data)})
        self.content += data + bytes(-len(data) % 4)
        return len(self.views) - 1


def write_document(path: str | Path, document: dict[str, Any], binary: Binary) -> None:
    """Write a document with the arrays that it refers to."""
    whole = document | {
        "accessors": binary.accessors,
        "bufferViews": binary.views,
        "buffers": [{"byteLength": len(binary.content)}],
    }
    text = json.dumps(whole, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), _JSON) + text
    chunks += struct.pack("<I4s", len(binary.content), _BINARY) + bytes(binary.content)
    with replacing(path) as beside:
        beside.write_bytes(struct.pack("<4sII", _MAGIC, _VERSION, 12 + len(chunks)) + chunks)


def read_document(path: str | Path) -> tuple[dict[str, Any], bytes]:
    """The document of a .glb file and its block of numbers.

    Raises:
        InputError: no such file, not glTF 2.0 in binary form, or cut off.
    """
    content = read_bytes(path)
    if content[:4] != _MAGIC or len(content) < 20:
        raise InputError(path, "not a binary glTF file, which begins with 'glTF'")
    _, version, length = struct.unpack_from("<4sII", content)
    if version != _VERSION:
        raise InputError(path, f"glTF version {version}, expected {_VERSION}")
    if len(content) < length:
        raise InputError(path, f"cut off, {len(content)} of {length} bytes are there")
    chunks, start = {}, 12
    while start + 8 <= length:
        size, kind = struct.unpack_from("<I4s", content, start)
        chunks.setdefault(kind, content[start + 8 : start + 8 + size])
        start += 8 + size
    try:
        document = json.loads(chunks[_JSON])
    except (KeyError, ValueError):
        raise InputError(path, "holds no readable JSON, which every glTF file needs") from None
    return document, chunks.get(_BINARY, b"")


def read_array(document: dict[str, Any], content: bytes, accessor: int) -> np.ndarray:
    """(N, ...) float64 numbers of an accessor.

    Raises:
        ValueError: sparse, outside the file, or otherwise beyond what is read here.
    """
    told = document["accessors"][accessor]
    view = document["bufferViews"][told["bufferView"]]
    if "sparse" in told or "uri" in document["buffers"][view["buffer"]]:
        raise ValueError("numbers that are sparse or in another file")
    dtype, shape = _DTYPES[told["componentType"]], _SHAPES[told["type"]]
    size = int(np.prod(shape, dtype=int)) * dtype.itemsize
    start = view.get("byteOffset", 0) + told.get("byteOffset", 0)
    stride = view.get("byteStride", size)
    rows = [content[start + i * stride : start + i * stride + size] for i in range(told["count"])]
    numbers = np.frombuffer(b"".join(rows), dtype).astype(float)
    if told.get("normalized"):
        numbers = np.maximum(numbers / np.iinfo(dtype).max, -1.0)
    array = numbers.reshape(-1, *shape)
    if len(array) != told["count"]:
        raise ValueError("numbers that the file does not hold")
    return array.swapaxes(1, 2) if len(shape) == 2 else array
