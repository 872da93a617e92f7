"""Whether standard deviations are right: intervals that contain the truth as often as they state.

INPUTS: truth, estimate and standard deviation over time. OUTPUTS: IntervalCoverage of
each coordinate by itself.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

LEVEL = 0.9


@dataclass(frozen=True)
class IntervalCoverage:
    """Figures of each column, shaped as a row of what they were made of, such as (3,) or (L, 3).

    Attributes:
        samples: where all three were measured.
        share: of these, truths within the interval; NaN where there is none.
        ratio: median standard deviation over root mean square error; NaN where there is none,
            infinite where there is no error.
    """

    samples: np.ndarray
    share: np.ndarray
    ratio: np.ndarray


def interval_coverage(
    truth: np.ndarray, estimate: np.ndarray, deviation: np.ndarray, level: float = LEVEL
) -> IntervalCoverage:
    """Hold standard deviations against actual errors.

    The interval is the estimate plus and minus what a normal distribution puts ``level`` within
    (1.645 standard deviations for 0.9).

    Args:
        truth: (T, ...) such as (T, 3) or (T, L, 3), metres; NaN where unknown.
        estimate: of the same shape.
        deviation: of the same shape.
        level: nominal share, between 0 and 1.
    """
    error = np.asarray(estimate, float) - np.asarray(truth, float)
    deviation = np.asarray(deviation, float)
    is_finite = np.isfinite(error) & np.isfinite(deviation)
    inside = is_finite & (np.abs(error) <= ndtri((1 + level) / 2) * deviation)
    samples = is_finite.sum(0)
    some, counts = samples > 0, np.maximum(samples, 1)
    rms = np.sqrt(np.sum(np.where(is_finite, error, 0.0) ** 2, 0) / counts)
    # Columns without data get a row that keeps NumPy's median from warning.
    medians = np.nanmedian(np.where(is_finite | ~some, np.where(some, deviation, 0.0), np.nan), 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(some, medians / rms, np.nan)
    return IntervalCoverage(samples, np.where(some, inside.sum(0) / counts, np.nan), ratio)
