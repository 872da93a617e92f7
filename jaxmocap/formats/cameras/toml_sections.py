"""Changing one section of a TOML file and nothing else: comments and unknown keys stay.

INPUTS: the text of a TOML file, the names of a section, its new entries.
OUTPUTS: the text with that section's entries replaced or added.
"""

import re
import tomllib
from codecs import BOM_UTF8
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxmocap.formats.files.toml import read_toml_text, statement_starts, toml_key, toml_value
from jaxmocap.formats.files.writing import write_bytes

_HEADER = re.compile(r"\s*\[.*\]\s*(#.*)?")


def rewrite_toml(path: Path, change: Callable[[str], str]) -> None:
    """Change a TOML file's text; the mark at its start and the ends of its lines stay as they were.

    Raises:
        InputError: no TOML.
        OutputError: the file cannot be written.
    """
    before = path.read_bytes()
    text = change(read_toml_text(path))
    text = text.replace("\n", "\r\n") if b"\r\n" in before else text
    write_bytes(path, text.encode("utf-8-sig" if before.startswith(BOM_UTF8) else "utf-8"))


def replace_entries(text: str, section: str | Sequence[str], entries: Mapping[str, Any]) -> str:
    """Put entries into ``[section]``, by its name or names from the top; all else stays as it is.

    It is added at the end of the text, which is valid, where there is none.

    Raises:
        ValueError: the section is not written as a ``[section]`` of its own.
    """
    names = (section,) if isinstance(section, str) else tuple(section)
    header = f"[{'.'.join(map(toml_key, names))}]"
    table: Any = tomllib.loads(text)
    alone: dict[str, Any] = {}
    for name in reversed(names):
        alone = {name: alone}
    blocks = _sections(text)
    for i, block in enumerate(blocks):
        if _begins_with(block, alone):
            blocks[i] = _with_entries(block, entries)
            break
    else:
        for name in names:
            table = table.get(name) if isinstance(table, Mapping) else None
        if table is not None:
            raise ValueError(f"is not written as {header} on a line of its own")
        before = "".join(blocks).rstrip("\n")
        blocks = [f"{before}\n\n" if before else "", _with_entries(f"{header}\n", entries)]
    return "".join(blocks)


def replace_entries_of_each(
    text: str, array: str, entries: Callable[[Mapping[str, Any]], Mapping[str, Any]]
) -> str:
    """Put what ``entries`` makes of each table into every ``[[array]]``; all else stays as it is.

    Raises:
        ValueError: an entry of the array is not written as an ``[[array]]`` of its own.
    """
    tables, changed = tomllib.loads(text).get(array, []), []
    blocks, found = _sections(text), 0
    for block in blocks:
        if _begins_with(block, {array: [{}]}):
            block, found = _with_entries(block, entries(tables[found])), found + 1
        changed.append(block)
    if found != len(tables):
        raise ValueError(f"has not each written as [[{array}]] on a line of its own")
    return "".join(changed)


def _begins_with(block: str, tables: Mapping[str, Any]) -> bool:
    """Does a block begin with a header that alone stands for these tables?"""
    header = block.lstrip().split("\n")[0]
    return header.startswith("[") and tomllib.loads(header) == tables


def _sections(text: str) -> list[str]:
    """A text cut before every header."""
    blocks: list[list[str]] = [[]]
    for statement in _statements(text):
        if _HEADER.fullmatch(statement.rstrip("\n")):
            blocks.append([])
        blocks[-1].append(statement)
    return ["".join(block) for block in blocks]


def _statements(text: str) -> list[str]:
    """A valid text cut before every line that is not within a value of several lines."""
    starts = statement_starts(text)
    return [text[start:end] for start, end in zip(starts, [*starts[1:], None], strict=True)]


def _with_entries(block: str, entries: Mapping[str, Any]) -> str:
    """A section's text with each entry in the place of its key, or after the last key."""
    lines = {key: f"{toml_key(key)} = {toml_value(value)}\n" for key, value in entries.items()}
    header, *statements = _statements(block if block.endswith("\n") else block + "\n")
    body = [lines.pop(key, old) if (key := _key(old)) else old for old in statements]
    end = max((i + 1 for i, old in enumerate(body) if _key(old) is not None), default=0)
    return "".join([header, *body[:end], *lines.values(), *body[end:]])


def _key(statement: str) -> str | None:
    """The key that a statement sets; None for an empty line or a comment."""
    return next(iter(tomllib.loads(statement)), None)
