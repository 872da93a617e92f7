"""A sender's clock, estimated from when its packets arrive.

INPUTS: arrivals on this machine's clock, the sender's stamps. OUTPUTS: times on this machine's
clock that hold the sender's rhythm, not the network's.
"""

# A step of the sender's clock is no network's delay, seconds.
JUMP_S = 0.25
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
        stamp_step = 0.0 if self._offset is None else stamp - self._stamp
        is_stopped = stamp_step <= 0 and arrival - self._arrival > SEPARATE_S
        self._stamp, self._arrival = stamp, arrival
        if self._offset is None:
            self._offset = offset
        elif abs(offset - self._offset) > JUMP_S:
            self.jumps += 1
            self._offset = offset
        elif is_stopped:
            # A clock that does not run has no rhythm.
            return arrival
        self._offset = min(offset, self._offset + MAX_DRIFT * max(stamp_step, 0.0))
        return min(stamp + self._offset, arrival)
