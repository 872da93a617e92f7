"""Euler angles over time that do not jump.

INPUTS: rotations over time. OUTPUTS: three angles each, of all that make the same turn those
nearest to the sample before.
"""

import warnings

import numpy as np
from scipy.spatial.transform import Rotation


def continuous_euler(R: np.ndarray, order: str) -> np.ndarray:
    """Angles (T, J, 3), radians, of (T, J, 3, 3) rotations, intrinsic about three different axes.

    Where the outer axes fall together (gimbal lock) the last angle is 0 or what continues best.
    """
    shape = R.shape[:2]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Gimbal lock")
        angles = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_euler(order).reshape(*shape, 3)
    other = angles * [1, -1, 1] + np.pi
    for i in range(1, len(angles)):
        ways = [_nearest(way[i], angles[i - 1]) for way in (angles, other)]
        far = [np.abs(way - angles[i - 1]).sum(-1, keepdims=True) for way in ways]
        angles[i] = np.where(far[1] < far[0], ways[1], ways[0])
    return angles


def _nearest(angles: np.ndarray, before: np.ndarray) -> np.ndarray:
    """The angles by whole turns nearest to others."""
    return angles - 2 * np.pi * np.round((angles - before) / (2 * np.pi))
