"""Pickles of plain values and NumPy arrays, read without running anything that is in them.

INPUTS: bytes of a pickle, protocol 2 to 5. OUTPUTS: dicts with text as keys, lists, tuples, text,
bytes, numbers and arrays; InputError in one sentence.

Python's own unpickler, restricted to plain values. Of names it takes only those by which NumPy
describes arrays, and arrays are made here, from their bytes. Keys are text: a tuple of tuples takes
for ever to hash.
"""

import io
import pickle
import pickletools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NoReturn

import numpy as np

from jaxmocap.formats.files.errors import InputError, short_repr

FIRST_BYTE = b"\x80"
MAX_PICKLE_BYTES = 2**20
MAX_DIMENSIONS = 4
# Whole numbers, those without sign, floating point, true or false.
_DTYPES = ("i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "f4", "f8", "b1")
_NUMPY = ("numpy", "numpy.core.multiarray", "numpy._core.multiarray", "numpy.core.numeric",
          "numpy._core.numeric", "_codecs")  # fmt: skip
_PLAIN = {"PROTO", "FRAME", "STOP", "MARK", "MEMOIZE", "BINPUT", "LONG_BINPUT", "BINGET",
          "LONG_BINGET", "NONE", "NEWTRUE", "NEWFALSE", "BININT", "BININT1", "BININT2", "LONG1",
          "BINFLOAT", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8", "BINBYTES", "SHORT_BINBYTES",
          "BINBYTES8", "BYTEARRAY8", "BINSTRING", "SHORT_BINSTRING", "EMPTY_TUPLE", "TUPLE",
          "TUPLE1", "TUPLE2", "TUPLE3", "EMPTY_LIST", "APPEND", "APPENDS", "EMPTY_DICT", "SETITEM",
          "SETITEMS", "GLOBAL", "STACK_GLOBAL", "REDUCE", "BUILD"}  # fmt: skip


class _RefusedError(Exception):
    """What is not plain."""


class _TextKeys(dict):
    """A dict whose keys are text."""

    def __setitem__(self, key: Any, value: Any) -> None:
        if not isinstance(key, str):
            raise _RefusedError(f"a dict with a {type(key).__name__} as a key")
        super().__setitem__(key, value)


@dataclass
class _Dtype:
    """A kind of numbers, such as f8, and the order of its bytes."""

    code: str
    order: str = "<"


@dataclass
class _Array:
    """An array whose state comes later."""

    value: np.ndarray | None = None


def _array(dtype: Any, shape: Any, content: Any, order: Any) -> np.ndarray:
    """An array of so many numbers from exactly its bytes."""
    if not isinstance(dtype, _Dtype) or not isinstance(content, bytes):
        raise _RefusedError("an array of objects")
    if not isinstance(shape, tuple) or len(shape) > MAX_DIMENSIONS:
        raise _RefusedError("an array of too many dimensions")
    if any(type(side) is not int or side < 0 for side in shape):
        raise TypeError
    if dtype.code not in _DTYPES or dtype.order not in ("<", ">", "|", "="):
        raise _RefusedError(f"an array of {short_repr(dtype.code)}")
    kind = np.dtype((">" if dtype.order == ">" else "<") + dtype.code)
    return np.frombuffer(content, kind).reshape(shape, order=order)


def _refusal(problem: str) -> Callable[..., NoReturn]:
    def refuse(*_: Any) -> NoReturn:
        raise _RefusedError(problem)

    return refuse


# What stands for NumPy's functions.
_FUNCTIONS = {
    "_reconstruct": lambda *_: _Array(),
    "_frombuffer": lambda content, dtype, shape, order: _array(dtype, shape, content, order),
    "scalar": lambda dtype, content: _array(dtype, (), content, "C").item(),
    "dtype": lambda code, *_: _Dtype(code),
    "ndarray": _refusal("a call of ndarray"),
    "encode": lambda text, *_: text.encode("latin-1"),
}


def _build(unpickler: Any) -> None:
    """A state: all of an array, or the order of its numbers' bytes."""
    state, target = unpickler.stack.pop(), unpickler.stack[-1]
    if isinstance(target, _Array):
        _, shape, dtype, fortran, content = state
        target.value = _array(dtype, shape, content, "F" if fortran else "C")
    elif isinstance(target, _Dtype):
        target.order = state[1]
    else:
        raise _RefusedError("a state of what is no array")


class _Unpickler(pickle._Unpickler):
    """Python's own in Python, restricted."""

    dispatch: ClassVar = {
        ord(each.code): pickle._Unpickler.dispatch[ord(each.code)]
        if each.name in _PLAIN
        else _refusal(f"an instruction {each.name}")
        for each in pickletools.opcodes
    } | {
        pickle.EMPTY_DICT[0]: lambda unpickler: unpickler.append(_TextKeys()),
        pickle.BUILD[0]: _build,
        # Python's own makes room for as many bytes as a file states.
        pickle.BYTEARRAY8[0]: pickle._Unpickler.dispatch[pickle.BINBYTES8[0]],
    }

    def find_class(self, module: str, name: str) -> Any:
        """What stands for one of NumPy's functions; no other is taken, none imported."""
        if module not in _NUMPY or name not in _FUNCTIONS:
            raise _RefusedError(f"the name {short_repr(f'{module}.{name}')}")
        return _FUNCTIONS[name]


def read_plain_pickle(path: Path, content: bytes) -> Any:
    """What a pickle holds, arrays within a dict as arrays; InputError for anything not plain."""
    if len(content) > MAX_PICKLE_BYTES:
        most = f"{MAX_PICKLE_BYTES / 2**20:g} MB"
        raise InputError(path, f"found {len(content)} bytes of a pickle, expected at most {most}")
    try:
        value = _Unpickler(io.BytesIO(content), encoding="latin-1").load()
    except _RefusedError as error:
        expected = "expected a calibration of plain numbers"
        raise InputError(path, f"the pickle holds {error}, {expected}") from None
    # A broken file breaks any of the steps.
    except Exception:
        raise InputError(path, "not a complete pickle, or cut off") from None
    if isinstance(value, dict):
        return {key: each.value if isinstance(each, _Array) else each
                for key, each in value.items()}  # fmt: skip
    return value
