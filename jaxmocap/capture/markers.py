"""Markers at any time, between the samples that were taken.

INPUTS: sample times (T,) in seconds, positions (T, M, 3) with NaN where missing, times to look at.
OUTPUTS: positions (K, M, 3) at those times; NaN where they are missing.
"""

import numpy as np

# Neighbouring samples further apart than this many median intervals are a gap, not a motion.
GAP_INTERVALS = 3.0
# So is a step that would be faster than this, metres per second: no hand is.
MAX_SPEED_M_S = 50.0


def median_interval(times: np.ndarray) -> float:
    """The median step of ascending times (T,), seconds; 0 where there are fewer than two."""
    return float(np.median(np.diff(times))) if len(times) > 1 else 0.0


def interpolate_markers(
    times: np.ndarray, positions: np.ndarray, at: np.ndarray, causal: bool = False
) -> np.ndarray:
    """Linear in time between neighbouring samples; at a sample's own time that sample.

    Unknown, and NaN, where either neighbour is missing, where the neighbours lie further apart
    than three median intervals or than a marker can go meanwhile, and further than half an
    interval outside the samples. With ``causal`` the line goes through the newest two samples that
    are not later and is followed for one interval at most.

    Args:
        times: (T,) seconds, ascending.
        positions: (T, M, 3) metres.
        at: (K,) seconds, in any order.
        causal: use no sample later than each time.

    Returns:
        (K, M, 3) metres.
    """
    times, positions, at = (np.asarray(a, float) for a in (times, positions, at))
    newest = np.searchsorted(times, at, side="right") - 1
    exact = (newest >= 0) & (times[newest] == at)
    if len(times) < 2:
        return np.where(exact[:, None, None], positions[newest], np.nan)
    interval = median_interval(times)
    first = np.clip(newest - 1 if causal else newest, 0, len(times) - 2)
    start, end = times[first], times[first + 1]
    if causal:
        is_valid = (newest >= 1) & (at - end <= interval)
    else:
        is_valid = (at - times[-1] <= interval / 2) & (times[0] - at <= interval / 2)
    is_valid &= end - start <= GAP_INTERVALS * interval
    weight, step = (at - start) / (end - start), positions[first + 1] - positions[first]
    is_valid = is_valid[:, None] & (
        np.linalg.norm(step, axis=-1) <= MAX_SPEED_M_S * (end - start)[:, None]
    )
    line = positions[first] + weight[:, None, None] * step
    line = np.where(is_valid[..., None], line, np.nan)
    return np.where(exact[:, None, None], positions[newest], line)
