"""What was measured of a limb in the last frames is withdrawn once it is found elsewhere.

INPUTS: the last frames, joints that were relocated. OUTPUTS: the frames, without those joints'
information.
"""

import numpy as np

from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.silhouette.fit.cycles import information_without
from jaxmocap.silhouette.state import RecentFrame, StepReport, TrackedBody, TrackerConstants

# Frames before a limb was found elsewhere whose pairs had it in the wrong place.
LOST_FRAMES = 3


def remembered(recent: tuple[RecentFrame, ...], frame: RecentFrame) -> tuple[RecentFrame, ...]:
    """The last ``LOST_FRAMES`` frames after another one."""
    kept = frame._replace(report=frame.report._replace(revised=()))
    return (*recent[1 - LOST_FRAMES :], kept)


def withdrawn(
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
