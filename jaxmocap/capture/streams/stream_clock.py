"""A sender's clock, estimated from when its packets arrive.

INPUTS: arrivals on this machine's clock, the sender's stamps. OUTPUTS: times on this machine's
clock that hold the sender's rhythm, not the network's.
"""

import math

# A step of the sender's clock is no network's delay, seconds.
JUMP_S = 0.25
# What a network has held up comes in together, within so many seconds.
HELD_UP_S = 0.25
# So many seconds a second the clocks may drift apart.
MAX_DRIFT = 2e-4
# Packets that come so much later were not sent together, seconds.
SEPARATE_S = 0.005
# How fast a clock runs is measured over so many seconds, so many times in a row;
RATE_WINDOW_S = 2.0
RATE_WINDOWS = 3
# it is wrong by such a factor and more. No network's delay makes as much of a window.
WRONG_RATE = 1.25
# A clock that is as slow as that stands.
SLOWEST_RATE = 0.01
# Stamps beyond (seconds since 1900 are 4e9) are too coarse for a rhythm.
LARGEST_STAMP_S = 1e10


class StreamClock:
    """One sender.

    Attributes:
        jumps: how often its clock was set.
        rate: its seconds in each of ours, where it runs too fast or too slowly; else None.
    """

    def __init__(self):
        self.jumps = 0
        self.rate: float | None = None
        # Stamp and arrival where a window began, and the rates of those before, all of them wrong.
        self._window: tuple[float, float] | None = None
        self._wrong_rates: list[float] = []
        self._offset: float | None = None
        # Whether a packet that was read promptly agrees with the offset.
        self._is_sure = False
        self._stamp = self._arrival = 0.0
        self._late_since = math.inf

    def time(self, arrival: float, stamp: float | None, is_prompt: bool = True) -> float:
        """When a packet was sent, never after it arrived.

        The packet that was under way the shortest, of late, determines the clocks' offset. What was
        not read promptly was held up here, for however long: it says nothing about its clock but
        where that goes back.

        Args:
            arrival: seconds; when it was read.
            stamp: seconds on the sender's clock; None where it has none.
            is_prompt: no other packet of this sender waited to be read after it.
        """
        if stamp is None or not abs(stamp) <= LARGEST_STAMP_S:
            return arrival
        if is_prompt:
            self._measure_rate(arrival, stamp)
        offset = arrival - stamp
        if self.rate is not None:
            # Neither a rhythm nor a clock that was set.
            self._offset = None
            return arrival
        if self._offset is None:
            self._offset, self._stamp, self._arrival = offset, stamp, arrival
        late, stamp_step = offset - self._offset, stamp - self._stamp
        is_stopped = stamp_step <= 0 and arrival - self._arrival > SEPARATE_S
        self._stamp, self._arrival = stamp, arrival
        if late <= JUMP_S:
            self._late_since = math.inf
        elif is_prompt:
            self._late_since = min(self._late_since, arrival)
        lasts = is_prompt and arrival - self._late_since > HELD_UP_S
        # Networks change the order of packets that are close together.
        is_set = late < -JUMP_S or (late > JUMP_S and (lasts or stamp_step < -JUMP_S))
        if is_set:
            # An offset of packets that were held up was too large from the start.
            self.jumps += self._is_sure or late > JUMP_S
            self._offset, self._late_since = offset, math.inf
        self._is_sure = is_prompt if is_set else self._is_sure or (is_prompt and late <= JUMP_S)
        if is_stopped and not is_set:
            # A clock that does not run has no rhythm.
            self._offset = offset
            return arrival
        self._offset = min(offset, self._offset + MAX_DRIFT * max(stamp_step, 0.0))
        return min(stamp + self._offset, arrival)

    def _measure_rate(self, arrival: float, stamp: float) -> None:
        """Compare the clocks, window by window."""
        if self._window is None:
            self._window = stamp, arrival
        if (elapsed := arrival - self._window[1]) < RATE_WINDOW_S:
            return
        rate = (stamp - self._window[0]) / elapsed
        self._window = stamp, arrival
        is_wrong = rate > WRONG_RATE or SLOWEST_RATE < rate < 1 / WRONG_RATE
        wrong = [*self._wrong_rates, rate][-RATE_WINDOWS:] if is_wrong else []
        # A clock that is set makes one window wrong, or two that differ.
        is_steady = len(wrong) == RATE_WINDOWS and max(wrong) < WRONG_RATE * min(wrong)
        self._wrong_rates, self.rate = wrong, rate if is_steady else None
