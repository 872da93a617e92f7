"""How far to trust landmarks, from what is left uncertain.

INPUTS: variances with and without what the cameras saw. OUTPUTS: deviations, and what is a guess.
"""

import numpy as np

# A landmark is a guess where the video leaves more than this share of its variance, unless markers
# hold it already, as they do below some HELD_M metres.
GUESSED, HELD_M = 0.7, 0.01


def trusted(
    told: np.ndarray, guessed: np.ndarray, mismatch: float
) -> tuple[np.ndarray, np.ndarray]:
    """Deviations (T, L, 3) of landmarks, and whether (T, L) they are guesses.

    Args:
        told: (T, L, 3) variances given all that is known.
        guessed: (T, L, 3) without what the cameras saw.
        mismatch: deviation of a landmark that no marker holds, however sure the video, metres.
    """
    loose = told / (told + HELD_M**2)
    deviations = np.sqrt(told + loose * mismatch**2)
    from_prior = told.sum(-1) > GUESSED * guessed.sum(-1)
    markers_hold = guessed.sum(-1) < 9 * HELD_M**2
    return deviations, (from_prior & ~markers_hold).astype(float)
