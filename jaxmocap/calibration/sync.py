"""By how much a video's clock differs from the markers', from the motion itself.

At the right offset the image moves where the hands are as the hands do. Coarse: the lag at which
the flow at the hands correlates best with their motion. Fine: weighted least squares of the
difference, whose derivative by the lag is the hands' acceleration. The standard deviation is that
over blocks of time drawn with replacement, since what disturbs the flow lasts for several frames.

INPUTS: a Recording. OUTPUTS: a Synced for each video: offset and deviation, or why there is none.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import jax
import numpy as np

from jaxmocap.calibration.hand_flow import HandFlow, Path, Terms, flow_fields
from jaxmocap.capture.video import FrameSource, open_video
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.recording import Recording, VideoSource

# A stretch of video that is looked at: seconds and frames at most; how many of them at most.
STRETCH_S, STRETCH_FRAMES, STRETCHES = 10.0, 450, 6
# Lags that are tried, seconds: coarse steps over the range, fine ones about the best.
COARSE_S, FINE_S, NEAR_S = 0.01, 0.004, 0.06
# Steps of the least squares, and the one at which they have settled, seconds.
STEPS, SETTLED_S = 30, 1e-5
# Correlation that the best lag must have, and by what it must exceed the best one elsewhere.
CORRELATED, ELSEWHERE_S, AHEAD = 0.3, 0.15, 1.08
# An offset is known if least squares' deviation is no more than the first, and that of the lag at
# which flow and markers are nearest, which is coarser, no more than the second. No deviation is
# believed below the third, since flow has errors of its own that blocks of time do not show.
WORST_S, WORST_NEAR_S, BEST_S = 0.005, 0.008, 0.001
# Blocks of so many seconds are drawn so many times.
BLOCK_S, DRAWS = 0.25, 200
# A drift is told where stretches are this far apart, seconds.
LONG_S = 60.0
# Hands slower than this, pixels per frame, tell nothing.
SLOW_PX = 0.5


@dataclass(frozen=True)
class Synced:
    """One video's clock.

    Attributes:
        camera: its name.
        stated: the offset in the recording, seconds.
        offset: seconds to add to video time to get marker time; NaN where it is not identifiable.
        std: its standard deviation, seconds; NaN likewise.
        correlation: of image and markers at the best lag.
        drift: seconds of marker time gained for each second of video, or NaN where the recording
            is too short to tell.
        drift_std: its standard deviation.
        reason: why there is no offset; empty where there is one.
    """

    camera: str
    stated: float
    offset: float
    std: float
    correlation: float
    drift: float = float("nan")
    drift_std: float = float("nan")
    reason: str = ""

    @property
    def is_found(self) -> bool:
        """Whether there is an offset."""
        return not self.reason


@dataclass(frozen=True)
class Lag:
    """What one stretch of a video says.

    Attributes:
        middle: of the stretch, seconds of marker time.
        lag: seconds to add to the stated offset, or NaN.
        std: its standard deviation, seconds, or NaN.
        correlation: of image and markers at that lag.
        reason: why there is no lag; empty where there is one.
    """

    middle: float
    lag: float
    std: float
    correlation: float
    reason: str = ""


def sync(recording: Recording, search: float = 1.0) -> list[Synced]:
    """Find every video's offset.

    Args:
        recording: with at least one video.
        search: seconds about the stated offsets to look in.

    Raises:
        InputError: no video, or no marker that is seen for long enough.
    """
    where = recording.path or recording.name
    if not recording.videos:
        raise InputError(where, "[[video]] is missing, there is nothing to align with the markers")
    paths = hand_paths(recording.marked())
    if not paths:
        raise InputError(where, "[markers.on]: no marker is seen in four samples or more")
    return [_sync_video(recording, source, paths, search) for source in recording.videos]


def hand_paths(recording: Recording) -> list[Path]:
    """Paths of the markers on hands and forearms; of all markers where there are none."""
    hands = recording.skeleton.tree.names_in("forearm", "hand")
    columns = [i for i, place in enumerate(recording.places) if place.bone in hands]
    paths = [
        Path.through(recording.times, recording.positions_world[:, i])
        for i in columns or range(len(recording.places))
    ]
    return [path for path in paths if path is not None]


def _sync_video(
    recording: Recording, source: VideoSource, paths: Sequence[Path], search: float
) -> Synced:
    video, found = open_video(source), []
    # On the host: what follows projects a few points thousands of times.
    camera = jax.tree.map(np.asarray, source.camera)
    for first, count in _stretches(video, paths):
        fields, spacing = flow_fields(video, first, count)
        times = video.times[first : first + count]
        found.append(_lag(HandFlow(times, fields, spacing, camera, paths), search))
    return together(source, found)


def _stretches(video: FrameSource, paths: Sequence[Path]) -> list[tuple[int, int]]:
    """First frame and number of frames of the liveliest stretch in each equal part of a video."""
    frames, fps = len(video), video.fps or 1.0
    longest = max(2, min(frames, round(STRETCH_S * fps), STRETCH_FRAMES))
    parts = int(np.clip(frames // longest, 1, STRETCHES))
    edges = np.linspace(0, frames, parts + 1).astype(int)
    speeds = [np.linalg.norm(path.spline(video.times, 1), axis=-1) for path in paths]
    inside = [np.isfinite(path.at(video.times)).all(-1) for path in paths]
    lively = np.cumsum([0.0, *np.sum(np.where(inside, speeds, 0.0), 0)])
    stretches = []
    for start, end in pairwise(edges.tolist()):
        firsts = np.arange(start, max(start + 1, end - longest + 1))
        ends = np.minimum(firsts + longest, end)
        best = int(np.argmax(lively[ends] - lively[firsts]))
        stretches.append((int(firsts[best]), int(ends[best] - firsts[best])))
    return [stretch for stretch in stretches if stretch[1] > 1]


def _lag(flow: HandFlow, search: float) -> Lag:
    """The lag of one stretch."""
    middle = float(flow.times.mean())
    lags = np.arange(-search, search + COARSE_S / 2, COARSE_S)
    scores = np.array([correlation(flow.terms(lag)) for lag in lags])
    best = int(np.nanargmax(np.nan_to_num(scores, nan=-1.0)))
    if reason := _doubtful(flow, lags, scores, best, search):
        return Lag(middle, np.nan, np.nan, float(scores[best]), reason)
    near = lags[best] + np.arange(-NEAR_S, NEAR_S + FINE_S / 2, FINE_S)
    costs = np.array([_distances(flow.terms(lag)) for lag in near])
    lag, std = _least_squares(flow, float(near[np.nanmean(costs, (1, 2)).argmin()]))
    spread = _spread(near, costs, flow.times)
    if std > WORST_S or spread > WORST_NEAR_S or abs(lag - lags[best]) > NEAR_S:
        least = 1e3 * max(std, spread)
        reason = f"not identifiable, to {least:.0f} ms at best: move the hands faster or longer"
        return Lag(middle, np.nan, np.nan, float(scores[best]), reason)
    return Lag(middle, lag, float(np.hypot(std, BEST_S)), float(scores[best]))


def correlation(terms: Terms) -> float:
    """Of flow and markers' motion, as vectors about zero; NaN where neither moves."""
    seen, told = (np.nan_to_num(part) for part in terms)
    size = np.sqrt((seen**2).sum() * (told**2).sum())
    return float((seen * told).sum() / size) if size > 0 else float("nan")


def _doubtful(
    flow: HandFlow, lags: np.ndarray, scores: np.ndarray, best: int, search: float
) -> str:
    """Why the best lag says nothing; empty where it does."""
    told = flow.terms(float(lags[best])).told
    if not np.isfinite(told).any():
        return "not identifiable: the image does not show the hands"
    speed = float(np.sqrt(np.nanmean((told**2).sum(-1))))
    if speed < SLOW_PX:
        return f"not identifiable: move the hands faster ({speed:.2f} pixels per frame)"
    if scores[best] < CORRELATED:
        return (
            f"not identifiable: the image does not move as the hands do (correlation "
            f"{scores[best]:.2f}); move them faster, or check the camera and [markers.on]"
        )
    peaks = np.r_[False, (scores[1:-1] > scores[:-2]) & (scores[1:-1] > scores[2:]), False]
    elsewhere = peaks & (np.abs(lags - lags[best]) > ELSEWHERE_S)
    if elsewhere.any() and scores[best] < AHEAD * scores[elsewhere].max():
        return "not identifiable: the motion repeats itself; move the hands faster and unevenly"
    if best in (0, len(lags) - 1):
        return f"the best lag is at the end of the ±{search:g} s searched; search wider (--search)"
    return ""


def _distances(terms: Terms) -> np.ndarray:
    """(K, H) pixels between flow and markers' motion."""
    return np.linalg.norm(terms.seen - terms.told, axis=-1)


def _least_squares(flow: HandFlow, lag: float) -> tuple[float, float]:
    """Gauss and Newton's lag under Cauchy's weights, and its deviation over blocks of time."""
    half = 1e-3
    slopes = weights = residuals = np.zeros(1)
    for _ in range(STEPS):
        later, sooner = flow.terms(lag + half, lag), flow.terms(lag - half, lag)
        residuals = later.seen - (later.told + sooner.told) / 2
        slopes = (later.told - sooner.told) / (2 * half)
        away = np.linalg.norm(residuals, axis=-1, keepdims=True)
        scale = 2.0 * np.nanmedian(away) + 0.5
        weights = 1 / (1 + (away / scale) ** 2)
        step = float(np.nansum(weights * slopes * residuals) / np.nansum(weights * slopes**2))
        lag += np.clip(step, -FINE_S, FINE_S)
        if abs(step) < SETTLED_S:
            break
    blocks = _blocks(flow.times)
    tops = np.bincount(blocks, np.nansum(weights * slopes * residuals, (1, 2)))
    bottoms = np.bincount(blocks, np.nansum(weights * slopes**2, (1, 2)))
    drawn = _drawn(len(tops))
    return float(lag), float(np.std((drawn @ tops) / np.maximum(drawn @ bottoms, 1e-9)))


def _spread(lags: np.ndarray, costs: np.ndarray, times: np.ndarray) -> float:
    """Deviation of the lag of the smallest mean distance (L, K, H) over blocks of time."""
    blocks, known = _blocks(times), np.isfinite(costs)
    sums = np.array([np.bincount(blocks, row) for row in np.where(known, costs, 0.0).sum(2)])
    counts = np.array([np.bincount(blocks, row) for row in known.sum(2)])
    drawn = _drawn(sums.shape[1])
    best = ((sums @ drawn.T) / np.maximum(counts @ drawn.T, 1)).argmin(0)
    return float(np.std(lags[best]))


def _blocks(times: np.ndarray) -> np.ndarray:
    """(K,) which block of time each pair of frames belongs to."""
    return ((times[:-1] - times[0]) / BLOCK_S).astype(int)


def _drawn(count: int) -> np.ndarray:
    """(DRAWS, count) how often each block is drawn."""
    return np.random.default_rng(0).multinomial(count, np.full(count, 1 / count), DRAWS)


def together(source: VideoSource, found: Sequence[Lag]) -> Synced:
    """One offset from all stretches, and the drift where they lie far enough apart."""
    good = [each for each in found if not each.reason]
    if not found:
        nan, reason = float("nan"), "fewer than two of its frames can be compared"
        return Synced(source.camera_name, source.offset, nan, nan, nan, reason=reason)
    if not good:
        nan, best = float("nan"), max(found, key=lambda each: each.correlation)
        name, stated = source.camera_name, source.offset
        return Synced(name, stated, nan, nan, best.correlation, reason=best.reason)
    middles, lags, stds = (
        np.array([getattr(each, key) for each in good]) for key in ("middle", "lag", "std")
    )
    weights = 1 / stds**2
    lag, std = float(weights @ lags / weights.sum()), float(weights.sum() ** -0.5)
    # Stretches that disagree by more than they should make all of them less sure.
    chi2 = float(weights @ (lags - lag) ** 2) / max(len(good) - 1, 1)
    drift = drift_std = float("nan")
    if len(good) > 1 and np.ptp(middles) >= LONG_S:
        centre = weights @ middles / weights.sum()
        since = middles - centre
        drift = float((weights * since) @ lags / (weights @ since**2))
        drift_std = float((weights @ since**2) ** -0.5)
        chi2 = float(weights @ (lags - lag - drift * since) ** 2) / max(len(good) - 2, 1)
    wider = max(1.0, chi2) ** 0.5
    return Synced(
        source.camera_name,
        source.offset,
        source.offset + lag,
        std * wider,
        max(each.correlation for each in good),
        drift,
        drift_std * wider,
    )


def text(found: Sequence[Synced]) -> str:
    """A line for each video to put into the recording, or why there is none."""
    lines = []
    for each in found:
        if each.reason:
            lines.append(f"{each.camera}: {each.reason}")
            continue
        lines.append(
            f"{each.camera}: offset = {each.offset:.4f}  (± {each.std:.4f} s, correlation "
            f"{each.correlation:.2f}; the recording says {each.stated:g})"
        )
        if np.isfinite(each.drift):
            lines.append(
                f"{each.camera}: the markers' clock gains {1e6 * each.drift:.0f} ± "
                f"{1e6 * each.drift_std:.0f} µs a second on the video's; the offset is "
                "that of the middle, and no field corrects a drift"
            )
    return "\n".join(lines)
