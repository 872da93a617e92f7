"""The two arms as the video step sees them: three limbs each, hung on a shoulder, held by a grip.

INPUTS: a Skeleton and its Frames. OUTPUTS: Arms, left then right, and their flesh.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.flesh import Cones
from jaxmocap.body.kinematics import Frames, Sites, site_positions
from jaxmocap.body.skeleton import Skeleton, Tree
from jaxmocap.geometry.rotations import about_axis, compose, rotate

SIDES = ("l", "r")
LIMBS = ("humerus", "radius", "hand")


class Arms(NamedTuple):
    """Left and right arm, world, metres. The forearm and the hand are one rigid piece.

    Attributes:
        shoulder: (2, 3).
        elbow: (2, 3).
        wrist: (2, 3).
        tip: (2, 3) far end of the hand.
        grip: (2, 3) the point that the arm's marker holds; the wrist where it carries none.
        R_world_radius: (2, 3, 3) orientation of the forearm.
        humerus_length: (2,).
        radii: (2, 3, 2) of humerus, radius and hand at their two ends.
    """

    shoulder: Array
    elbow: Array
    wrist: Array
    tip: Array
    grip: Array
    R_world_radius: Array
    humerus_length: Array
    radii: Array


def limb_bones(tree: Tree) -> np.ndarray:
    """Indices (2, 3) of humerus, radius and hand, left and right."""
    return np.array([[tree.bone(f"{limb}_{side}") for limb in LIMBS] for side in SIDES], np.int32)


def grips(skeleton: Skeleton, markers: Sites) -> Sites:
    """The point of each arm that its first marker on forearm or hand holds, else the wrist."""
    bones = limb_bones(skeleton.tree)
    wrists = Sites(bones[:, 2], jnp.zeros(2, markers.at.dtype), jnp.zeros((2, 3), markers.at.dtype))
    chosen = list(zip(*wrists, strict=True))
    for side in range(2):
        carried = np.flatnonzero(np.isin(markers.bones, bones[side, 1:]))
        if carried.size:
            i = int(carried[0])
            chosen[side] = (markers.bones[i], markers.at[i], markers.offsets[i])
    on, at, offsets = zip(*chosen, strict=True)
    return Sites(np.array(on), jnp.stack(at), jnp.stack(offsets))


def arms_of(skeleton: Skeleton, frames: Frames, grip_sites: Sites) -> Arms:
    """The arms of a pose."""
    bones = limb_bones(skeleton.tree)
    joints, R = frames.joints_world[bones], frames.R_world_bone[bones]
    hands = bones[:, 2]
    reach = skeleton.lengths[hands, None] * skeleton.directions[hands]
    return Arms(
        joints[:, 0],
        joints[:, 1],
        joints[:, 2],
        joints[:, 2] + rotate(R[:, 2], reach),
        site_positions(skeleton, frames, grip_sites),
        R[:, 1],
        skeleton.lengths[bones[:, 0]],
        skeleton.diameters[bones] / 2,
    )


class Hung(NamedTuple):
    """Arms hung on a fixed trunk: what their joints' angles alone leave open (left, right).

    Attributes:
        R_world_carrier: (2, 3, 3) orientations of the clavicles.
        axes: (2, 4, 3) hinge axes, shoulder to elbow, each in the frame its predecessors leave.
        reaches: (2, 3, 3) vectors along humerus, radius and hand, each in its bone's frame.
        grip: (2, 3) in the forearm's frame, from the elbow.
        arms: at the pose that the trunk was taken from.
    """

    R_world_carrier: Array
    axes: Array
    reaches: Array
    grip: Array
    arms: Arms


def arm_dofs(tree: Tree) -> np.ndarray:
    """Indices (2, 4) of each arm's degrees of freedom, shoulder to elbow."""
    bones = limb_bones(tree)
    rows = [np.flatnonzero(np.isin(tree.dof_bones, arm)) for arm in bones]
    return np.array(rows, np.int32)


def hang(skeleton: Skeleton, frames: Frames, grip_sites: Sites) -> Hung:
    """The arms of a pose, ready to be bent by their own angles alone."""
    bones = limb_bones(skeleton.tree)
    arms = arms_of(skeleton, frames, grip_sites)
    carriers = np.array(skeleton.tree.parents, np.int32)[bones[:, 0]]
    to_radius = arms.R_world_radius.swapaxes(-1, -2)
    return Hung(
        frames.R_world_bone[carriers],
        skeleton.axes[arm_dofs(skeleton.tree)],
        skeleton.lengths[bones][..., None] * skeleton.directions[bones],
        rotate(to_radius, arms.grip - arms.elbow),
        arms,
    )


def bend(hung: Hung, angles: Array) -> Arms:
    """The arms (2) with their (2, 4) joint angles, radians; the hand goes with the forearm."""
    hinges = about_axis(hung.axes, angles)
    R_humerus = hung.R_world_carrier
    for i in range(3):
        R_humerus = compose(R_humerus, hinges[:, i])
    R_radius = compose(R_humerus, hinges[:, 3])
    elbow = hung.arms.shoulder + rotate(R_humerus, hung.reaches[:, 0])
    wrist = elbow + rotate(R_radius, hung.reaches[:, 1])
    return hung.arms._replace(
        elbow=elbow,
        wrist=wrist,
        tip=wrist + rotate(R_radius, hung.reaches[:, 2]),
        grip=elbow + rotate(R_radius, hung.grip),
        R_world_radius=R_radius,
    )


def flesh(arms: Arms) -> Cones:
    """Sphere-swept cones (2, 3) of the arms."""
    near = jnp.stack([arms.shoulder, arms.elbow, arms.wrist], -2)
    far = jnp.stack([arms.elbow, arms.wrist, arms.tip], -2)
    return Cones(near, far, arms.radii)


def turn_forearm(arms: Arms, R_turn: Array) -> tuple[Arms, Array]:
    """Turn one forearm (no batch) about its grip; the upper arm follows, the shoulder gives way.

    Args:
        arms: one arm.
        R_turn: (3, 3) in the world.

    Returns:
        The arm, and by how much (metres) the shoulder had to move along the upper arm.
    """
    elbow, wrist, tip = (
        arms.grip + rotate(R_turn, point - arms.grip)
        for point in (arms.elbow, arms.wrist, arms.tip)
    )
    upper = arms.shoulder - elbow
    length = jnp.sqrt(jnp.sum(upper**2) + 1e-12)
    shoulder = elbow + upper * (arms.humerus_length / length)
    moved = arms._replace(shoulder=shoulder, elbow=elbow, wrist=wrist, tip=tip)
    return moved, length - arms.humerus_length
