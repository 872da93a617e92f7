"""The videos of a recording, opened, checked and read forward, the next frame decoded ahead.

INPUTS: a Recording. OUTPUTS: frame sources and warnings; images by their index; the same with
smaller frames, kept where they are gone through again and again.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np

from jaxmocap.capture.checks.cameras import check_recording
from jaxmocap.capture.timeline import check_overlap
from jaxmocap.capture.video import FrameSource, TimedImage, check_size, open_video
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.images.foreground import shrink, shrunk_size


def open_footage(recording: Recording) -> tuple[list[FrameSource], tuple[str, ...]]:
    """Every video of a recording, and warnings about the recording.

    InputError for what is not a video, does not fit its calibration, or shares no time with the
    markers; or a recording that cannot be what its file says (see ``capture.checks``).
    """
    videos, warnings = open_unchecked(recording)
    where = recording.path or recording.name
    findings = check_recording(recording, [video.times for video in videos])
    if findings and findings[0].fatal:
        raise recording.error(findings[0].sentence)
    return videos, (*warnings, *(f"{where}: {finding.sentence}" for finding in findings))


def open_unchecked(recording: Recording) -> tuple[list[FrameSource], tuple[str, ...]]:
    """The same, the recording itself unchecked."""
    videos, warnings = [], list(recording.warnings)
    for source in recording.videos:
        video = open_video(source)
        warning = check_size(video.size, source.camera.size, video.name)
        check_overlap(recording.times, video.times, video.name)
        videos.append(video)
        warnings += [warning] if warning else []
    return videos, tuple(warnings)


# All videos of a recording together; of longer ones the frames are decoded each time.
MAX_CACHED_BYTES = 2**29


class ForwardReader:
    """One video, asked for frames in rising order; while one is used the next is decoded."""

    def __init__(self, video: FrameSource, worker: Executor, colour: bool = False):
        self._frames, self._worker = video.frames(luma=not colour), worker
        self._index, self._image = -1, None
        self._next_frame = worker.submit(next, self._frames, None)

    def at(self, index: int) -> np.ndarray | None:
        """A frame (H, W), or (H, W, 3) BGR, uint8; None where there is none or for index -1."""
        if index < 0:
            return None
        while self._index < index:
            frame = self._next_frame.result()
            if frame is None:
                return None
            self._index, self._image = self._index + 1, frame[1]
            self._next_frame = self._worker.submit(next, self._frames, None)
        return self._image


@contextmanager
def forward_readers(
    videos: Sequence[FrameSource], colour: bool = False
) -> Iterator[list[ForwardReader]]:
    """Readers of the videos, grey or in colour, each with a thread that decodes one frame ahead."""
    with ThreadPoolExecutor(max(1, len(videos))) as workers:
        yield [ForwardReader(video, workers, colour) for video in videos]


class CachedFrames(FrameSource):
    """A video whose frames have at most so many rows, kept in memory if they fit there.

    Its ``size`` is still that of the full frames.
    """

    def __init__(self, video: FrameSource, rows: int, most_bytes: int):
        """Of a video; nothing is decoded yet."""
        self.name, self.times, self.size = video.name, video.times, video.size
        self._video, self._rows = video, rows
        self._cache: list[TimedImage] | None = None
        width, height = shrunk_size(video.size, rows)
        self._fits = 3 * width * height * len(video) <= most_bytes

    def frames(self, luma: bool = False) -> Iterator[TimedImage]:
        """See ``FrameSource.frames``; grey ones are as they were."""
        if luma:
            return self._video.frames(luma)
        if not self._fits:
            return self._shrunk()
        if self._cache is None:
            self._cache = list(self._shrunk())
        return iter(self._cache)

    def _shrunk(self) -> Iterator[TimedImage]:
        for time, image in self._video.frames():
            yield time, None if image is None else shrink(np.atleast_3d(image), self._rows)


def cached_frames(videos: Sequence[FrameSource], rows: int) -> list[FrameSource]:
    """All videos of a recording, kept together as far as memory allows."""
    return [CachedFrames(video, rows, MAX_CACHED_BYTES // len(videos)) for video in videos]
