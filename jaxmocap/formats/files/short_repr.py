"""What a file holds, as messages show it: short, whatever its size and depth.

INPUTS: a value or names from a file. OUTPUTS: text of some dozens of characters.
"""

import reprlib
from collections.abc import Iterable
from itertools import islice
from typing import Any

# Characters that one value may take in a message.
MAX_CHARACTERS = 60
# Names that a message lists: all of a full set of markers.
MAX_LISTED = 60


class _Short(reprlib.Repr):
    """``repr`` that looks at a few entries and levels only."""

    def __init__(self):
        super().__init__()
        self.maxlevel, self.maxstring, self.maxother = 4, MAX_CHARACTERS, MAX_CHARACTERS

    def repr_int(self, x: int, level: int) -> str:
        """Whole numbers of any length: Python refuses to print those of thousands of digits."""
        return repr(x) if x.bit_length() < 128 else f"a whole number of {x.bit_length()} bits"

    def repr_float(self, x: float, level: int) -> str:
        """As Python has it."""
        return repr(x)


_short = _Short()


def short_repr(value: Any) -> str:
    """A value as Python writes it, cut where it is long: no escapes and no line ends in it."""
    text = _short.repr(value)
    return text if len(text) <= MAX_CHARACTERS else text[:MAX_CHARACTERS] + "…"


def short_name(name: str) -> str:
    """A name as it is where it prints and is short, else as Python writes it, cut."""
    return name if name.isprintable() and 0 < len(name) <= MAX_CHARACTERS else short_repr(name)


def comma_list(names: Iterable[str]) -> str:
    """Names between commas; of many the first ones, and how many more there are."""
    names = list(names)
    first = ", ".join(map(short_name, islice(names, MAX_LISTED)))
    rest = len(names) - MAX_LISTED
    return f"{first} and {rest} more" if rest > 0 else first
