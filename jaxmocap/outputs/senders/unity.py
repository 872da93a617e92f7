"""A pose as Unity has it: joints' rotations from the T pose, left-handed, y up, z ahead, x right.

INPUTS: a Skeleton; poses. OUTPUTS: each joint's position and rotation in its parent, and in the
world.

In NumPy, where one pose takes a tenth of a millisecond.
"""

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
        rest = Rotation.from_matrix(rest_orientations(skeleton))
        above = np.array(tree.parents)[self._bones]
        turns = rest.as_quat(scalar_first=True)
        # Joint in its parent, in T: R_rest_parent @ local @ R_rest_bone.T
        self._before = np.where((above >= 0)[:, None], turns[above], [1.0, 0, 0, 0])
        self._after = turns[self._bones] * [1, -1, -1, -1]

    def local(self, pose: Pose) -> Joints:
        """Every joint in its parent, the pelvis in the world."""
        half = np.append(np.asarray(pose.angles, float), 0.0) / 2
        axes = np.append(self._axes, np.zeros((1, 3)), 0)
        hinges = np.column_stack([np.cos(half), np.sin(half)[:, None] * axes])
        turns = self._before
        for slot in self._slots.T:
            # An empty slot is -1, which is the hinge that does not turn.
            turns = multiply(turns, hinges[slot])
        wxyz = np.vstack([np.asarray(pose.quaternion, float)[None], multiply(turns, self._after)])
        positions = self._offsets.copy()
        positions[0] = to_unity(np.asarray(pose.position, float))
        # The mirror reverses the axes that quaternions turn about.
        return Joints(positions, np.hstack([-to_unity(wxyz[:, 1:]), wxyz[:, :1]]))

    def in_world(self, local: Joints) -> Joints:
        """Every joint in the world."""
        positions, turns = local.positions.copy(), local.quaternions[:, [3, 0, 1, 2]]
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                w, axis = turns[parent, 0], turns[parent, 1:]
                around = 2 * np.cross(axis, positions[joint])
                rotated = positions[joint] + w * around + np.cross(axis, around)
                positions[joint] = positions[parent] + rotated
                turns[joint] = multiply(turns[parent], turns[joint])
        return Joints(positions, turns[:, [1, 2, 3, 0]])


def to_unity(points_world: np.ndarray) -> np.ndarray:
    """Points (..., 3) of the world in Unity's frame."""
    return points_world @ R_WORLD_UNITY


def multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Hamilton product of (..., 4) quaternions, wxyz."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        -1,
    )


def euler_degrees(xyzw: np.ndarray) -> np.ndarray:
    """Unity's angles (..., 3) about x, y, z, degrees: it turns about z first, then x, then y."""
    x, y, z, w = np.moveaxis(xyzw, -1, 0)
    up = np.clip(2 * (w * x - y * z), -1, 1)
    about_x = np.arcsin(up)
    # Gimbal lock: with x up or down, rotations about y and z are the same, and all of it is y's.
    locked = np.abs(up) > 1 - 1e-9
    about_y = np.arctan2(2 * (w * y + x * z), 1 - 2 * (x * x + y * y))
    about_z = np.arctan2(2 * (w * z + x * y), 1 - 2 * (x * x + z * z))
    about_y = np.where(locked, 2 * np.arctan2(y, w), about_y)
    return np.degrees(np.stack([about_x, about_y, np.where(locked, 0.0, about_z)], -1))
