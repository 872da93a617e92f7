"""Corrections that fade in: a track that changes its mind does not jump.

Each new solve moves what lies behind a little. What was given out cannot be moved any more, so the
difference to it is carried on and dies out as a critically damped spring does. With its speed no
solve begins with a jerk; but that of poses which later video frames still correct threw heads off
by 45 degrees. Where the solves agree nothing is added: a motion that is tracked right is not
delayed.

INPUTS: corrections, times. OUTPUTS: what is left of them.
"""

from typing import NamedTuple

import numpy as np


class Fading(NamedTuple):
    """What is left of earlier corrections."""

    offset: np.ndarray  # (N,) to be added to the track
    rate: np.ndarray  # (N,) its change per second
    time: float  # () seconds

    def correct(self, offset: np.ndarray, rate: np.ndarray | float = 0.0) -> "Fading":
        """With a track that from now on lies by ``offset`` behind the last one, more at a rate."""
        return self._replace(offset=self.offset + offset, rate=self.rate + rate)

    def at(self, time: float, fade: float) -> "Fading":
        """What is left at a later time, with the time constant ``fade``, seconds."""
        elapsed = time - self.time
        pull = self.rate + self.offset / fade
        left = np.exp(-elapsed / fade)
        offset = (self.offset + pull * elapsed) * left
        return Fading(offset, (self.rate - pull * elapsed / fade) * left, time)
