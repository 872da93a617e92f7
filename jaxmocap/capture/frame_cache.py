"""A video's frames, decoded and shrunk once, where they are gone through again and again.

INPUTS: a video. OUTPUTS: the same with smaller frames.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from jaxmocap.capture.video import FrameSource, TimedImage
from jaxmocap.images.foreground import shrink, shrunk_size

# All videos of a recording together; of longer ones the frames are decoded each time.
MAX_BYTES = 2**29


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
    return [CachedFrames(video, rows, MAX_BYTES // len(videos)) for video in videos]
