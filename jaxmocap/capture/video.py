"""Video: frames with their times, from a file or from memory.

INPUTS: a video file, or times and images; seconds to add to video time to get marker time.
OUTPUTS: frame times in seconds of marker time, known without decoding, and the frames themselves,
None where one cannot be decoded.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError
from av.packet import Packet
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from jaxmocap.capture.markers import median_interval
from jaxmocap.formats.errors import InputError
from jaxmocap.formats.recording import VideoSource
from jaxmocap.formats.tables import Places, check_times
from jaxmocap.geometry.cameras import Camera

Frame = tuple[float, np.ndarray | None]
# A video that differs more than this from its calibration was not taken with it.
SIZE_TOLERANCE = 0.02


class FrameSource(ABC):
    """F frames over time. It can be gone through any number of times.

    Attributes:
        name: the file, or a name where there is none.
        times: (F,) seconds of marker time, ascending.
        size: width and height in pixels.
    """

    name: str
    times: np.ndarray
    size: tuple[int, int]

    @abstractmethod
    def frames(self, luma: bool = False) -> Iterator[Frame]:
        """Go through all F frames.

        Args:
            luma: grey images instead of colour.

        Yields:
            Time, and an image (H, W, 3) BGR uint8 or with ``luma`` (H, W) uint8; None where the
            frame cannot be decoded.
        """

    def __iter__(self) -> Iterator[Frame]:
        return self.frames()

    def __len__(self) -> int:
        return len(self.times)

    @property
    def fps(self) -> float:
        """Frames per second, by the median interval; 0 for a single frame."""
        interval = median_interval(self.times)
        return 1 / interval if interval else 0.0

    @property
    def duration(self) -> float:
        """Seconds from the first frame to the end of the last."""
        return float(self.times[-1] - self.times[0]) + median_interval(self.times)


class Video(FrameSource):
    """A video file."""

    def __init__(self, path: str | Path, offset: float = 0.0):
        """Look through the file's packets for the times, and decode until there is one image.

        Args:
            path: of any file that FFmpeg reads.
            offset: seconds to add to video time to get marker time.

        Raises:
            InputError: no such file, not a video, or no frame in it can be decoded.
        """
        self.name, self.path = str(path), Path(path)
        if not self.path.is_file():
            raise InputError(path, "no such file")
        stamps, seconds = self._scan()
        self._index = None if stamps is None else {stamp: i for i, stamp in enumerate(stamps)}
        self.times = seconds + offset
        height, width = self._first_image().shape
        self.size = (width, height)

    def _open(self) -> InputContainer:
        try:
            container = av.open(str(self.path), metadata_errors="replace")
        except (FFmpegError, OSError):
            raise InputError(self.path, "is not a video") from None
        if not container.streams.video:
            container.close()
            raise InputError(self.path, "is not a video, it has no video stream")
        return container

    def _scan(self) -> tuple[list[int] | None, np.ndarray]:
        """Presentation stamps of all frames in order, and seconds since the stream's start."""
        with self._open() as container:
            stream = container.streams.video[0]
            packets = [p for p in _packets(container, stream) if p.size and not p.is_discard]
            found = {packet.pts for packet in packets if packet.pts is not None}
            if any(packet.pts is None for packet in packets):
                # Without stamps the frames follow one another at the stream's rate.
                rate = stream.average_rate or stream.guessed_rate or Fraction(30)
                return None, np.arange(len(packets)) / float(rate)
            stamps = sorted(found)
            start = stream.start_time if stream.start_time is not None else min(found, default=0)
            return stamps, (np.array(stamps) - start) * float(stream.time_base or 1)

    def _first_image(self) -> np.ndarray:
        for _, image in self.frames(luma=True):
            if image is not None:
                return image
        raise InputError(self.path, "is not a video, none of its frames can be decoded")

    def frames(self, luma: bool = False) -> Iterator[Frame]:
        """See ``FrameSource.frames``. The end of a truncated file yields None."""
        done = 0
        for i, frame in self._decoded():
            if i < done:
                continue
            for missing in range(done, i):
                yield float(self.times[missing]), None
            done = i + 1
            yield float(self.times[i]), None if frame.is_corrupt else image_of(frame, luma)
        for missing in range(done, len(self.times)):
            yield float(self.times[missing]), None

    def _decoded(self) -> Iterator[tuple[int, VideoFrame]]:
        """Index and frame of all that can be decoded; a broken packet costs only its frames."""
        with self._open() as container:
            stream = container.streams.video[0]
            stream.thread_type = "AUTO"
            count = 0
            for packet in _packets(container, stream):
                try:
                    frames = packet.decode()
                except (FFmpegError, OSError):
                    continue
                for frame in frames:
                    i = count if self._index is None else self._index.get(frame.pts, -1)
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
        check_times(name, self.times, Places("frame"))
        height, width = shapes.pop()
        self.size = (width, height)

    def frames(self, luma: bool = False) -> Iterator[Frame]:
        """See ``FrameSource.frames``."""
        import cv2

        for time, image in zip(self.times, self.images, strict=True):
            if image is None:
                yield float(time), None
            elif luma:
                yield (
                    float(time),
                    image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY),
                )
            else:
                yield (
                    float(time),
                    image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR),
                )


def open_video(source: VideoSource) -> FrameSource:
    """The frames of a recording's video, in marker time."""
    if source.frames is not None:
        return MemoryVideo(*source.frames, offset=source.offset, name=source.camera_name)
    if source.path is None:
        raise InputError(source.camera_name, "the video has neither a file nor frames")
    return Video(source.path, source.offset)


def check_size(video: FrameSource, camera: Camera, path: str | Path) -> str | None:
    """Does a video fit its camera's calibration?

    A video a few columns or rows off is taken as cropped on the right or at the bottom, and never
    rescaled: its pixels keep their places.

    Args:
        video: the frames.
        camera: the calibration.
        path: of the video, for messages.

    Returns:
        A sentence of warning, or None where the sizes agree.

    Raises:
        InputError: more than 2 % off in width or height.
    """
    size, expected = np.array(video.size), np.asarray(camera.size, float)
    if (size == expected).all():
        return None
    found = f"the video is {size[0]} × {size[1]}, its calibration {expected[0]:g} × {expected[1]:g}"
    if (np.abs(size - expected) > SIZE_TOLERANCE * expected).any():
        raise InputError(path, f"{found} pixels, expected at most 2 % of difference")
    return f"{path}: {found} pixels; taken as cropped on the right and at the bottom, not rescaled"


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


def image_of(frame: VideoFrame, luma: bool) -> np.ndarray:
    """A frame as BGR or grey array, upright as its file says that it shall be shown."""
    if luma and frame.format.name in ("yuv420p", "yuvj420p", "nv12", "gray"):
        plane = frame.planes[0]
        # A plane is a buffer, which its type stubs do not say.
        rows = np.frombuffer(memoryview(plane), np.uint8)  # type: ignore[arg-type]
        image = rows.reshape(-1, plane.line_size)[: frame.height, : frame.width]
    else:
        image = frame.to_ndarray(format="gray" if luma else "bgr24")
    turned = np.rot90(image, round(frame.rotation / 90))
    return np.array(turned, order="C")
