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
from jaxmocap.silhouette.fit.correspond import ContourPairs
from jaxmocap.silhouette.recovery.lost_limbs import LimbMemory, LimbRecovery
from jaxmocap.silhouette.segmentation.image_changes import ImageHistory
from jaxmocap.silhouette.segmentation.outlines import Outlines
from jaxmocap.silhouette.segmentation.segment import Histograms
from jaxmocap.silhouette.settings import Settings
from jaxmocap.silhouette.surfaces.body_shape import BodyShape
from jaxmocap.silhouette.surfaces.rim import RimFinder


class TrackerConstants(NamedTuple):
    """What stays as it is for all frames and passes."""

    cameras: Camera  # C, stacked
    settings: Settings
    finder: RimFinder  # of rims
    rest_deviations: np.ndarray  # (D,) of joints held about 0, radians; infinite for the others
    carriers: np.ndarray  # (M,) the bone that carries most of each node of the surface


class TrackedBody(NamedTuple):
    """Who is tracked."""

    shape: BodyShape  # bones and surface
    model: Model  # bones, and where markers sit that are followed too
    recovery: LimbRecovery  # of limbs of these bones' lengths


class StepReport(NamedTuple):
    """How a step went, and how well its pose is determined."""

    used: np.ndarray  # (C,) bool: cameras that counted
    matched_shares: np.ndarray  # (C,) of rim and contour that found a partner
    spread: float  # standard deviation of the pairs, metres
    # (6 + D,) standard deviations of the degrees of freedom, metres and radians.
    deviations: np.ndarray
    # (6 + D,) bool: those that the images determine; the others keep their prediction.
    observed: np.ndarray
    # (6 + D, 6 + D), see ``PoseResult``; by the pairs of parts that are visible.
    information: np.ndarray
    slope: np.ndarray  # (6 + D,), likewise
    outlines: Outlines  # what was segmented
    # (D,) bool: joints that a particle filter, or an earlier pass, put elsewhere.
    relocated: np.ndarray
    hidden: np.ndarray  # (D,) bool: joints of parts that are not visible where the pose has them
    pairs: ContourPairs  # that the pose was fitted to
    # Reports of the last frames, the oldest first, where this one withdraws what they had of
    # relocated joints; in place of theirs.
    revised: "tuple[StepReport, ...]" = ()


class RecentFrame(NamedTuple):
    """A frame that a later one may still revise."""

    report: StepReport  # in full
    pose: Pose  # as estimated
    measured: Measurements  # besides its images


class State(NamedTuple):
    """What a tracker remembers: all of it."""

    pose: Pose  # at ``time``
    velocity: np.ndarray  # (6 + D,) metres and radians per second
    time: float | None  # seconds; None before the first frame
    histograms: Histograms  # of C cameras' images
    determined: np.ndarray  # (6 + D,) bool: degrees of freedom that the last frame determined well
    image_history: ImageHistory
    limbs: LimbMemory
    body: TrackedBody
    # C models of what each camera shows where nobody stands; None where unknown.
    backgrounds: tuple[Background | None, ...]
    recent: tuple[RecentFrame, ...] = ()  # the last frames, the oldest first


class PoseEstimate(NamedTuple):
    """A frame's pose, and velocity (6 + D,), metres and radians per second, as a pass left them."""

    pose: Pose
    velocity: np.ndarray
