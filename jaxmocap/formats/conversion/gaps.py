"""Gaps: spans of time in which a recording holds nothing.

INPUTS: times of samples; an Armature. OUTPUTS: which intervals are gaps; the armature with its
poses held across them.

A gap is no motion: nothing is drawn through it. Where a format must say something, the last pose
before it is held, and the first one after it follows at once.
"""

from dataclasses import replace

import numpy as np

from jaxmocap.formats.armatures.armature import Armature

# Seconds: a hand moves by half a metre in less, so that a straight line would show another motion.
LONGEST_BRIDGED_S = 0.5
# Slow recordings are bridged over so many of their own intervals.
MAX_INTERVALS_BRIDGED = 5


def is_gap(times: np.ndarray) -> np.ndarray:
    """(T - 1,) whether what lies between each of (T,) times and the next one is a gap."""
    steps = np.diff(times)
    if not len(steps):
        return np.zeros(0, bool)
    return steps > max(LONGEST_BRIDGED_S, MAX_INTERVALS_BRIDGED * float(np.median(steps)))


def hold_across_gaps(armature: Armature) -> Armature:
    """The samples that have a pose, and the pose before each gap once more at its end."""
    valid_samples = np.flatnonzero(armature.is_valid)
    times = armature.times[valid_samples]
    before = np.flatnonzero(is_gap(times))
    if not len(before) and len(valid_samples) == len(armature.times):
        return armature
    order, later = valid_samples, times
    if len(before):
        # One interval before the first pose after the gap, as if a sample were there.
        last = times[before + 1] - float(np.median(np.diff(times)))
        order, later = (
            np.insert(valid_samples, before + 1, valid_samples[before]),
            np.insert(times, before + 1, last),
        )
    return replace(
        armature,
        times=later,
        positions=armature.positions[order],
        rotations=armature.rotations[order],
    )
