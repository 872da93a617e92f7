"""Forward kinematics and the geometric Jacobian, by recursion along the tree.

INPUTS: a skeleton and a pose (anything with a Skeleton's and a Pose's attributes).
OUTPUTS: frames of all bones, points on bones, their derivatives; float64.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

# Landmark -> bone and which end of it, in the order in which ``landmarks`` returns them.
LANDMARK_ENDS = {
    "pelvis": ("spine1", 0.0),
    "neck": ("neck", 0.0),
    "head": ("head", 0.0),
    "vertex": ("head", 1.0),
    "shoulder_l": ("humerus_l", 0.0),
    "shoulder_r": ("humerus_r", 0.0),
    "elbow_l": ("humerus_l", 1.0),
    "elbow_r": ("humerus_r", 1.0),
    "wrist_l": ("radius_l", 1.0),
    "wrist_r": ("radius_r", 1.0),
    "hand_l": ("hand_l", 1.0),
    "hand_r": ("hand_r", 1.0),
    "hip_l": ("hip_l", 1.0),
    "hip_r": ("hip_r", 1.0),
    "knee_l": ("femur_l", 1.0),
    "knee_r": ("femur_r", 1.0),
    "ankle_l": ("tibia_l", 1.0),
    "ankle_r": ("tibia_r", 1.0),
    "toe_l": ("foot_l", 1.0),
    "toe_r": ("foot_r", 1.0),
}


class Frames(NamedTuple):
    """Where the bones are, for B bones and D degrees of freedom."""

    root: np.ndarray  # (3,) position of the pelvis in the world, metres
    R_world_bone: np.ndarray  # (B, 3, 3) orientations
    joints_world: np.ndarray  # (B, 3) positions of the bones' joints, metres
    axes_world: np.ndarray  # (D, 3) hinge axes v_j of equation (4)


def rotate_vectors(vectors: np.ndarray, axis: np.ndarray, angle: float) -> np.ndarray:
    """Vectors (K, 3) turned by ``angle``, radians, about a unit axis (3,)."""
    return Rotation.from_rotvec(angle * axis).apply(vectors)


def quaternion_matrix(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrix (3, 3) of a quaternion (4,), wxyz."""
    return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()


def forward(skeleton: Any, pose: Any) -> Frames:
    """Frames of all bones, each from its parent's, parents first."""
    tree = skeleton.tree
    root = np.asarray(pose.position, float)
    angles, axes = np.asarray(pose.angles, float), np.asarray(skeleton.axes, float)
    R_world_root = quaternion_matrix(np.asarray(pose.quaternion, float))
    turns = Rotation.from_rotvec(angles[:, None] * axes).as_matrix()
    R_world_bone, joints_world, axes_world = [], [], np.zeros((len(tree.joints), 3))
    for bone, parent in enumerate(tree.parents):
        R = R_world_root if parent < 0 else R_world_bone[parent]
        if parent < 0:
            joints_world.append(root)
        else:
            joints_world.append(joints_world[parent] + R @ bone_vector(skeleton, parent))
        for dof, turned_bone in enumerate(tree.dof_bones):
            if turned_bone == bone:
                axes_world[dof] = R @ axes[dof]
                R = R @ turns[dof]
        R_world_bone.append(R)
    return Frames(root, np.array(R_world_bone), np.array(joints_world), axes_world)


def bone_vector(skeleton: Any, bone: int) -> np.ndarray:
    """From a bone's joint to its far end (3,), in its own frame, metres."""
    return float(skeleton.lengths[bone]) * np.asarray(skeleton.directions[bone], float)


def site_positions(skeleton: Any, frames: Any, sites: Any) -> np.ndarray:
    """Positions s (M, 3) of points on bones in the world, metres."""
    positions = []
    for bone, at, offset in zip(sites.bones, sites.at, sites.offsets, strict=True):
        local = float(at) * bone_vector(skeleton, bone) + np.asarray(offset, float)
        positions.append(frames.joints_world[bone] + frames.R_world_bone[bone] @ local)
    return np.array(positions)


def jacobian(skeleton: Any, frames: Any, bones: np.ndarray, points_world: np.ndarray) -> np.ndarray:
    """Derivatives (M, 3, 6 + D) of points fixed to bones: equation (4) without its weight.

    The root's columns come first: translations along the world's axes, then turns about them.
    """
    tree = skeleton.tree
    points = np.asarray(points_world, float)
    J = np.zeros((len(points), 3, 6 + len(tree.joints)))
    for i, (bone, point) in enumerate(zip(bones, points, strict=True)):
        for k, axis in enumerate(np.eye(3)):
            J[i, :, k] = axis
            J[i, :, 3 + k] = np.cross(axis, point - frames.root)
        chain = tree.chain(tree.bones[bone])
        for dof, turned_bone in enumerate(tree.dof_bones):
            if turned_bone in chain:
                pivot = frames.joints_world[turned_bone]
                J[i, :, 6 + dof] = np.cross(frames.axes_world[dof], point - pivot)
    return J


def landmarks(skeleton: Any, pose: Any) -> np.ndarray:
    """Positions (L, 3) of a pose's landmarks, world, metres."""
    return landmark_positions(skeleton, forward(skeleton, pose))


def landmark_positions(skeleton: Any, frames: Any) -> np.ndarray:
    """Positions (L, 3) of all landmarks, in the order of ``LANDMARK_ENDS``, world, metres."""
    positions = []
    for name, end in LANDMARK_ENDS.values():
        bone = skeleton.tree.bone(name)
        reach = end * (frames.R_world_bone[bone] @ bone_vector(skeleton, bone))
        positions.append(frames.joints_world[bone] + reach)
    return np.array(positions)
