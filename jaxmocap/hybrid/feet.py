"""Where the feet stand, and where a body is first placed.

INPUTS: marker targets (world, metres) with a mask, the last pose and stance.
OUTPUTS: the stance, planted anew where the head has left it; the relaxed pose placed by markers.
"""

from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Sites, forward, joined_sites, landmark_sites, site_positions
from jaxmocap.body.pose import Pose, relaxed_pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.geometry.rotations import HIGHEST, quaternion_to_matrix, rotate
from jaxmocap.hybrid.settings import IKSettings

SIDES = ("l", "r")


class Effectors(NamedTuple):
    """Everything that is held somewhere: M markers, then the feet that carry none.

    Attributes:
        sites: (M + F) points on bones.
        held: sides ("l", "r") of the F feet held where they stand.
    """

    sites: Sites
    held: tuple[str, ...]


class Stance(NamedTuple):
    """Where the feet stand.

    Attributes:
        ankles: (2, 3) left and right, world, metres.
        overstretched: () whether a held foot was missed in the last frame.
    """

    ankles: Array
    overstretched: Array


def on_held_feet(skeleton: Skeleton, held: tuple[str, ...]) -> Skeleton:
    """The skeleton as inverse kinematics takes it while neither foot carries a marker.

    Nothing tells then how the trunk leans, and a straight leg cannot be shortened to the first
    order: a sinking head would bend neck and trunk instead of the knees. So the knees stay soft
    and cheap, and the trunk is stiff. With markers on both legs the skeleton stays as it is.
    """
    if len(held) < len(SIDES):
        return skeleton
    low = jnp.maximum(skeleton.limits[:, 0], skeleton.unmarked_least)
    return replace(
        skeleton,
        costs=skeleton.costs * skeleton.unmarked_costs,
        relaxed=jnp.maximum(skeleton.relaxed, skeleton.unmarked_relaxed),
        limits=jnp.stack([low, skeleton.limits[:, 1]], -1),
    )


def effectors(skeleton: Skeleton, markers: Sites) -> Effectors:
    """Markers, and the ankles of those feet that carry no marker on tibia or foot."""
    tree = skeleton.tree
    held = tuple(
        side
        for side in SIDES
        if not np.isin(markers.bones, tree.bones_in("shank", "foot", side=side)).any()
    )
    ankles = landmark_sites(skeleton, tuple(f"ankle_{side}" for side in held))
    return Effectors(joined_sites(markers, ankles), held)


def replant(
    skeleton: Skeleton,
    held: Effectors,
    settings: IKSettings,
    pose: Pose,
    stance: Stance,
    targets: Array,
    mask: Array,
) -> tuple[Stance, Array]:
    """Plant the held feet below the head where it has left them, or a leg was overstretched."""
    if not held.held:
        return stance, jnp.zeros((), bool)
    above, known = _head_target(skeleton, held, targets, mask)
    middle = jnp.mean(stance.ankles, 0)
    thigh, shank = skeleton.tree.bones_in("thigh", "shank", side="l")
    leg = skeleton.lengths[thigh] + skeleton.lengths[shank]
    away = jnp.sum((above - middle)[:2] ** 2) > (settings.stance_radius * leg) ** 2
    planted = known & (away | stance.overstretched)
    anew = stand_below(skeleton, settings, above, quaternion_to_matrix(pose.quaternion)[:, 1])
    ankles = jnp.where(planted, anew, stance.ankles)
    return Stance(ankles, jnp.zeros((), bool)), planted


def _head_target(
    skeleton: Skeleton, held: Effectors, targets: Array, mask: Array
) -> tuple[Array, Array]:
    """Mean (3,) of the seen markers on head or neck, and whether there is one."""
    on_head = np.isin(held.sites.bones[: len(mask)], skeleton.tree.bones_in("head"))
    chosen = mask & on_head
    total = jnp.sum(jnp.where(chosen[:, None], targets, 0.0), 0)
    return total / jnp.maximum(jnp.sum(chosen), 1).astype(total.dtype), jnp.any(chosen)


def stand_below(skeleton: Skeleton, settings: IKSettings, above: Array, left: Array) -> Array:
    """Ankles (2, 3) on the ground, hip-width apart along ``left`` (3,), below a point."""
    level = left.at[2].set(0.0)
    level = level / jnp.maximum(jnp.linalg.norm(level), 1e-6)
    tree = skeleton.tree
    hip = skeleton.lengths[tree.bones_in("hip", side="l")[0]]
    ankle = skeleton.diameters[tree.bones_in("foot", side="l")[0], 0]
    ground = above.at[2].set(settings.floor + ankle)
    return jnp.stack([ground + hip * level, ground - hip * level])


def place(
    skeleton: Skeleton, held: Effectors, settings: IKSettings, targets: Array, mask: Array
) -> tuple[Pose, Stance]:
    """The relaxed pose, placed by the markers in closed form.

    The body is shifted and turned about the vertical so that its effectors lie nearest to the
    markers in the least-squares sense (a planar Procrustes problem); of the two answers that a
    symmetric marker set may leave, rounding decides nothing: left and right are labelled. Without
    two markers apart from each other horizontally the heading stays +x.
    """
    pose = relaxed_pose(skeleton)
    count = len(mask)
    sites = Sites(held.sites.bones[:count], held.sites.at[:count], held.sites.offsets[:count])
    points = site_positions(skeleton, forward(skeleton, pose), sites)
    weight = mask.astype(points.dtype)[:, None] / jnp.maximum(jnp.sum(mask), 1).astype(points.dtype)
    seen = jnp.where(mask[:, None], targets, 0.0)
    mean_body, mean_world = jnp.sum(weight * points, 0), jnp.sum(weight * seen, 0)
    a, b = points - mean_body, jnp.where(mask[:, None], seen - mean_world, 0.0)
    cosine = jnp.sum(weight[:, 0] * (a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]))
    sine = jnp.sum(weight[:, 0] * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))
    yaw = jnp.arctan2(sine, jnp.where(jnp.abs(cosine) + jnp.abs(sine) < 1e-6, 1.0, cosine))
    zero = jnp.zeros_like(yaw)
    quaternion = jnp.stack([jnp.cos(yaw / 2), zero, zero, jnp.sin(yaw / 2)])
    R = quaternion_to_matrix(quaternion)
    above, known = _head_target(skeleton, held, targets, mask)
    head = landmark_above(skeleton, pose)
    by_head = above - rotate(R, head)
    position = jnp.where(known, by_head, mean_world - rotate(R, mean_body))
    pose = Pose(position, quaternion, pose.angles)
    ankles = stand_below(skeleton, settings, position, R[:, 1])
    return pose, Stance(ankles, jnp.zeros((), bool))


def landmark_above(skeleton: Skeleton, pose: Pose) -> Array:
    """The head bone's far end (3,) of a pose."""
    frames = forward(skeleton, pose)
    head = skeleton.tree.bones_in("head")[-1]
    along = skeleton.lengths[head] * skeleton.directions[head]
    return frames.joints_world[head] + jnp.matmul(
        frames.R_world_bone[head], along, precision=HIGHEST
    )
