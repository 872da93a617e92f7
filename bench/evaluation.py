"""One recording, tracked by markers alone and with video, and the figures of the two.

INPUTS: a Clip, settings of the tracker. OUTPUTS: a Result.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from bench.acceleration import AccelerationAndLag, compare_tracks
from bench.clips import Clip
from bench.wrong_turns import WrongTurns, wrong_turns
from jaxmocap.body.motion import Motion
from jaxmocap.body.skeleton import landmark_rows
from jaxmocap.capture.footage import open_footage
from jaxmocap.capture.timeline import Mode
from jaxmocap.evaluation.errors import Errors
from jaxmocap.evaluation.motions import evaluate
from jaxmocap.evaluation.series import sample_step
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.hybrid.settings import Settings
from jaxmocap.pipelines.tracking.track import track

FEET = ("ankle", "toe")  # parts of their markers' names
# An elbow is astray where it is farther off than that, metres,
ASTRAY_M = 0.2
# and that is stated where it is no farther off than so many of its deviations.
STATED = 2.0


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
