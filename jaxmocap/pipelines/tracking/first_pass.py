"""What one way through a recording found, and the motions that come of it.

INPUTS: poses and reports of all events, what a second pass made of them. OUTPUTS: Motions.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import numpy as np

from jaxmocap.body.motion import Motion, Report
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.hybrid.tracker import StepReport
from jaxmocap.pipelines.tracking import warnings
from jaxmocap.pipelines.tracking.events import Plan
from jaxmocap.pipelines.tracking.report_figures import judge_steps
from jaxmocap.pipelines.tracking.second_pass import FirstPass, Smoothed
from jaxmocap.smoothing.fixed_lag import Given


class Tracked(NamedTuple):
    """One run over a recording, seen twice.

    Attributes:
        motion: by markers and video.
        markers_only: the same steps before the video had its say.
    """

    motion: Motion
    markers_only: Motion


@dataclass
class Passed:
    """One way through the E events of a recording.

    Attributes:
        plan: the events.
        refined: poses (E, ...).
        reports: of the steps, (E, ...).
        said: sentences of each event.
        milliseconds: stage -> times.
        given: what a smoother behind the tracker gave out, event by event.
    """

    plan: Plan
    refined: Pose
    reports: StepReport
    said: list[list[str]]
    milliseconds: dict[str, list[float]]
    given: list[Given] = field(default_factory=list)

    def first_pass(self) -> FirstPass:
        """What a second pass starts from."""
        plan = self.plan
        return FirstPass(plan.timeline, plan.markers_world, self.reports.pose, self.refined)

    def tracked(self, skeleton: Skeleton, told: dict, smoothed: Smoothed | None) -> Tracked:
        """All samples as arrays, NaN before the first one with a marker.

        Args:
            skeleton: of the person, as the tracker has it.
            told: settings for the report.
            smoothed: what the second pass found, if there was one.
        """
        plan, before = self.plan, self.plan.before
        at_samples = np.flatnonzero(plan.timeline.sample_index >= 0)

        def column(values: np.ndarray) -> np.ndarray:
            kept = np.asarray(values)[at_samples]
            return np.concatenate([np.full((before, *kept.shape[1:]), np.nan), kept])

        def motion(person: Skeleton, poses: Pose, report: Report | None) -> Motion:
            poses, recording = jax.tree.map(column, poses), plan.recording
            return Motion(person, recording.times, poses, report, recording.origin_world)

        judged = judge_steps(self.reports) if smoothed is None else smoothed.judged
        report = Report(
            markers=plan.recording.marker_names,
            marker_errors=column(judged.distances),
            arm_costs=column(np.asarray(self.reports.arm_costs)),
            swivels=column(judged.swivels),
            confidence=column(judged.confidence),
            landmarks_std=column(judged.deviations),
            from_prior=column(judged.from_prior),
            statuses=self._sentences(column(judged.confidence)),
            milliseconds={stage: np.array(t) for stage, t in self.milliseconds.items()},
            settings=told,
        )
        person, poses = (skeleton, self.refined) if smoothed is None else smoothed[:2]
        return Tracked(motion(person, poses, report), motion(skeleton, self.reports.pose, None))

    def _sentences(self, confidence: np.ndarray) -> tuple[tuple[str, ...], ...]:
        """What there is to say of each sample, by the (T, 2) confidence in its elbows."""
        before = (("no marker has been seen yet",),) * self.plan.before
        said = list(self.plan.about_samples(self.said))
        if self.plan.unseen:
            unsure = map(warnings.of_confidence, confidence[len(before) :])
            said = [(*sentences, *more) for sentences, more in zip(said, unsure, strict=True)]
        return before + tuple(said)
