"""Text files line by line: however large, one line at a time is in memory.

INPUTS: a UTF-8 text file, its lines ended as any system ends them.
OUTPUTS: numbered lines; InputError where it is no text, or more than any of ours.
"""

import io
from collections.abc import Iterator
from itertools import repeat
from pathlib import Path

from jaxmocap.formats.errors import InputError
from jaxmocap.formats.reading import open_regular

# Half an hour of 60 markers at 200 Hz takes 0.6 GB.
MOST_TABLE_BYTES = 2**30
# Of files that are read whole.
MOST_WHOLE_BYTES = 2**20
# 14 hours at 200 Hz.
MOST_LINES = 10_000_000
# Characters: 10,000 numbers, far more than any row has.
LONGEST_LINE = 2**20


def numbered_lines(path: str | Path, most: int = MOST_TABLE_BYTES) -> Iterator[tuple[int, str]]:
    """Number, from 1, and text of every line, without byte-order mark and line ends.

    Args:
        path: of the file.
        most: bytes that it may hold.

    Raises:
        InputError: no such file, nothing in it, or the line that is no text or too long.
    """
    blank = 0
    with open_regular(path, most) as file:
        text = io.TextIOWrapper(file, "utf-8-sig", errors="surrogateescape")
        for number in range(1, MOST_LINES + 1):
            if not (line := _line(path, number, text)):
                break
            most -= len(line)
            if most < 0:
                raise InputError(path, f"line {number}: the file does not end")
            if blank is not None and not line.strip():
                blank += 1
                continue
            # Those before it, which alone would make no file.
            yield from zip(range(1, 1 + (blank or 0)), repeat(""), strict=False)
            blank = None
            yield number, line.rstrip("\n")
        else:
            raise InputError(path, f"found more than {MOST_LINES} lines")
    if blank is not None:
        raise InputError(path, "the file is empty")


def _line(path: str | Path, number: int, text: io.TextIOWrapper) -> str:
    """The next line with its end; empty where there is none."""
    try:
        line = text.readline(LONGEST_LINE + 1)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from None
    if "\0" in line:
        raise InputError(path, f"line {number}: found binary data, expected text")
    if not line.isascii() and any("\ud800" <= c <= "\udfff" for c in line):
        raise InputError(path, f"line {number}: found bytes that are not UTF-8 text")
    if len(line) > LONGEST_LINE:
        problem = f"found more than {LONGEST_LINE} characters, expected a line of a table"
        raise InputError(path, f"line {number}: {problem}")
    return line


def read_lines(path: str | Path, most: int = MOST_WHOLE_BYTES) -> list[str]:
    """All lines of a small file; none that is empty stands at the end."""
    lines = [line for _, line in numbered_lines(path, most)]
    while not lines[-1]:
        lines.pop()
    return lines
