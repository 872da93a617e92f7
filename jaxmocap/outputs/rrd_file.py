"""Files of the rerun viewer that are whole, or an error.

INPUTS: what lets the viewer's library write to a path. OUTPUTS: the file; the system's own error
where it cannot be written.

The library writes from a thread of its own and keeps to itself that the disk is full. So it writes
into a pipe, and what comes out of it is written here, as it comes.
"""

import os
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

# Where open files have paths: not on every system.
_OPEN_FILES = Path("/dev/fd")
# Copied at once, bytes.
_BLOCK = 2**20
# At its end a file says where its table of contents is: place, length, checksum, these letters and
# how many such entries there are.
_END, _LETTERS = struct.Struct("<QQI8sI"), b"RRF2FOOT"


@contextmanager
def written(path: Path, begin: Callable[[str], None]) -> Iterator[None]:
    """What the library writes, from ``begin`` until this is left, as a file.

    Args:
        path: of the file.
        begin: lets the library open a path to write to.

    Raises:
        OSError: it cannot be written.
    """
    if not _OPEN_FILES.is_dir():
        begin(str(path))
        yield
        return
    reading, writing = os.pipe()
    copy = _Copy(reading, path)
    copy.start()
    try:
        try:
            begin(f"{_OPEN_FILES}/{writing}")
        finally:
            # The library has opened it once more; when that is closed too the pipe ends.
            os.close(writing)
        yield
    finally:
        copy.join()
    if copy.error is not None:
        raise copy.error


class _Copy(Thread):
    """Writes what comes out of a pipe to a file.

    Attributes:
        error: why it could not; what comes after it is lost, so that nobody waits.
    """

    def __init__(self, reading: int, path: Path):
        super().__init__(name="recording.rrd", daemon=True)
        self._reading, self._path = reading, path
        self.error: OSError | None = None

    def run(self) -> None:
        """Until the pipe ends."""
        with open(self._reading, "rb", buffering=0) as pipe:
            try:
                with open(self._path, "wb", buffering=0) as file:
                    while block := pipe.read(_BLOCK):
                        left = memoryview(block)
                        while left:
                            left = left[file.write(left) :]
            except OSError as error:
                self.error = error
            while pipe.read(_BLOCK):
                pass


def is_whole(path: Path) -> bool:
    """Whether a file ends with where its table of contents is, and nothing before it is missing."""
    size = path.stat().st_size
    if size < _END.size:
        return False
    with path.open("rb") as file:
        file.seek(-_END.size, os.SEEK_END)
        place, length, _, letters, _ = _END.unpack(file.read())
    return letters == _LETTERS and place + length + _END.size == size
