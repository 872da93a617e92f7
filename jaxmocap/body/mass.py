"""Centres of gravity, augmented bodies, base of support.

INPUTS: a Skeleton and its Frames. OUTPUTS: masses (kg) and points (world, metres).
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Frames
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.geometry.rotations import HIGHEST, rotate


class AugmentedBodies(NamedTuple):
    """What each degree of freedom carries (section 4.4)."""

    masses: Array  # (D,) m_i, kilograms
    arms: Array  # (D,) h_i, horizontal distance from the joint to the centre of gravity, metres


def bone_centres(skeleton: Skeleton, frames: Frames) -> Array:
    """Centres of gravity (B, 3) of the bones, world, metres."""
    along = (skeleton.centres * skeleton.lengths)[:, None] * skeleton.directions
    return frames.joints_world + rotate(frames.R_world_bone, along)


def centre_of_gravity(skeleton: Skeleton, frames: Frames) -> Array:
    """Centre of gravity (3,) of the whole body, world, metres."""
    weights = skeleton.masses / jnp.sum(skeleton.masses)
    return jnp.matmul(weights, bone_centres(skeleton, frames), precision=HIGHEST)


def augmented_bodies(skeleton: Skeleton, frames: Frames, proximal: bool = False) -> AugmentedBodies:
    """Mass and lever arm of each degree of freedom's augmented body.

    Args:
        skeleton: D degrees of freedom.
        frames: of the pose.
        proximal: take the parts between root and joint, as the paper's words read, instead of
            what the degree of freedom carries. The first spine joint's would be empty: its mass
            is 0 then.
    """
    tree = skeleton.tree
    carried = tree.carries[ROOT_DOF:]
    if proximal:
        chains = [set(tree.chain(tree.bones[bone])) - {bone} for bone in tree.dof_bones]
        carried = np.array([[i in chain for i in range(len(tree.bones))] for chain in chains])
    weights = jnp.where(carried, skeleton.masses, 0.0)
    masses = jnp.sum(weights, -1)
    moments = jnp.matmul(weights, bone_centres(skeleton, frames), precision=HIGHEST)
    empty = masses == 0
    joints = frames.joints_world[np.array(tree.dof_bones)]
    centres = jnp.where(empty[:, None], joints, moments / jnp.where(empty, 1.0, masses)[:, None])
    squared = jnp.sum((centres - joints)[:, :2] ** 2, -1)
    on_axis = squared < 1e-12
    arms = jnp.where(on_axis, 0.0, jnp.sqrt(jnp.where(on_axis, 1.0, squared)))
    return AugmentedBodies(masses, arms)


def base_of_support(points_world: Array) -> tuple[Array, Array]:
    """Smallest and largest corner (2,) of the box that the supporting points (P, 3) span (5.3)."""
    ground = points_world[:, :2]
    return jnp.min(ground, 0), jnp.max(ground, 0)
