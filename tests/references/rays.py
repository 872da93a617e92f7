"""Points of the body on rays of the cameras: the paper's system, three equations to a pair.

And the pose that solves it with all that tracking adds: contours, outliers, a prior, limits. Where
the original leaves joints out that would pass their limits, here every step is the exact solution
within them, by SciPy.

INPUTS: a skeleton, a pose, pairs of points and lines, settings, a prior (anything with the
originals' attributes). OUTPUTS: residuals, their derivatives, a pose; float64.
"""

from typing import Any

import numpy as np
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from jaxmocap.reference.hybrid.ik import Pose, as_pose, retract
from jaxmocap.reference.kinematics import forward, quaternion_matrix

# Of the lengths of normal errors in a plane, by the deviation of a component: their median.
MEDIAN_OF_LENGTHS = np.sqrt(2 * np.log(2))


def hat(twist: np.ndarray) -> np.ndarray:
    """The matrix (4, 4) of a twist (v, omega): equations (3.6) and (3.7)."""
    x, y, z = twist[3:]
    return np.array([[0, -z, y, twist[0]], [z, 0, -x, twist[1]], [-y, x, 0, twist[2]], [0.0] * 4])


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
    """Derivatives (N, 3, 6 + D) of the points; the root's columns are twists about the pelvis.

    A hinge's twist at the present pose is (o x omega, omega).
    """
    tree, parts = skeleton.tree, [np.asarray(part) for part in points]
    twists = [np.concatenate([axis, np.zeros(3)]) for axis in np.eye(3)]
    joints = [*[frames.root] * 3, *frames.joints_world[list(tree.dof_bones)]]
    for joint, axis in zip(joints, [*np.eye(3), *frames.axes_world], strict=True):
        twists.append(np.concatenate([np.cross(joint, axis), axis]))
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


def difference(pose: Pose, other: Pose) -> np.ndarray:
    """The step (6 + D,) from the other pose to this one."""
    R, there = (quaternion_matrix(each.quaternion) for each in (pose, other))
    turn = Rotation.from_matrix(R @ there.T).as_rotvec()
    return np.concatenate([pose.position - other.position, turn, pose.angles - other.angles])


def contour_rows(skeleton: Any, frames: Any, pairs: Any) -> tuple[np.ndarray, np.ndarray]:
    """How far points are off their rays, across a contour and, by the grip, along it.

    Returns:
        Residuals (N, 2), metres, and their derivatives (N, 2, 6 + D).
    """
    x, J = pose_points(frames, pairs.points), slopes(skeleton, frames, pairs.points)
    residuals, rows = np.zeros((len(x), 2)), np.zeros((len(x), 2, J.shape[-1]))
    lines = zip(*(np.asarray(part, float) for part in pairs.lines), strict=True)
    across = np.asarray(pairs.across, float)
    along_weights = np.asarray(pairs.along_weights, float)
    for i, (direction, moment) in enumerate(lines):
        off = x[i] - np.cross(direction, moment)
        ways = np.stack([across[i], along_weights[i] * np.cross(direction, across[i])])
        residuals[i], rows[i] = ways @ off, ways @ J[i]
    return residuals, rows


def shares(residuals: np.ndarray, weights: np.ndarray, settings: Any) -> tuple[np.ndarray, float]:
    """Tukey's biweight (N,) of every pair, and the spread of those that count, metres."""
    distances = np.linalg.norm(residuals, axis=1)
    usual = np.percentile(distances[weights > 0], 50, method="lower")
    spread = max(usual / MEDIAN_OF_LENGTHS, float(settings.deviation))
    ratio = distances / (settings.reach * spread)
    return np.where(ratio < 1, (1 - ratio**2) ** 2, 0.0), spread


def solve_pose(skeleton: Any, pose: Any, pairs: Any, settings: Any, prior: Any = None) -> Pose:
    """Linearise, weigh, solve within the limits, transform, ``settings.iterations`` times."""
    now = as_pose(pose)
    weights = np.asarray(pairs.weights, float)
    for _ in range(int(settings.iterations)):
        residuals, rows = contour_rows(skeleton, forward(skeleton, now), pairs)
        share, spread = shares(residuals, weights, settings)
        firm = np.repeat(np.sqrt(share * weights) / spread, 2)
        A, b = [firm[:, None] * rows.reshape(len(firm), -1)], [firm * residuals.ravel()]
        if prior is not None:
            prior_weights = 1 / np.asarray(prior.deviations, float)
            A.append(np.diag(prior_weights))
            b.append(prior_weights * difference(now, as_pose(prior.pose)))
        low, high = (np.asarray(skeleton.limits, float) - now.angles[:, None]).T
        endless = np.full(6, np.inf)
        bounds = np.append(-endless, np.minimum(low, 0.0)), np.append(endless, np.maximum(high, 0))
        solution = lsq_linear(np.concatenate(A), -np.concatenate(b), bounds, method="bvls")
        now = retract(now, solution.x)
    return now
