"""Text files line by line: however large, some thousand lines at a time are in memory.

INPUTS: a UTF-8 text file, its lines ended as any system ends them.
OUTPUTS: numbered lines; InputError where it is no text, or more than any of ours.
"""

import io
import re
from collections.abc import Iterator
from pathlib import Path

from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.reading import open_regular

# Half an hour of 60 markers at 200 Hz takes 0.6 GB.
MAX_TABLE_BYTES = 2**30
# 7 hours at 200 Hz.
MAX_LINES = 5_000_000
# Characters: 10,000 numbers, far more than any row has.
MAX_LINE_CHARACTERS = 2**20
# Characters that are read at a time.
_BLOCK_CHARACTERS = 2**18
# What binary data or bytes that are no UTF-8 are decoded to.
_NOT_TEXT = re.compile("[\0\ud800-\udfff]")


def numbered_lines(path: str | Path, max_bytes: int = MAX_TABLE_BYTES) -> Iterator[tuple[int, str]]:
    """Number, from 1, and text of every line, without byte-order mark and line ends.

    Args:
        path: of the file.
        max_bytes: bytes that it may hold.

    Raises:
        InputError: no such file, nothing in it, or the line that is no text or too long.
    """
    number, is_empty = 0, True
    for lines in _blocks(path, max_bytes):
        if number + len(lines) > MAX_LINES:
            raise InputError(path, f"found more than {MAX_LINES} lines")
        if is_empty and any(map(str.strip, lines)):
            is_empty = False
            # Those before, which alone would make no file.
            yield from ((blank, "") for blank in range(1, number + 1))
        if not is_empty:
            yield from enumerate(lines, number + 1)
        number += len(lines)
    if is_empty:
        raise InputError(path, "the file is empty")


def _blocks(path: str | Path, most: int) -> Iterator[list[str]]:
    """Some lines at a time, without their ends."""
    number, rest = 0, ""
    with open_regular(path, most) as file:
        text = io.TextIOWrapper(file, "utf-8-sig", errors="surrogateescape")
        while True:
            try:
                block = text.read(_BLOCK_CHARACTERS)
            except OSError as error:
                raise InputError(path, f"cannot be read ({error.strerror})") from None
            if not block:
                break
            # A file of the system may be endless and say that it is empty.
            if (most := most - len(block)) < 0:
                raise InputError(path, "found a file that does not end")
            block = rest + block
            if match := _NOT_TEXT.search(block):
                line = number + block.count("\n", 0, match.start()) + 1
                is_binary = match[0] == "\0"
                what = (
                    "binary data, expected text" if is_binary else "bytes that are not UTF-8 text"
                )
                raise InputError(path, f"line {line}: found {what}")
            *lines, rest = block.split("\n")
            if len(rest) > MAX_LINE_CHARACTERS:
                problem = (
                    f"found more than {MAX_LINE_CHARACTERS} characters, expected a line of a table"
                )
                raise InputError(path, f"line {number + len(lines) + 1}: {problem}")
            yield lines
            number += len(lines)
    yield [rest]


def read_lines(path: str | Path) -> list[str]:
    """All lines of a file of a megabyte at most; none that is empty stands at the end."""
    lines = [line for _, line in numbered_lines(path, 2**20)]
    while not lines[-1]:
        lines.pop()
    return lines
