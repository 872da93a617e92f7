"""What one frame's pose answers for besides the sights: markers, joints, ground, what is usual.

INPUTS: a skeleton, a pose, what is known of the frame. OUTPUTS: whitened residuals.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Sites, forward, landmark_sites, site_positions
from jaxmocap.body.pose import Pose, beyond_limits
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.geometry.rotations import quaternion_to_matrix
from jaxmocap.hybrid.settings import SmoothingSettings

# How far joints go from the relaxed pose, degrees (standard deviation), by how their names begin.
EASE = {
    "spine": 15, "neck": 25, "arm_flex": 60, "arm": 40, "elbow": 60,
    "hip_flexion": 40, "hip": 25, "knee": 60,
}  # fmt: skip
GROUND = ("ankle_l", "ankle_r")
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
    """

    targets: Array | np.ndarray
    up: Array | np.ndarray
    facing: Array | np.ndarray
    ankles: Array | np.ndarray
    feet: Array | np.ndarray


def residuals(
    skeleton: Skeleton, markers: Sites, settings: SmoothingSettings, pose: Pose, known: Known
) -> Array:
    """All whitened residuals (R,) of one frame but its sights'."""
    bones = forward(skeleton, pose)
    seen = jnp.isfinite(known.targets)
    off = site_positions(skeleton, bones, markers) - jnp.where(seen, known.targets, 0.0)
    held = jnp.where(seen, off, 0.0) / settings.marker
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
            (pose.angles - skeleton.relaxed) / _ease(skeleton),
            beyond_limits(skeleton.limits, pose.angles) / settings.limit,
            (known.feet * (ankles - known.ankles) / ground).ravel(),
        ]
    )


def _ease(skeleton: Skeleton) -> Array:
    """Standard deviations (D,) of the joints about the relaxed pose, radians."""
    degrees = [
        next((ease for start, ease in EASE.items() if joint.startswith(start)), 40)
        for joint in skeleton.tree.joints
    ]
    return jnp.asarray(np.radians(degrees), skeleton.relaxed.dtype)
