"""Pose from points on rays with all that tracking adds: contours, outliers, a prior, limits.

INPUTS: a skeleton, a pose, pairs of points and lines, settings, a prior (anything with the
originals' attributes). OUTPUTS: the pose that solves the system; float64.

Where the original leaves joints out that would pass their limits, here every step is the exact
solution within them, by SciPy.
"""

from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from jaxmocap.reference.kinematics import forward
from jaxmocap.reference.silhouette.points import Pose, difference, move_pose, pose_points, slopes

# Of the lengths of normal errors in a plane, by the deviation of a component: their median.
MEDIAN_OF_LENGTHS = np.sqrt(2 * np.log(2))


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
    now = Pose(*(np.asarray(part, float) for part in pose))
    weights = np.asarray(pairs.weights, float)
    for _ in range(int(settings.iterations)):
        residuals, rows = contour_rows(skeleton, forward(skeleton, now), pairs)
        share, spread = shares(residuals, weights, settings)
        firm = np.repeat(np.sqrt(share * weights) / spread, 2)
        A, b = [firm[:, None] * rows.reshape(len(firm), -1)], [firm * residuals.ravel()]
        if prior is not None:
            prior_weights = 1 / np.asarray(prior.deviations, float)
            expected = Pose(*(np.asarray(part, float) for part in prior.pose))
            A.append(np.diag(prior_weights))
            b.append(prior_weights * difference(now, expected))
        low, high = (np.asarray(skeleton.limits, float) - now.angles[:, None]).T
        endless = np.full(6, np.inf)
        bounds = np.append(-endless, np.minimum(low, 0.0)), np.append(endless, np.maximum(high, 0))
        solution = lsq_linear(np.concatenate(A), -np.concatenate(b), bounds, method="bvls")
        now = move_pose(now, solution.x)
    return now
