"""Pickles of plain values and NumPy arrays, read without running anything that is in them.

INPUTS: bytes of a pickle, protocol 2 to 5. OUTPUTS: dicts with text as keys, lists, tuples, text,
bytes, numbers and arrays; InputError in one sentence.

Python's own unpickler calls whatever a file names. Here the instructions are interpreted: some
thirty are known, and the only functions are the five by which NumPy describes arrays, each made
from its bytes.
"""

import pickletools
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.short_repr import short_repr

FIRST_BYTE = b"\x80"
MAX_PICKLE_BYTES = 2**20
MAX_DIMENSIONS = 4
# Kinds of numbers: whole, without sign, floating point, true or false.
_KINDS = "iufb"
_NUMPY = ("numpy", "numpy.core.multiarray", "numpy._core.multiarray", "numpy.core.numeric",
          "numpy._core.numeric", "_codecs")  # fmt: skip
_FUNCTIONS = ("_reconstruct", "_frombuffer", "scalar", "dtype", "ndarray", "encode")
_CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_VALUES = {"BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT", "BINUNICODE", "SHORT_BINUNICODE",
           "BINUNICODE8", "BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8", "BINSTRING",
           "SHORT_BINSTRING"}  # fmt: skip
_IGNORED = {"PROTO", "FRAME"}
_MARK = object()


class _RefusedError(Exception):
    """What is not plain."""


@dataclass(frozen=True)
class _Function:
    """One of NumPy's, by its name."""

    name: str


@dataclass
class _Array:
    """An array whose state comes later."""

    value: np.ndarray | None = None


@dataclass
class _Dtype:
    """A kind of numbers, such as f8, and the order of its bytes."""

    code: str
    order: str = "<"

    def numpy(self) -> np.dtype:
        """As NumPy has it; refused where it is no plain number."""
        if len(self.code) != 2 or self.code[0] not in _KINDS or self.code[1] not in "1248":
            raise _RefusedError(f"an array of {short_repr(self.code)}")
        try:
            return np.dtype(("<" if self.order in "|=" else self.order) + self.code)
        except TypeError:
            raise _RefusedError(f"an array of {short_repr(self.order + self.code)}") from None


def read_plain_pickle(path: Path, content: bytes) -> Any:
    """What a pickle holds.

    Raises:
        InputError: too large, cut off, or with anything but plain values and arrays of numbers.
    """
    if len(content) > MAX_PICKLE_BYTES:
        most = f"{MAX_PICKLE_BYTES / 2**20:g} MB"
        raise InputError(path, f"found {len(content)} bytes of a pickle, expected at most {most}")
    try:
        # Of Python's about escapes in texts that make no sense.
        with warnings.catch_warnings(action="ignore"):
            return _interpreted(content)
    except _RefusedError as error:
        expected = "expected a calibration of plain numbers"
        raise InputError(path, f"the pickle holds {error}, {expected}") from None
    # A broken file breaks any of the steps.
    except Exception:
        raise InputError(path, "not a complete pickle, or cut off") from None


def _interpreted(content: bytes) -> Any:
    """What is on the stack at the end."""
    machine = _Machine()
    for opcode, argument, _ in pickletools.genops(content):
        if opcode.name == "STOP":
            break
        machine.step(opcode.name, argument)
    return _plain(machine.stack[-1])


class _Machine:
    """The stack and the memory of a pickle's instructions."""

    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.memory: dict[int, Any] = {}
        self.steps: dict[str, Callable[[Any], None]] = {
            "MARK": lambda _: self.stack.append(_MARK),
            "EMPTY_DICT": lambda _: self.stack.append({}),
            "EMPTY_LIST": lambda _: self.stack.append([]),
            "EMPTY_TUPLE": lambda _: self.stack.append(()),
            "TUPLE": lambda _: self.stack.append(tuple(self.marked())),
            "TUPLE1": lambda _: self.stack.append(self.popped(1)),
            "TUPLE2": lambda _: self.stack.append(self.popped(2)),
            "TUPLE3": lambda _: self.stack.append(self.popped(3)),
            "APPEND": lambda _: self.extend(self.popped(1)),
            "APPENDS": lambda _: self.extend(self.marked()),
            "SETITEM": lambda _: self.set_items(self.popped(2)),
            "SETITEMS": lambda _: self.set_items(self.marked()),
            "MEMOIZE": lambda _: self.memory.update({len(self.memory): self.stack[-1]}),
            "BINPUT": lambda key: self.memory.update({key: self.stack[-1]}),
            "LONG_BINPUT": lambda key: self.memory.update({key: self.stack[-1]}),
            "BINGET": lambda key: self.stack.append(self.memory[key]),
            "LONG_BINGET": lambda key: self.stack.append(self.memory[key]),
            "GLOBAL": lambda names: self.name(*names.split(" ")),
            "STACK_GLOBAL": lambda _: self.name(*self.popped(2)),
            "REDUCE": lambda _: self.stack.append(_called(*self.popped(2))),
            "BUILD": lambda _: _build(self.stack[-2], *self.popped(1)),
        }

    def step(self, name: str, argument: Any) -> None:
        """Carry out one instruction."""
        if name in _VALUES:
            self.stack.append(argument)
        elif name in _CONSTANTS:
            self.stack.append(_CONSTANTS[name])
        elif name in self.steps:
            self.steps[name](argument)
        elif name not in _IGNORED:
            raise _RefusedError(f"an instruction {name}")

    def popped(self, count: int) -> tuple:
        """So many values from the stack's top, in their order."""
        if len(self.stack) < count:
            raise IndexError
        values = tuple(self.stack[-count:])
        del self.stack[-count:]
        return values

    def marked(self) -> list:
        """All values from the last mark on."""
        values: list[Any] = []
        while (value := self.stack.pop()) is not _MARK:
            values.append(value)
        return values[::-1]

    def extend(self, values: Any) -> None:
        """Append to the list on the top."""
        if not isinstance(self.stack[-1], list):
            raise TypeError
        self.stack[-1].extend(values)

    def set_items(self, items: Any) -> None:
        """Put keys and values by turns into the dict on the top."""
        if not isinstance(self.stack[-1], dict):
            raise TypeError
        for key, value in zip(items[::2], items[1::2], strict=True):
            if not isinstance(key, str):
                raise _RefusedError(f"a dict with a {type(key).__name__} as a key")
            self.stack[-1][key] = value

    def name(self, module: Any, name: Any) -> None:
        """One of the functions that describe arrays; any other is refused, and never imported."""
        if not isinstance(module, str) or not isinstance(name, str):
            raise TypeError
        if module not in _NUMPY or name not in _FUNCTIONS:
            raise _RefusedError(f"the name {short_repr(f'{module}.{name}')}")
        self.stack.append(_Function(name))


def _called(function: Any, arguments: Any) -> Any:
    """What NumPy's function makes of its arguments."""
    name = function.name
    if name == "_reconstruct":
        return _Array()
    if name == "dtype" and isinstance(arguments[0], str):
        return _Dtype(arguments[0])
    if name == "encode":
        return arguments[0].encode("latin-1")
    if name == "scalar":
        return _array(arguments[0], (), arguments[1], fortran=False).item()
    if name == "_frombuffer":
        content, dtype, shape, order = arguments
        return _array(dtype, shape, content, fortran=order == "F")
    raise _RefusedError(f"a call of {name}")


def _build(target: Any, state: Any) -> None:
    """Give an array or a kind of numbers its state."""
    if isinstance(target, _Dtype):
        target.order = state[1]
    elif isinstance(target, _Array):
        _, shape, dtype, fortran, content = state
        target.value = _array(dtype, shape, content, bool(fortran))
    else:
        raise _RefusedError(f"a state of a {type(target).__name__}")


def _array(dtype: Any, shape: Any, content: Any, fortran: bool) -> np.ndarray:
    """An array of so many numbers from exactly its bytes."""
    if not isinstance(dtype, _Dtype) or not isinstance(content, bytes | bytearray):
        raise _RefusedError("an array of objects")
    if not isinstance(shape, tuple) or len(shape) > MAX_DIMENSIONS:
        raise _RefusedError("an array of too many dimensions")
    if any(type(side) is not int or side < 0 for side in shape):
        raise TypeError
    numbers = np.frombuffer(bytes(content), dtype.numpy())
    return numbers.reshape(shape, order="F" if fortran else "C")


def _plain(value: Any) -> Any:
    """A dict, with its arrays in place; what is deeper is left as it is."""
    if isinstance(value, _Array):
        return value.value
    if isinstance(value, dict):
        return {key: each.value if isinstance(each, _Array) else each
                for key, each in value.items()}  # fmt: skip
    return value
