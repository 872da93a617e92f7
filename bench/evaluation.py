"""One recording, tracked by markers alone and with video, and the figures of the two.

How far elbows are off; how often video makes them worse (wrong turns); how much they shake, by
their acceleration; how late they are, by correlation. A frozen joint does not shake, and a delayed
one may be as smooth as the reference: so both are told. A reference that was low-pass filtered (the
real recording's at some 6 Hz) has lost what true acceleration there was above; a ratio a little
over 1 is then no fault.

INPUTS: a Clip, settings of the tracker; or points of joints over time (metres, seconds).
OUTPUTS: a Result; AccelerationAndLag; WrongTurns.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from bench.clips import Clip
from jaxmocap.body.motion import Motion
from jaxmocap.body.skeleton import landmark_rows
from jaxmocap.capture.footage import open_footage
from jaxmocap.capture.timeline import Mode
from jaxmocap.evaluation.errors import Errors, evaluate
from jaxmocap.evaluation.series import sample_step, second_difference
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.hybrid.settings import Settings
from jaxmocap.pipelines.tracking.track import track

LARGEST_LAG_S = 0.25
# Velocities for the lag are taken over this time: from sample to sample, jitter would drown them.
BASELINE_S = 0.1
# Lags tried within a sample; a parabola through the best three finds what lies between.
LAGS_PER_SAMPLE = 2
# Velocities whose correlation is less at every lag determine none.
LEAST_CORRELATION = 0.5
# Video is a wrong turn where it is farther off than the markers alone by more.
WORSE_BY_M = 0.05
FEET = ("ankle", "toe")  # parts of their markers' names
# An elbow is astray where it is farther off than that, metres,
ASTRAY_M = 0.2
# and that is stated where it is no farther off than so many of its deviations.
STATED = 2.0


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


@dataclass(frozen=True)
class WrongTurns:
    """Where J joints were worse with video.

    Attributes:
        share: (J,) of the samples; NaN for a joint without data.
        longest: (J,) the longest stretch without a good sample, seconds: how long it takes to
            recover.
    """

    share: np.ndarray
    longest: np.ndarray


def wrong_turns(times: np.ndarray, alone: np.ndarray, video: np.ndarray) -> WrongTurns:
    """Samples at which video's error exceeds the other by more than ``WORSE_BY_M``.

    Args:
        times: (N,) seconds.
        alone: (N, J) errors by markers alone, metres; NaN where unknown.
        video: (N, J) errors with video, likewise. Unknown samples count neither way.
    """
    is_measured = np.isfinite(alone) & np.isfinite(video)
    wrong = is_measured & (video > alone + WORSE_BY_M)
    counts = is_measured.sum(0)
    share = np.where(counts > 0, wrong.sum(0) / np.maximum(counts, 1), np.nan)
    step = sample_step(times)
    longest = [
        _longest(times[rows], bad[rows], step)
        for rows, bad in zip(is_measured.T, wrong.T, strict=True)
    ]
    return WrongTurns(share, np.array(longest))


def _longest(times: np.ndarray, bad: np.ndarray, step: float) -> float:
    """Seconds from the first to the last sample of the longest run of bad ones, and one sample."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]).astype(int)))
    starts, ends = edges[::2], edges[1::2] - 1
    return float((times[ends] - times[starts]).max() + step) if len(starts) else 0.0


class Sureness(NamedTuple):
    """Errors of L landmarks beside the deviations that the tracker reports.

    Attributes:
        landmarks: their names.
        offsets: (N, L, 3) tracked minus reference, metres; NaN where either is missing.
        deviations: (N, L, 3) metres.
        from_prior: (N, L) whether the tracker reports no more than its prior.
    """

    landmarks: tuple[str, ...]
    offsets: np.ndarray
    deviations: np.ndarray
    from_prior: np.ndarray


@dataclass(frozen=True)
class Result:
    """One recording, tracked twice.

    Attributes:
        clip: the recording.
        alone: errors of the elbows by markers alone.
        video: the same with video.
        off: (T, M) distances from head and hands to their markers after refinement, metres.
        turns: where video was worse than markers alone, each elbow.
        calm_alone: acceleration and lag of the elbows by markers alone.
        calm: the same with video.
        frame: time between two video frames, seconds.
        sureness: None where the tracker reports no deviations.
    """

    clip: Clip
    alone: Errors
    video: Errors
    off: np.ndarray
    turns: WrongTurns
    calm_alone: AccelerationAndLag
    calm: AccelerationAndLag
    frame: float
    sureness: Sureness | None

    @property
    def improvement(self) -> float:
        """By which share video lowers the mean error."""
        return 1 - self.video.mean / self.alone.mean

    @property
    def lag_frames(self) -> float:
        """Of the elbow that is farthest off, in frames of the video; NaN if that is unknown."""
        return self.calm.worst_lag / self.frame

    @property
    def astray(self) -> tuple[float, float]:
        """Seconds for which elbows are astray, both together: with that stated, and without.

        Without deviations nothing is stated.
        """
        off, step = self.video.distances, sample_step(self.video.times)
        far, stated = off > ASTRAY_M, np.zeros(off.shape, bool)
        if self.sureness is not None:
            columns = [self.sureness.landmarks.index(name) for name in self.video.joints]
            stated = off <= STATED * np.linalg.norm(self.sureness.deviations[:, columns], axis=-1)
        return float((far & stated).sum() * step), float((far & ~stated).sum() * step)

    @property
    def wrong_share(self) -> float:
        """Share of wrong turns over both elbows."""
        return float(np.nanmean(self.turns.share))


def evaluate_clip(clip: Clip, settings: Settings, mode: Mode = "own", noise: float = 0.0) -> Result:
    """Track a recording by markers alone and with video, and hold both against the truth.

    Args:
        clip: the recording.
        settings: of the tracker with video.
        mode: of ``track``.
        noise: standard deviation of white noise on every coordinate of the markers, metres.
    """
    recording = shaken(Recording.load(clip.path), noise, clip.seed)
    alone = track(recording, Settings(refine="none", smooth=False), mode=mode)
    video = track(recording, settings, mode=mode)
    assert video.report is not None
    upper = [not any(foot in name.lower() for foot in FEET) for name in video.report.markers]
    before, after = (evaluate(motion, clip.truth, clip.pairs) for motion in (alone, video))
    (footage, *_), _ = open_footage(recording)
    return Result(
        clip,
        before,
        after,
        video.report.marker_errors[:, upper],
        wrong_turns(after.times, before.distances, after.distances),
        calm_of(alone, clip),
        calm_of(video, clip),
        sample_step(footage.times),
        sureness_of(video, clip),
    )


def shaken(recording: Recording, noise: float, seed: int) -> Recording:
    """The recording with white noise (metres, of each coordinate) on its markers."""
    if not noise:
        return recording
    rng = np.random.default_rng([seed, 5])
    positions = recording.positions_world
    return replace(recording, positions_world=positions + rng.normal(0, noise, positions.shape))


def calm_of(motion: Motion, clip: Clip) -> AccelerationAndLag:
    """Acceleration and lag of the elbows."""
    markers, joints = read_markers(clip.truth), motion.joints()
    truth = markers.points()
    return compare_tracks(
        motion.times,
        np.stack([joints[joint] for joint in clip.pairs], 1),
        markers.times,
        np.stack([truth[marker] for marker in clip.pairs.values()], 1),
    )


def sureness_of(motion: Motion, clip: Clip) -> Sureness | None:
    """Errors of every landmark that the reference has, beside the reported deviations."""
    errors = evaluate(motion, clip.truth, clip.landmarks)
    if motion.report is None or errors.deviations is None:
        return None
    rows = np.searchsorted(motion.times, errors.times)
    from_prior = motion.report.from_prior[rows][:, landmark_rows(clip.landmarks)]
    return Sureness(errors.joints, errors.offsets, errors.deviations, from_prior)
