"""The door that every input file comes in by: a regular file of bounded size.

INPUTS: a path, from a user or from another file. OUTPUTS: its bytes, or its numbered
lines, of which some thousand at a time are in memory; InputError in one sentence.

A FIFO, a device or a folder is refused before anything is read from it: each may keep a reader
waiting for ever, or never end.
"""

import io
import os
import re
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from jaxmocap.formats.files.errors import InputError

# What files that are read whole may hold, bytes.
MAX_BYTES = 512 * 2**20

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def reader_process(script: str, *arguments: str) -> tuple[list[str], dict[str, str]]:
    """Command and environment of a process of its own, for what may take a reader along."""
    # Packages may lie where only PYTHONPATH or the user's own folder leads, which -I would hide.
    command = [sys.executable, "-P", script, *arguments]
    # Each further thread of its libraries would take addresses.
    return command, os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def regular_file(path: str | Path) -> Path:
    """The path of a regular file that is there; InputError for none. Nothing is opened."""
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        raise InputError(path, "no such file") from None
    except ValueError:
        raise InputError(repr(str(path)), "not a file's name, it holds a NUL") from None
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from None
    if not stat.S_ISREG(mode):
        kind = next((name for is_kind, name in _KINDS if is_kind(mode)), "no regular file")
        raise InputError(path, f"found {kind}, expected a file")
    return Path(path)


@contextmanager
def open_regular(path: str | Path, max_bytes: int = MAX_BYTES) -> Iterator[BinaryIO]:
    """A regular file, open from its beginning; InputError for none, or a larger one.

    A file of the system may be endless and say that it is empty: whoever reads counts as well.
    """
    regular_file(path)
    try:
        # What has become something else since then must not block.
        flags = os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0)
        descriptor = os.open(path, flags)
    except OSError as error:
        raise InputError(path, f"cannot be read ({error.strerror})") from None
    with open(descriptor, "rb") as file:
        if (size := os.fstat(descriptor).st_size) > max_bytes:
            raise _too_large(path, size, max_bytes)
        yield file


def read_bytes(path: str | Path, max_bytes: int = MAX_BYTES) -> bytes:
    """A regular file's content; InputError for none, or one of more bytes than it may hold."""
    with open_regular(path, max_bytes) as file:
        try:
            content = file.read(max_bytes + 1)
        except OSError as error:
            raise InputError(path, f"cannot be read ({error.strerror})") from None
    if len(content) > max_bytes:
        raise _too_large(path, len(content), max_bytes)
    return content


def _too_large(path: str | Path, size: int, most: int) -> InputError:
    megabytes = f"{size / 2**20:.0f} MB"
    return InputError(path, f"found {megabytes}, expected at most {most / 2**20:g} MB")


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
    """Number, from 1, and text of every line, without mark and ends; InputError names the line."""
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
