"""Values that no honest file holds, and what makes trees of them.

INPUTS: a random generator, nested dicts and lists. OUTPUTS: hostile values; the tree with one or a
few places changed; its text as JSON or TOML.

What neither JSON nor TOML can be told to hold, such as nan or 3,000 brackets, goes through as a
token in a text, which the finished text then has replaced.
"""

import json
import math
from collections.abc import Iterator
from copy import deepcopy
from typing import Any

import numpy as np

# Python refuses to read whole numbers of more digits than 4,300.
DIGITS = 4400
NUMBERS = (
    *("2", "3.7", "-0.1", "1e-6", "1e6", "250", "60", "1.0", "nan", "inf", "-inf", "1e308"),
    *("-1e308", "1e-320", "1e12", "-1", "0", "-0.0", "0.5", "1e9", "1e24", "-1e39", "1e-39"),
    *("1000000000", "2147483648", "4294967295", "9223372036854775808", "9" * DIGITS),
    *("1" + "0" * 5000, "1e999999", "1e", "0x10", "1_000", "٣", "1,5", "--1", ".", "1d3", "NaN(7)"),
)
LONG = 100_000
# Names that would lie outside the outputs' folder lie within the case's: it is deep enough.
STRINGS = (
    *("", " ", "\t", "\0", "a\0b", "\x1b[31mred\x1b[0m", "\x1b]0;title\x07", "line\nbreak", "\r"),
    *("\u202egnp.exe", "\u2066x\u2069", "\u200b", "\ufeff", "\u2028", "\x7f", "\x85", "\x9b31m"),
    *("../../../EVIL", "x/../../../EVIL", "/", "..", ".", "~", "C:\\con", "nul", "con.txt", "*"),
    *(
        "%s%n",
        "{0}",
        "$(touch EVIL)",
        "a" * 300,
        "é" * 200,
        "日本",
        "💀",
        "nan",
        "-1",
        "true",
        "a=b",
    ),
    *("[markers]", '"', "'", "\\", "#", ",", ";", "Head.x", "x" * LONG, "\n" * 1000, "ß" * LONG),
)
# Beside every case's inputs: things that are no files.
ODD = ("pipe", "zeros", "noise", "loop", "gone", "folder", "socket", "self", "locked", "empty")
DEPTHS = (101, 1000, 5000, 100_000)


def hostile_text(rng: np.random.Generator) -> str:
    """A text; every third time the name of something that is no file."""
    if rng.random() < 0.3:
        return f"odd/{ODD[rng.integers(len(ODD))]}"
    return STRINGS[rng.integers(len(STRINGS))]


def hostile_number(rng: np.random.Generator) -> str:
    """A number, or what nearly is one, as text."""
    return NUMBERS[rng.integers(len(NUMBERS))]


def raw(text: str) -> str:
    """A token that the written text has replaced by ``text`` without quotes."""
    return f"@raw@{text}@raw@"


def hostile_value(rng: np.random.Generator) -> Any:
    """Anything."""
    kind = rng.integers(8)
    if kind == 0:
        return raw(hostile_number(rng))
    if kind == 1:
        return hostile_text(rng)
    if kind == 2:
        depth = int(DEPTHS[rng.integers(len(DEPTHS))])
        return raw("[" * depth + "1" + "]" * depth)
    simple = ([], {}, True, [[]], {"a": {"b": [1, "c", {}]}}, [None], -1, 10**9, [0.0] * 10_000)
    return simple[rng.integers(len(simple))]


def places_in(tree: Any) -> Iterator[tuple[Any, Any]]:
    """What everything in a tree, but the root, is in, and its key or index there."""
    entries = tree.items() if isinstance(tree, dict) else ()
    for key, value in enumerate(tree) if isinstance(tree, list) else entries:
        yield tree, key
        yield from places_in(value)


def change_tree(rng: np.random.Generator, tree: Any) -> None:
    """Change one place of a tree in place."""
    actual = list(places_in(tree))
    if not actual:
        return
    parent, key = actual[rng.integers(len(actual))]
    how = rng.integers(10)
    if how == 0:
        del parent[key]
    elif how == 1 and isinstance(parent, dict):
        parent[hostile_text(rng)] = parent.pop(key)
    elif how == 2:
        other, at = actual[rng.integers(len(actual))]
        parent[key] = deepcopy(other[at])
    elif how == 3 and isinstance(parent[key], list):
        parent[key] = parent[key] * int(rng.choice([0, 2, 1000]))
    elif how == 4 and isinstance(parent, dict):
        parent[hostile_text(rng)] = hostile_value(rng)
    elif isinstance(parent[key], int | float) and how < 9:
        parent[key] = raw(hostile_number(rng))
    elif isinstance(parent[key], str) and how < 9:
        parent[key] = hostile_text(rng)
    else:
        parent[key] = hostile_value(rng)


def brief(value: Any) -> str:
    """A value for a person to read."""
    text = ascii(value)
    return text if len(text) <= 40 else f"{text[:24]}... ({len(text)} characters)"


def as_json(tree: Any) -> bytes:
    """A tree as JSON."""
    return _with_raw(json.dumps(tree)).encode()


def as_toml(tree: dict[str, Any]) -> bytes:
    """A tree as TOML, a line for each of its entries."""
    lines = [f"{_quoted(key)} = {_inline(value)}" for key, value in tree.items()]
    return _with_raw("\n".join(lines) + "\n").encode("utf-8", "surrogatepass")


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        entries = (f"{_quoted(key)} = {_inline(entry)}" for key, entry in value.items())
        return "{ " + ", ".join(entries) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return _quoted(value) if isinstance(value, str) else repr(value) if value is not None else "{}"


def _quoted(text: Any) -> str:
    return json.dumps(str(text), ensure_ascii=False).replace("\x7f", "\\u007f")


def _with_raw(text: str) -> str:
    """The tokens replaced by what they stand for."""
    return text.replace('"@raw@', "").replace('@raw@"', "")
