"""TOML files: read with errors that name the field, and written as far as we need it.

INPUTS: a .toml file; or nested dicts of text, numbers, booleans, lists and dicts.
OUTPUTS: a dict; or a .toml file.
"""

import json
import math
import tomllib
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.formats.errors import InputError
from jaxmocap.formats.reading import read_bytes
from jaxmocap.formats.writing import replacing


def read_toml(path: str | Path) -> dict[str, Any]:
    """Read a TOML file; InputError with line and column where it is not TOML."""
    content = read_bytes(path)
    try:
        return tomllib.loads(content.decode("utf-8-sig").replace("\r\n", "\n"))
    except UnicodeDecodeError:
        raise InputError(path, "found bytes that are not UTF-8 text, expected TOML") from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(path, f"not TOML: {error}") from None


class Fields:
    """One table of a TOML file, whose entries are asked for by name and kind.

    Every complaint is an InputError that names the file, the table and the field.
    """

    def __init__(self, path: Path, where: str, table: Any, keys: Collection[str] | None = None):
        """Check that it is a table with no other than the given keys (None: any)."""
        self.path, self.where = path, where
        if not isinstance(table, dict):
            raise self.error("", f"found {_shown(table)}, expected a table")
        for key in table:
            if keys is not None and key not in keys:
                raise self.error("", f"unknown key {key!r}, expected {', '.join(keys)}")
        self.table: dict[str, Any] = table

    def error(self, key: str, problem: str) -> InputError:
        """The error to raise about one field, or with ``""`` about the table."""
        place = " ".join(filter(None, [self.where, key]))
        return InputError(self.path, f"{place}: {problem}" if place else problem)

    def __contains__(self, key: str) -> bool:
        return key in self.table

    def required(self, key: str) -> Any:
        """An entry as it is; InputError where it is missing."""
        if key not in self.table:
            raise self.error("", f"{key!r} is missing")
        return self.table[key]

    def text(self, key: str) -> str:
        """A required text that is not empty."""
        value = self.required(key)
        if not isinstance(value, str) or not value:
            raise self.error(key, f"found {_shown(value)}, expected text in quotes")
        return value

    def number(self, key: str, default: float | None = None) -> float:
        """A finite number; required where there is no default."""
        value = self.required(key) if default is None else self.table.get(key, default)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not _finite(value):
            raise self.error(key, f"found {_shown(value)}, expected a number")
        return float(value)

    def array(self, key: str, shapes: Collection[tuple[int, ...]], expected: str) -> np.ndarray:
        """A required array of finite numbers, of one of the shapes."""
        value = self.required(key)
        try:
            array = np.array(value, float)
        except (TypeError, ValueError, OverflowError):
            array = np.array(np.nan)
        if array.shape not in shapes or not np.isfinite(array).all():
            raise self.error(key, f"found {_shown(value)}, expected {expected}")
        return array

    def file(self, key: str, folder: bool = False) -> Path:
        """A required path, relative to the TOML file, of a file (or folder) that exists."""
        path = self.path.parent / self.text(key)
        kind = "folder" if folder else "file"
        try:
            there = path.is_dir() if folder else path.is_file()
        except (OSError, ValueError):
            there = False
        if not there:
            raise self.error(key, f"no such {kind}: {path}")
        return path


def _finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:60] + "…"


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
    """Write tables in order.

    Args:
        path: of the file.
        tables: header line, such as ``[markers]`` or ``[[video]]``, and entries of each.
    """
    blocks = [
        "\n".join(
            [header, *(f"{toml_key(key)} = {toml_value(item)}" for key, item in table.items())]
        )
        for header, table in tables
    ]
    with replacing(path) as beside:
        beside.write_text("\n\n".join(blocks) + "\n", encoding="utf-8", newline="\n")
