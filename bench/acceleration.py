"""How much a track shakes, by its acceleration, and how late it is, by correlation.

Either alone can be cheated: a frozen joint does not shake, and a delayed one may be as smooth as
the reference. A reference that was low-pass filtered (the real recording's at some 6 Hz) has lost
what true acceleration there was above; a ratio a little over 1 is then no fault.

INPUTS: points of joints over time, tracked and reference (metres, seconds).
OUTPUTS: AccelerationAndLag.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from jaxmocap.evaluation.series import sample_step, second_difference

LARGEST_LAG_S = 0.25
# Velocities for the lag are taken over this time: from sample to sample, jitter would drown them.
BASELINE_S = 0.1
# Lags tried within a sample; a parabola through the best three finds what lies between.
LAGS_PER_SAMPLE = 2
# Velocities whose correlation is less at every lag determine none.
LEAST_CORRELATION = 0.5


@dataclass(frozen=True)
class AccelerationAndLag:
    """Acceleration and lag of J joints.

    Attributes:
        track: (J,) root mean square acceleration of the track, m/s^2.
        reference: (J,) the same of the reference at the same times.
        lags: (J,) seconds by which the track comes after the reference; NaN where it moves too
            differently to tell, as a frozen joint does.
        correlations: (J,) correlation of the velocities at that lag; NaN where one does not move.
    """

    track: np.ndarray
    reference: np.ndarray
    lags: np.ndarray
    correlations: np.ndarray

    @property
    def ratio(self) -> float:
        """Acceleration of all joints together, track over reference; NaN without data."""
        both = np.isfinite(self.track) & np.isfinite(self.reference)
        squares = [np.sum(values[both] ** 2) for values in (self.track, self.reference)]
        return float(np.sqrt(squares[0] / squares[1])) if squares[1] > 0 else float("nan")

    @property
    def worst_lag(self) -> float:
        """The lag farthest from 0, seconds; NaN if that of any joint is unknown."""
        return float(self.lags[np.argmax(np.where(np.isnan(self.lags), np.inf, abs(self.lags)))])


def compare_tracks(
    times: np.ndarray, points: np.ndarray, reference_times: np.ndarray, reference: np.ndarray
) -> AccelerationAndLag:
    """Compare the tracks of J joints with their reference.

    The track is taken as it is, sample by sample, so that none of its shaking is lost; the
    reference, smooth by assumption, is brought to its times.

    Args:
        times: (T,) seconds.
        points: (T, J, 3) world, metres; NaN where missing.
        reference_times: (R,) seconds.
        reference: (R, J, 3) world, metres; NaN where missing.
    """
    figures = [
        (
            *_accelerations(times, track, resampled_by_spline(reference_times, truth, times)),
            *lag(times, track, reference_times, truth),
        )
        for track, truth in zip(_per_joint(points), _per_joint(reference), strict=True)
    ]
    return AccelerationAndLag(*np.array(figures).reshape(-1, 4).T)


def resampled_by_spline(times: np.ndarray, values: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Values (N, C) at other times, by a cubic spline through those that are not missing.

    Args:
        times: (N,) seconds, rising.
        values: (N, C); a row with NaN is missing.
        wanted: (...) seconds.

    Returns:
        (..., C); NaN outside the series and within its gaps.
    """
    is_finite = np.isfinite(values).all(-1)
    t, wanted = np.asarray(times, float)[is_finite], np.asarray(wanted, float)
    if len(t) < 2:
        return np.full((*wanted.shape, values.shape[-1]), np.nan)
    after = np.clip(np.searchsorted(t, wanted), 1, len(t) - 1)
    # A microsecond's slack: text files round their time stamps.
    inside = (wanted >= t[0] - 1e-6) & (wanted <= t[-1] + 1e-6)
    near = np.minimum(np.abs(wanted - t[after]), np.abs(wanted - t[after - 1])) <= 1e-6
    no_gap = (t[after] - t[after - 1] < 1.5 * sample_step(np.asarray(times, float))) | near
    resampled = CubicSpline(t, np.asarray(values, float)[is_finite])(wanted)
    return np.where((inside & no_gap)[..., None], resampled, np.nan)


def _per_joint(points: np.ndarray) -> np.ndarray:
    """(T, J, 3) as (J, T, 3)."""
    return np.moveaxis(np.asarray(points, float), 1, 0)


def _accelerations(times: np.ndarray, *tracks: np.ndarray) -> list[float]:
    """Root mean square accelerations of (T, 3) tracks over the samples that all of them have."""
    squares = np.sum(second_difference(times, np.stack(tracks, 1)) ** 2, -1)
    common = squares[np.isfinite(squares).all(-1)]
    return np.sqrt(common.mean(0)).tolist() if len(common) else [float("nan")] * len(tracks)


def lag(
    times: np.ndarray, track: np.ndarray, reference_times: np.ndarray, reference: np.ndarray
) -> tuple[float, float]:
    """By how much a (T, 3) track comes after a (R, 3) reference, and how alike they then move.

    The lag, seconds, at which their velocities correlate best, finer than a sample; NaN where they
    are not alike at any. The correlation is of the samples that both have.
    """
    step = sample_step(times)
    count = int(LAGS_PER_SAMPLE * LARGEST_LAG_S / step)
    lags = np.arange(-count, count + 1) * step / LAGS_PER_SAMPLE
    truth = resampled_by_spline(reference_times, reference, times - lags[:, None])
    apart = max(round(BASELINE_S / step), 1)
    correlations = _correlations(
        track[apart:] - track[:-apart], truth[:, apart:] - truth[:, :-apart]
    )
    if np.isnan(correlations).all():
        return float("nan"), float("nan")
    best = int(np.nanargmax(correlations))
    if correlations[best] < LEAST_CORRELATION:
        return float("nan"), float(correlations[best])
    before, here, after = correlations[np.clip([best - 1, best, best + 1], 0, 2 * count)]
    bend = before - 2 * here + after
    # At the end of what was tried, or beside a gap, there is no parabola.
    between = (before - after) / (2 * bend) if bend < 0 and 0 < best < 2 * count else 0.0
    return float(lags[best] + between * step / LAGS_PER_SAMPLE), float(here)


def _correlations(track: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """(L,) correlations of (N, 3) velocities with each of (L, N, 3); NaN for too few samples."""
    both = np.isfinite(np.sum(track + truth, -1))
    a, b = (np.where(both[..., None], velocities, 0.0) for velocities in (track, truth))
    sizes = np.sqrt(np.sum(a * a, (1, 2)) * np.sum(b * b, (1, 2)))
    enough = (both.sum(-1) >= track.shape[0] / 2) & (sizes > 1e-12)
    return np.where(enough, np.sum(a * b, (1, 2)) / np.where(enough, sizes, 1.0), np.nan)
