"""What is done to markers before they are tracked: frozen ones, outliers, gaps, low-pass.

INPUTS: a Recording and what its Filters ask for.
OUTPUTS: the Recording with other positions, and a Cleaning: which filter changed which sample.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from jaxmocap.capture.frozen_markers import find_frozen
from jaxmocap.capture.markers import GAP_INTERVALS
from jaxmocap.capture.one_euro import filter_step, initial_state
from jaxmocap.formats.recordings.filters import Filters, OneEuroSettings
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.tables import is_even, usual_step

# The key of the low-pass, in messages.
BUTTERWORTH = "[markers.filters] butterworth"
# Hampel's identifier looks so far to each side, seconds and samples at least.
HAMPEL_HALF_WINDOW_S = 0.05
HAMPEL_MIN_HALF_WINDOW = 3
# Farther from the median than so many standard deviations, by the median deviation, is an outlier,
HAMPEL_DEVIATIONS = 3.0
# but never within this distance, metres.
HAMPEL_FLOOR_M = 0.02
# Beyond 1 kHz the window is shorter than HAMPEL_HALF_WINDOW_S, samples.
HAMPEL_MAX_HALF_WINDOW = 50
# Samples whose windows are in memory together.
HAMPEL_BLOCK_SAMPLES = 4096
# Of a normal distribution: its standard deviation over its median absolute deviation.
MAD_TO_STD = 1.4826
# The slopes at a gap's ends are those of parabolas through so many samples, at least three.
SLOPE_SAMPLES = 7
# Second order, forward and backward.
BUTTERWORTH_ORDER = 2
# Each pass has a higher cut-off, so that both together pass 1 / sqrt(2) at the one stated (Winter).
TWO_PASS_CUTOFF_RATIO = (2**0.5 - 1) ** 0.25


@dataclass(frozen=True)
class Cleaning:
    """What filters did to T samples of M markers."""

    names: tuple[str, ...]  # of the markers
    applied: dict[str, Any]  # filter -> its parameter, of those that were on
    frozen: np.ndarray  # (T, M) samples that repeat the one before, taken for missing
    outliers: np.ndarray  # (T, M) samples taken for missing
    filled: np.ndarray  # (T, M) samples that were filled in
    missing: np.ndarray  # (T, M) samples still missing
    warnings: tuple[str, ...] = ()  # sentences that a user should see

    def figures(self) -> dict[str, Any]:
        """Filters that were on, and counts for each marker."""
        kinds = ("frozen", "outliers", "filled", "missing")
        counts = {
            name: {kind: int(getattr(self, kind)[:, i].sum()) for kind in kinds}
            for i, name in enumerate(self.names)
        }
        is_changed = bool(self.applied) or self.frozen.any()
        return {"on": self.applied} | ({"samples": counts} if is_changed else {})

    def statuses(self, sample: int) -> tuple[str, ...]:
        """What was done to one sample."""
        return tuple(
            f"marker {self.names[i]} was {what}"
            for what, samples in (
                ("frozen", self.frozen),
                ("an outlier", self.outliers),
                ("filled in", self.filled),
            )
            for i in np.flatnonzero(samples[sample])
        )


def filter_markers(recording: Recording, causal: bool = False) -> tuple[Recording, Cleaning]:
    """Send a recording's markers through its filters: One Euro where ``causal``, else the others.

    Samples of a marker that is frozen, see ``frozen_markers``, are missing afterwards.

    InputError for a cut-off that the markers' rate cannot hold.
    """
    filters, times, positions = recording.filters, recording.times, recording.positions_world
    none = np.zeros(positions.shape[:2], bool)
    outliers, filled = none, none
    frozen = find_frozen(times, positions, causal)
    warnings = [
        f"marker {name} repeats its last place in {count} samples, as of a device that has lost "
        "it; these are taken as missing"
        for name, count in zip(recording.marker_names, frozen.sum(0).tolist(), strict=True)
        if count
    ]
    if frozen.any():
        positions = np.where(frozen[..., None], np.nan, positions)
    applied = active_filters(filters, causal)
    if "hampel" in applied:
        outliers = find_outliers(times, positions)
        positions = np.where(outliers[..., None], np.nan, positions)
    if "gaps" in applied:
        before = _is_missing(positions)
        positions = fill_gaps(times, positions, filters.gaps)
        filled = before & ~_is_missing(positions)
    if filters.butterworth is not None and "butterworth" in applied:
        check_cutoff(recording, filters.butterworth, BUTTERWORTH)
        if not is_even(times):
            warnings.append(
                "unevenly spaced samples went through the Butterworth filter as if even"
            )
        positions = butterworth_low_pass(times, positions, filters.butterworth)
    if filters.one_euro is not None and "one_euro" in applied:
        positions = filter_one_euro(times, positions, filters.one_euro)
    if unused := ", ".join(active_filters(filters, not causal)):
        which = "look ahead, which --causal does not" if causal else "is for live and --causal"
        warnings.append(f"[markers.filters] {unused}: not used, {which}")
    cleaning = Cleaning(
        recording.marker_names,
        applied,
        frozen,
        outliers,
        filled,
        _is_missing(positions),
        tuple(warnings),
    )
    return replace(recording, positions_world=positions, filters=Filters()), cleaning


def active_filters(filters: Filters, causal: bool) -> dict[str, Any]:
    """Filter -> parameter, of those that are on and allowed."""
    if causal:
        return {"one_euro": filters.one_euro} if filters.one_euro else {}
    on = {"hampel": filters.hampel, "gaps": filters.gaps, "butterworth": filters.butterworth}
    return {name: value for name, value in on.items() if value}


def _is_missing(positions: np.ndarray) -> np.ndarray:
    return np.asarray(np.isnan(positions).any(-1))


def find_outliers(times: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """(T, M) outliers of (T, M, N) by Hampel's identifier: markers with one such coordinate."""
    interval = usual_step(times)
    half = round(HAMPEL_HALF_WINDOW_S / interval) if interval else 0
    half = min(max(half, HAMPEL_MIN_HALF_WINDOW), HAMPEL_MAX_HALF_WINDOW)
    outliers = np.zeros(positions.shape[:2], bool)
    for marker in range(positions.shape[1]):
        path = np.pad(positions[:, marker], ((half, half), (0, 0)), constant_values=np.nan)
        windows = np.lib.stride_tricks.sliding_window_view(path, 2 * half + 1, 0)
        present = np.flatnonzero(~_is_missing(positions[:, marker]))
        for first in range(0, len(present), HAMPEL_BLOCK_SAMPLES):
            rows = present[first : first + HAMPEL_BLOCK_SAMPLES]
            middle = np.nanmedian(windows[rows], -1)
            spread = MAD_TO_STD * np.nanmedian(np.abs(windows[rows] - middle[..., None]), -1)
            allowed = np.maximum(HAMPEL_DEVIATIONS * spread, HAMPEL_FLOOR_M)
            is_far = np.abs(positions[rows, marker] - middle) > allowed
            outliers[rows, marker] = is_far.any(-1)
    return outliers


def fill_gaps(times: np.ndarray, positions: np.ndarray, longest: float) -> np.ndarray:
    """Cubic across gaps, with the slopes of the samples on both sides; NaN where they are longer.

    Args:
        times: (T,) seconds.
        positions: (T, M, 3) metres, or (T, M, N) of anything; NaN where missing.
        longest: seconds that a marker may be missing: from the first sample without it to the
            first with it again.
    """
    filled, allowed = positions.copy(), longest + usual_step(times)
    for marker in range(positions.shape[1]):
        present = np.flatnonzero(~_is_missing(positions[:, marker]))
        for before, after in pairwise(present.tolist()):
            if after - before > 1 and times[after] - times[before] <= allowed * (1 + 1e-9):
                inside = slice(before + 1, after)
                path = positions[:, marker]
                filled[inside, marker] = _hermite(times, path, present, before, after)
    return filled


def _hermite(
    times: np.ndarray, path: np.ndarray, present: np.ndarray, before: int, after: int
) -> np.ndarray:
    """(K, 3) Hermite's cubic at the samples between two present ones; a line where no slope is."""
    from scipy.interpolate import CubicHermiteSpline

    row = int(np.searchsorted(present, before))
    ends = (present[max(0, row + 1 - SLOPE_SAMPLES) : row + 1], present[row + 1 :][:SLOPE_SAMPLES])
    both, inside = [before, after], times[before + 1 : after]
    slopes = [_slope(times, path, rows, at) for rows, at in zip(ends, both, strict=True)]
    if np.isnan(slopes).any():
        slopes = np.tile((path[after] - path[before]) / (times[after] - times[before]), (2, 1))
    return CubicHermiteSpline(times[both], path[both], slopes)(inside)


def _slope(times: np.ndarray, path: np.ndarray, rows: np.ndarray, at: int) -> np.ndarray:
    """(3,) metres per second at a sample, of the parabola through those near it; NaN without."""
    since = times[rows] - times[at]
    near = np.abs(since) <= SLOPE_SAMPLES * usual_step(times)
    if near.sum() < 3:
        return np.full(3, np.nan)
    return np.polynomial.polynomial.polyfit(since[near], path[rows[near]], 2)[1]


def butterworth_low_pass(times: np.ndarray, positions: np.ndarray, cutoff: float) -> np.ndarray:
    """Butterworth's filter forward and backward: no delay, half the power at the cut-off, Hz.

    Of (T, M, N) positions at even times (T,), seconds, each run between gaps goes by itself.
    """
    # Half a second of imports, and few recordings ask for it.
    from scipy.signal import butter, sosfiltfilt

    interval = usual_step(times)
    sections = butter(
        BUTTERWORTH_ORDER, cutoff / TWO_PASS_CUTOFF_RATIO, fs=1 / interval, output="sos"
    )
    smooth = positions.copy()
    for marker in range(positions.shape[1]):
        for run in _runs(times, ~_is_missing(positions[:, marker])):
            # The ends are mirrored over one period of the cut-off, or what there is of it.
            pad = min(len(run) - 1, round(1 / (cutoff * interval)))
            smooth[run, marker] = sosfiltfilt(sections, positions[run, marker], 0, padlen=pad)
    return smooth


def _runs(times: np.ndarray, is_present: np.ndarray) -> list[np.ndarray]:
    """Rows that are present and follow one another without a gap, run by run."""
    rows = np.flatnonzero(is_present)
    breaks = (np.diff(rows) > 1) | (np.diff(times[rows]) > GAP_INTERVALS * usual_step(times))
    return [run for run in np.split(rows, np.flatnonzero(breaks) + 1) if len(run) > 1]


def check_cutoff(recording: Recording, cutoff: float, name: str) -> None:
    """InputError unless the samples can hold the cut-off of a low-pass, by its setting's name."""
    interval = usual_step(recording.times)
    highest = TWO_PASS_CUTOFF_RATIO / (2 * interval) if interval else 0.0
    if cutoff >= highest:
        raise recording.error(
            f"{name}: found {cutoff:g} Hz, expected less than "
            f"{highest:.3g} Hz for {1 / interval if interval else 0:.3g} samples per second"
        )


def filter_one_euro(
    times: np.ndarray, positions: np.ndarray, settings: OneEuroSettings
) -> np.ndarray:
    """(T, M, 3) positions as the filter gives them out one after the other."""
    state, filtered_samples = initial_state(positions.shape[1]), []
    for time, sample in zip(times, positions, strict=True):
        state, filtered = filter_step(settings, state, float(time), sample)
        filtered_samples.append(filtered)
    return np.stack(filtered_samples)
