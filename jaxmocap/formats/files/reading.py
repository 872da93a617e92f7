"""The door that every input file comes in by: a regular file of bounded size.

INPUTS: a path, from a user or from another file. OUTPUTS: its bytes; InputError in one sentence.

A FIFO, a device or a folder is refused before anything is read from it: each may keep a reader
waiting for ever, or never end.
"""

import os
import stat
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


def regular_file(path: str | Path) -> Path:
    """The path, of a regular file that is there; nothing is opened.

    Raises:
        InputError: no such file, a name that no file can have, or something else than a file.
    """
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
    """A regular file, open to be read from its beginning.

    Args:
        path: of the file.
        max_bytes: bytes that it may hold; a file of the system may be endless and say that it is
            empty, so whoever reads counts as well.

    Raises:
        InputError: it is missing, cannot be read, is no regular file, or is too large.
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
    """A regular file's content.

    Args:
        path: of the file.
        max_bytes: bytes that it may hold.

    Raises:
        InputError: it is missing, cannot be read, is no regular file, or is too large.
    """
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
