"""Where the feet stand, and where a body is first placed.

INPUTS: marker targets (world, metres; NaN where missing), the last pose, where the feet stood.
OUTPUTS: where they stand, planted again where the head has left them; the relaxed pose placed by
markers.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Frames, forward, landmark_sites, site_positions
from jaxmocap.body.model import SIDES, Model
from jaxmocap.body.pose import Pose, relaxed_pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.evidence.markers import are_present
from jaxmocap.geometry.rotations import HIGHEST, quaternion_to_matrix, rotate
from jaxmocap.hybrid.settings import IKSettings

# Hands that are less far apart tell no direction, metres along the ground.
HANDS_APART_M = 0.2


class FootPlacement(NamedTuple):
    """Where the feet stand."""

    ankles: Array  # (2, 3) left and right, world, metres
    overstretched: Array  # () whether an unmarked foot was missed in the last frame


def replant(
    model: Model, settings: IKSettings, pose: Pose, feet: FootPlacement, targets: Array
) -> tuple[FootPlacement, Array]:
    """Plant unmarked feet below the head where it has left them, or a leg was overstretched.

    Args:
        model: of the person and the markers.
        settings: traced.
        pose: the last one.
        feet: where they stood.
        targets: (M, 3) markers, world, metres; NaN where missing.

    Returns:
        Where they stand, and whether they were planted again.
    """
    if not model.unmarked_feet or settings.feet == "stand":
        return feet, jnp.zeros((), bool)
    skeleton = model.skeleton
    above, is_measured = _head_target(model, targets)
    middle = jnp.mean(feet.ankles, 0)
    thigh, shank = skeleton.tree.bones_in("thigh", "shank", side="l")
    leg = skeleton.lengths[thigh] + skeleton.lengths[shank]
    away = jnp.sum((above - middle)[:2] ** 2) > (settings.stance_radius * leg) ** 2
    planted = is_measured & (away | feet.overstretched)
    below = stand_below(skeleton, settings, above, quaternion_to_matrix(pose.quaternion)[:, 1])
    ankles = jnp.where(planted, below, feet.ankles)
    return FootPlacement(ankles, jnp.zeros((), bool)), planted


def _head_target(model: Model, targets: Array) -> tuple[Array, Array]:
    """Mean (3,) of the markers on head or neck that are there, and whether there is one."""
    on_head = np.isin(model.markers.bones, model.skeleton.tree.bones_in("head"))
    chosen = are_present(targets) & on_head
    return _mean_of(targets, chosen), jnp.any(chosen)


def _mean_of(targets: Array, chosen: Array) -> Array:
    """Mean (3,) of the chosen (M,) targets; 0 where none is."""
    total = jnp.sum(jnp.where(chosen[:, None], targets, 0.0), 0)
    return total / jnp.maximum(jnp.sum(chosen), 1).astype(total.dtype)


def stand_below(skeleton: Skeleton, settings: IKSettings, above: Array, left: Array) -> Array:
    """Ankles (2, 3) on the ground, hip-width apart along ``left`` (3,), below a point."""
    level = left.at[2].set(0.0)
    level = level / jnp.maximum(jnp.linalg.norm(level), 1e-6)
    hip = skeleton.lengths[skeleton.tree.bones_in("hip", side="l")[0]]
    ankle = skeleton.diameters[skeleton.tree.bones_in("foot", side="l")[0], 0]
    ground = above.at[2].set(settings.floor + ankle)
    return jnp.stack([ground + hip * level, ground - hip * level])


def place(
    model: Model, settings: IKSettings, targets: Array, frames: Frames | None = None
) -> tuple[Pose, FootPlacement]:
    """The relaxed pose, placed by the markers in closed form.

    The body is shifted and turned about the vertical so that its effectors lie nearest to the
    markers in the least-squares sense (a planar Procrustes problem); of the two answers that a
    symmetric marker set may leave, rounding decides nothing: left and right are labelled. Without
    two markers apart from each other horizontally the heading stays +x.

    Args:
        model: of the person and the markers.
        settings: traced.
        targets: (M, 3) markers, world, metres.
        frames: of the bones in the relaxed pose; found without them.
    """
    skeleton, pose, mask = model.skeleton, relaxed_pose(model.skeleton), are_present(targets)
    frames = frames or forward(skeleton, pose)
    points = site_positions(skeleton, frames, model.markers)
    weight = mask.astype(points.dtype)[:, None] / jnp.maximum(jnp.sum(mask), 1).astype(points.dtype)
    present = jnp.where(mask[:, None], targets, 0.0)
    mean_body, mean_world = jnp.sum(weight * points, 0), jnp.sum(weight * present, 0)
    a, b = points - mean_body, jnp.where(mask[:, None], present - mean_world, 0.0)
    cosine = jnp.sum(weight[:, 0] * (a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]))
    sine = jnp.sum(weight[:, 0] * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    yaw = jnp.arctan2(sine, jnp.where(jnp.abs(cosine) + jnp.abs(sine) < 1e-6, 1.0, cosine))
    zero = jnp.zeros_like(yaw)
    quaternion = jnp.stack([jnp.cos(yaw / 2), zero, zero, jnp.sin(yaw / 2)])
    R = quaternion_to_matrix(quaternion)
    above, is_measured = _head_target(model, targets)
    by_head = above - rotate(R, landmark_above(skeleton, frames))
    position = jnp.where(is_measured, by_head, mean_world - rotate(R, mean_body))
    ankles = stand_below(skeleton, settings, position, R[:, 1])
    placed = FootPlacement(ankles, jnp.zeros((), bool))
    return Pose(position, quaternion, pose.angles), placed


def faces_away(model: Model, pose: Pose, targets: Array) -> Array:
    """Whether the hands lie as only somebody has them who faces the other way.

    Feet that stand keep a body from turning with somebody who turns on the spot. A left hand to the
    right of the other says so, unless both are where crossed arms have them: ahead of the body,
    which for who faces the other way is behind it.

    Args:
        model: of the person and the markers.
        pose: the last one.
        targets: (M, 3) markers, world, metres; NaN where missing.

    Returns:
        (); False where a foot or only one arm is marked.
    """
    tree, bones = model.skeleton.tree, model.markers.bones
    on_arms = [np.isin(bones, tree.bones_in("forearm", "hand", side=side)) for side in SIDES]
    if not model.no_foot_is_marked or not all(on_arm.any() for on_arm in on_arms):
        return jnp.zeros((), bool)
    present = [are_present(targets) & on_arm for on_arm in on_arms]
    left, right = (_mean_of(targets, chosen)[:2] for chosen in present)
    above, is_measured = _head_target(model, targets)
    across, ahead = left - right, (left + right) / 2 - above[:2]
    apart, facing = jnp.linalg.norm(across), quaternion_to_matrix(pose.quaternion)[:2, 0]
    turned = jnp.stack([across[1], -across[0]]) / jnp.maximum(apart, HANDS_APART_M)
    facing = facing / jnp.maximum(jnp.linalg.norm(facing), 1e-6)
    is_away = (apart > HANDS_APART_M) & (jnp.sum(facing * turned) < 0)
    is_away &= jnp.sum(ahead * (turned - facing)) > 0
    return is_away & is_measured & jnp.any(present[0]) & jnp.any(present[1])


def landmark_above(skeleton: Skeleton, frames: Frames) -> Array:
    """The head bone's far end (3,)."""
    head = skeleton.tree.bones_in("head")[-1]
    along = skeleton.lengths[head] * skeleton.directions[head]
    return frames.joints_world[head] + jnp.matmul(
        frames.R_world_bone[head], along, precision=HIGHEST
    )


def standing(model: Model, pose: Pose) -> FootPlacement:
    """The feet as a pose has them."""
    ankles = landmark_sites(model.skeleton, ("ankle_l", "ankle_r"))
    points = site_positions(model.skeleton, forward(model.skeleton, pose), ankles)
    return FootPlacement(points, jnp.zeros((), bool))
