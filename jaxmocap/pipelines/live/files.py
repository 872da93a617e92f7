"""Files that grow during a live run and are valid at any time, whatever ends it.

INPUTS: lines; frames. OUTPUTS: a text file of complete lines; an MP4 file of complete fragments.

Little is buffered: a process that is killed loses half a second of lines and two frames. On a full
disk an incomplete part is removed again, so that the rest stays valid.
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

# Ticks per second of the file's clock.
CLOCK_HZ = 90_000
# Fragments of so many microseconds, each written at once.
MP4_OPTIONS = {
    "movflags": "empty_moov+default_base_moof",
    "frag_duration": "250000",
    "flush_packets": "1",
}
# No frame is held back in the encoder.
ENCODER_OPTIONS = {"preset": "ultrafast", "tune": "zerolatency", "crf": "20", "g": "30"}


class GrowingFile:
    """A new file that grows by complete parts; ``complete_bytes`` end the last of them."""

    def __init__(self, path: Path):
        """Make it.

        Raises:
            OutputError: there is one of that name, or it cannot be made.
        """
        self.path, self.complete_bytes, self._end = path, 0, 0
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

    def mark_complete(self) -> None:
        """Mark what is written so far as complete."""
        if not self._broken:
            self.complete_bytes = self._end

    def incomplete_bytes(self) -> int:
        """Bytes on disk beyond the complete parts."""
        return self._end - self.complete_bytes

    def drop_incomplete(self, kept: int = 0) -> None:
        """Remove what is incomplete, but for its first ``kept`` bytes, which become complete."""
        self.complete_bytes = self._end = self.complete_bytes + kept
        os.ftruncate(self._file, self.complete_bytes)

    def close(self) -> None:
        """Remove what is incomplete, and wait until the rest is on the disk.

        Raises:
            OSError: it could not be.
        """
        try:
            self.drop_incomplete()
            os.fsync(self._file)
        finally:
            os.close(self._file)


class LineFile:
    """A text file of lines, UTF-8, and how many are on disk, but for the header, or did not fit."""

    def __init__(self, path: Path, header: str):
        """Make it.

        Raises:
            OutputError: there is one of that name, or it cannot be written.
        """
        self._file, self.line_count, self.lost_count = GrowingFile(path), 0, 0
        self._lines: list[str] = []
        try:
            with as_output_error(path):
                self._file.write(header.encode() + b"\n")
        except BaseException:
            _close_and_remove(self._file)
            raise
        self._file.mark_complete()

    @property
    def has_lines(self) -> bool:
        """Whether any line is on disk or waits to be written."""
        return bool(self.line_count or self._lines)

    def add(self, line: str) -> None:
        """Add a line, which ``flush`` writes."""
        self._lines.append(line)

    def flush(self) -> None:
        """Write the lines that wait, as one part.

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
            written = content[: self._file.incomplete_bytes()]
            self._file.drop_incomplete(kept=written.rfind(b"\n") + 1)
            self.line_count += written.count(b"\n")
            self.lost_count += count - written.count(b"\n")
            raise
        self._file.mark_complete()
        self.line_count += count

    def close(self) -> None:
        """Write what waits.

        Raises:
            OSError: it cannot be.
        """
        try:
            self.flush()
        finally:
            self._file.close()


class GrowingVideo:
    """One camera's video, each frame at its own time; that of the first in seconds."""

    def __init__(self, path: Path, frame: LiveFrame):
        """Make it, in the size of its first frame.

        Raises:
            OutputError: there is one of that name, or it cannot be made.
            OSError, FFmpegError: it cannot be written.
        """
        self.path, self.first_time, self._last = path, frame.time, -1
        self._file = GrowingFile(path)
        try:
            self._container = av.open(self._file, "w", format="mp4", options=MP4_OPTIONS)
            self._stream: av.VideoStream = self._container.add_stream(
                "libx264", options=ENCODER_OPTIONS
            )
            height, width = frame.image.shape[:2]
            # Chroma is sampled for two rows and columns; an odd last one is left out.
            self._stream.width, self._stream.height = width - width % 2, height - height % 2
            self._stream.pix_fmt = "yuv420p"
            self._stream.codec_context.time_base = self._stream.time_base = Fraction(1, CLOCK_HZ)
            self._container.start_encoding()
        except BaseException:
            _close_and_remove(self._file)
            raise
        self._file.mark_complete()
        self._header = self._file.complete_bytes

    @property
    def is_readable(self) -> bool:
        """Whether any frame is on disk."""
        return self._file.complete_bytes > self._header

    def add(self, frame: LiveFrame) -> None:
        """Add a frame, later than the last.

        Raises:
            OSError, FFmpegError: it cannot be written.
        """
        image = frame.image[: self._stream.height, : self._stream.width]
        colours = "bgr24" if image.ndim == 3 else "gray"
        picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format=colours)
        stamp = max(round((frame.time - self.first_time) * CLOCK_HZ), self._last + 1)
        picture.pts, picture.time_base, self._last = stamp, Fraction(1, CLOCK_HZ), stamp
        self._container.mux(self._stream.encode(picture))
        self._file.mark_complete()

    def close(self) -> None:
        """Write what waits; after an error the complete parts stay.

        Raises:
            OSError, FFmpegError: it cannot be.
        """
        try:
            self._container.mux(self._stream.encode())
            self._container.close()
            self._file.mark_complete()
        finally:
            with suppress(OSError, FFmpegError):
                self._container.close()
            self._file.close()


def _close_and_remove(file: GrowingFile) -> None:
    with suppress(OSError):
        file.close()
    with suppress(OSError):
        file.path.unlink(missing_ok=True)
