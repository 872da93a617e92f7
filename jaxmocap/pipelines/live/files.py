"""Files that a live run writes as it goes: whatever ends it, what is on disk is whole.

INPUTS: lines; frames. OUTPUTS: a text file of whole lines; an MP4 file of whole fragments.

Nothing waits in a buffer for long, so a process that is killed loses what came in within half a
second and two frames. On a full disk what does not fit is taken off again, and the rest is whole.
"""

import os
from contextlib import suppress
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from av.error import FFmpegError

from jaxmocap.capture.streams.inbox import LiveFrame
from jaxmocap.formats.files.writing import as_output_error

CLOCK = 90_000
# A fragment takes so many microseconds, and goes to the file at once.
MP4 = {
    "movflags": "empty_moov+default_base_moof",
    "frag_duration": "250000",
    "flush_packets": "1",
}
# No frame waits in the encoder for the next ones.
QUICK = {"preset": "ultrafast", "tune": "zerolatency", "crf": "20", "g": "30"}


class GrowingFile:
    """A new file that grows by whole parts.

    Attributes:
        path: of it.
        whole: bytes up to the end of the last whole part.
    """

    def __init__(self, path: Path):
        """Make it.

        Raises:
            OutputError: there is one of that name, or it cannot be made.
        """
        self.path, self.whole, self._end = path, 0, 0
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
        with as_output_error(path):
            self._file = os.open(path, flags, 0o666)
        self._broken = False

    def write(self, content: bytes) -> int:
        """Add to it; after an error nothing more is written.

        Raises:
            OSError: the disk is full, for example.
        """
        rest = memoryview(content)
        while len(rest) and not self._broken:
            try:
                written = os.write(self._file, rest)
            except OSError:
                self._broken = True
                raise
            rest, self._end = rest[written:], self._end + written
        return len(content)

    def complete(self) -> None:
        """What is written so far is whole."""
        if not self._broken:
            self.whole = self._end

    def written(self) -> int:
        """Bytes that are on disk beyond the whole parts."""
        return self._end - self.whole

    def cut(self, kept: int = 0) -> None:
        """Take off what is not whole, but for so many bytes."""
        self.whole = self._end = self.whole + kept
        os.ftruncate(self._file, self.whole)

    def close(self) -> None:
        """Take off what is not whole, and wait until the rest is on the disk.

        Raises:
            OSError: it could not be.
        """
        try:
            self.cut()
            os.fsync(self._file)
        finally:
            os.close(self._file)


class Rows:
    """A text file of lines, UTF-8.

    Attributes:
        rows: lines on disk, but for the header.
        lost: lines that did not fit there.
    """

    def __init__(self, path: Path, header: str):
        """Make it.

        Raises:
            OutputError: there is one of that name, or it cannot be written.
        """
        self._file, self.rows, self.lost = GrowingFile(path), 0, 0
        self._lines: list[str] = []
        try:
            with as_output_error(path):
                self._file.write(header.encode() + b"\n")
        except BaseException:
            self.remove()
            raise
        self._file.complete()

    @property
    def begun(self) -> bool:
        """Is any line on disk, or waits to be?"""
        return bool(self.rows or self._lines)

    def add(self, line: str) -> None:
        """Add a line, which ``flush`` writes."""
        self._lines.append(line)

    def flush(self) -> None:
        """Write the lines that wait, as one whole.

        Raises:
            OSError: the disk is full; the lines that fit are there.
        """
        if not self._lines:
            return
        content, count = "".join(f"{line}\n" for line in self._lines).encode(), len(self._lines)
        self._lines = []
        try:
            self._file.write(content)
        except OSError:
            fit = content[: self._file.written()]
            self._file.cut(fit.rfind(b"\n") + 1)
            self.rows += fit.count(b"\n")
            self.lost += count - fit.count(b"\n")
            raise
        self._file.complete()
        self.rows += count

    def close(self) -> None:
        """Write what waits.

        Raises:
            OSError: it cannot be.
        """
        try:
            self.flush()
        finally:
            self._file.close()

    def remove(self) -> None:
        """Close it and remove it."""
        _close_and_remove(self._file)


class Film:
    """One camera's video, each frame at its own time.

    Attributes:
        path: of the file.
        first: time of the first frame, seconds.
    """

    def __init__(self, path: Path, frame: LiveFrame):
        """Make it, in the size of its first frame.

        Raises:
            OutputError: there is one of that name, or it cannot be made.
            OSError, FFmpegError: it cannot be written.
        """
        self.path, self.first, self._last = path, frame.time, -1
        self._file = GrowingFile(path)
        try:
            self._container = av.open(self._file, "w", format="mp4", options=MP4)
            self._stream: av.VideoStream = self._container.add_stream("libx264", options=QUICK)
            height, width = frame.image.shape[:2]
            # Chroma comes by twos; an odd last row or column is left out.
            self._stream.width, self._stream.height = width - width % 2, height - height % 2
            self._stream.pix_fmt = "yuv420p"
            self._stream.codec_context.time_base = self._stream.time_base = Fraction(1, CLOCK)
            self._container.start_encoding()
        except BaseException:
            _close_and_remove(self._file)
            raise
        self._file.complete()
        self._header = self._file.whole

    @property
    def is_readable(self) -> bool:
        """Is any frame of it on disk?"""
        return self._file.whole > self._header

    def add(self, frame: LiveFrame) -> None:
        """Add a frame, later than the last.

        Raises:
            OSError, FFmpegError: it cannot be written.
        """
        image = frame.image[: self._stream.height, : self._stream.width]
        colours = "bgr24" if image.ndim == 3 else "gray"
        picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format=colours)
        stamp = max(round((frame.time - self.first) * CLOCK), self._last + 1)
        picture.pts, picture.time_base, self._last = stamp, Fraction(1, CLOCK), stamp
        self._container.mux(self._stream.encode(picture))
        self._file.complete()

    def close(self) -> None:
        """Write what waits; after an error what was whole stays.

        Raises:
            OSError, FFmpegError: it cannot be.
        """
        try:
            self._container.mux(self._stream.encode())
            self._container.close()
            self._file.complete()
        finally:
            with suppress(OSError, FFmpegError):
                self._container.close()
            self._file.close()


def _close_and_remove(file: GrowingFile) -> None:
    with suppress(OSError):
        file.close()
    with suppress(OSError):
        file.path.unlink(missing_ok=True)
