"""What a silhouette tracker remembers from frame to frame, and what it tells of each.

INPUTS: nothing. OUTPUTS: State, StepReport, Moving.
"""

from typing import NamedTuple

import numpy as np

from jaxmocap.body.pose import Pose
from jaxmocap.silhouette.recovery.lost_limbs import LimbMemory
from jaxmocap.silhouette.segmentation.image_changes import ImageHistory
from jaxmocap.silhouette.segmentation.outlines import Outlines
from jaxmocap.silhouette.segmentation.segment import Histograms
from jaxmocap.silhouette.surfaces.shape import NodePairs


class State(NamedTuple):
    """What a tracker remembers.

    Attributes:
        pose: at ``time``.
        velocity: (6 + D,) metres and radians per second.
        time: seconds; None before the first frame.
        histograms: of C cameras' images.
        determined: (6 + D,) bool: degrees of freedom that the last frame told much of.
        image_history: at what the cameras showed last.
        limbs: limbs that may be elsewhere.
    """

    pose: Pose
    velocity: np.ndarray
    time: float | None
    histograms: Histograms
    determined: np.ndarray
    image_history: ImageHistory
    limbs: LimbMemory


class StepReport(NamedTuple):
    """How far to trust a step.

    Attributes:
        used: (C,) bool: cameras that counted.
        matched_shares: (C,) of rim and contour that found each other.
        spread: deviation of the pairs, metres.
        deviations: (6 + D,) of the degrees of freedom, metres and radians.
        observed: (6 + D,) bool: those that the images told of; the others are held.
        information: (6 + D, 6 + D), see ``PoseResult``; by the pairs of parts that are seen.
        slope: (6 + D,), likewise.
        outlines: what was segmented.
        relocated: (D,) bool: joints that a hypothesis, or an earlier pass, put elsewhere.
        hidden: (D,) bool: joints of parts that are not seen where they are thought to be.
        pairs: that the pose was found by.
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


class PoseEstimate(NamedTuple):
    """A frame's pose and how it moves on, as a pass over the frames left them.

    Attributes:
        pose: that was found.
        velocity: (6 + D,) metres and radians per second.
    """

    pose: Pose
    velocity: np.ndarray
