"""The two arms as the video step sees them: three limbs each, hung on a shoulder, held by a grip.

INPUTS: a Skeleton and its Frames. OUTPUTS: Arms, left then right, and their flesh.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Frames, Sites, forward, site_positions
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton, landmark_rows
from jaxmocap.body.surfaces.cones import Cones
from jaxmocap.body.tree import Tree
from jaxmocap.compilation.arrays import Numbers, namespace
from jaxmocap.geometry.rotations import (
    about_axis,
    compose,
    cross,
    exp,
    nearest_hinges,
    quaternion_log,
    rotate,
)

SIDES = ("l", "r")
# Rows (2, 4) of shoulder, elbow, wrist and tip among the landmarks.
ARM_LANDMARKS = np.stack(
    [
        landmark_rows(f"{name}_{side}" for name in ("shoulder", "elbow", "wrist", "hand"))
        for side in SIDES
    ]
)


class Arms(NamedTuple):
    """Left and right arm, world, metres. The forearm and the hand are one rigid piece."""

    shoulder: Array  # (2, 3)
    elbow: Array  # (2, 3)
    wrist: Array  # (2, 3)
    tip: Array  # (2, 3) far end of the hand
    grip: Array  # (2, 3) the point that the arm's marker holds; the wrist where it carries none
    R_world_radius: Array  # (2, 3, 3) orientation of the forearm
    humerus_length: Array  # (2,)
    radii: Array  # (2, 3, 2) of humerus, radius and hand at their two ends


def limb_bones(tree: Tree) -> np.ndarray:
    """Indices (2, 3) of upper arm, forearm and hand, left and right."""
    return np.stack([tree.bones_in("arm", side=side) for side in SIDES])


def grips(skeleton: Skeleton, markers: Sites) -> Sites:
    """The point (2) of each arm that its first marker on forearm or hand holds, else the wrist."""
    bones, on = limb_bones(skeleton.tree), markers.bones
    chosen = [np.flatnonzero(np.isin(on, arm[1:]))[:1] for arm in bones]
    rows = np.array([own[0] if own.size else len(on) for own in chosen], np.int32)
    carriers = [
        int(on[row]) if row < len(on) else int(hand)
        for row, hand in zip(rows, bones[:, 2], strict=True)
    ]
    # Where an arm carries no marker: its wrist, which follows the markers' own points.
    at = jnp.append(jnp.asarray(markers.at), jnp.zeros((), markers.at.dtype))
    offsets = jnp.concatenate([jnp.asarray(markers.offsets), jnp.zeros((1, 3), markers.at.dtype)])
    return Sites(carriers, at[rows], offsets[rows])


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


# Directions in which a search turns a forearm about its grip, seen from where markers put it.
FARTHEST_TURN_DEG = 75.0
TURN_SPACING_DEG = 10.0


def forearm_turns() -> np.ndarray:
    """Rotation vectors (K, 3), radians, about x and y of the forearm: a hexagonal grid."""
    spacing = TURN_SPACING_DEG
    reach = int(FARTHEST_TURN_DEG / (spacing * np.sqrt(0.75))) + 1
    rows, columns = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-2 * reach, 2 * reach + 1))
    x = (columns + 0.5 * (rows % 2)) * spacing
    y = rows * spacing * np.sqrt(0.75)
    kept = np.hypot(x, y) <= FARTHEST_TURN_DEG
    flat = np.stack([x[kept], y[kept], np.zeros(kept.sum())], 1)
    return np.radians(flat)


TURNS = forearm_turns()


# About which of its points an arm is turned: the grip, which a marker holds; or, where it carries
# none, the shoulder with all of the arm, and the elbow with the forearm.
GRIP, SHOULDER, ELBOW = range(3)
AT_GRIPS = np.array([GRIP, GRIP], np.int32)


def unmarked_arms(tree: Tree, markers: Sites, points: Numbers) -> Numbers:
    """(..., 2) which arms carry no marker that is there, of points (..., M, 3), NaN for missing."""
    xp = namespace(points)
    is_present = xp.isfinite(points).all(-1)
    on = [np.isin(markers.bones, tree.bones_in("arm", side=side)) for side in SIDES]
    return xp.stack([~(is_present & own).any(-1) for own in on], -1)


def with_pivots(arms: Arms, pivots: Array | np.ndarray) -> Arms:
    """The same arms, that which they are turned about (2,) in place of their grips."""
    pivots = jnp.asarray(pivots)[:, None]
    joint = jnp.where(pivots == SHOULDER, arms.shoulder, arms.elbow)
    return arms._replace(grip=jnp.where(pivots == GRIP, arms.grip, joint))


class Hung(NamedTuple):
    """Arms hung on a fixed trunk, to be moved by their own joints alone (left, right)."""

    angles: Array  # (2, 4) of the pose, shoulder to elbow, radians
    R_world_carrier: Array  # (2, 3, 3) orientations of the clavicles
    axes: Array  # (2, 4, 3) hinge axes, shoulder to elbow, each in the frame its predecessors leave
    limits: Array | None  # (2, 4, 2) that decide between two answers, radians; or none do
    reaches: Array  # (2, 3, 3) vectors along humerus, radius and hand, each in its bone's frame
    grip: Array  # (2, 3) in the forearm's frame, from the elbow
    arms: Arms  # at the pose that the trunk was taken from, with their pivots for grips


def arm_dofs(tree: Tree) -> np.ndarray:
    """Indices (2, 4) of each arm's degrees of freedom, shoulder to elbow; no twist, no wrist."""
    bones = limb_bones(tree)
    rows = [np.flatnonzero(np.isin(tree.dof_bones, arm[:2]))[:4] for arm in bones]
    return np.array(rows, np.int32)


def hang(
    skeleton: Skeleton,
    pose: Pose,
    grip_sites: Sites,
    pivots: Array | np.ndarray = AT_GRIPS,
    limited: bool = True,
) -> Hung:
    """The arms of a pose, ready to be moved by their own joints alone, or about pivots (2,).

    Of the two ways to write a shoulder's rotation the one within its limits counts, where these
    are ``limited`` and the other is not; else the one nearer to the pose's.
    """
    bones, dofs = limb_bones(skeleton.tree), arm_dofs(skeleton.tree)
    frames = forward(skeleton, pose)
    arms = arms_of(skeleton, frames, grip_sites)
    carriers = np.array(skeleton.tree.parents, np.int32)[bones[:, 0]]
    reaches = skeleton.lengths[bones][..., None] * skeleton.directions[bones]
    R_world_radius = arms.R_world_radius
    if np.isin(skeleton.tree.dof_bones, bones).sum() > dofs.size:
        # Twist and wrists stay as they are: what they turn is carried as the elbow leaves it.
        hinges = about_axis(skeleton.axes[dofs[:, 3]], pose.angles[dofs[:, 3]])
        R_world_radius = compose(frames.R_world_bone[bones[:, 0]], hinges)
        hand = rotate(R_world_radius.swapaxes(-1, -2), arms.tip - arms.wrist)
        reaches = reaches.at[:, 2].set(hand)
    to_radius = R_world_radius.swapaxes(-1, -2)
    return Hung(
        pose.angles[dofs],
        frames.R_world_bone[carriers],
        skeleton.axes[dofs],
        skeleton.limits[dofs] if limited else None,
        reaches,
        rotate(to_radius, arms.grip - arms.elbow),
        with_pivots(arms, pivots),
    )


def swing(hung: Hung, moves: Array) -> tuple[Arms, Array]:
    """The arms (2) bent, and then swung about the axis from shoulder to grip.

    The swing, an arm's swivel, moves no grip however far it goes; along the joints' angles the same
    way is curved, and a simplex would hardly slide along it.

    Args:
        hung: arms of a pose.
        moves: (2, 4) the swivel, then what is added to the shoulder's first two angles and to the
            elbow's, radians.

    Returns:
        The arms, and their (2, 4) joint angles, radians.
    """
    added = jnp.zeros_like(moves).at[:, np.array([0, 1, 3])].set(moves[:, 1:])
    angles = hung.angles + added
    hinges = about_axis(hung.axes, angles)
    R_humerus = compose(compose(hinges[:, 0], hinges[:, 1]), hinges[:, 2])
    R_world_humerus = compose(hung.R_world_carrier, R_humerus)
    R_world_radius = compose(R_world_humerus, hinges[:, 3])
    elbow = rotate(R_world_humerus, hung.reaches[:, 0])
    wrist = elbow + rotate(R_world_radius, hung.reaches[:, 1])
    grip = elbow + rotate(R_world_radius, hung.grip)
    axis = grip / jnp.sqrt(jnp.sum(grip**2, -1, keepdims=True) + 1e-12)
    R_swing = about_axis(axis, moves[:, 0])
    tip = wrist + rotate(R_world_radius, hung.reaches[:, 2])
    shoulder = hung.arms.shoulder
    arms = hung.arms._replace(
        elbow=shoulder + rotate(R_swing, elbow),
        wrist=shoulder + rotate(R_swing, wrist),
        tip=shoulder + rotate(R_swing, tip),
        grip=shoulder + grip,
        R_world_radius=compose(R_swing, R_world_radius),
    )
    R_local = compose(hung.R_world_carrier.swapaxes(-1, -2), compose(R_swing, R_world_humerus))
    turned = jax.vmap(nearest_hinges)(R_local, hung.axes[:, :3], angles[:, :3])
    return arms, jnp.concatenate([turned, angles[:, 3:]], -1)


def bent(hung: Hung, arm: Arms) -> Array:
    """Joint angles (4,), shoulder to elbow, that bring one arm (no batch) to where it is.

    The elbow's hinge is across the plane of upper arm and forearm; of a straight arm it is open.
    Its shoulder's place does not count.
    """
    upper, fore = arm.elbow - arm.shoulder, arm.wrist - arm.elbow
    local_upper, axis = hung.reaches[0], hung.axes[3]
    across = cross(upper, fore)
    # As much across as along: the angle between the two.
    elbow = jnp.arctan2(jnp.sqrt(jnp.sum(across**2) + 1e-12), jnp.sum(upper * fore))
    local = _upright(local_upper, axis)
    R_world_humerus = compose(_upright(upper, across).T, local)
    R = compose(hung.R_world_carrier.T, R_world_humerus)
    limits = None if hung.limits is None else hung.limits[:3]
    return jnp.append(nearest_hinges(R, hung.axes[:3], hung.angles[:3], limits), elbow)


def _upright(along: Array, across: Array) -> Array:
    """Rows (3, 3) of the frame whose first axis is along one vector, the second across it."""
    x = along / jnp.sqrt(jnp.sum(along**2) + 1e-12)
    y = across - x * jnp.sum(x * across)
    y = y / jnp.sqrt(jnp.sum(y**2) + 1e-12)
    return jnp.stack([x, y, cross(x, y)])


def flesh(arms: Arms) -> Cones:
    """Sphere-swept cones (2, 3) of the arms."""
    near = jnp.stack([arms.shoulder, arms.elbow, arms.wrist], -2)
    far = jnp.stack([arms.elbow, arms.wrist, arms.tip], -2)
    return Cones(near, far, arms.radii)


def turn_forearm(arms: Arms, R_turn: Array) -> tuple[Arms, Array]:
    """Turn one forearm (no batch) about its grip; the upper arm follows, the shoulder gives way.

    About another pivot that is where its grip is, see ``with_pivots``.

    Args:
        arms: one arm.
        R_turn: (..., 3, 3) in the world, one or many.

    Returns:
        The arm (what moves is (..., 3)), and by how much (...) the shoulder had to move along the
        upper arm, metres.
    """
    elbow, wrist, tip = (
        arms.grip + rotate(R_turn, point - arms.grip)
        for point in (arms.elbow, arms.wrist, arms.tip)
    )
    upper = arms.shoulder - elbow
    length = jnp.sqrt(jnp.sum(upper**2, -1) + 1e-12)
    shoulder = elbow + upper * (arms.humerus_length / length)[..., None]
    moved = arms._replace(shoulder=shoulder, elbow=elbow, wrist=wrist, tip=tip)
    return moved, length - arms.humerus_length


def side_of(arms: Arms, side: int | Array) -> Arms:
    """One of both arms."""
    return jax.tree.map(lambda part: part[side], arms)


def turn_arms(arms: Arms) -> tuple[Arms, Array]:
    """Candidates (2, K) of both arms, and by how much (2, K) their shoulders give way."""
    turns = jnp.asarray(TURNS, arms.elbow.dtype)
    return jax.vmap(jax.vmap(_turn_arm, (None, 0)), (0, None))(arms, turns)


def _turn_arm(arm: Arms, turn: Array) -> tuple[Arms, Array]:
    """``turn_forearm`` by a rotation vector (3,) in the forearm's own frame, radians."""
    R = arm.R_world_radius
    return turn_forearm(arm, compose(compose(R, exp(turn)), R.T))


def turned_angles(hung: Hung, arms: Arms) -> Array:
    """Joint angles (2, K, 4), shoulder to elbow, of both arms' candidates (2, K)."""
    return jax.vmap(jax.vmap(bent, (None, 0)))(hung, arms)


def turn_pose(
    skeleton: Skeleton,
    pose: Pose,
    grip_sites: Sites,
    turns: Array,
    pivots: Array | np.ndarray = AT_GRIPS,
    limited: bool = True,
) -> Pose:
    """A pose whose arms turn about their pivots by (2, 3), radians; 0 leaves an arm alone."""
    hung = hang(skeleton, pose, grip_sites, pivots, limited)
    dofs = arm_dofs(skeleton.tree)
    angles = jax.vmap(bent)(hung, jax.vmap(_turn_arm)(hung.arms, turns)[0])
    moves = jnp.any(turns != 0, -1, keepdims=True)
    return pose._replace(
        angles=pose.angles.at[dofs].set(jnp.where(moves, angles, pose.angles[dofs]))
    )


def turn_between(arms: Arms, refined: Arms) -> Array:
    """Rotation vectors (2, 3), the shortest, between two forearms, in the frame of the first."""
    R = arms.R_world_radius
    a = rotate(R.swapaxes(1, 2), arms.elbow - arms.grip)
    b = rotate(R.swapaxes(1, 2), refined.elbow - refined.grip)
    a, b = (each / jnp.sqrt(jnp.sum(each**2, -1, keepdims=True) + 1e-12) for each in (a, b))
    half = jnp.concatenate([1 + jnp.sum(a * b, -1, keepdims=True), cross(a, b)], -1)
    norm = jnp.sqrt(jnp.sum(half**2, -1, keepdims=True) + 1e-12)
    return quaternion_log(half / norm)


def swivels(arms: Arms, refined: Arms) -> Array:
    """Turns (2,) of the elbows about the axis from shoulder to grip, radians."""
    axis = refined.grip - refined.shoulder
    axis = axis / jnp.sqrt(jnp.sum(axis**2, -1, keepdims=True) + 1e-12)

    def across(points: Array) -> Array:
        return points - jnp.sum(points * axis, -1, keepdims=True) * axis

    a, b = across(arms.elbow - arms.shoulder), across(refined.elbow - refined.shoulder)
    sine = jnp.sum(cross(a, b) * axis, -1)
    cosine = jnp.sum(a * b, -1)
    still = jnp.abs(sine) + jnp.abs(cosine) < 1e-9
    return jnp.where(still, 0.0, jnp.arctan2(sine, jnp.where(still, 1.0, cosine)))
