"""TOML files: read with errors that name the field, and written as far as we need it.

INPUTS: a .toml file; or nested dicts of text, numbers, booleans, lists and dicts.
OUTPUTS: a dict; or a .toml file.

A text is looked through before it is parsed: Python's parser takes a time that grows with the
square of a key's parts (16 kB take seconds), and calls itself for every level of a value.
"""

import json
import os
import re
import sys
import tomllib
import unicodedata
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.formats.files.arrays import float_array
from jaxmocap.formats.files.errors import InputError, printable, short_repr, shorten_text
from jaxmocap.formats.files.reading import read_bytes, regular_file
from jaxmocap.formats.files.writing import write_text

# Levels of brackets, parts of a dotted key, characters of a number or a bare key.
MAX_LEVELS = 32
MAX_KEY_PARTS = 32
MAX_WORD_CHARACTERS = 200

# Texts, comments, and a text that does not end, where a parser stops. Only what is one character is
# repeated possessively: with groups Python up to 3.11.4 finds too much (CPython's gh-100061).
_QUOTED = re.compile(
    r"""
    "{3}[^"\\]*+(?:(?:\\.|"(?!""))[^"\\]*+)*"{3,5} | '{3}[^']*+(?:'(?!'')[^']*+)*'{3,5}
    | "[^"\\\n]*+(?:\\[^\n][^"\\\n]*+)*" | '[^'\n]*+' | \#[^\n]*+ | ["'] .*+
    """,
    re.VERBOSE | re.DOTALL,
)
_WORD = r"[^\s\[\]{},=.]"
# From a word's beginning only.
_LONG_WORD = re.compile(f"(?<!{_WORD}){_WORD}{{{MAX_WORD_CHARACTERS + 1},}}")
_LONG_KEY = re.compile(rf"(?<!{_WORD})(?:{_WORD}++[^\S\n]*+\.[^\S\n]*+){{{MAX_KEY_PARTS}}}{_WORD}")
_BRACKETS = re.compile(r"[\[{\]}\n]")


def _bare(text: str) -> str:
    """A text of the same length with a mark for what stands in quotes, and without comments."""
    return _QUOTED.sub(lambda each: (" " if each[0][0] == "#" else "_").ljust(len(each[0])), text)


def parsing_problem(text: str) -> str | None:
    """What is too deep or too long in a text, with its line; None where it may be parsed."""
    bare, levels = _bare(text), 0
    if match := _LONG_WORD.search(bare):
        expected = f"expected at most {MAX_WORD_CHARACTERS} characters without quotes"
        return f"{_line(text, match)}: found {short_repr(match[0])}, {expected}"
    if match := _LONG_KEY.search(bare):
        expected = f"expected at most {MAX_KEY_PARTS} parts between dots"
        return f"{_line(text, match)}: nested too deeply, {expected}"
    for match in _BRACKETS.finditer(bare):
        levels += (match[0] in "[{") - (match[0] in "]}")
        if levels > MAX_LEVELS:
            expected = f"expected at most {MAX_LEVELS} levels"
            return f"{_line(text, match)}: nested too deeply, {expected}"
    return None


def _line(text: str, match: re.Match) -> str:
    return f"line {text.count(chr(10), 0, match.start()) + 1}"


def statement_starts(text: str) -> list[int]:
    """Where the lines of a valid text begin that are not within a value of several lines."""
    levels, starts = 0, [0]
    for match in _BRACKETS.finditer(_bare(text)):
        levels += (match[0] in "[{") - (match[0] in "]}")
        if match[0] == "\n" and levels == 0:
            starts.append(match.end())
    return starts


# A recording or calibration takes some kilobytes.
MAX_TOML_BYTES = 2**20
# Metres, pixels, seconds (since 1970 as well), Hz: no number of ours is larger, and its square is
# a number in single precision.
LARGEST_NUMBER = 1e12
# What a camera's name may take as a part of a file's name: a system's file names have 255 bytes.
MAX_FILE_NAME_CHARACTERS = 100
MAX_FILE_NAME_BYTES = 200
_FORBIDDEN_CHARACTERS = frozenset('<>:"/\\|?*')
_RESERVED_NAMES = {"con", "prn", "aux", "nul"} | {
    f"{kind}{i}" for kind in ("com", "lpt") for i in range(10)
}


def read_toml(path: str | Path) -> dict[str, Any]:
    """Read a TOML file; InputError, with line and column, for no TOML, or too much of it."""
    return parse_toml(path, read_toml_text(path))


def read_toml_text(path: str | Path) -> str:
    """The text of a TOML file; its lines end with a line feed."""
    try:
        text = read_bytes(path, MAX_TOML_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(path, "found bytes that are not UTF-8 text, expected TOML") from None
    return text.replace("\r\n", "\n")


def parse_toml(path: str | Path, text: str) -> dict[str, Any]:
    """What a text says; ``path`` is what messages name."""
    if problem := parsing_problem(text):
        raise InputError(path, problem)
    try:
        return tomllib.loads(text)
    except (tomllib.TOMLDecodeError, ValueError) as error:
        raise InputError(path, f"not TOML: {error}") from None


def file_name_problem(name: str) -> str | None:
    """Why a name cannot be a part of a file's name on every system, or None where it can."""
    if not name.isprintable() or _FORBIDDEN_CHARACTERS & set(name):
        forbidden = " ".join(sorted(_FORBIDDEN_CHARACTERS))
        return f"expected a name without {forbidden} and control characters, since files get it"
    if not 0 < len(name) <= MAX_FILE_NAME_CHARACTERS or len(name.encode()) > MAX_FILE_NAME_BYTES:
        return (
            f"expected 1 to {MAX_FILE_NAME_CHARACTERS} characters, since files are named after it"
        )
    if name.startswith(".") or name.split(".")[0].strip().lower() in _RESERVED_NAMES:
        return "expected another name, since files are named after it"
    return None


def same_file_name(name: str) -> str:
    """What two names have in common that some file systems take for one."""
    return unicodedata.normalize("NFC", name).casefold()


class TomlTable:
    """One table of a TOML file, whose entries are asked for by name and kind.

    Every complaint is an InputError that names the file, the table and the field.
    """

    def __init__(self, path: Path, where: str, table: Any, keys: Collection[str] | None = None):
        """Check that it is a table with no other than the given keys (None: any)."""
        self.path, self.where = path, shorten_text(printable(where), 100)
        if not isinstance(table, dict):
            raise self.error("", f"found {short_repr(table)}, expected a table")
        for key in table:
            if keys is not None and key not in keys:
                raise self.error("", f"unknown key {short_repr(key)}, expected {', '.join(keys)}")
        self.entries: dict[str, Any] = table

    def error(self, key: str, problem: str) -> InputError:
        """The error to raise about one field, or with ``""`` about the table."""
        place = " ".join(filter(None, [self.where, shorten_text(printable(key), 60)]))
        return InputError(self.path, f"{place}: {problem}" if place else problem)

    def __contains__(self, key: str) -> bool:
        return key in self.entries

    def require(self, key: str) -> Any:
        """An entry as it is; InputError where it is missing."""
        if key not in self.entries:
            raise self.error("", f"{key!r} is missing")
        return self.entries[key]

    def only_one(self, *keys: str) -> str:
        """Which of these keys it has; InputError unless that is exactly one."""
        stated = [key for key in keys if key in self.entries]
        if len(stated) != 1:
            found = " and ".join(stated) or "none"
            raise self.error("", f"found {found}, expected one of {', '.join(keys)}")
        return stated[0]

    def text(self, key: str) -> str:
        """A required text that is not empty."""
        value = self.require(key)
        if not isinstance(value, str) or not value:
            raise self.error(key, f"found {short_repr(value)}, expected text in quotes")
        return value

    def choice(self, key: str, options: Collection[str], expected: str = "") -> str:
        """A required text that is one of these; ``expected`` is how messages list them."""
        value = self.text(key)
        if value not in options:
            expected = expected or f"one of {', '.join(options)}"
            raise self.error(key, f"found {short_repr(value)}, expected {expected}")
        return value

    def file_name(self, key: str) -> str:
        """A required text that files may be named after: it leads into no other folder."""
        name = self.text(key)
        if problem := file_name_problem(name):
            raise self.error(key, f"found {short_repr(name)}, {problem}")
        return name

    def flag(self, key: str, default: bool = False) -> bool:
        """True or false, or the default."""
        value = self.entries.get(key, default)
        if not isinstance(value, bool):
            raise self.error(key, f"found {short_repr(value)}, expected true or false")
        return value

    def number(
        self,
        key: str,
        default: float | None = None,
        low: float = -LARGEST_NUMBER,
        high: float = LARGEST_NUMBER,
        kind: str = "a number",
    ) -> float:
        """A number, of a ``kind``, from ``low`` to ``high``; required where there is no default."""
        value = self.require(key) if default is None else self.entries.get(key, default)
        # A whole number may be too large to be a float.
        is_number = isinstance(value, (int, float)) and abs(value) <= sys.float_info.max
        if isinstance(value, bool) or not is_number:
            raise self.error(key, f"found {short_repr(value)}, expected a number")
        if not low <= value <= high:
            expected = f"expected {kind} from {low:g} to {high:g}"
            raise self.error(key, f"found {short_repr(value)}, {expected}")
        return float(value)

    def integer(self, key: str, low: int, high: int) -> int:
        """A required whole number from ``low`` to ``high``."""
        value = self.number(key, None, low, high)
        if value != int(value):
            raise self.error(key, f"found {value:g}, expected a whole number")
        return int(value)

    def array(
        self,
        key: str,
        shapes: Collection[tuple[int, ...]],
        expected: str,
        largest: float = LARGEST_NUMBER,
    ) -> np.ndarray:
        """A required array of numbers, of one of the shapes; none beyond ``largest``, or minus."""
        value = self.require(key)
        try:
            array = float_array(value)
        except (TypeError, ValueError, OverflowError):
            array = np.array(np.nan)
        if array.shape not in shapes or not np.isfinite(array).all():
            raise self.error(key, f"found {short_repr(value)}, expected {expected}")
        if array.size and np.abs(array).max() > largest:
            raise self.error(key, f"found {short_repr(value)}, expected none beyond {largest:g}")
        return array

    def file(self, key: str, folder: bool = False) -> Path:
        """A required path, relative to the TOML file, of a file (or folder) that is there."""
        path = self.path.parent / self.text(key)
        if folder:
            if not os.path.isdir(path):
                raise self.error(key, f"no such folder: {path}")
            return path
        try:
            return regular_file(path)
        except InputError as error:
            raise self.error(key, f"{error.problem}: {path}") from None


def toml_value(value: Any) -> str:
    """One value as TOML: text, number, boolean, list, or a dict as an inline table."""
    if isinstance(value, dict):
        inside = ", ".join(f"{toml_key(key)} = {toml_value(item)}" for key, item in value.items())
        return f"{{ {inside} }}"
    if isinstance(value, (list, tuple, np.ndarray)):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, (bool, np.bool_)):
        return "true" if value else "false"
    if isinstance(value, (int, np.integer)):
        return str(int(value))
    if isinstance(value, (float, np.floating)):
        return repr(float(value))
    if isinstance(value, Path):
        return toml_value(value.as_posix())
    if isinstance(value, str):
        # JSON's escapes are TOML's too; the one control character that JSON leaves is escaped here.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    raise TypeError(f"{type(value).__name__} cannot be written to TOML")


def toml_key(key: str) -> str:
    """A key, quoted where it must be."""
    bare = key.isascii() and key.replace("_", "").replace("-", "").isalnum()
    return key if bare else toml_value(key)


def write_toml(path: str | Path, tables: list[tuple[str, dict[str, Any]]]) -> None:
    """Write tables in order: of each its header, such as ``[markers]``, and its entries."""
    blocks = [
        "\n".join(
            [header, *(f"{toml_key(key)} = {toml_value(item)}" for key, item in table.items())]
        )
        for header, table in tables
    ]
    write_text(path, "\n\n".join(blocks) + "\n")
