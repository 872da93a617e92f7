"""How many video frames are tracked, where there is not the time for all of them.

Markers must not wait: a pose is owed for each of their samples, and a frame only makes it better.

INPUTS: seconds worked and passed. OUTPUTS: whether the next frame is due.
"""

import math

# Share of the time that tracking may take, so that the threads that receive find some as well.
MOST_BUSY = 0.85
# Seconds of work beyond that share with which no frame is taken: about what one takes. More than so
# many times that is forgotten, as after a second of compiling.
MOST_BEHIND_S, FORGOTTEN = 0.03, 4
# Seconds after which a frame is taken all the same.
LONGEST_WAIT_S = 0.1


class FramePace:
    """Seconds of work that were taken beyond ``MOST_BUSY`` of those that passed."""

    def __init__(self) -> None:
        self._behind, self._last_frame = 0.0, -math.inf

    def count_work(self, worked: float, passed: float) -> None:
        """Count seconds of work among so many that passed."""
        behind = self._behind + worked - MOST_BUSY * passed
        self._behind = min(max(behind, 0.0), FORGOTTEN * MOST_BEHIND_S)

    def took_frame(self, now: float) -> None:
        """Count a frame, taken at that second."""
        self._last_frame = now

    def is_due(self, now: float) -> bool:
        """Whether a frame is to be taken at that second."""
        return self._behind < MOST_BEHIND_S or now - self._last_frame >= LONGEST_WAIT_S
