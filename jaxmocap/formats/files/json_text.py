"""JSON from files of others: bounded in size, in depth and in the number of its parts.

INPUTS: text, or bytes of UTF-8. OUTPUTS: what it stands for, or its parts, asked for by what they
must be; InputError in one sentence that names the part, what was found there, what was expected.

Python's objects take up to twenty-four times as much memory as the text that they come from.
"""

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.formats.files.errors import InputError, comma_list, short_repr

MAX_JSON_BYTES = 16 * 2**20
MAX_LEVELS = 64
# Lists and tables.
MAX_PARTS = 2_000_000
MAX_TEXT_CHARACTERS = 200
_LARGEST = 2**53


def parse_json(
    path: str | Path,
    text: str | bytes,
    max_bytes: int = MAX_JSON_BYTES,
    allow_nan: bool = False,
    max_parts: int = MAX_PARTS,
) -> Any:
    """What a JSON text stands for; ``allow_nan`` lets NaN and Infinity stand in it.

    Raises:
        InputError: it is no JSON, too long, nested too deeply, or of too many lists and tables.
    """
    if len(text) > max_bytes:
        raise InputError(path, f"found {len(text)} bytes of JSON, expected at most {max_bytes}")
    if isinstance(text, str):
        parts = text.count("[") + text.count("{")
    else:
        parts = text.count(b"[") + text.count(b"{")
    if parts > max_parts:
        raise InputError(path, f"found JSON of {parts} parts, expected at most {max_parts}")
    too_deep = f"JSON nested too deeply, expected at most {MAX_LEVELS} levels"
    try:
        value = json.loads(text, parse_constant=None if allow_nan else _refuse)
    except RecursionError:
        raise InputError(path, too_deep) from None
    except ValueError as error:
        raise InputError(path, f"holds no readable JSON ({_reason(error)})") from None
    # Level by level: a loop that calls itself would end where Python's calls do.
    level, depth = [value], 0
    while level:
        depth += 1
        if depth > MAX_LEVELS:
            raise InputError(path, too_deep)
        inside = (each.values() if isinstance(each, dict) else each for each in level
                  if isinstance(each, dict | list))  # fmt: skip
        level = [each for values in inside for each in values if isinstance(each, dict | list)]
    return value


def _refuse(constant: str) -> None:
    raise ValueError(f"found {constant}, expected a number")


def _reason(error: ValueError) -> str:
    if isinstance(error, json.JSONDecodeError):
        return f"line {error.lineno}, column {error.colno}: {error.msg}"
    if isinstance(error, UnicodeDecodeError):
        return "found bytes that are not UTF-8 text"
    text = str(error)
    return "a number of thousands of digits" if "integer string conversion" in text else text


@dataclass(frozen=True)
class JsonPart:
    """One value of a document."""

    path: str | Path  # of the file
    place: str  # where it stands, such as ``nodes[3].rotation``; empty for the document
    value: Any  # as parsed

    def error(self, problem: str) -> InputError:
        """An error about this part."""
        return InputError(self.path, f"{self.place}: {problem}" if self.place else problem)

    def _mismatch(self, what: str) -> InputError:
        return self.error(f"found {short_repr(self.value)}, expected {what}")

    def has(self, key: str) -> bool:
        """Whether a table has an entry."""
        return isinstance(self.value, dict) and key in self.value

    def __getitem__(self, key: str | int) -> "JsonPart":
        """An entry of a table or a list; None where a table has none."""
        if isinstance(key, int):
            return JsonPart(self.path, f"{self.place}[{key}]", self.value[key])
        if not isinstance(self.value, dict):
            raise self._mismatch("a JSON table")
        place = f"{self.place}.{key}" if self.place else key
        return JsonPart(self.path, place, self.value.get(key))

    def get(self, key: str, default: Any) -> "JsonPart":
        """An entry of a table; this value where a table has none."""
        part = self[key]
        return replace(part, value=default) if part.value is None else part

    def items(self) -> Sequence[Any]:
        """A list's values."""
        if not isinstance(self.value, list):
            raise self._mismatch("a JSON list")
        return self.value

    def parts(self) -> Iterator["JsonPart"]:
        """A list's entries."""
        return (self[i] for i in range(len(self.items())))

    def integer(self, low: int = 0) -> int:
        """A whole number from ``low`` on."""
        value = self.value
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= _LARGEST:
            raise self._mismatch(f"a whole number, {low} or more")
        return value

    def index(self, of: "JsonPart") -> int:
        """The index of an entry of a list."""
        count = 0 if of.value is None else len(of.items())
        if isinstance(self.value, bool) or not isinstance(self.value, int):
            raise self._mismatch(f"an index of {of.place}")
        if not 0 <= self.value < count:
            raise self._mismatch(f"an index of {of.place}, which has {count}")
        return self.value

    def number(self, most: float) -> float:
        """A number from ``-most`` to ``most``."""
        value = self.value
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._mismatch("a number")
        # A whole number may be too large to be a float.
        if not -most <= value <= most or not math.isfinite(value):
            raise self._mismatch(f"a number from {-most:g} to {most:g}")
        return float(value)

    def numbers(self, count: int, most: float) -> np.ndarray:
        """(count,) numbers from ``-most`` to ``most``."""
        if len(self.items()) != count:
            raise self._mismatch(f"{count} numbers")
        return np.array([part.number(most) for part in self.parts()])

    def text(self) -> str:
        """A text that prints, of at most ``MAX_TEXT_CHARACTERS`` characters."""
        value = self.value
        if (
            not isinstance(value, str)
            or not value.isprintable()
            or len(value) > MAX_TEXT_CHARACTERS
        ):
            raise self._mismatch(f"a text that prints, of at most {MAX_TEXT_CHARACTERS} characters")
        return value

    def choice(self, options: Sequence[Any]) -> Any:
        """One of some values."""
        if isinstance(self.value, list | dict) or self.value not in options:
            raise self._mismatch(f"one of {comma_list(map(str, options))}")
        return self.value
