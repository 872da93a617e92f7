"""JSON from files of others: bounded in size, in depth and in the number of its parts.

INPUTS: text, or bytes of UTF-8. OUTPUTS: what it stands for; InputError in one sentence.

Python's objects take up to twenty-four times as much memory as the text that they come from.
"""

import json
from pathlib import Path
from typing import Any

from jaxmocap.formats.files.errors import InputError

MAX_JSON_BYTES = 16 * 2**20
MAX_LEVELS = 64
# Lists and tables.
MAX_PARTS = 2_000_000


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
