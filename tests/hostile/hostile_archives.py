"""Mutations of formats that hold arrays: npz archives and binary glTF.

INPUTS: a random generator and a file's content. OUTPUTS: another content, and what was done.
"""

import io
import json
import struct
import zipfile

import numpy as np
from hostile_bytes import Mutated
from hostile_values import as_json, change_tree

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
