"""Cameras that are on: a device, a network stream, or a file at its own pace.

INPUTS: [[video]] of a live file. OUTPUTS: LiveFrames, the newest, from a thread of its own; what
became of it.
"""

import math
import re
import subprocess
from collections.abc import Callable, Generator
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from time import monotonic
from typing import IO, Any

import numpy as np
from av.error import FFmpegError

from jaxmocap.capture import decoding
from jaxmocap.capture.decoding import TIMEOUT_S
from jaxmocap.capture.streams.inbox import LiveFrame
from jaxmocap.capture.streams.source import Listener
from jaxmocap.capture.video import Video
from jaxmocap.formats.cameras.video_sources import read_video_tables
from jaxmocap.formats.files.errors import InputError, short_repr
from jaxmocap.formats.files.reading import reader_process
from jaxmocap.formats.files.toml import TomlTable
from jaxmocap.geometry.cameras import SIZE_TOLERANCE, Camera

Images = Generator[np.ndarray, None, None]
# A camera that went away is asked for again after so many seconds.
RETRY_S = 0.5
# What a pipe holds, where the system lets it: an image has megabytes.
PIPE_BYTES = 2**20
# Of a sentence about what went wrong.
MAX_REASON_BYTES = 500

# More than any live run has; compiling takes as long as there are cameras.
MAX_CAMERAS = 16
# No camera is slower, seconds.
MAX_DELAY_S = 60.0
# Devices are counted from 0.
MAX_DEVICE = 999
# The address of a stream; a file has a field of its own.
_URL = re.compile(r"(?!file:)[a-z][a-z0-9+.-]*://[!-~]+", re.IGNORECASE)


@dataclass(frozen=True)
class LiveVideo:
    """One camera that is on."""

    camera_name: str  # its section in the calibration
    camera: Camera  # its calibration
    source: int | Path | str  # index of a device, path of a file, or address of a network stream
    # Seconds to add to a frame's arrival to get when it was exposed, on the markers' clock;
    # negative by the camera's delay.
    offset: float = 0.0


class LiveCamera(Listener):
    """One camera and its thread.

    Attributes:
        name: of the camera.
        last_arrival: when a frame came in last, ``monotonic`` seconds; None before.
        status: "waiting", "on", "gone" (it is asked for again) or "ended".
        problem: why it is not used, or None.
        reason: why nothing came in when it was last asked for, or None.
        frames: that came in.
    """

    def __init__(
        self,
        video: LiveVideo,
        index: int,
        on_frame: Callable[[LiveFrame], None],
        colour: bool,
        now: Callable[[], float] = monotonic,
    ):
        """Prepare one of the cameras; InputError for no video, or no such device."""
        super().__init__(f"camera {index}", TIMEOUT_S + 1.0)
        self.name, self.status = video.camera_name, "waiting"
        self.last_arrival, self.problem = None, None
        self.frames, self.reason = 0, None
        self._video, self._index, self._on_frame, self._now = video, index, on_frame, now
        self._is_retried = not isinstance(video.source, Path)
        self._open = _opener(video, colour, self._stop)

    def _listen(self) -> None:
        while not self._stop.is_set():
            try:
                # Closed here, whatever ends it: a device is let go, a stream hung up.
                with closing(self._open()) as images:
                    for image in images:
                        if self._stop.is_set() or not self._fits(image):
                            return
                        arrived = self._now()
                        self.last_arrival, self.status, self.reason = arrived, "on", None
                        self.frames += 1
                        exposed = arrived + self._video.offset
                        self._on_frame(LiveFrame(self._index, exposed, image, arrived))
            except (FFmpegError, OSError, InputError) as error:
                # A camera that is away is asked for again.
                reason = error.strerror if isinstance(error, OSError) else None
                reason = error.problem if isinstance(error, InputError) else reason
                self.reason = reason or type(error).__name__
            if self.frames:
                self.status = "gone" if self._is_retried else "ended"
            if not self._is_retried:
                return
            self._stop.wait(RETRY_S)

    def _fits(self, image: np.ndarray) -> bool:
        """Whether an image can be of the camera that was calibrated."""
        expected = np.asarray(self._video.camera.size, float)
        height, width = image.shape[:2]
        if (np.abs(np.array([width, height]) - expected) > SIZE_TOLERANCE * expected).any():
            expected = " × ".join(f"{side:g}" for side in expected)
            self.problem = f"images of {width} × {height} pixels, calibrated for {expected}"
            self.status = "ended"
        return self.problem is None


def _opener(video: LiveVideo, colour: bool, stop: Event) -> Callable[[], Images]:
    """What begins to look."""
    if isinstance(video.source, Path):
        file = Video(video.source)
        return lambda: paced_frames(file, colour, stop)
    if isinstance(video.source, str):
        url, most = video.source, max_pixels(video.camera.size)
        return lambda: stream_frames(url, colour, most)
    device, size = video.source, np.asarray(video.camera.size, int).tolist()
    opened = [device_frames(device, size, colour)]
    return lambda: opened.pop() if opened else device_frames(device, size, colour)


def max_pixels(size: Any) -> int:
    """Of an image that a camera of this calibrated size may send; a larger one is not decoded."""
    width, height = np.asarray(size, float).tolist()
    # Decoders work on whole blocks.
    sides = ((1 + SIZE_TOLERANCE) * side + 128 for side in (width, height))
    return round(math.prod(sides))


def paced_frames(video: Video, colour: bool, stop: Event) -> Images:
    """A file's frames, each at its time since the first."""
    began = monotonic() - video.times[0]
    for time, image in video.frames(luma=not colour):
        stop.wait(max(began + time - monotonic(), 0.0))
        if stop.is_set():
            return
        if image is not None:
            yield image


def stream_frames(url: str, colour: bool, max_pixels: int) -> Images:
    """Frames of at most so many pixels of a network stream, as they come, until it ends.

    A process of its own decodes them, within limits of memory and time. InputError where it cannot
    be had, has no video that is decoded, or its process has ended.
    """
    import cv2

    arguments = url, "colour" if colour else "grey", str(max_pixels)
    command, alone = reader_process(decoding.__file__, *arguments)
    nowhere = subprocess.DEVNULL
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=nowhere, env=alone) as process:
        assert process.stdout is not None
        try:
            _widen(process.stdout)
            while len(header := process.stdout.read(decoding.HEADER.size)) == decoding.HEADER.size:
                height, width, layout = decoding.HEADER.unpack(header)
                if not height:
                    if reason := process.stdout.read(MAX_REASON_BYTES).decode(errors="replace"):
                        raise InputError(short_repr(url), reason)
                    return
                # Whoever has sent may write here by now.
                if layout not in decoding.SHAPES or not 0 < height * width <= max_pixels:
                    break
                if layout == decoding.PLANES and (height % 2 or width % 2):
                    break
                rows, channels = decoding.SHAPES[layout]
                shape = round(rows * height), width, *channels
                content = process.stdout.read(math.prod(shape))
                if len(content) < math.prod(shape):
                    break
                image = np.frombuffer(content, np.uint8).reshape(shape)
                has_planes = layout == decoding.PLANES
                yield cv2.cvtColor(image, cv2.COLOR_YUV2BGR_I420) if has_planes else image
            raise InputError(short_repr(url), "the process that decodes it has ended")
        finally:
            process.kill()


def _widen(pipe: IO[bytes]) -> None:
    """Let a pipe hold ``PIPE_BYTES``; it stays as it is where the system does not let it."""
    with suppress(ImportError, AttributeError, OSError):
        import fcntl

        fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, PIPE_BYTES)


def device_frames(device: int, size: list[int], colour: bool) -> Images:
    """Frames of a device, asked for in its calibration's size; InputError without such a camera."""
    import cv2

    capture = cv2.VideoCapture(device)
    if not capture.isOpened():
        raise InputError(f"camera {device}", "no such device, or another program has it")
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
    return _grab_frame(capture, colour)


def _grab_frame(capture: Any, colour: bool) -> Images:
    import cv2

    try:
        while True:
            there, image = capture.read()
            if not there:
                return
            if image.ndim == 2:
                yield cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if colour else image
            else:
                yield image if colour else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    except cv2.error:
        raise InputError("camera", "its driver has failed") from None
    finally:
        capture.release()


def read_live_videos(top: TomlTable) -> tuple[Path | None, tuple[LiveVideo, ...]]:
    """The calibration file and the cameras; InputError where a field does not fit."""
    keys = ("device", "file", "url", "camera", "offset")
    file, tables = read_video_tables(top, keys, MAX_CAMERAS)
    videos = []
    for fields, name, camera in tables:
        offset = fields.number("offset", 0.0, -MAX_DELAY_S, MAX_DELAY_S)
        videos.append(LiveVideo(name, camera, _camera_source(fields), offset))
    return file, tuple(videos)


def _camera_source(fields: TomlTable) -> int | Path | str:
    """A device's number, a file, or the address of a stream."""
    stated = fields.only_one("device", "file", "url")
    if stated == "device":
        return fields.integer("device", 0, MAX_DEVICE)
    if stated == "file":
        return fields.file("file")
    url = fields.text("url")
    if not _URL.fullmatch(url):
        problem = f"found {short_repr(url)}, expected an address such as rtsp://..."
        raise fields.error("url", problem)
    return url
