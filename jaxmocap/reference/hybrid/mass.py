"""Centres of gravity, augmented bodies, base of support, bone by bone.

INPUTS: a skeleton and its frames. OUTPUTS: masses (kg) and points (world, metres); float64.
"""

from typing import Any, NamedTuple

import numpy as np

from jaxmocap.reference.kinematics import bone_vector


class AugmentedBodies(NamedTuple):
    """What each of D degrees of freedom carries (section 4.4)."""

    masses: np.ndarray  # (D,) m_i, kilograms
    # (D,) h_i, horizontal distance from the joint to the centre of gravity, metres.
    arms: np.ndarray


def bone_centres(skeleton: Any, frames: Any) -> np.ndarray:
    """Centres of gravity (B, 3) of the bones, world, metres."""
    centres = []
    for bone in range(len(skeleton.tree.bones)):
        local = float(skeleton.centres[bone]) * bone_vector(skeleton, bone)
        centres.append(frames.joints_world[bone] + frames.R_world_bone[bone] @ local)
    return np.array(centres)


def centre_of_gravity(skeleton: Any, frames: Any) -> np.ndarray:
    """Centre of gravity (3,) of the whole body, world, metres."""
    return _centre(skeleton, frames, list(range(len(skeleton.tree.bones))))


def augmented_bodies(skeleton: Any, frames: Any, proximal: bool = False) -> AugmentedBodies:
    """Mass and lever arm of each degree of freedom's augmented body.

    Args:
        skeleton: D degrees of freedom.
        frames: of the pose.
        proximal: the parts between root and joint instead of those that the joint carries.
    """
    tree = skeleton.tree
    masses, arms = [], []
    for turned_bone in tree.dof_bones:
        joint = frames.joints_world[turned_bone]
        if proximal:
            members = list(tree.chain(tree.bones[turned_bone]))[:-1]
        else:
            members = [i for i, name in enumerate(tree.bones) if turned_bone in tree.chain(name)]
        masses.append(sum(float(skeleton.masses[i]) for i in members))
        centre = _centre(skeleton, frames, members) if members else joint
        arms.append(np.hypot(*(centre - joint)[:2]))
    return AugmentedBodies(np.array(masses), np.array(arms))


def _centre(skeleton: Any, frames: Any, members: list[int]) -> np.ndarray:
    """Centre of gravity (3,) of some bones."""
    centres = bone_centres(skeleton, frames)
    total = sum(float(skeleton.masses[i]) for i in members)
    return sum((float(skeleton.masses[i]) * centres[i] for i in members), np.zeros(3)) / total


def base_of_support(points_world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest corner (2,) of the box that the supporting points (P, 3) span (5.3)."""
    x, y = points_world[:, 0], points_world[:, 1]
    return np.array([min(x), min(y)]), np.array([max(x), max(y)])
