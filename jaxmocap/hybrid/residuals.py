"""What one frame's pose answers for besides the sights: markers, joints, ground, what is usual.

INPUTS: a skeleton, a pose, what is known of the frame. OUTPUTS: whitened residuals.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Frames, Sites, forward, landmark_sites, site_positions
from jaxmocap.body.pose import Pose, beyond_limits
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.geometry.rotations import quaternion_to_matrix
from jaxmocap.hybrid.keypoints import Lines, line_residuals
from jaxmocap.hybrid.smoothing_settings import SmoothingSettings

# How far joints go from the relaxed pose, degrees (standard deviation), by how their names begin.
EASE = {
    "spine": 15, "neck": 25, "arm_flex": 60, "arm": 40, "elbow": 60,
    "hip_flexion": 40, "hip": 25, "knee": 60,
}  # fmt: skip
GROUND = ("ankle_l", "ankle_r")
ELBOWS = ("elbow_l", "elbow_r")
# Bones whose markers hold a foot.
FEET = ("tibia", "foot")
# Of both elbows, where no hypothesis puts them anywhere.
NO_GOALS = np.full((2, 3), np.nan)
# Where no marker holds the feet, the markers' pose faces so many times less surely.
UNFOOTED = 3.0


class Known(NamedTuple):
    """What is known of one frame besides its sights.

    Attributes:
        targets: (M, 3) markers, world, metres; NaN where missing.
        up: (2,) horizontal part of the pelvis' upright in the markers' pose.
        facing: (3,) unit and horizontal, where the markers' pose faces.
        ankles: (2, 3) of the markers' pose, world, metres.
        feet: () 1 where no marker holds the feet, so that the ground must, else 0.
        goals: (2, 3) where a hypothesis puts the elbows, world, metres; NaN where none does.
        lines: of sight of the cameras that come with key points; None where none does.
    """

    targets: Array | np.ndarray
    up: Array | np.ndarray
    facing: Array | np.ndarray
    ankles: Array | np.ndarray
    feet: Array | np.ndarray
    goals: Array | np.ndarray
    lines: Lines | None = None


def residuals(
    skeleton: Skeleton, markers: Sites, settings: SmoothingSettings, pose: Pose, known: Known
) -> Array:
    """All whitened residuals (R,) of one frame but its sights'."""
    bones = forward(skeleton, pose)
    held = _off(site_positions(skeleton, bones, markers), known.targets) / settings.marker
    elbows = site_positions(skeleton, bones, landmark_sites(skeleton, ELBOWS))
    R = quaternion_to_matrix(pose.quaternion)
    turned = jnp.cross(R[:, 0], known.facing)[2]
    facing = settings.facing * (1 + (UNFOOTED - 1) * known.feet)
    ankles = site_positions(skeleton, bones, landmark_sites(skeleton, GROUND))
    ground = jnp.stack([settings.footing, settings.footing, settings.ground])
    return jnp.concatenate(
        [
            held.ravel(),
            (R[:2, 2] - (1 - known.feet) * known.up) / settings.lean,
            turned[None] / facing,
            (pose.angles - skeleton.relaxed) / (settings.ease * ease(skeleton)),
            beyond_limits(skeleton.limits, pose.angles) / settings.limit,
            (known.feet * (ankles - known.ankles) / ground).ravel(),
            (_off(elbows, known.goals) / settings.goal).ravel(),
            *_off_lines(skeleton, settings, bones, known),
        ]
    )


def _off_lines(
    skeleton: Skeleton, settings: SmoothingSettings, bones: Frames, known: Known
) -> list[Array]:
    """How far the landmarks are from where key points show them."""
    if known.lines is None:
        return []
    points = site_positions(skeleton, bones, landmark_sites(skeleton, tuple(LANDMARKS)))
    return [line_residuals(points, known.lines, settings.keypoints).ravel()]


def _off(points: Array, targets: Array | np.ndarray) -> Array:
    """Points less their targets; 0 where there is none."""
    there = jnp.isfinite(targets)
    return jnp.where(there, points - jnp.where(there, targets, 0.0), 0.0)


def feet_free(skeleton: Skeleton, markers: Sites) -> float:
    """1 where no marker holds the feet, else 0."""
    return float(not any(skeleton.tree.bones[b].startswith(FEET) for b in markers.bones))


def ease(skeleton: Skeleton) -> Array:
    """How far joints go from the relaxed pose, (D,) standard deviations, radians."""
    degrees = [
        next((ease for start, ease in EASE.items() if joint.startswith(start)), 40)
        for joint in skeleton.tree.joints
    ]
    return jnp.asarray(np.radians(degrees), skeleton.relaxed.dtype)
