"""What a silhouette tracker is given, what it remembers from frame to frame, and what it reports.

INPUTS: nothing. OUTPUTS: TrackerConstants; TrackedBody, State; StepReport, PoseEstimate.
"""

from typing import NamedTuple

import numpy as np

from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose
from jaxmocap.evidence.terms import Measurements
from jaxmocap.geometry.cameras import Camera
from jaxmocap.images.background_model import Background
from jaxmocap.silhouette.recovery.lost_limbs import LimbMemory, LimbRecovery
from jaxmocap.silhouette.segmentation.image_changes import ImageHistory
from jaxmocap.silhouette.segmentation.outlines import Outlines
from jaxmocap.silhouette.segmentation.segment import Histograms
from jaxmocap.silhouette.settings import Settings
from jaxmocap.silhouette.surfaces.body_shape import BodyShape
from jaxmocap.silhouette.surfaces.rim import RimFinder
from jaxmocap.silhouette.surfaces.shape import NodePairs


class TrackerConstants(NamedTuple):
    """What stays as it is for all frames and passes.

    Attributes:
        cameras: C, stacked.
        settings: how to work.
        finder: of rims.
        rest_deviations: (D,) of joints held about 0, radians; infinite for the others.
        carriers: (M,) the bone that carries most of each node of the surface.
    """

    cameras: Camera
    settings: Settings
    finder: RimFinder
    rest_deviations: np.ndarray
    carriers: np.ndarray


class TrackedBody(NamedTuple):
    """Who is tracked.

    Attributes:
        shape: bones and surface.
        model: bones, and where markers sit that are followed too.
        recovery: of limbs of these bones' lengths.
    """

    shape: BodyShape
    model: Model
    recovery: LimbRecovery


class StepReport(NamedTuple):
    """How a step went, and how well its pose is determined.

    Attributes:
        used: (C,) bool: cameras that counted.
        matched_shares: (C,) of rim and contour that found a partner.
        spread: standard deviation of the pairs, metres.
        deviations: (6 + D,) standard deviations of the degrees of freedom, metres and radians.
        observed: (6 + D,) bool: those that the images determine; the others keep their prediction.
        information: (6 + D, 6 + D), see ``PoseResult``; by the pairs of parts that are visible.
        slope: (6 + D,), likewise.
        outlines: what was segmented.
        relocated: (D,) bool: joints that a particle filter, or an earlier pass, put elsewhere.
        hidden: (D,) bool: joints of parts that are not visible where the pose has them.
        pairs: that the pose was fitted to.
        revised: reports of the last frames, the oldest first, where this one withdraws what they
            had of relocated joints; in place of theirs.
    """

    used: np.ndarray
    matched_shares: np.ndarray
    spread: float
    deviations: np.ndarray
    observed: np.ndarray
    information: np.ndarray
    slope: np.ndarray
    outlines: Outlines
    relocated: np.ndarray
    hidden: np.ndarray
    pairs: NodePairs
    revised: "tuple[StepReport, ...]" = ()


class RecentFrame(NamedTuple):
    """A frame that a later one may still revise.

    Attributes:
        report: in full.
        pose: as estimated.
        measured: besides its images.
    """

    report: StepReport
    pose: Pose
    measured: Measurements


class State(NamedTuple):
    """What a tracker remembers: all of it.

    Attributes:
        pose: at ``time``.
        velocity: (6 + D,) metres and radians per second.
        time: seconds; None before the first frame.
        histograms: of C cameras' images.
        determined: (6 + D,) bool: degrees of freedom that the last frame determined well.
        image_history: what the cameras showed last.
        limbs: what is remembered of them.
        body: who is tracked.
        backgrounds: C models of what each camera shows where nobody stands; None where unknown.
        recent: the last frames, the oldest first.
    """

    pose: Pose
    velocity: np.ndarray
    time: float | None
    histograms: Histograms
    determined: np.ndarray
    image_history: ImageHistory
    limbs: LimbMemory
    body: TrackedBody
    backgrounds: tuple[Background | None, ...]
    recent: tuple[RecentFrame, ...] = ()


class PoseEstimate(NamedTuple):
    """A frame's pose, and velocity (6 + D,), metres and radians per second, as a pass left them."""

    pose: Pose
    velocity: np.ndarray
