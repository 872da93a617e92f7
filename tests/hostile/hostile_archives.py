"""Mutations of formats that hold arrays: npz archives and binary glTF.

INPUTS: a random generator and a file's content. OUTPUTS: another content, and what was done.
"""

import io
import json
import re
import struct
import warnings
import zipfile
import zlib
from functools import cache

import numpy as np
from hostile_bytes import MAGIC, Mutated
from hostile_values import as_json, change_tree

# What a bomb unpacks to, bytes: more than a case may take.
BOMB = 5 * 2**29
MOST_UNPACKED = 2**26
VALUES = (np.nan, np.inf, 1e308, 1e24, 1e39, -1.0, 0.0, 1e9, -(2.0**63), 1e-320)
DTYPES = ("f2", "f4", "f8", "i1", "i8", "u8", "?", "c16", "S3", "U9", "M8[s]", "m8[s]", "V7", "O")


class Evil:
    """Unpickled it leaves a file behind."""

    def __reduce__(self):
        return open, ("EVIL", "w")


def unpacked(content: bytes) -> dict[str, np.ndarray]:
    """Name -> array of an npz file."""
    with np.load(io.BytesIO(content)) as file:
        if sum(member.file_size for member in file.zip.infolist()) > MOST_UNPACKED:
            raise ValueError("too much to be taken apart")
        return dict(file)


def packed(arrays: dict[str, np.ndarray]) -> bytes:
    """An npz file; pickles where arrays hold objects."""
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w") as archive:
        for name, array in arrays.items():
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), npy(array))
    return held.getvalue()


def npy(array: np.ndarray) -> bytes:
    """An npy file."""
    held = io.BytesIO()
    np.lib.format.write_array(held, np.asarray(array), allow_pickle=True)
    return held.getvalue()


def npz_changed(rng: np.random.Generator, content: bytes) -> Mutated:
    """One of the arrays is missing, called otherwise, or of another kind, shape or content."""
    arrays = unpacked(content)
    name = str(rng.choice(list(arrays)))
    how = str(rng.choice(["drop", "rename", "dtype", "shape", "values", "copy", "object", "none"]))
    if how == "drop":
        del arrays[name]
    elif how == "rename":
        arrays[f"../{name}"] = arrays.pop(name)
    elif how == "copy":
        arrays[name] = arrays[other := str(rng.choice(list(arrays)))]
        how = f"is {other}"
    elif how == "object":
        arrays[name] = np.array([Evil()], object)
    elif how == "none":
        arrays = {}
    else:
        change = {"dtype": other_dtype, "shape": other_shape, "values": other_values}[how]
        arrays[name], how = change(rng, arrays[name])
    return packed(arrays), f"{name}: {how}"


def other_dtype(rng: np.random.Generator, array: np.ndarray) -> tuple[np.ndarray, str]:
    """The same numbers, or zeros, of another kind."""
    dtype = str(rng.choice(DTYPES))
    try:
        with np.errstate(all="ignore"):
            return array.astype(dtype), dtype
    except (ValueError, TypeError):
        return np.zeros(array.shape, dtype), dtype


def other_shape(rng: np.random.Generator, array: np.ndarray) -> tuple[np.ndarray, str]:
    """Fewer or more of them, an axis more or less, or transposed."""
    flat = array.reshape(-1)
    shapes = [
        array[..., None], array[None], flat, array.T, array[:0] if array.ndim else flat[:0],
        flat[:1].reshape(()) if array.size else flat, np.concatenate([flat, flat]),
        array[1:] if array.ndim else flat, array[..., :-1] if array.ndim else flat,
        np.repeat(flat[:1], 300_000),
    ]  # fmt: skip
    new = shapes[rng.integers(len(shapes))]
    return new, f"shape {new.shape}"


def other_values(rng: np.random.Generator, array: np.ndarray) -> tuple[np.ndarray, str]:
    """One or all of them hostile; parents in a circle."""
    value = VALUES[rng.integers(len(VALUES))]
    new = np.array(array)
    if new.dtype.kind in "US":
        texts = np.array(["", "\0", "\x1b[31m", "x/../../../EVIL", "a" * 1000, new.flat[0]])
        new = np.where(rng.random(new.shape) < 0.5, texts[rng.integers(len(texts))], new)
        return new, "texts"
    at = np.ones(new.shape, bool) if rng.random() < 0.3 else rng.random(new.shape) < 0.1
    at.flat[rng.integers(max(1, at.size))] = True
    with np.errstate(all="ignore"):
        if rng.random() < 0.2:
            new[at] = np.flip(new)[at]
            return new, "some from the other end"
        if rng.random() < 0.3 and new.ndim == 1:
            return np.arange(new.size).astype(new.dtype), "each its own number"
        new[at] = np.asarray(value).astype(new.dtype)
    return new, f"{int(at.sum())} of them {value:g}"


def npz_archive(rng: np.random.Generator, content: bytes) -> Mutated:
    """What an archive can be: encrypted, of two members of a name, an npy, another's."""
    arrays = unpacked(content)
    name = str(rng.choice(list(arrays)))
    how = str(rng.choice(["encrypted", "npy", "pickle", "twice", "method", "nested", "header",
                          "big-endian", "fortran", "huge", "text"]))  # fmt: skip
    one = npy(arrays[name])
    ways = {
        "npy": one,
        "pickle": MAGIC["pickle"] + one,
        "nested": _zipped([(f"{name}.npy", content)]),
        "twice": _zipped([(f"{n}.npy", npy(a)) for n, a in [*arrays.items(), *arrays.items()]]),
        "text": _zipped([("readme.txt", b"no array"), (f"{name}.npy", b"no array either")]),
        "big-endian": packed({n: _swapped(a) for n, a in arrays.items()}),
        "fortran": packed({n: np.asfortranarray(a) for n, a in arrays.items()}),
        "encrypted": _headers_with(packed(arrays), 6, 1),
        "method": _headers_with(packed(arrays), 8, 99),
        "header": _zipped([(f"{name}.npy", one.replace(b"'shape': (", b"'shape': (-", 1))]),
        "huge": _zipped(
            (f"{n}.npy", _claiming(a, 2**34) if n == name else npy(a)) for n, a in arrays.items()
        ),
    }
    return ways[how], f"{how}, {name}"


def npz_bomb(rng: np.random.Generator, content: bytes) -> Mutated:
    """An array that unpacks to gigabytes, all of which are there."""
    arrays = unpacked(content)
    name = str(rng.choice(list(arrays)))
    dtype = str(rng.choice(["<f8", "|u1", "<U4"]))
    header = _header(dtype, BOMB // np.dtype(dtype).itemsize)
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w") as archive:
        for other, array in arrays.items():
            if other != name:
                archive.writestr(zipfile.ZipInfo(f"{other}.npy"), npy(array))
    return _with_zeros(held.getvalue(), f"{name}.npy", header), f"{name}: {BOMB} bytes, {dtype}"


def _swapped(array: np.ndarray) -> np.ndarray:
    return array.astype(array.dtype.newbyteorder(">"))


def _zipped(members) -> bytes:
    held = io.BytesIO()
    with zipfile.ZipFile(held, "w") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        for name, content in members:
            archive.writestr(zipfile.ZipInfo(name), content)
    return held.getvalue()


def _header(dtype: str, count: int) -> bytes:
    held = io.BytesIO()
    fields = {"descr": dtype, "fortran_order": False, "shape": (count,)}
    np.lib.format.write_array_header_2_0(held, fields)
    return held.getvalue()


def _claiming(array: np.ndarray, count: int) -> bytes:
    """An array that says it has so many entries."""
    return _header("<f8", count) + array.tobytes()[:4096]


@cache
def _zeros() -> bytes:
    """``BOMB`` zeros deflated, some MB."""
    block = bytes(2**24)
    squeezer = zlib.compressobj(1, zlib.DEFLATED, -15)
    once = squeezer.compress(block) + squeezer.flush(zlib.Z_FULL_FLUSH)
    return once * (BOMB // len(block)) + b"\x03\0"


@cache
def _checksum(header: bytes) -> int:
    """Of a header and ``BOMB`` zeros."""
    block, checksum = bytes(2**24), zlib.crc32(header)
    for _ in range(BOMB // len(block)):
        checksum = zlib.crc32(block, checksum)
    return checksum


def _with_zeros(archive: bytes, name: str, header: bytes) -> bytes:
    """An archive and one more member: a header and ``BOMB`` zeros."""
    stored = struct.pack("<BHH", 0, len(header), len(header) ^ 0xFFFF) + header + _zeros()
    end = archive.rfind(b"PK\x05\x06")
    (count,) = struct.unpack_from("<H", archive, end + 10)
    directory_size, directory = struct.unpack_from("<II", archive, end + 12)
    sizes = struct.pack("<III", _checksum(header), len(stored), BOMB + len(header))
    # Version, flags, deflated, midnight of a day in 1980.
    fields = struct.pack("<HHHHH", 20, 0, 8, 0, 33) + sizes
    local = b"PK\3\4" + fields + struct.pack("<HH", len(name), 0) + name.encode() + stored
    entry = b"PK\1\2" + struct.pack("<H", 20) + fields
    entry += struct.pack("<HHHHHII", len(name), 0, 0, 0, 0, 0, directory) + name.encode()
    body = archive[:directory] + local + archive[directory : directory + directory_size] + entry
    counts = struct.pack("<HHHH", 0, 0, count + 1, count + 1)
    place = struct.pack("<II", directory_size + len(entry), directory + len(local))
    return body + b"PK\5\6" + counts + place + b"\0\0"


def _headers_with(archive: bytes, offset: int, value: int) -> bytes:
    """An archive whose members' headers, both of each, hold another number at an offset."""
    held = bytearray(archive)
    for match in re.finditer(b"PK\x01\x02|PK\x03\x04", archive):
        at = match.start() + offset + 2 * (match[0] == b"PK\x01\x02")
        struct.pack_into("<H", held, at, value)
    return bytes(held)


def glb_parts(content: bytes) -> tuple[dict, bytes]:
    """The document of a binary glTF file and its block of numbers."""
    (length,) = struct.unpack_from("<I", content, 12)
    return json.loads(content[20 : 20 + length]), content[28 + length :]


def glb_of(text: bytes, block: bytes) -> bytes:
    """A binary glTF file of a document's text."""
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(block), b"BIN\0") + block
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def glb_changed(rng: np.random.Generator, content: bytes) -> Mutated:
    """Keys and values of other kinds; half of the time where the numbers are described."""
    document, block = glb_parts(content)
    part = str(rng.choice([*document, "accessors", "accessors", "bufferViews", "nodes", "skins"]))
    tree = document if rng.random() < 0.3 else {part: document.get(part, {})}
    done = change_tree(rng, tree)
    return glb_of(as_json({**document, **tree}), block), done


def glb_nodes(rng: np.random.Generator, content: bytes) -> Mutated:
    """Nodes in loops, diamonds, chains, and crowds; accessors without end; deep JSON."""
    document, block = glb_parts(content)
    nodes, depth = document["nodes"], int(rng.choice([40, 3000, 50_000]))
    how = str(rng.choice(["loop", "self", "diamond", "chain", "crowd", "count", "stride", "deep",
                          "offset", "weights", "same"]))  # fmt: skip
    first = len(nodes)
    if how == "loop":
        nodes[-1]["children"] = [0]
    elif how == "self":
        nodes[rng.integers(first)]["children"] = [int(rng.integers(first))]
    elif how == "diamond":
        depth = min(depth, 3000)
        nodes += [{"children": [first + i + 1] * 2} for i in range(depth)] + [{}]
        nodes[0]["children"] = [*nodes[0].get("children", ()), first]
    elif how == "chain":
        nodes += [{"children": [first + i + 1], "name": f"n{i}"} for i in range(depth)] + [{}]
        nodes[0]["children"] = [*nodes[0].get("children", ()), first]
    elif how == "crowd":
        nodes += [{"name": f"n{i}"} for i in range(depth)]
        nodes[0]["children"] = [*nodes[0].get("children", ()), *range(first, first + depth)]
    elif how == "count":
        for accessor in document["accessors"]:
            accessor["count"] = int(rng.choice([0, -1, 10**6, 10**9, 10**18]))
    elif how == "stride":
        document["bufferViews"][0] |= {"byteStride": int(rng.choice([0, 1, 252, 10**9]))}
    elif how == "offset":
        view = document["bufferViews"][rng.integers(len(document["bufferViews"]))]
        view["byteOffset"] = int(rng.choice([-1, -(10**6), 2**31, 10**18]))
    elif how == "weights":
        document["animations"] *= 2
        document["animations"][0]["channels"] *= 3000
    elif how == "same":
        document["skins"] = [{"joints": list(range(first)) * 100}]
    else:
        document["asset"] = "@raw@" + "[" * depth + "]" * depth + "@raw@"
    return glb_of(as_json(document), block), f"{how}, {depth}"
