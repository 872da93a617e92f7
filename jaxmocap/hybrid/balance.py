"""Balance in a squat: the spine bows as the pelvis sinks (section 5.3).

The paper sets the factors p_i by hand for each person. Here they are computed from the skeleton:
a squat is solved by the tracker's own inverse kinematics with the spine bowed by more and more, and
the bow that brings the centre of gravity over the middle of the feet is taken.

INPUTS: a Skeleton, a pose with its goals. OUTPUTS: factors; the balanced pose.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Sites, forward, landmark_sites, site_positions
from jaxmocap.body.mass import base_of_support, centre_of_gravity
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, relaxed_pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.evidence.markers import Goals
from jaxmocap.evidence.terms import Measurements
from jaxmocap.hybrid.ik import reach
from jaxmocap.hybrid.settings import IKSettings

# The pelvis' turns about the world's horizontal axes, among the degrees of freedom.
LEAN = np.array([3, 4], np.int32)
# The squat that the factors are computed for, metres, and the depths on the way.
SQUAT, DEPTHS = 0.3, 6
# Shares of the farthest bow that are tried.
TRIALS = 9
# A foot is lifted that is higher above the other than this, or above the ground than twice this,
# metres.
LIFTED = 0.04
# A pelvis sunk by less leaves the pose as it is, metres.
LEAST_SINKING = 0.005
SUPPORTS = ("ankle_l", "ankle_r", "toe_l", "toe_r")


def spine_dofs(skeleton: Skeleton) -> np.ndarray:
    """Indices (S,) of the degrees of freedom that bow the spine: the first of each bone."""
    tree = skeleton.tree
    bones = [bone for bone in tree.bones_in("spine") if bone in tree.dof_bones]
    return np.array([tree.dof_bones.index(bone) for bone in bones], np.int32)


def standing_height(skeleton: Skeleton) -> Array:
    """Height () of the pelvis above the ankles in the relaxed pose, metres."""
    names = ("pelvis", "ankle_l", "ankle_r")
    frames = forward(skeleton, relaxed_pose(skeleton))
    heights = site_positions(skeleton, frames, landmark_sites(skeleton, names))[:, 2]
    return heights[0] - jnp.mean(heights[1:])


def sinking(skeleton: Skeleton, pose: Pose) -> Array:
    """Delta h (): how far the pelvis is below its height when standing, metres, never negative."""
    sites = landmark_sites(skeleton, ("ankle_l", "ankle_r"))
    ankles = site_positions(skeleton, forward(skeleton, pose), sites)[:, 2]
    return jnp.maximum(standing_height(skeleton) - (pose.position[2] - jnp.mean(ankles)), 0.0)


def on_both_feet(ankles_world: Array, floor: Array, ankle_height: Array) -> Array:
    """Whether neither of the two ankles (2, 3) is lifted or in flight."""
    heights = ankles_world[:, 2] - floor - ankle_height
    level = jnp.abs(heights[0] - heights[1]) < LIFTED
    return level & (jnp.max(heights) < 2 * LIFTED)


def bow(skeleton: Skeleton, pose: Pose, angles: Array) -> Pose:
    """Turn the spine's bones by (3,) tau_i, radians, as far as their ranges allow."""
    dofs = spine_dofs(skeleton)
    low, high = skeleton.limits[dofs, 0], skeleton.limits[dofs, 1]
    bent = jnp.clip(pose.angles[dofs] + angles, low, high)
    return pose._replace(angles=pose.angles.at[dofs].set(bent))


def all_but_trunk(skeleton: Skeleton) -> Array:
    """The degrees of freedom (6 + D,) that move when arms and head are solved again.

    The spine stays bowed, and the pelvis does not lean back against it: it moves and turns about
    the vertical, and the hips go back.
    """
    free = jnp.ones(skeleton.costs.shape, bool)
    return free.at[np.concatenate([LEAN, ROOT_DOF + spine_dofs(skeleton)])].set(False)


def bow_on_feet(
    skeleton: Skeleton, settings: IKSettings, pose: Pose, factors: Array
) -> tuple[Pose, Array, Array]:
    """Bow the spine where the body stands on both feet and the pelvis has sunk.

    Returns:
        The pose, the degrees of freedom (6 + D,) that may move to meet the markers again, and
        whether the spine was bowed.
    """
    sites = landmark_sites(skeleton, ("ankle_l", "ankle_r"))
    ankles = site_positions(skeleton, forward(skeleton, pose), sites)
    height = skeleton.diameters[skeleton.tree.bones_in("foot", side="l")[0], 0]
    sunk = sinking(skeleton, pose)
    bows = on_both_feet(ankles, settings.floor, height) & (sunk > LEAST_SINKING)
    bowed = bow(skeleton, pose, factors * sunk)
    angles = jnp.where(bows, bowed.angles, pose.angles)
    return pose._replace(angles=angles), ~bows | all_but_trunk(skeleton), bows


def imbalance(skeleton: Skeleton, pose: Pose) -> tuple[Array, Array]:
    """How the centre of gravity lies over the feet.

    Returns:
        Its distance () before the middle of the base of support, along the body's facing, metres,
        and by how much () it is outside of the base (0 inside).
    """
    frames = forward(skeleton, pose)
    gravity = centre_of_gravity(skeleton, frames)[:2]
    supports = site_positions(skeleton, frames, landmark_sites(skeleton, SUPPORTS))
    low, high = base_of_support(supports)
    facing = frames.R_world_bone[skeleton.tree.bones_in("hip", side="l")[0], :2, 0]
    facing = facing / jnp.maximum(jnp.sqrt(jnp.sum(facing**2)), 1e-6)
    ahead = jnp.sum((gravity - (low + high) / 2) * facing)
    outside = jnp.maximum(jnp.maximum(low - gravity, gravity - high), 0.0)
    return ahead, jnp.sqrt(jnp.sum(outside**2) + 1e-18)


def bow_factors(skeleton: Skeleton, settings: IKSettings) -> Array:
    """Factors p_i (S,), radians per metre, for a squat of ``SQUAT`` metres.

    The three bones share the bow in proportion to their ranges.
    """
    dofs = spine_dofs(skeleton)
    most = skeleton.limits[dofs, 1] - skeleton.relaxed[dofs]
    model = Model.create(skeleton, squat_goals(skeleton, 0.0).sites)
    standing = relaxed_pose(skeleton)
    trunk_stays = all_but_trunk(skeleton)

    def ahead(share: Array) -> Array:
        def stage(i: Array, pose: Pose) -> Pose:
            # Down by the markers, then the same with the spine bowed: as in tracking, but traced
            # once.
            down = i < DEPTHS
            goals = squat_goals(skeleton, SQUAT * jnp.minimum((i + 1) / DEPTHS, 1.0))
            tau = share * most / SQUAT * sinking(skeleton, pose)
            bowed = bow(skeleton, pose, jnp.where(down, 0.0, tau))
            return reach(model, settings, Measurements(goals=goals), bowed, down | trunk_stays)

        return imbalance(skeleton, jax.lax.fori_loop(0, DEPTHS + 1, stage, standing))[0]

    shares = jnp.linspace(0.0, 1.0, TRIALS, dtype=most.dtype)
    leads = jax.lax.map(ahead, shares)
    # The more it bows, the less it leads: between two trials it stands over the middle.
    best = jnp.interp(jnp.zeros((), most.dtype), -leads, shares)
    return best * most / SQUAT


def squat_goals(skeleton: Skeleton, depth: Array | float) -> Goals:
    """The relaxed pose's head, hands and ankles, the upper ones sunk by ``depth`` metres."""
    names = ("vertex", "wrist_l", "wrist_r", "ankle_l", "ankle_r")
    sites: Sites = landmark_sites(skeleton, names)
    points = site_positions(skeleton, forward(skeleton, relaxed_pose(skeleton)), sites)
    sunk = points.at[:3, 2].add(-depth)
    return Goals(sites, sunk, jnp.ones(len(names), points.dtype))
