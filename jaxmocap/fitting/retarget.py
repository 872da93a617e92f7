"""One person's motion played by another's body, feet on the ground (second paper, Figs. 6, 32).

INPUTS: a Motion; the Skeleton of another person. OUTPUTS: that person's Motion.

Joints bend as they did. What is left is where the pelvis goes: as it went, by the length of the
legs, but so that feet on the ground are there, and go no further than they went.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from scipy.linalg import solveh_banded

from jaxmocap.body.motion import Motion, landmarks_over_time
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton

FEET = ("ankle_l", "toe_l", "ankle_r", "toe_r")
# A foot's end is on the ground so near to its usual lowest place, metres and per cent.
NEAR_M, USUAL_LOWEST = 0.03, 5.0
# How firmly, against the pelvis's own way from frame to frame: feet on the ground go as they went,
# and keep their height; the pelvis does not drift from its way where none is on the ground.
STAY, HEIGHT, ANCHOR = 100.0, 1.0, 1e-4


def retargeted(motion: Motion, skeleton: Skeleton) -> Motion:
    """The motion, played by another person.

    The skeleton is the other's, with the same bones; the motion's joints move it.

    Raises:
        ValueError: the bones are others.
    """
    mine, other = motion.skeleton, skeleton
    if other.tree.bones != mine.tree.bones:
        raise ValueError(
            f"expected the bones {', '.join(mine.tree.bones)}; found {', '.join(other.tree.bones)}"
        )
    # Bones are theirs, and what joints there are and how they turn is the motion's.
    bones = ("lengths", "directions", "masses", "centres", "diameters")
    other = replace(mine, **{key: getattr(other, key) for key in bones})
    before = feet(mine, motion.poses)
    way, feet_way = (
        scaled_by_legs(motion, other, at) for at in (np.asarray(motion.poses.position), before)
    )
    poses = Pose(jnp.zeros_like(motion.poses.position), *motion.poses[1:])
    by_feet = feet_way - feet(other, poses)
    root = jnp.asarray(_way(way, by_feet, grounded(before)), float)
    poses = poses._replace(position=root)
    return Motion(other, motion.times, poses, origin_world=motion.origin_world)


def scaled_by_legs(motion: Motion, skeleton: Skeleton, points: np.ndarray) -> np.ndarray:
    """Where points (T, ..., 3) of a motion go by the other's length of legs, world, metres.

    From where the pelvis began, and upwards from the floor.
    """
    ratio = leg_length(skeleton) / leg_length(motion.skeleton)
    floor = floors(feet(motion.skeleton, motion.poses))[1]
    origin = np.append(np.asarray(motion.poses.position[0, :2], float), floor)
    return origin + ratio * (np.asarray(points, float) - origin)


def leg_length(skeleton: Skeleton) -> float:
    """Thigh and shank, mean of both sides, metres."""
    bones = skeleton.tree.bones_in("thigh", "shank")
    return float(np.sum(np.asarray(skeleton.lengths)[bones]) / 2)


def feet(skeleton: Skeleton, poses: Pose) -> np.ndarray:
    """(T, F, 3) both ends of both feet, world, metres."""
    rows = np.array([LANDMARKS.index(name) for name in FEET])
    return landmarks_over_time(skeleton, poses, rows).astype(float)


def floors(points: np.ndarray) -> np.ndarray:
    """(2,) usual lowest height of ankles and of toes, of the ``FEET`` (T, F, 3), metres."""
    # Of left and right together: one leg may be in the air all the time.
    return np.percentile(points.reshape(len(points), 2, 2, 3)[..., 2], USUAL_LOWEST, axis=(0, 1))


def grounded(points: np.ndarray) -> np.ndarray:
    """(T, F) bool: which of the ``FEET`` (T, F, 3) are on the ground; on a treadmill they move."""
    return points[..., 2] < np.tile(floors(points), 2) + NEAR_M


def _way(wanted: np.ndarray, by_feet: np.ndarray, low: np.ndarray) -> np.ndarray:
    """The pelvis's way (T, 3): linear least squares, tridiagonal, coordinate by coordinate.

    Args:
        wanted: (T, 3) as it would go without ground.
        by_feet: (T, F, 3) as each of the feet would have it.
        low: (T, F) bool: which are on the ground.
    """
    both = STAY * (low[1:] & low[:-1])
    fixed = np.full(wanted.T.shape, ANCHOR)
    fixed[2] += HEIGHT * low.sum(1)
    pulled = ANCHOR * wanted.T
    pulled[2] += HEIGHT * np.sum(low * by_feet[..., 2], 1)
    joined = 1.0 + both.sum(1)
    steps = np.diff(wanted, axis=0) + np.einsum("tf,tfi->ti", both, np.diff(by_feet, axis=0))
    root = np.empty_like(wanted)
    for axis in range(3):
        diagonal = fixed[axis].copy()
        diagonal[1:] += joined
        diagonal[:-1] += joined
        right = pulled[axis].copy()
        right[1:] += steps[:, axis]
        right[:-1] -= steps[:, axis]
        root[:, axis] = solveh_banded(np.array([np.append(0.0, -joined), diagonal]), right)
    return root
