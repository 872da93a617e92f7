"""Which joints a set of markers determines beyond the paper's 21, by where the markers sit.

Head, hands and feet leave trunk, clavicles and ankles open; markers on pelvis, chest, shoulders and
all limbs do not. In a usual posture, with limbs a little bent, the markers' Jacobian shows how far
each joint and each landmark stays open.

INPUTS: a Skeleton, places of markers. OUTPUTS: the skeleton, with more joints where they are many.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Sites, forward, jacobian, landmark_sites, site_positions
from jaxmocap.body.model import Placed, marker_sites
from jaxmocap.body.model_files import MARKED, joint_rows
from jaxmocap.body.pose import relaxed_pose
from jaxmocap.body.skeleton import Skeleton, with_added_joints
from jaxmocap.body.tree import ROOT_DOF

# Standard deviation of a marker about its point on the body, metres.
MARKER_M = 0.01
# Markers determine a body where they leave none of these landmarks more open than this, metres.
OPEN_M = 0.05
LIMBS = tuple(
    f"{joint}_{side}"
    for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    for side in "lr"
)
# A joint is determined where its deviation falls to this share of the usual one.
DETERMINED_SHARE = 0.7
# Radians by which limbs are bent: straight, an elbow's or a knee's side would stay open.
BENT = {"elbow_flex": 0.7, "knee_flexion": 0.5, "arm_flex": 0.5, "arm_abduct": 0.5}


def with_marked_joints(skeleton: Skeleton, places: Sequence[Placed]) -> Skeleton:
    """The skeleton with those joints of ``markers.toml`` that the markers determine.

    The skeleton as it is, where markers leave trunk or limbs open.
    """
    rows = joint_rows(MARKED)
    full = with_added_joints(skeleton, rows)
    if not determine_body(full, marker_sites(full, places)):
        return skeleton
    shares = np.asarray(_left_open(full, marker_sites(full, places))[1])
    determined = {
        joint for joint, share in zip(full.tree.joints, shares, strict=True)
        if share < DETERMINED_SHARE
    }  # fmt: skip
    return with_added_joints(skeleton, [row for row in rows if row["name"] in determined])


def determine_body(skeleton: Skeleton, markers: Sites) -> bool:
    """Whether markers leave neither the trunk nor a limb open."""
    # Fewer coordinates than unknowns cannot.
    if 3 * len(markers.bone_indices) < len(skeleton.tree.joints):
        return False
    return bool(_left_open(skeleton, markers)[0].max() < OPEN_M)


@jax.jit
def _left_open(skeleton: Skeleton, markers: Sites) -> tuple[Array, Array]:
    """Deviations of the ``LIMBS``, metres, and (D,) of the joints, as shares of the usual ones."""
    bent = [BENT.get(joint.rpartition("_")[0], 0.0) for joint in skeleton.tree.joints]
    pose = relaxed_pose(skeleton)
    pose = pose._replace(angles=pose.angles + jnp.asarray(bent, pose.angles.dtype))
    frames, usual = forward(skeleton, pose), skeleton.usual_deviations

    def derivatives(sites: Sites) -> Array:
        points = site_positions(skeleton, frames, sites)
        return jacobian(skeleton, frames, sites.bones, points).reshape(-1, ROOT_DOF + usual.size)

    J, limbs = derivatives(markers), derivatives(landmark_sites(skeleton, LIMBS))
    prior = jnp.concatenate([jnp.ones(ROOT_DOF, usual.dtype), 1 / usual**2])
    covariance = jnp.linalg.inv(J.T @ J / MARKER_M**2 + jnp.diag(prior))
    spread = jnp.einsum("ij,jk,ik->i", limbs, covariance, limbs).reshape(-1, 3)
    of_joints = jnp.sqrt(jnp.diag(covariance)[ROOT_DOF:])
    return jnp.sqrt(jnp.sum(spread, -1)), of_joints / usual
