"""Series over time: pairing two of them by time stamp, differences, filtering.

INPUTS: rising time stamps, seconds, and values at them. OUTPUTS: indices; filtered values.
"""

import numpy as np

from jaxmocap.formats.time_series.tables import MILLISECOND_S, nearest_times, usual_step

# The paper's Fig. 8 shows what of the error changes faster than this.
HIGH_PASS_HZ = 0.3


def sample_step(times: np.ndarray) -> float:
    """Time between samples, seconds; infinite for a single one."""
    return usual_step(times) or float("inf")


def match(
    times_a: np.ndarray, times_b: np.ndarray, tolerance: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Pair samples of two rising series by time stamp: each the other's nearest.

    Args:
        times_a: (A,) seconds.
        times_b: (B,) seconds.
        tolerance: largest difference, seconds; None is half a sample of the finer series, a
            millisecond of two single samples.

    Returns:
        Indices (N,) into the first and (N,) into the second series, both rising.
    """
    a, b = np.asarray(times_a, float), np.asarray(times_b, float)
    if not len(a) or not len(b):
        return np.zeros(0, int), np.zeros(0, int)
    if tolerance is None:
        step = min(sample_step(a), sample_step(b))
        tolerance = step / 2 if np.isfinite(step) else MILLISECOND_S
    (nearest_b, apart), (nearest_a, _) = nearest_times(b, a), nearest_times(a, b)
    mutual = nearest_a[nearest_b] == np.arange(len(a))
    # A microsecond's slack: text files round their time stamps.
    near = apart <= tolerance + 1e-6
    indices_a = np.flatnonzero(mutual & near)
    return indices_a, nearest_b[indices_a]


def finite_mean(values: np.ndarray) -> float:
    """Of what is not NaN; NaN where there is nothing."""
    return float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")


def second_difference(times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(N - 2, ...) second derivative of (N, ...) values, per second squared.

    NaN across a gap in the times.
    """
    step = sample_step(times)
    differences = np.diff(np.asarray(values, float), 2, axis=0) / step**2
    differences[np.abs(times[2:] - times[:-2] - 2 * step) > step / 2] = np.nan
    return differences


def high_pass(times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """The part of a series that changes faster than ``HIGH_PASS_HZ``, where half passes.

    A second-order Butterworth filter run forwards and backwards, as its gain over frequency on
    the series continued by its mirror image: no phase shift, no mean, no steps at its ends.

    Args:
        times: (N,) seconds, evenly spaced on the whole.
        values: (N,) the series; NaN is bridged for filtering and stays NaN.

    Returns:
        (N,) filtered values.
    """
    values = np.asarray(values, float)
    is_finite = np.isfinite(values)
    if is_finite.sum() < 2:
        return np.where(is_finite, 0.0, np.nan)
    bridged = np.interp(times, np.asarray(times)[is_finite], values[is_finite])
    mirrored = np.concatenate([bridged, bridged[::-1]])
    ratio = (np.fft.rfftfreq(len(mirrored), sample_step(times)) / HIGH_PASS_HZ) ** 4
    filtered = np.fft.irfft(np.fft.rfft(mirrored) * ratio / (1 + ratio), len(mirrored))
    return np.where(is_finite, filtered[: len(values)], np.nan)
