"""How far to trust landmarks, from what is left uncertain.

INPUTS: variances with and without what the cameras saw. OUTPUTS: deviations, and what is a guess.
"""

from typing import NamedTuple

import numpy as np

# A landmark is a guess where the video leaves more than this share of its variance, unless markers
# hold it already, as they do below some HELD_M metres.
GUESSED, HELD_M = 0.7, 0.01


class Trust(NamedTuple):
    """How far to trust the landmarks of a trajectory.

    Attributes:
        deviations: (T, L, 3) standard deviations of their coordinates, world, metres.
        from_prior: (T, L) 1 where markers and video leave a landmark almost as uncertain as it is
            without them, else 0.
    """

    deviations: np.ndarray
    from_prior: np.ndarray


def trusted(told: np.ndarray, guessed: np.ndarray, mismatch: float) -> Trust:
    """What the variances of landmarks come to.

    Args:
        told: (T, L, 3) variances given all that is known.
        guessed: (T, L, 3) without what the cameras saw.
        mismatch: deviation of a landmark that no marker holds, however sure the video, metres.
    """
    loose = told / (told + HELD_M**2)
    deviations = np.sqrt(told + loose * mismatch**2)
    from_prior = told.sum(-1) > GUESSED * guessed.sum(-1)
    markers_hold = guessed.sum(-1) < 9 * HELD_M**2
    return Trust(deviations, (from_prior & ~markers_hold).astype(float))
