"""The one writer: files that appear complete or not at all.

INPUTS: the path that a file shall have.
OUTPUTS: a path beside it to write to; the file is checked, flushed to the disk and moved into
place when the writer is done. OutputError where it cannot be: what was there before is as it was.

A process that is killed leaves its hidden part behind; the next that writes there removes it, or
in the folder of compiled programs the next start.
"""

import hashlib
import os
import re
import shutil
import socket
import sys
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from jaxmocap.formats.files.errors import InputError, OutputError

# .jaxmocap-HOST-PROCESS-CHANCE.suffix: hidden, of this machine, and of a process that can be asked
# for.
_TEMPORARY_NAME = re.compile(r"\.jaxmocap-([0-9a-f]{8})-(\d+)-[0-9a-f]{8}(\..*)?")
# A disk with less room is full before the work begins.
SMALLEST_ROOM_BYTES = 2**20
_HOST = hashlib.sha256(socket.gethostname().encode()).hexdigest()[:8]


def temporary_beside(path: Path) -> Path:
    """A hidden name in the same folder, so that a move is atomic.

    It keeps the suffix, by which libraries choose a format.
    """
    return path.with_name(f".jaxmocap-{_HOST}-{os.getpid()}-{uuid.uuid4().hex[:8]}{path.suffix}")


@contextmanager
def replacing(
    path: str | Path, check: Callable[[Path], bool] | None = None, lasting: bool = True
) -> Iterator[Path]:
    """Write beside ``path`` and replace it at the end; after an error it is as it was before.

    Missing folders are made. Where the path is a link, the file that it leads to is replaced.

    Args:
        path: of the file.
        check: whether what was written is complete, asked with the hidden path before it is moved;
            for libraries that do not say that the disk is full.
        lasting: flushed to the disk, in a folder without what killed processes left. A cache's
            thousands of files need not be: what is cut off is made again.

    Yields:
        The hidden path to write to.

    Raises:
        OutputError: the disk is full, the folder cannot be written to, or what was written is not
            complete.
    """
    with as_output_error(Path(path)):
        path = Path(os.path.realpath(path))
        if path.exists() and not path.is_file():
            raise OutputError(path, "found a folder or a device, expected a file to replace")
        path.parent.mkdir(parents=True, exist_ok=True)
        if lasting:
            remove_stale_temporaries(path.parent)
        temporary = temporary_beside(path)
        try:
            yield temporary
            if lasting:
                flush_to_disk(temporary)
            if check is not None and not check(temporary):
                raise OutputError(path, "cannot be written completely, is the disk full?")
            os.replace(temporary, path)
        finally:
            _remove(temporary)


def check_target(path: str | Path, inputs: Iterable[str | Path] = ()) -> Path:
    """The path of a file to write, looked at before the work begins; nothing is made.

    InputError where the work reads it as one of its inputs, or it cannot be written to.
    """
    path = Path(path)
    check_file_name(path)
    if path.exists() and not path.is_file():
        raise InputError(path, "found a folder or a device, expected a file's name to write to")
    for each in inputs:
        if path.exists() and Path(each).exists() and path.samefile(each):
            raise InputError(path, "would be replaced while it is read, expected another name")
    check_folder_writable(path.parent, path)
    return path


def check_file_name(path: Path) -> None:
    """InputError where no file can be called so."""
    if "\0" in str(path):
        raise InputError(ascii(str(path)), "not a file's name, it holds a NUL")
    try:
        path.exists()
        os.fsencode(path)
    except OSError as error:
        raise InputError(path, f"cannot be written to ({error.strerror})") from None
    except UnicodeEncodeError:
        raise InputError(ascii(str(path)), "not a file's name on this system") from None


def check_folder_writable(folder: Path, path: Path | None = None) -> None:
    """Try whether a folder can be made and written to, and take away what was written.

    Raises:
        InputError: it is read-only, or a file.
        OutputError: it takes no file, as on a full disk; of ``path``, or else of the folder.
    """
    existing = folder
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        raise InputError(folder, f"cannot be a folder, {existing} is a file")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise InputError(folder, f"cannot be written to, {existing} is read-only")
    probe = temporary_beside(existing / "probe")
    with as_output_error(path or folder):
        try:
            probe.write_bytes(bytes(SMALLEST_ROOM_BYTES))
            flush_to_disk(probe)
        finally:
            _remove(probe)


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a complete file; OutputError as ``replacing`` has it."""
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def write_text(path: str | Path, text: str) -> None:
    """Write a whole text file by ``write_bytes``: UTF-8, lines end with a line feed everywhere."""
    write_bytes(path, text.encode())


def write_lines(path: str | Path, *parts: Iterable[str]) -> None:
    """Write a text file of any length line by line, part after part; see ``replacing``."""
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(f"{line}\n" for lines in parts for line in lines)


def flush_to_disk(path: Path) -> None:
    """Wait until a file's content is on the disk: a full one may say so no earlier."""
    descriptor = os.open(path, os.O_RDWR | getattr(os, "O_BINARY", 0))
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def remove_stale_temporaries(folder: Path) -> None:
    """Remove what processes that were killed left in a folder; what others write stays."""
    try:
        entries = list(os.scandir(folder))
    except OSError:
        return
    for entry in entries:
        match = _TEMPORARY_NAME.fullmatch(entry.name)
        if match and match[1] == _HOST and not _is_running(int(match[2])):
            _remove(Path(entry.path))


def _is_running(process: int) -> bool:
    if sys.platform == "win32":
        # There is no way to ask that would not disturb it.
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        pass
    return True


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
        return
    # The error that led here is what counts.
    with suppress(OSError):
        path.unlink(missing_ok=True)


@contextmanager
def as_output_error(path: Path) -> Iterator[None]:
    """The system's errors as one sentence about the file that was to be written."""
    try:
        yield
    except OSError as error:
        raise OutputError(path, f"cannot be written ({error.strerror or error})") from error
