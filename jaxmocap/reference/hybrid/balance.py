"""Balance in a squat (section 5.3): tau_i = p_i * delta h.

INPUTS: a skeleton, a pose, the factors. OUTPUTS: the bowed pose; float64.
"""

from types import SimpleNamespace
from typing import Any

import numpy as np

from jaxmocap.reference.hybrid.ik import Pose, as_pose
from jaxmocap.reference.hybrid.mass import base_of_support, centre_of_gravity
from jaxmocap.reference.kinematics import forward, site_positions

SPINE = ("spine1", "spine2", "spine3")
# A foot higher above the other, or above the ground, than this is lifted, metres.
LIFTED = 0.04
# A pelvis sunk by less leaves the pose as it is, metres.
LEAST_SINKING = 0.005


def ankles(skeleton: Any, pose: Any) -> np.ndarray:
    """Both ankles (2, 3), world, metres."""
    frames = forward(skeleton, pose)
    return np.array([frames.joints_world[skeleton.tree.bone(f"foot_{side}")] for side in "lr"])


def sinking(skeleton: Any, pose: Any) -> float:
    """Delta h: how far the pelvis is below its height when standing relaxed, metres."""
    relaxed = Pose(np.zeros(3), np.array([1.0, 0, 0, 0]), np.asarray(skeleton.relaxed, float))
    standing = -np.mean(ankles(skeleton, relaxed)[:, 2])
    now = float(pose.position[2]) - np.mean(ankles(skeleton, pose)[:, 2])
    return max(float(standing - now), 0.0)


def on_both_feet(ankles_world: np.ndarray, floor: float, ankle_height: float) -> bool:
    """Whether neither of the two ankles (2, 3) is lifted or in flight."""
    left, right = (z - floor - ankle_height for z in ankles_world[:, 2])
    return bool(abs(left - right) < LIFTED and max(left, right) < 2 * LIFTED)


def bow(skeleton: Any, pose: Any, angles: np.ndarray) -> Pose:
    """Turn the spine's bones by (3,) tau_i, radians, as far as their ranges allow."""
    position, quaternion, bent = as_pose(pose)
    bent = bent.copy()
    for name, tau in zip(SPINE, angles, strict=True):
        dof = skeleton.tree.dof_bones.index(skeleton.tree.bone(name))
        low, high = (float(limit) for limit in skeleton.limits[dof])
        bent[dof] = min(max(bent[dof] + tau, low), high)
    return Pose(position, quaternion, bent)


def bow_on_feet(
    skeleton: Any, settings: Any, pose: Any, factors: np.ndarray
) -> tuple[Pose, np.ndarray, bool]:
    """Equation tau_i = p_i * delta h, where the body stands on both feet and has sunk.

    Returns:
        The pose, the degrees of freedom (6 + D,) that may move to meet the markers again, and
        whether the spine was bowed.
    """
    height = float(skeleton.diameters[skeleton.tree.bone("foot_l"), 0])
    sunk = sinking(skeleton, pose)
    standing = on_both_feet(ankles(skeleton, pose), float(settings.floor), height)
    free = np.ones(len(skeleton.costs), bool)
    if not standing or sunk <= LEAST_SINKING:
        return as_pose(pose), free, False
    for name in SPINE:
        free[6 + skeleton.tree.dof_bones.index(skeleton.tree.bone(name))] = False
    # The pelvis may not lean back against the bow: its turns about the world's x and y stay.
    free[3], free[4] = False, False
    return bow(skeleton, pose, np.asarray(factors, float) * sunk), free, True


def imbalance(skeleton: Any, pose: Any) -> tuple[float, float]:
    """The centre of gravity before the middle of the feet, and outside of their box, metres."""
    frames = forward(skeleton, pose)
    gravity = centre_of_gravity(skeleton, frames)[:2]
    low, high = base_of_support(site_positions(skeleton, frames, _feet(skeleton)))
    facing = frames.R_world_bone[skeleton.tree.bone("hip_l"), :2, 0]
    ahead = (gravity - (low + high) / 2) @ facing / np.linalg.norm(facing)
    outside = np.maximum(np.maximum(low - gravity, gravity - high), 0.0)
    return float(ahead), float(np.linalg.norm(outside))


def _feet(skeleton: Any) -> Any:
    """Ankles and toes of both feet, as points on bones."""
    feet = [skeleton.tree.bone(f"foot_{side}") for side in "lr"]
    return SimpleNamespace(bones=feet + feet, at=[0.0, 0.0, 1.0, 1.0], offsets=np.zeros((4, 3)))
