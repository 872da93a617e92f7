"""Video: frames with their times, from a file or from memory.

INPUTS: a video file, or times and images; seconds to add to video time to get marker time.
OUTPUTS: frame times in seconds of marker time, found without decoding, and the frames themselves,
None where one cannot be decoded.
"""

import os
from abc import ABC, abstractmethod
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError
from av.packet import Packet
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from jaxmocap.capture.decoding import FORMATS, decoder_options, image_of, refused_codec
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.reading import regular_file
from jaxmocap.formats.recordings.recording import VideoSource
from jaxmocap.formats.time_series.tables import check_times, usual_step
from jaxmocap.geometry.cameras import SIZE_TOLERANCE

TimedImage = tuple[float, np.ndarray | None]
NO_VIDEO = "is not a video"
# The size before the first image.
_UNKNOWN_SIZE = (0, 0)
# 8K; a file of some kilobytes may state any size.
MAX_PIXELS = 2**25
# 4.6 hours at 120 Hz.
MAX_FRAMES = 2_000_000
# A week, seconds.
MAX_DURATION_S = 604_800.0
# Frames per second of a video without stamps.
MAX_RATE_HZ = 100_000.0
_OPTIONS = {"format_whitelist": FORMATS, "protocol_whitelist": "file"} | decoder_options(MAX_PIXELS)


class FrameSource(ABC):
    """F frames over time. It can be gone through any number of times."""

    name: str  # the file, or a name where there is none
    times: np.ndarray  # (F,) seconds of marker time, ascending
    size: tuple[int, int]  # width and height in pixels

    @abstractmethod
    def frames(self, luma: bool = False) -> Iterator[TimedImage]:
        """Go through all F frames: time, and an image (H, W, 3) BGR or grey (H, W), uint8.

        None in place of an image that cannot be decoded.
        """

    def __iter__(self) -> Iterator[TimedImage]:
        return self.frames()

    def __len__(self) -> int:
        return len(self.times)

    @property
    def fps(self) -> float:
        """Frames per second, by the median interval; 0 for a single frame."""
        interval = usual_step(self.times)
        return 1 / interval if interval else 0.0


class Video(FrameSource):
    """A video file.

    Attributes:
        metadata: what the file says of itself, key -> text.
    """

    def __init__(self, path: str | Path, offset: float = 0.0):
        """Look through the file's packets for the times, and decode until there is one image.

        Args:
            path: of any file that FFmpeg reads.
            offset: seconds to add to video time to get marker time.

        Raises:
            InputError: no such file, not a video, or no frame in it can be decoded.
        """
        self.name, self.path = str(path), regular_file(path)
        self.size = _UNKNOWN_SIZE
        self.metadata: dict[str, str] = {}
        self._stamps, seconds = self._scan()
        self.times = seconds + offset
        images = (image for _, image in self.frames(luma=True) if image is not None)
        if (first := next(images, None)) is None:
            raise InputError(self.path, f"{NO_VIDEO}, none of its frames can be decoded")
        height, width = first.shape
        self.size = (width, height)

    def _open(self) -> InputContainer:
        try:
            url = f"file:{os.path.realpath(self.path)}"
            container = av.open(url, metadata_errors="replace", options=_OPTIONS)
        except (FFmpegError, OSError, ValueError):
            raise InputError(self.path, NO_VIDEO) from None
        if not container.streams.video:
            problem = f"{NO_VIDEO}, it has no video stream"
        elif problem := refused_codec(container.streams.video[0]):
            problem = f"{NO_VIDEO}, {problem}"
        elif (
            context := container.streams.video[0].codec_context
        ).width * context.height > MAX_PIXELS:
            problem = f"found images of {context.width} × {context.height} pixels"
            problem += f", expected up to {MAX_PIXELS / 1e6:.0f} million"
        else:
            return container
        container.close()
        raise InputError(self.path, problem)

    def _scan(self) -> tuple[np.ndarray | None, np.ndarray]:
        """Presentation stamps of all frames in order, and seconds since the stream's start."""
        stamps, unstamped = array("q"), 0
        with self._open() as container:
            stream = container.streams.video[0]
            self.metadata = {**container.metadata, **stream.metadata}
            for packet in _packets(container, stream):
                if packet.size and not packet.is_discard:
                    unstamped += packet.pts is None
                    stamps.append(packet.pts or 0)
                if len(stamps) > MAX_FRAMES:
                    raise InputError(self.path, f"expected at most {MAX_FRAMES} frames")
            if unstamped:
                # Without stamps the frames follow one another at the stream's rate.
                rate = float(stream.average_rate or stream.guessed_rate or 30)
                if not 0 < rate <= MAX_RATE_HZ:
                    raise InputError(self.path, f"found {rate:g} frames per second")
                return None, np.arange(len(stamps)) / rate
            distinct = np.unique(np.asarray(stamps, np.int64))
            return distinct, self._seconds(distinct, stream)

    def _seconds(self, stamps: np.ndarray, stream: VideoStream) -> np.ndarray:
        """Since the stream's start, of ascending stamps."""
        if not len(stamps):
            return np.zeros(0)
        tick = float(stream.time_base or 1)
        start = int(stamps[0]) if stream.start_time is None else stream.start_time
        # Python's numbers do not overflow.
        first, last = (tick * (int(stamp) - start) for stamp in stamps[[0, -1]])
        if not -MAX_DURATION_S <= first <= last <= MAX_DURATION_S:
            problem = f"found frames {first:.4g} to {last:.4g} s after its start"
            problem = f"{problem}, expected within {MAX_DURATION_S / 86400:g} days"
            raise InputError(self.path, problem)
        return (stamps - start) * tick

    def frames(self, luma: bool = False) -> Iterator[TimedImage]:
        """See ``FrameSource.frames``. The end of a truncated file yields None."""
        next_frame = 0
        for i, frame in self._decode_frames():
            if i < next_frame:
                continue
            for missing in range(next_frame, i):
                yield float(self.times[missing]), None
            next_frame = i + 1
            yield float(self.times[i]), self._image(frame, luma)
        for missing in range(next_frame, len(self.times)):
            yield float(self.times[missing]), None

    def _image(self, frame: VideoFrame, luma: bool) -> np.ndarray | None:
        """A frame's image; None of one that is broken, or of another size than the first."""
        if frame.is_corrupt or frame.width * frame.height > MAX_PIXELS:
            return None
        try:
            image = image_of(frame, luma)
        except (FFmpegError, OSError, ValueError):
            return None
        return image if self.size in (_UNKNOWN_SIZE, image.shape[1::-1]) else None

    def _decode_frames(self) -> Iterator[tuple[int, VideoFrame]]:
        """Index and frame of all that can be decoded; a broken packet costs only its frames."""
        with self._open() as container:
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            stream.codec_context.options = decoder_options(MAX_PIXELS)
            count = 0
            for packet in _packets(container, stream):
                try:
                    frames = packet.decode()
                except (FFmpegError, OSError):
                    continue
                for frame in frames:
                    i = count if self._stamps is None else _frame_index(self._stamps, frame.pts)
                    count += 1
                    if 0 <= i < len(self.times):
                        yield i, frame


class MemoryVideo(FrameSource):
    """Frames that are in memory already."""

    def __init__(
        self,
        times: np.ndarray,
        images: Sequence[np.ndarray | None] | np.ndarray,
        offset: float = 0.0,
        name: str = "video in memory",
    ):
        """Check that times and images fit.

        Args:
            times: (F,) seconds, ascending.
            images: F images, (H, W, 3) BGR or (H, W) grey, uint8; None where there is none.
            offset: seconds to add to the times to get marker time.
            name: for messages.

        Raises:
            InputError: no image, counts or shapes that differ, times that do not ascend.
        """
        self.name, self.images = name, images
        self.times = np.asarray(times, float) + offset
        shapes = {image.shape[:2] for image in images if image is not None}
        if len(images) != len(self.times) or len(shapes) != 1:
            raise InputError(
                name,
                f"found {len(images)} images of sizes {sorted(shapes)} for {len(self.times)} "
                "times, expected one image of the same size for each",
            )
        check_times(name, self.times, "frame")
        height, width = shapes.pop()
        self.size = (width, height)

    def frames(self, luma: bool = False) -> Iterator[TimedImage]:
        """See ``FrameSource.frames``."""
        import cv2

        for time, image in zip(self.times, self.images, strict=True):
            if image is not None and (image.ndim == 2) != luma:
                image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY if luma else cv2.COLOR_GRAY2BGR)
            yield float(time), image


def open_video(source: VideoSource) -> FrameSource:
    """The frames of a recording's video, in marker time."""
    if source.frames is not None:
        return MemoryVideo(*source.frames, offset=source.offset, name=source.camera_name)
    if source.path is None:
        raise InputError(source.camera_name, "the video has neither a file nor frames")
    return Video(source.path, source.offset)


def check_size(
    size: Sequence[int], calibrated: Any, path: str | Path, what: str = "video"
) -> str | None:
    """A warning where a video's or photograph's width and height are not as calibrated, or None.

    A few columns or rows off, it is taken as cropped on the right or at the bottom, and never
    rescaled: its pixels keep their places. InputError beyond 2 % in width or height.
    """
    expected = np.asarray(calibrated, float)
    if (np.array(size) == expected).all():
        return None
    difference = (
        f"the {what} is {size[0]} × {size[1]}, its calibration {expected[0]:g} × {expected[1]:g}"
    )
    if (np.abs(size - expected) > SIZE_TOLERANCE * expected).any():
        raise InputError(path, f"{difference} pixels, expected at most 2 % of difference")
    taken = "taken as cropped on the right and at the bottom, not rescaled"
    return f"{path}: {difference} pixels; {taken}"


def _packets(container: InputContainer, stream: VideoStream) -> Iterator[Packet]:
    """Packets up to the file's end, or to where it is cut off, and the one that flushes."""
    packets = container.demux(stream)
    while True:
        try:
            yield next(packets)
        except StopIteration:
            return
        except (FFmpegError, OSError):
            flush = Packet()
            flush.stream = stream
            yield flush
            return


def _frame_index(stamps: np.ndarray, stamp: int | None) -> int:
    """Where a stamp is among ascending ones; -1 where it is not."""
    i = -1 if stamp is None else int(np.searchsorted(stamps, stamp))
    return i if 0 <= i < len(stamps) and stamps[i] == stamp else -1
