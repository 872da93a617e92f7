"""Parts of a JSON document, asked for by what they must be.

INPUTS: what ``parse_json`` returned. OUTPUTS: tables, lists, indices, numbers and texts;
InputError in one sentence that names the part, what was found there, and what was expected.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.formats.files.errors import InputError, comma_list, short_repr

MAX_TEXT_CHARACTERS = 200
_LARGEST = 2**53


@dataclass(frozen=True)
class JsonPart:
    """One value of a document.

    Attributes:
        path: of the file.
        place: where it stands, such as ``nodes[3].rotation``; empty for the document.
        value: as parsed.
    """

    path: str | Path
    place: str
    value: Any

    def error(self, problem: str) -> InputError:
        """An error about this part."""
        return InputError(self.path, f"{self.place}: {problem}" if self.place else problem)

    def _expected(self, what: str) -> InputError:
        return self.error(f"found {short_repr(self.value)}, expected {what}")

    def has(self, key: str) -> bool:
        """Whether a table has an entry."""
        return isinstance(self.value, dict) and key in self.value

    def __getitem__(self, key: str | int) -> "JsonPart":
        """An entry of a table or a list; None where a table has none."""
        if isinstance(key, int):
            return JsonPart(self.path, f"{self.place}[{key}]", self.value[key])
        if not isinstance(self.value, dict):
            raise self._expected("a JSON table")
        place = f"{self.place}.{key}" if self.place else key
        return JsonPart(self.path, place, self.value.get(key))

    def get(self, key: str, default: Any) -> "JsonPart":
        """An entry of a table; this value where a table has none."""
        part = self[key]
        return replace(part, value=default) if part.value is None else part

    def items(self) -> Sequence[Any]:
        """A list's values."""
        if not isinstance(self.value, list):
            raise self._expected("a JSON list")
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
            raise self._expected(f"a whole number, {low} or more")
        return value

    def index(self, of: "JsonPart") -> int:
        """The index of an entry of a list."""
        count = 0 if of.value is None else len(of.items())
        if isinstance(self.value, bool) or not isinstance(self.value, int):
            raise self._expected(f"an index of {of.place}")
        if not 0 <= self.value < count:
            raise self._expected(f"an index of {of.place}, which has {count}")
        return self.value

    def number(self, most: float) -> float:
        """A number from ``-most`` to ``most``."""
        value = self.value
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._expected("a number")
        # A whole number may be too large to be a float.
        if not -most <= value <= most or not math.isfinite(value):
            raise self._expected(f"a number from {-most:g} to {most:g}")
        return float(value)

    def numbers(self, count: int, most: float) -> np.ndarray:
        """(count,) numbers from ``-most`` to ``most``."""
        if len(self.items()) != count:
            raise self._expected(f"{count} numbers")
        return np.array([part.number(most) for part in self.parts()])

    def text(self) -> str:
        """A text that prints, of at most ``MAX_TEXT_CHARACTERS`` characters."""
        value = self.value
        if (
            not isinstance(value, str)
            or not value.isprintable()
            or len(value) > MAX_TEXT_CHARACTERS
        ):
            raise self._expected(f"a text that prints, of at most {MAX_TEXT_CHARACTERS} characters")
        return value

    def choice(self, options: Sequence[Any]) -> Any:
        """One of some values."""
        if isinstance(self.value, list | dict) or self.value not in options:
            raise self._expected(f"one of {comma_list(map(str, options))}")
        return self.value
