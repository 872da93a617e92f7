"""A sender's clock, estimated from when its packets arrive.

INPUTS: arrivals on this machine's clock, the sender's stamps. OUTPUTS: times on this machine's
clock that hold the sender's rhythm, not the network's.
"""

import math

# A step of the sender's clock is no network's delay, seconds.
JUMP_S = 0.25
# What a network or a busy machine has held up comes in together, within so many seconds.
HELD_UP_S = 0.25
# So many seconds a second the clocks may drift apart.
MAX_DRIFT = 2e-4
# Packets that come so much later were not sent together, seconds.
SEPARATE_S = 0.005
# Stamps beyond (seconds since 1900 are 4e9) are too coarse for a rhythm.
LARGEST_STAMP_S = 1e10


class StreamClock:
    """One sender.

    Attributes:
        jumps: how often its clock was set.
    """

    def __init__(self):
        self.jumps = 0
        self._offset: float | None = None
        self._stamp = self._arrival = 0.0
        self._late_since = math.inf

    def time(self, arrival: float, stamp: float | None) -> float:
        """When a packet was sent, never after it arrived.

        The packet that was under way the shortest, of late, determines the clocks' offset.

        Args:
            arrival: seconds.
            stamp: seconds on the sender's clock; None where it has none.
        """
        if stamp is None or not abs(stamp) <= LARGEST_STAMP_S:
            return arrival
        offset = arrival - stamp
        if self._offset is None:
            self._offset, self._stamp, self._arrival = offset, stamp, arrival
        late, stamp_step = offset - self._offset, stamp - self._stamp
        is_stopped = stamp_step <= 0 and arrival - self._arrival > SEPARATE_S
        self._stamp, self._arrival = stamp, arrival
        self._late_since = min(self._late_since, arrival) if late > JUMP_S else math.inf
        is_held_up = stamp_step >= 0 and arrival - self._late_since <= HELD_UP_S
        if late < -JUMP_S or (late > JUMP_S and not is_held_up):
            self.jumps += 1
            self._offset, self._late_since = offset, math.inf
        elif is_stopped:
            # A clock that does not run has no rhythm.
            self._offset = offset
            return arrival
        self._offset = min(offset, self._offset + MAX_DRIFT * max(stamp_step, 0.0))
        return min(stamp + self._offset, arrival)
