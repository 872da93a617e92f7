"""By how much a video's clock differs from the markers', from the motion itself.

At the right offset the image moves where the hands are as the hands do. Coarse: the lag at which
the flow at the hands correlates best with their motion. Fine: weighted least squares of the
difference, whose derivative by the lag is the hands' acceleration. The standard deviation is that
over blocks of time drawn with replacement, since what disturbs the flow lasts for several frames.

INPUTS: a Recording. OUTPUTS: a VideoOffset for each video: offset and deviation, or why there is
none.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from jaxmocap.calibration.hand_flow import HandFlow, MarkerPath, correlations
from jaxmocap.capture.video import open_video
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.recording import Recording, VideoSource
from jaxmocap.formats.time_series.tables import usual_step

# A stretch of video whose lag is estimated lasts so many seconds at most,
STRETCH_S = 10.0
# and has so many frames at most.
MAX_STRETCH_FRAMES = 450
# Stretches of one video.
MAX_STRETCHES = 6
# Lags that are tried about the coarse steps' best, seconds: fine steps
FINE_STEP_S = 0.004
# so far to both sides.
FINE_RANGE_S = 0.06
# Iterations of the least squares,
MAX_ITERATIONS = 30
# which has converged where a step is smaller than this, seconds.
CONVERGED_S = 1e-5
# Correlation that the best lag must have.
MIN_CORRELATION = 0.3
# It must exceed every peak that is so far from it, seconds,
OTHER_PEAK_DISTANCE_S = 0.15
# by this factor.
MIN_PEAK_RATIO = 1.08
# An offset is determined if the standard deviation of least squares is no more than this, seconds,
MAX_STD_S = 0.005
# and that of the lag at which flow and markers are nearest, which is coarser, no more than this.
MAX_NEAREST_STD_S = 0.008
# No smaller standard deviation is stated: flow has errors that blocks of time do not show.
MIN_STD_S = 0.001
# The bootstrap draws blocks of so many seconds: of a few blocks it would be sure of anything.
BLOCK_S, LEAST_S = 0.25, 1.5
# It draws so many times.
BOOTSTRAP_DRAWS = 200
# A drift is estimated where stretches are this far apart, seconds.
MIN_DRIFT_SPAN_S = 60.0
# Hands slower than this, pixels per frame, determine no lag.
MIN_SPEED_PX = 0.5


@dataclass(frozen=True)
class VideoOffset:
    """One video's clock."""

    camera: str  # its name
    stated_offset_s: float  # the offset in the recording
    # To add to video time to get marker time; NaN where it is not identifiable.
    offset_s: float
    std_s: float  # its standard deviation; NaN likewise
    correlation: float  # of image and markers at the best lag
    # Marker time gained for each second of video, or NaN where the recording is too short for one.
    drift_s_per_s: float = float("nan")
    drift_std_s_per_s: float = float("nan")  # its standard deviation
    reason: str = ""  # why there is no offset; empty where there is one

    @property
    def is_found(self) -> bool:
        """Whether there is an offset."""
        return not self.reason


@dataclass(frozen=True)
class StretchLag:
    """The lag of one stretch of a video."""

    middle: float  # of the stretch, seconds of marker time
    lag: float  # seconds to add to the stated offset, or NaN
    std: float  # its standard deviation, seconds, or NaN
    correlation: float  # of image and markers at that lag
    reason: str = ""  # why there is no lag; empty where there is one


def estimate_video_offsets(recording: Recording, search: float = 1.0) -> list[VideoOffset]:
    """Find every video's offset, within ``search`` seconds of the stated one.

    Raises:
        InputError: no video, or no marker that is present for long enough.
    """
    where = recording.path or recording.name
    if not recording.videos:
        raise InputError(where, "[[video]] is missing, there is nothing to align with the markers")
    paths = hand_paths(recording.require_markers())
    if not paths:
        raise InputError(where, "[markers.on]: no hand's marker is present in four samples or more")
    return [video_offset(source, paths, search) for source in recording.videos]


def video_offset(source: VideoSource, paths: Sequence[MarkerPath], search: float) -> VideoOffset:
    """By all stretches of a video."""
    flow_of = partial(HandFlow.of_frames, source.camera, video := open_video(source), paths)
    stretches = _stretches(video.times, paths)
    return combine_lags(source, [_estimate_lag(flow_of(*each), search) for each in stretches])


def hand_paths(recording: Recording) -> list[MarkerPath]:
    """Paths of the markers on hands and forearms; of all markers where there are none."""
    hands = recording.skeleton.tree.names_in("forearm", "hand")
    columns = [i for i, place in enumerate(recording.places) if place.bone in hands]
    paths = [
        MarkerPath.through(recording.times, recording.positions_world[:, i])
        for i in columns or range(len(recording.places))
    ]
    return [path for path in paths if path is not None]


def _stretches(times: np.ndarray, paths: Sequence[MarkerPath]) -> list[tuple[int, int]]:
    """First frame and number of frames of the liveliest stretch in each equal part of a video.

    The ``times`` (F,) are its frames', marker time.
    """
    frames, step = len(times), usual_step(times) or 1.0
    longest = max(2, min(frames, round(STRETCH_S / step), MAX_STRETCH_FRAMES))
    parts = int(np.clip(frames // longest, 1, MAX_STRETCHES))
    edges = np.linspace(0, frames, parts + 1).astype(int)
    stretches = [
        liveliest_frames(times, paths, *ends, longest) for ends in pairwise(edges.tolist())
    ]
    return [stretch for stretch in stretches if stretch[1] > 1]


def liveliest_frames(
    times: np.ndarray, paths: Sequence[MarkerPath], start: int, end: int, longest: int
) -> tuple[int, int]:
    """First frame and number of frames, at most ``longest``, in which the hands move most."""
    times = times[start:end]
    speeds = [np.linalg.norm(path.spline(times, 1), axis=-1) for path in paths]
    inside = [np.isfinite(path.at(times)).all(-1) for path in paths]
    lively = np.cumsum([0.0, *np.sum(np.where(inside, speeds, 0.0), 0)])
    firsts = np.arange(max(1, end - start - longest + 1))
    ends = np.minimum(firsts + longest, end - start)
    best = int(np.argmax(lively[ends] - lively[firsts]))
    return start + best, int(ends[best] - firsts[best])


def _estimate_lag(flow: HandFlow, search: float) -> StretchLag:
    """The lag of one stretch."""
    middle = float(flow.times.mean())
    lags, scores = correlations(flow, search)
    best = int(np.argmax(scores))
    if reason := _why_unidentifiable(flow, lags, scores, best, search):
        return StretchLag(middle, np.nan, np.nan, float(scores[best]), reason)
    near = lags[best] + np.arange(-FINE_RANGE_S, FINE_RANGE_S + FINE_STEP_S / 2, FINE_STEP_S)
    # Pixels (K, H) between flow and markers' motion at each lag.
    pairs = map(flow.flow_pair, near)
    costs = np.array([np.linalg.norm(p.measured - p.predicted, axis=-1) for p in pairs])
    lag, std = _least_squares(flow, float(near[np.nanmean(costs, (1, 2)).argmin()]))
    spread = _bootstrap_std(near, costs, flow.times)
    if std > MAX_STD_S or spread > MAX_NEAREST_STD_S or abs(lag - lags[best]) > FINE_RANGE_S:
        least = 1e3 * max(std, spread)
        reason = f"not identifiable, to {least:.0f} ms at best: move the hands faster or longer"
        return StretchLag(middle, np.nan, np.nan, float(scores[best]), reason)
    return StretchLag(middle, lag, float(np.hypot(std, MIN_STD_S)), float(scores[best]))


def _why_unidentifiable(
    flow: HandFlow, lags: np.ndarray, scores: np.ndarray, best: int, search: float
) -> str:
    """Why the best lag is no estimate; empty where it is one."""
    if np.ptp(flow.times) < LEAST_S:
        return f"not identifiable: {np.ptp(flow.times):.1f} s long, expected {LEAST_S:g} at least"
    predicted = flow.flow_pair(float(lags[best])).predicted
    if not np.isfinite(predicted).any():
        return "not identifiable: the image does not show the hands"
    speed = float(np.sqrt(np.nanmean((predicted**2).sum(-1))))
    if speed < MIN_SPEED_PX:
        return f"not identifiable: move the hands faster ({speed:.2f} pixels per frame)"
    if scores[best] < MIN_CORRELATION:
        return (
            f"not identifiable: the image does not move as the hands do (correlation "
            f"{scores[best]:.2f}) within ±{search:g} s; search wider (--search), move them "
            "faster, or check the camera and [markers.on]"
        )
    peaks = np.r_[False, (scores[1:-1] > scores[:-2]) & (scores[1:-1] > scores[2:]), False]
    elsewhere = peaks & (np.abs(lags - lags[best]) > OTHER_PEAK_DISTANCE_S)
    if elsewhere.any() and scores[best] < MIN_PEAK_RATIO * scores[elsewhere].max():
        return "not identifiable: the motion repeats itself; move the hands faster and unevenly"
    if best in (0, len(lags) - 1):
        return f"the best lag is at the end of the ±{search:g} s searched; search wider (--search)"
    return ""


def _least_squares(flow: HandFlow, lag: float) -> tuple[float, float]:
    """Gauss and Newton's lag under Cauchy's weights, and its deviation over blocks of time."""
    half = 1e-3
    slopes = weights = residuals = np.zeros(1)
    for _ in range(MAX_ITERATIONS):
        later, sooner = flow.flow_pair(lag + half, lag), flow.flow_pair(lag - half, lag)
        residuals = later.measured - (later.predicted + sooner.predicted) / 2
        slopes = (later.predicted - sooner.predicted) / (2 * half)
        distances = np.linalg.norm(residuals, axis=-1, keepdims=True)
        scale = 2.0 * np.nanmedian(distances) + 0.5
        weights = 1 / (1 + (distances / scale) ** 2)
        step = float(np.nansum(weights * slopes * residuals) / np.nansum(weights * slopes**2))
        lag += np.clip(step, -FINE_STEP_S, FINE_STEP_S)
        if abs(step) < CONVERGED_S:
            break
    blocks = _blocks(flow.times)
    numerators = np.bincount(blocks, np.nansum(weights * slopes * residuals, (1, 2)))
    denominators = np.bincount(blocks, np.nansum(weights * slopes**2, (1, 2)))
    return float(lag), float(np.std(_redrawn(numerators, denominators)))


def _bootstrap_std(lags: np.ndarray, costs: np.ndarray, times: np.ndarray) -> float:
    """Deviation of the lag of the smallest mean distance (L, K, H) over blocks of time."""
    blocks, is_finite = _blocks(times), np.isfinite(costs)
    sums = np.array([np.bincount(blocks, row) for row in np.where(is_finite, costs, 0.0).sum(2)])
    counts = np.array([np.bincount(blocks, row) for row in is_finite.sum(2)])
    return float(np.std(lags[_redrawn(sums, counts).argmin(0)]))


def _blocks(times: np.ndarray) -> np.ndarray:
    """(K,) which block of time each pair of frames belongs to."""
    return ((times[:-1] - times[0]) / BLOCK_S).astype(int)


def _redrawn(numerators: np.ndarray, denominators: np.ndarray) -> np.ndarray:
    """(..., BOOTSTRAP_DRAWS) ratios of sums over blocks (..., K), redrawn with replacement."""
    count = numerators.shape[-1]
    draws = np.random.default_rng(0).multinomial(count, np.full(count, 1 / count), BOOTSTRAP_DRAWS)
    return (numerators @ draws.T) / np.maximum(denominators @ draws.T, 1e-9)


def combine_lags(source: VideoSource, lags_found: Sequence[StretchLag]) -> VideoOffset:
    """One offset from all stretches, and the drift where they lie far enough apart."""
    good = [each for each in lags_found if not each.reason]
    if not good:
        nan, none = float("nan"), "fewer than two of its frames can be compared"
        nothing = StretchLag(nan, nan, nan, nan, none)
        best = max(lags_found, key=lambda each: each.correlation, default=nothing)
        name, stated = source.camera_name, source.offset
        return VideoOffset(name, stated, nan, nan, best.correlation, reason=best.reason)
    middles, lags, stds = (
        np.array([getattr(each, key) for each in good]) for key in ("middle", "lag", "std")
    )
    weights = 1 / stds**2
    lag, std = float(weights @ lags / weights.sum()), float(weights.sum() ** -0.5)
    # Stretches that disagree by more than they should raise the deviation of all.
    chi2 = float(weights @ (lags - lag) ** 2) / max(len(good) - 1, 1)
    drift = drift_std = float("nan")
    if len(good) > 1 and np.ptp(middles) >= MIN_DRIFT_SPAN_S:
        centre = weights @ middles / weights.sum()
        since = middles - centre
        drift = float((weights * since) @ lags / (weights @ since**2))
        drift_std = float((weights @ since**2) ** -0.5)
        chi2 = float(weights @ (lags - lag - drift * since) ** 2) / max(len(good) - 2, 1)
    wider = max(1.0, chi2) ** 0.5
    return VideoOffset(
        source.camera_name,
        source.offset,
        source.offset + lag,
        std * wider,
        max(each.correlation for each in good),
        drift,
        drift_std * wider,
    )


def sync_text(offsets: Sequence[VideoOffset]) -> str:
    """A line for each video to put into the recording, or why there is none."""
    lines = []
    for each in offsets:
        if each.reason:
            lines.append(f"{each.camera}: {each.reason}")
            continue
        lines.append(
            f"{each.camera}: offset = {each.offset_s:.4f}  (± {each.std_s:.4f} s, correlation "
            f"{each.correlation:.2f}; {each.offset_s - each.stated_offset_s:+.4f} s to the stated "
            f"{each.stated_offset_s:g})"
        )
        if np.isfinite(each.drift_s_per_s):
            lines.append(
                f"{each.camera}: the markers' clock gains {1e6 * each.drift_s_per_s:.0f} ± "
                f"{1e6 * each.drift_std_s_per_s:.0f} µs a second on the video's; the offset is "
                "that of the middle, and no field corrects a drift"
            )
    return "\n".join(lines)
