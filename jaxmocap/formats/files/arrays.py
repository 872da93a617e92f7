"""NPZ: named arrays in a zip file, checked against what a format states of them; lists of numbers.

INPUTS: a .npz file; of each array its dimensions, what kind of values it holds, and their range.
OUTPUTS: the arrays; InputError in one sentence: the array, what was found, what was expected.

Nothing is decompressed or allocated before the sizes that the zip file, the array's header and the
format state agree with one another and with the bytes that are there. Pickles are never run.
"""

import io
import math
import re
import warnings
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.formats.files.errors import InputError, short_name, short_repr
from jaxmocap.formats.files.reading import read_bytes

# All arrays that are read from one file, in memory, bytes: a million samples take 500 MB.
MAX_ARRAY_BYTES = 768 * 2**20
# Arrays in one file; texts in one array; characters of a name.
MAX_ARRAYS = 1000
MAX_NAMES = 10_000
MAX_NAME_CHARACTERS = 200
# Of an array's header, characters.
MAX_HEADER_CHARACTERS = 10_000
# Deflate makes at most 1032 bytes out of one.
MAX_INFLATION = 1040

# What arrays hold: the kinds of values that a format states.
NUMBERS = "numbers"
INTEGERS = "whole numbers"
BYTES = "bytes"
NAMES = "names"
TEXT = "text"
_KINDS = {NUMBERS: "fiu", INTEGERS: "iu", BYTES: "u", NAMES: "U", TEXT: "U"}
# Bytes of one value.
_MAX_ITEM_BYTES = {NUMBERS: 8, INTEGERS: 8, BYTES: 1}
_LARGEST_INTEGER = 2**62
_SURROGATES = (0xD800, 0xDFFF)
_LAST_CHARACTER = 0x10FFFF
_READERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


@dataclass(frozen=True)
class ArraySpec:
    """What a format states of an array."""

    # A number, or a name for what other arrays have as many of; ``*`` is any number.
    shape: tuple[str | int, ...]
    # NUMBERS, INTEGERS, BYTES (any), NAMES (short, printable, not empty) or TEXT.
    kind: str = NUMBERS
    low: float = -math.inf  # the smallest number
    high: float = math.inf  # the largest number; it is finite if this is
    allow_nan: bool = False  # whether NaN may stand for what is missing
    allow_infinity: bool = False  # whether infinity may stand for what has no bound
    max_characters: int = MAX_NAME_CHARACTERS  # characters of each text


def float_array(value: Any) -> np.ndarray:
    """The numbers in nested lists; None becomes NaN.

    Raises:
        TypeError, ValueError, OverflowError: other values, also those that NumPy takes for numbers
            (true, false, texts), or lists that are not equally long.
    """
    array = np.array(value, float)
    if any(isinstance(each, bool | str) for each in np.array(value, object).flat):
        raise TypeError("found other than numbers")
    return array


class NpzArrays:
    """The arrays of a .npz file, none of them read yet.

    Sizes that an array gives to names of dimensions hold for all that are read after it.
    """

    def __init__(self, path: str | Path):
        """Look into the file.

        Raises:
            InputError: no such file, no zip file or cut off; names twice; members that are
                encrypted or compressed otherwise than by deflate.
        """
        self.path = path
        self._zip = _open_zip(path)
        self._members = _members(path, self._zip)
        self._sizes: dict[str, tuple[int, str]] = {}
        self._bytes_left = MAX_ARRAY_BYTES

    @property
    def names(self) -> tuple[str, ...]:
        """Of all arrays."""
        return tuple(self._members)

    def read(self, stated: Mapping[str, ArraySpec]) -> dict[str, np.ndarray]:
        """Arrays by name: numbers as float (single stays so), whole numbers as int64, texts as str.

        Raises:
            InputError: one is missing, or not as stated.
        """
        missing = [name for name in stated if name not in self._members]
        if missing:
            raise InputError(self.path, f"the array '{short_name(missing[0])}' is missing")
        return {name: self._read(name, what) for name, what in stated.items()}

    def _read(self, name: str, stated: ArraySpec) -> np.ndarray:
        start, shape, dtype = self._header(name)
        self._check_kind(name, dtype, stated)
        self._check_shape(name, shape, stated)
        self._check_size(name, start, math.prod(shape), dtype, stated)
        stored = self._read_stored(name)
        if stated.kind in (NAMES, TEXT):
            self._check_texts(name, stored, stated)
            return stored
        if stated.kind == BYTES:
            return stored
        self._check_numbers(name, stored, stated)
        if stated.kind == INTEGERS or stored.dtype.kind != "f":
            return stored.astype(np.int64 if stated.kind == INTEGERS else float)
        return stored

    def _error(self, name: str, problem: str) -> InputError:
        return InputError(self.path, f"{short_name(name)}: {problem}")

    def _header(self, name: str) -> tuple[int, tuple[int, ...], np.dtype]:
        """Where the values start, their shape and kind, of which some kB are decompressed."""
        try:
            with self._zip.open(self._members[name]) as member:
                start = io.BytesIO(member.read(MAX_HEADER_CHARACTERS))
            read = _READERS[np.lib.format.read_magic(start)]
            with warnings.catch_warnings():
                # Headers of Python 2 are read as well.
                warnings.simplefilter("ignore")
                shape, _, dtype = read(start, max_header_size=MAX_HEADER_CHARACTERS)
        # What parses the header raises any of a dozen, of the zip file and of Python's own text.
        except Exception:
            raise self._error(name, "no NumPy array, or damaged") from None
        return start.tell(), shape, dtype

    def _check_kind(self, name: str, dtype: np.dtype, stated: ArraySpec) -> None:
        if dtype.hasobject:
            raise self._error(name, f"found Python objects, expected {stated.kind}")
        wide = dtype.itemsize > _MAX_ITEM_BYTES.get(stated.kind, dtype.itemsize)
        if dtype.kind not in _KINDS[stated.kind] or not dtype.itemsize or wide:
            problem = f"found values of type {short_repr(dtype.str)}, expected {stated.kind}"
            raise self._error(name, problem)
        longest = dtype.itemsize // 4
        if dtype.kind == "U" and longest > stated.max_characters:
            expected = f"expected at most {stated.max_characters}"
            raise self._error(name, f"found texts of {longest} characters, {expected}")

    def _check_shape(self, name: str, shape: tuple[int, ...], stated: ArraySpec) -> None:
        sizes = [self._sizes.get(str(each), (each, ""))[0] for each in stated.shape]
        fits = len(shape) == len(sizes) and all(
            isinstance(size, str) or size == length
            for size, length in zip(sizes, shape, strict=True)
        )
        if not fits or any(size < 0 for size in shape):
            # Dimensions, and what their names stand for.
            fixed = [
                f"{each} = {self._sizes[each][0]} as in {short_name(self._sizes[each][1])}"
                for each in dict.fromkeys(map(str, stated.shape))
                if each in self._sizes
            ]
            expected = f"({', '.join(map(str, stated.shape))})"
            expected += f" with {', '.join(fixed)}" if fixed else ""
            raise self._error(name, f"found shape {short_repr(shape)}, expected {expected}")
        for each, length in zip(stated.shape, shape, strict=True):
            if isinstance(each, str) and each != "*":
                self._sizes.setdefault(each, (length, name))

    def _check_size(
        self, name: str, start: int, count: int, dtype: np.dtype, stated: ArraySpec
    ) -> None:
        """Against the bytes that are there, and against what all arrays may take."""
        member = self._members[name]
        stored, there = count * dtype.itemsize, member.file_size - start
        if stored != there:
            raise self._error(name, f"states {stored} bytes of values, but {there} are there")
        if stored > MAX_INFLATION * (member.compress_size + 64):
            problem = f"states {stored} bytes, more than its {member.compress_size} can hold"
            raise self._error(name, problem)
        if stated.kind == NAMES and count > MAX_NAMES:
            raise self._error(name, f"found {count} names, expected at most {MAX_NAMES}")
        # Fractions stay as they are, whole numbers take eight bytes.
        is_kept = stated.kind == BYTES or dtype.kind == "f"
        self._bytes_left -= count * (dtype.itemsize if is_kept else max(dtype.itemsize, 8))
        if self._bytes_left < 0:
            most = f"expected at most {MAX_ARRAY_BYTES / 2**20:g} MB of arrays"
            raise self._error(name, f"states {stored / 2**20:.0f} MB, {most} in one file")

    def _read_stored(self, name: str) -> np.ndarray:
        """The array, in this machine's order of bytes."""
        try:
            with self._zip.open(self._members[name]) as member, warnings.catch_warnings():
                warnings.simplefilter("ignore")
                limit = MAX_HEADER_CHARACTERS
                array = np.lib.format.read_array(member, False, max_header_size=limit)
                # At the very end the checksum is compared.
                member.read(1)
        except Exception:
            raise self._error(name, "damaged, or cut off") from None
        return array.astype(array.dtype.newbyteorder("="), copy=False)

    def _check_numbers(self, name: str, array: np.ndarray, stated: ArraySpec) -> None:
        low, high = stated.low, stated.high
        if stated.kind == INTEGERS:
            low, high = (
                round(max(-_LARGEST_INTEGER, min(bound, _LARGEST_INTEGER))) for bound in (low, high)
            )
        # Bounds beyond a small type's range are infinite in it.
        with np.errstate(over="ignore"):
            bad = ~((array >= low) & (array <= high))
        if array.dtype.kind == "f":
            infinite = np.isinf(array)
            bad = (bad & ~infinite) if stated.allow_infinity else (bad | infinite)
            bad &= ~np.isnan(array) if stated.allow_nan else True
        if bad.any():
            index = np.unravel_index(int(bad.argmax()), bad.shape)
            place = f"[{', '.join(str(int(i)) for i in index)}]" if index else ""
            bounds = [
                f"{word} {bound:g}"
                for word, bound in (("from", stated.low), ("to", stated.high))
                if math.isfinite(bound)
            ]
            expected = " ".join([f"expected {stated.kind}", *bounds])
            raise self._error(f"{name}{place}", f"found {array[index]}, {expected}")

    def _check_texts(self, name: str, array: np.ndarray, stated: ArraySpec) -> None:
        codes = np.ascontiguousarray(array).reshape(-1).view(np.uint32)
        low, high = _SURROGATES
        if ((codes > _LAST_CHARACTER) | ((codes >= low) & (codes <= high))).any():
            raise self._error(name, "found what is no text")
        if stated.kind == NAMES:
            for text in array.ravel().tolist():
                if not text or not text.isprintable():
                    problem = f"found {short_repr(text)}, expected a name that prints"
                    raise self._error(name, problem)


def _open_zip(path: str | Path) -> zipfile.ZipFile:
    """The zip file, its directory read; its members are not."""
    content = read_bytes(path)
    if not content:
        raise InputError(path, "the file is empty")
    if content.startswith(np.lib.format.MAGIC_PREFIX):
        raise InputError(path, "found a single array (.npy), expected several (.npz)")
    # Every entry of the directory starts so; what is compressed holds it by chance only.
    if content.count(b"PK\1\2") > MAX_ARRAYS:
        raise InputError(path, f"expected at most {MAX_ARRAYS} arrays")
    try:
        return zipfile.ZipFile(io.BytesIO(content))
    # A broken archive raises any of a dozen.
    except Exception:
        raise InputError(path, "not an .npz file, or cut off") from None


def _members(path: str | Path, archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """Array's name -> member of the zip file."""
    members: dict[str, zipfile.ZipInfo] = {}
    for member in archive.infolist():
        name = re.sub(r"\.npy\Z", "", member.filename)
        if name in members:
            raise InputError(path, f"the array {short_repr(name)} is there twice")
        if member.flag_bits & 1:
            raise InputError(path, f"{short_name(name)}: encrypted, which is not read")
        if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            problem = f"compressed by method {member.compress_type}, expected none or deflate"
            raise InputError(path, f"{short_name(name)}: {problem}")
        members[name] = member
    return members
