"""Putting lost limbs where they explain more: poses are proposed, fitted, and the best is kept.

What the last frames measured of a limb is withdrawn once it is found elsewhere.

INPUTS: a fitted pose, the frame that it was fitted to, what is remembered of the limbs; an earlier
pass's estimate, if there was one. OUTPUTS: a RecoveredPose.
"""

from typing import NamedTuple

import numpy as np

from jaxmocap.body.pose import Pose
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.silhouette.fit.cycles import FittedPose, FrameEvidence, fit_pose, information_without
from jaxmocap.silhouette.recovery.lost_limbs import LimbMemory, LimbProposal
from jaxmocap.silhouette.recovery.projected_body import ProjectedBody
from jaxmocap.silhouette.state import (
    PoseEstimate,
    RecentFrame,
    StepReport,
    TrackedBody,
    TrackerConstants,
)


class RecoveredPose(NamedTuple):
    """A frame's result, and what became of the limbs."""

    fitted: FittedPose
    relocated: np.ndarray  # (D,) bool: joints that were put elsewhere
    resumed: np.ndarray  # (D,) bool: those of them that are where an earlier pass found them
    hidden: np.ndarray  # (D,) bool: joints of parts that are not visible
    limbs: LimbMemory  # to remember


class _Relocation(NamedTuple):
    """The best pose so far, laid over the images, and the numbers of the limbs moved for it."""

    fitted: FittedPose
    projected: ProjectedBody
    limbs: tuple[int, ...] = ()


def recover_limbs(
    constants: TrackerConstants,
    body: TrackedBody,
    limbs: LimbMemory,
    frame: FrameEvidence,
    fitted: FittedPose,
    deviations: np.ndarray,
    earlier: PoseEstimate | None = None,
) -> RecoveredPose:
    """The fitted pose, or one that explains more with limbs elsewhere.

    ``deviations`` (6 + D,) are of the prior that it was fitted with; ``earlier`` is what an earlier
    pass found in this frame.
    """
    s, recovery = constants.settings, body.recovery
    none = recovery.joints_of(())
    if not fitted.used.any():
        return RecoveredPose(fitted, none, none, ~none, limbs)
    best = _Relocation(fitted, _project_pose(body, fitted.result.pose, fitted, frame))
    resumed, searched = (), ()
    # Without a background what looks like a person is taken for one, and learned as none.
    has_backgrounds = all(
        background is not None
        for background, used in zip(frame.backgrounds, fitted.used, strict=True)
        if used
    )
    if s.particles > 1 and has_backgrounds:
        if earlier is not None:
            proposal = recovery.earlier_proposal(limbs, best.projected, earlier.pose)
            best = _best_of(constants, body, proposal, limbs, frame, best, deviations)
            resumed = best.limbs
        proposal, limbs = recovery.propose(limbs, best.projected)
        best = _best_of(constants, body, proposal, limbs, frame, best, deviations)
        searched = best.limbs
    moved = (*resumed, *searched)
    hidden, limbs = recovery.hidden_joints(limbs, best.projected, frame.images, moved)
    old, new = recovery.joints_of(resumed), recovery.joints_of(searched)
    return RecoveredPose(best.fitted, old | new, old & ~new, hidden, limbs)


def _best_of(
    constants: TrackerConstants,
    body: TrackedBody,
    proposal: LimbProposal | None,
    limbs: LimbMemory,
    frame: FrameEvidence,
    best: _Relocation,
    deviations: np.ndarray,
) -> _Relocation:
    """The best of the poses proposed, each fitted; or what there was, and no limbs."""
    best = best._replace(limbs=())
    if proposal is None:
        return best
    joints, before = body.recovery.joints_of(proposal.limbs), best.fitted
    wide, widest = deviations.copy(), constants.settings.predicted_deviation
    wide[ROOT_DOF:][joints] = np.maximum(wide[ROOT_DOF:][joints], widest)
    least = proposal.least_gain
    for pose in proposal.poses:
        again = fit_pose(constants, body, frame, pose, wide)
        old, new = (_project_pose(body, each.result.pose, again, frame) for each in (before, again))
        gain = body.recovery.gain(proposal.limbs, old, new, limbs.appearance)
        if gain > least:
            least, best = gain, _Relocation(again, new, proposal.limbs)
    return best


def _project_pose(
    body: TrackedBody, pose: Pose, fitted: FittedPose, frame: FrameEvidence
) -> ProjectedBody:
    """A pose laid over what was segmented for another."""
    return body.recovery.projector.project(
        pose, fitted.outlines, fitted.used, frame.images, frame.backgrounds
    )


# Frames before a limb was found elsewhere whose pairs had it in the wrong place.
LOST_FRAMES = 3


def remember_frame(recent: tuple[RecentFrame, ...], frame: RecentFrame) -> tuple[RecentFrame, ...]:
    """The last ``LOST_FRAMES`` frames after another one."""
    kept = frame._replace(report=frame.report._replace(revised=()))
    return (*recent[1 - LOST_FRAMES :], kept)


def withdraw_joints(
    constants: TrackerConstants,
    body: TrackedBody,
    recent: tuple[RecentFrame, ...],
    relocated: np.ndarray,
) -> tuple[RecentFrame, ...]:
    """The last frames, joints (D,) that were relocated since being hidden in them."""
    frames = []
    for report, pose, measured in recent:
        hidden, observed = report.hidden | relocated, report.observed.copy()
        left = information_without(constants, body, hidden, pose, report.pairs, measured)
        observed[ROOT_DOF:][relocated] = False
        information, slope = np.asarray(left.information), np.asarray(left.slope)
        report = report._replace(
            hidden=hidden, observed=observed, information=information, slope=slope
        )
        frames.append(RecentFrame(report, pose, measured))
    return tuple(frames)


def slim(report: StepReport) -> StepReport:
    """A report without what is large: those of all frames of a recording are kept."""
    outlines = report.outlines._replace(segmentation=None, contours=())  # type: ignore[arg-type]
    return report._replace(outlines=outlines, pairs=None, revised=())  # type: ignore[arg-type]
