"""A pose as Unity has it: joints' rotations from the T pose, left-handed, y up, z ahead, x right.

INPUTS: a Skeleton; poses. OUTPUTS: each joint's position and rotation in its parent, and in the
world.

In NumPy, where one pose takes a tenth of a millisecond.
"""

import warnings
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.body.motion import Motion
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.formats.armatures.body_armature import armature_of, rest_orientations
from jaxmocap.formats.armatures.joint_names import PELVIS
from jaxmocap.formats.time_series.axes import R_WORLD_UNITY


class Joints(NamedTuple):
    """J joints in Unity's frame."""

    positions: np.ndarray  # (J, 3) metres
    quaternions: np.ndarray  # (J, 4) xyzw


class UnityBody:
    """A skeleton whose poses are converted to Unity's frame.

    Attributes:
        joints: our names of the J joints, the pelvis first, parents before children; no ends.
        parents: index of each one's parent, -1 for the pelvis.
    """

    def __init__(self, skeleton: Skeleton):
        """Prepare for a skeleton."""
        tree = skeleton.tree
        upright = Pose(np.zeros((1, 3)), np.eye(4)[:1], np.zeros((1, len(tree.joints))))  # type: ignore[arg-type]
        armature = armature_of(Motion(skeleton, np.zeros(1), upright))
        kept = [j for j, name in enumerate(armature.names) if not name.endswith("_end")]
        self.joints = tuple(armature.names[j] for j in kept)
        parents = [armature.parents[j] for j in kept]
        names = [armature.names[k] if k >= 0 else None for k in parents]
        self.parents = tuple(-1 if name is None else self.joints.index(name) for name in names)
        self._offsets = to_unity(armature.offsets[kept])
        self._axes = np.asarray(skeleton.axes, float)
        self._bones = np.array([tree.bone(name) for name in self.joints if name != PELVIS])
        self._slots = tree.hinge_slots[self._bones]
        # Joint in its parent, in T: R_rest_parent @ local @ R_rest_bone.T; the last is no bone's.
        rest = np.array([*rest_orientations(skeleton), np.eye(3)])
        self._before = Rotation.from_matrix(rest[np.array(tree.parents)[self._bones]])
        self._after = Rotation.from_matrix(rest[self._bones]).inv()

    def local(self, pose: Pose) -> Joints:
        """Every joint in its parent, the pelvis in the world."""
        angles = np.asarray(pose.angles, float)[:, None]
        # An empty slot is -1, which is the hinge that does not turn.
        hinges = Rotation.from_rotvec(np.append(angles * self._axes, np.zeros((1, 3)), 0))
        turns = self._before
        for slot in self._slots.T:
            turns = turns * hinges[slot]
        turns = (turns * self._after).as_quat(scalar_first=True)
        wxyz = np.vstack([np.asarray(pose.quaternion, float)[None], turns])
        positions = self._offsets.copy()
        positions[0] = to_unity(np.asarray(pose.position, float))
        # The mirror reverses the axes that quaternions turn about.
        return Joints(positions, np.hstack([-to_unity(wxyz[:, 1:]), wxyz[:, :1]]))

    def in_world(self, local: Joints) -> Joints:
        """Every joint in the world."""
        positions, turns = local.positions.copy(), list(Rotation.from_quat(local.quaternions))
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                positions[joint] = positions[parent] + turns[parent].apply(positions[joint])
                turns[joint] = turns[parent] * turns[joint]
        return Joints(positions, Rotation.concatenate(turns).as_quat())


def to_unity(points_world: np.ndarray) -> np.ndarray:
    """Points (..., 3) of the world in Unity's frame."""
    return points_world @ R_WORLD_UNITY


def euler_degrees(xyzw: np.ndarray) -> np.ndarray:
    """Unity's angles (..., 3) about x, y, z, degrees: it turns about z first, then x, then y."""
    with warnings.catch_warnings():
        # Gimbal lock: with x up or down, rotations about y and z are the same, all of it is y's.
        warnings.simplefilter("ignore")
        yxz = Rotation.from_quat(xyzw).as_euler("YXZ", degrees=True)
    return yxz[..., [1, 0, 2]]
