"""The errors that end a command in one sentence.

INPUTS: the file (or the name of what is only in memory) and what is wrong with it.
OUTPUTS: an exception whose text is one sentence that starts with the file, and that any terminal
can show. Values from files are shown in some dozens of characters, whatever their size and depth.
"""

import reprlib
from collections.abc import Iterable
from itertools import islice
from pathlib import Path
from typing import Any

# A sentence longer than this is cut, characters.
MAX_SENTENCE_CHARACTERS = 500


def printable(text: str) -> str:
    """Text of anybody for a terminal: what does not print stands as Python writes it."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def shorten_text(text: str, max_characters: int = MAX_SENTENCE_CHARACTERS) -> str:
    """Text of so many characters at most; what is left out in the middle shows as dots."""
    if len(text) <= max_characters:
        return text
    end = max_characters // 4
    return f"{text[: max_characters - end - 3]}...{text[-end:]}"


class FileError(ValueError):
    """A file cannot be used.

    Attributes:
        path: the file, or a name where there is no file.
        problem: line or field, what was found there, and what was expected.
    """

    def __init__(self, path: str | Path, problem: str):
        # Both go to the base, so that the error survives pickling between processes.
        super().__init__(path, problem)
        self.path = path
        self.problem = problem

    def __str__(self) -> str:
        return shorten_text(printable(f"{self.path}: {self.problem}"))


class InputError(FileError):
    """What a user passed cannot be used: a command ends with exit code 2."""


class OutputError(FileError):
    """What was to be written cannot be: a command ends with exit code 1.

    Whatever was there before is as it was.
    """


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
