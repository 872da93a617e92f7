"""Points of the body on rays of the cameras, joint after joint by the product of exponentials.

INPUTS: a skeleton, a pose, pairs of points and lines (anything with the originals' attributes).
OUTPUTS: the paper's system, three equations to a pair, and the pose that solves it; float64.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from jaxmocap.reference.kinematics import forward


class Pose(NamedTuple):
    """A configuration: position (3,), quaternion (4,) wxyz, angles (D,)."""

    position: np.ndarray
    quaternion: np.ndarray
    angles: np.ndarray


def hat(twist: np.ndarray) -> np.ndarray:
    """The matrix (4, 4) of a twist (v, omega): equations (3.6) and (3.7)."""
    x, y, z = twist[3:]
    return np.array([[0, -z, y, twist[0]], [z, 0, -x, twist[1]], [-y, x, 0, twist[2]], [0.0] * 4])


def joint_screws(skeleton: Any, frames: Any) -> list[np.ndarray]:
    """Each degree of freedom's twist (6,) at the present pose: (o x omega, omega)."""
    joints = frames.joints_world[list(skeleton.tree.dof_bones)]
    axes = zip(joints, frames.axes_world, strict=True)
    return [np.concatenate([np.cross(joint, axis), axis]) for joint, axis in axes]


def pose_points(frames: Any, points: Any) -> np.ndarray:
    """Points (N, 3) in the world, metres."""
    positions = []
    for bones, places, shares in zip(*(np.asarray(part) for part in points), strict=True):
        carried = [
            frames.joints_world[b] + frames.R_world_bone[b] @ x
            for b, x in zip(bones, places, strict=True)
        ]
        positions.append(shares @ np.array(carried))
    return np.array(positions)


def slopes(skeleton: Any, frames: Any, points: Any) -> np.ndarray:
    """Derivatives (N, 3, 6 + D) of the points; the root's columns are twists about the pelvis."""
    root = [np.concatenate([axis, np.zeros(3)]) for axis in np.eye(3)]
    root += [np.concatenate([np.cross(frames.root, axis), axis]) for axis in np.eye(3)]
    twists = root + joint_screws(skeleton, frames)
    tree, parts = skeleton.tree, [np.asarray(part) for part in points]
    result = np.zeros((len(parts[0]), 3, len(twists)))
    for i, (bones, places, shares) in enumerate(zip(*parts, strict=True)):
        for bone, place, share in zip(bones, places, shares, strict=True):
            chain = tree.chain(tree.bones[bone])
            x = frames.joints_world[bone] + frames.R_world_bone[bone] @ place
            for j, twist in enumerate(twists):
                if j < 6 or tree.dof_bones[j - 6] in chain:
                    result[i, :, j] += share * (hat(twist) @ np.append(x, 1.0))[:3]
    return result


def linearise_pairs(skeleton: Any, frames: Any, pairs: Any) -> tuple[np.ndarray, np.ndarray]:
    """Equation (3.12) for all pairs: x x n - m (N, 3) and its derivatives (N, 3, 6 + D)."""
    n = np.asarray(pairs.lines.directions, float)
    residuals = np.cross(pose_points(frames, pairs.points), n) - np.asarray(
        pairs.lines.moments, float
    )
    rows = np.cross(slopes(skeleton, frames, pairs.points), n[:, :, None], axis=1)
    return residuals, rows


def solve_pose(skeleton: Any, pose: Any, pairs: Any, iterations: int = 20) -> Pose:
    """Section 3.1.3 as printed: linearise, solve by least squares, transform, again.

    Without priors, limits or outliers; all pairs count alike. ``reference.pose`` has them.
    """
    now = Pose(*(np.asarray(part, float) for part in pose))
    for _ in range(iterations):
        residuals, rows = linearise_pairs(skeleton, forward(skeleton, now), pairs)
        A, b = rows.reshape(-1, rows.shape[-1]), -residuals.ravel()
        now = move_pose(now, np.linalg.lstsq(A, b, rcond=None)[0])
    return now


def move_pose(pose: Pose, step: np.ndarray) -> Pose:
    """The pose after a step (6 + D,): the twist's shift moves the pelvis, its turn turns it."""
    T = expm(hat(np.concatenate([np.zeros(3), step[3:6]])))
    turned = T[:3, :3] @ _matrix(pose.quaternion)
    quaternion = Rotation.from_matrix(turned).as_quat(scalar_first=True)
    return Pose(pose.position + step[:3], quaternion, pose.angles + step[6:])


def difference(pose: Pose, other: Pose) -> np.ndarray:
    """The step (6 + D,) from the other pose to this one."""
    turn = np.real(logm(_matrix(pose.quaternion) @ _matrix(other.quaternion).T))
    twist = [turn[2, 1], turn[0, 2], turn[1, 0]]
    return np.concatenate([pose.position - other.position, twist, pose.angles - other.angles])


def _matrix(q: np.ndarray) -> np.ndarray:
    """(3, 3) of a unit quaternion, wxyz."""
    K = hat(np.concatenate([np.zeros(3), q[1:]]))[:3, :3]
    return np.eye(3) + 2 * q[0] * K + 2 * K @ K
