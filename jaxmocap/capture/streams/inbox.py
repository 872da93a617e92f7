"""What has come in and waits for the tracker: never much, and the newest wins.

INPUTS: samples and frames, from any thread. OUTPUTS: the next of them, to one thread.
"""

from collections import deque
from threading import Condition
from typing import NamedTuple

import numpy as np

from jaxmocap.capture.streams.sample_assembly import MarkerSample


class LiveFrame(NamedTuple):
    """One camera's image."""

    camera: int  # its index
    time: float  # when it was exposed, seconds
    image: np.ndarray  # (H, W, 3) BGR or (H, W), uint8
    arrived: float  # when it came in, seconds on the same clock


class Inbox:
    """Some samples and one frame of each camera.

    Attributes:
        dropped_samples: that newer ones pushed out.
        dropped_frames: likewise.
    """

    def __init__(self, max_samples: int, keep_turns: bool = True):
        """Begin empty.

        Args:
            max_samples: that may wait.
            keep_turns: a frame that replaces another keeps its place in the queue; else things are
                given out in the order in which they came in, which smoothing needs, and a frame is
                replaced only once its turn has come. Either way frames are taken however many
                samples come.
        """
        self._samples: deque[MarkerSample] = deque()
        self._max_samples, self._keep_turns = max_samples, keep_turns
        self._frames: dict[int, LiveFrame] = {}
        # Since when a camera's frames wait: the turn of one that is replaced is kept.
        self._since: dict[int, float] = {}
        self._changed = Condition()
        self.dropped_samples = self.dropped_frames = 0

    def put_sample(self, sample: MarkerSample) -> None:
        """Add a sample; the oldest makes room."""
        with self._changed:
            self._samples.append(sample)
            if len(self._samples) > self._max_samples:
                self._samples.popleft()
                self.dropped_samples += 1
            self._changed.notify()

    def put_frame(self, frame: LiveFrame) -> None:
        """Add a frame in place of an older one of its camera, or not where that one must wait."""
        with self._changed:
            since = self._since.get(frame.camera)
            self.dropped_frames += since is not None
            must_wait = since is not None and self._samples and self._samples[0].arrived <= since
            if not self._keep_turns and must_wait:
                return
            self._frames[frame.camera] = frame
            if not self._keep_turns or since is None:
                self._since[frame.camera] = frame.arrived
            self._changed.notify()

    def take(
        self, timeout: float, with_frames: bool = True
    ) -> MarkerSample | list[LiveFrame] | None:
        """The next sample, or all frames where they came first; None after so many seconds.

        Frames wait, and newer ones take their place, while they are not asked for.
        """
        with self._changed:
            if not self._samples and not (with_frames and self._frames):
                self._changed.wait(timeout)
            first = min(self._since.values(), default=np.inf) if with_frames else np.inf
            if self._samples and self._samples[0].arrived <= first:
                return self._samples.popleft()
            if not (with_frames and self._frames):
                return None
            frames, self._frames, self._since = list(self._frames.values()), {}, {}
            return frames
