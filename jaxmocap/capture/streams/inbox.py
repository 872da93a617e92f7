"""What has come in and waits for the tracker: never much, and the newest wins.

INPUTS: samples and frames, from any thread. OUTPUTS: the next of them, to one thread.
"""

from collections import deque
from threading import Condition
from typing import NamedTuple

import numpy as np

from jaxmocap.capture.streams.sample_assembly import Sample


class Frame(NamedTuple):
    """One camera's image.

    Attributes:
        camera: its index.
        time: when it was exposed, seconds.
        image: (H, W, 3) BGR or (H, W), uint8.
        arrived: when it came in, seconds on the same clock.
    """

    camera: int
    time: float
    image: np.ndarray
    arrived: float


class Inbox:
    """Some samples and one frame of each camera.

    Attributes:
        dropped_samples: that newer ones pushed out.
        dropped_frames: likewise.
    """

    def __init__(self, most_samples: int, keep_turns: bool = True):
        """Begin empty.

        Args:
            most_samples: that may wait.
            keep_turns: a frame that replaces another has its turn, so that frames are looked at
                however many samples come; else things are given out in the order in which they
                came in, which smoothing needs.
        """
        self._samples: deque[Sample] = deque()
        self._most, self._keep_turns = most_samples, keep_turns
        self._frames: dict[int, Frame] = {}
        # Since when a camera's frames wait: the turn of one that is replaced is kept.
        self._since: dict[int, float] = {}
        self._something = Condition()
        self.dropped_samples = self.dropped_frames = 0

    def put_sample(self, sample: Sample) -> None:
        """Add a sample; the oldest makes room."""
        with self._something:
            self._samples.append(sample)
            if len(self._samples) > self._most:
                self._samples.popleft()
                self.dropped_samples += 1
            self._something.notify()

    def put_frame(self, frame: Frame) -> None:
        """Add a frame in place of an older one of its camera."""
        with self._something:
            self.dropped_frames += frame.camera in self._frames
            self._frames[frame.camera] = frame
            if not self._keep_turns or frame.camera not in self._since:
                self._since[frame.camera] = frame.arrived
            self._something.notify()

    def take(self, timeout: float) -> Sample | list[Frame] | None:
        """The next sample, or all frames where they came first; None after so many seconds."""
        with self._something:
            if not self._samples and not self._frames:
                self._something.wait(timeout)
            first = min(self._since.values(), default=np.inf)
            if self._samples and self._samples[0].arrived <= first:
                return self._samples.popleft()
            if not self._frames:
                return None
            frames, self._frames, self._since = list(self._frames.values()), {}, {}
            return frames
