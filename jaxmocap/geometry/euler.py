"""Euler angles over time that do not jump.

INPUTS: rotations over time (NumPy, on the host). OUTPUTS: three angles each, of all that make the
same turn those nearest to the sample before.
"""

import warnings

import numpy as np
from scipy.spatial.transform import Rotation

# Outer axes nearer to each other than this, radians, turn as one.
LOCK = 1e-6


def continuous_euler(R: np.ndarray, order: str) -> np.ndarray:
    """Angles (T, J, 3), radians, of (T, J, 3, 3) rotations; NaN where those are.

    Every turn has two triples of angles, and each angle any number of whole turns; of these the
    nearest to the last measured sample is taken. At the first one they are between -pi and pi, the
    second angle between -pi/2 and pi/2, or, where the outer axes are the same, between -pi and 0.
    Where the outer axes fall together (gimbal lock) only the sum or the difference of the outer
    angles is determined: the first one stays as it was, or as it will be where it has not been yet.

    Args:
        R: rotations.
        order: intrinsic, capitals, of three different axes (``ZXY``) or with the outer ones the
            same (``YXY``).
    """
    same = order[0] == order[2]
    ways = np.stack(_ways(R, order, same))
    middle = ways[0, ..., 1]
    apart = np.sin(middle) if same else np.cos(middle)
    locked = np.asarray(np.abs(apart) < LOCK)
    is_measured = np.asarray(np.isfinite(middle))
    angles, before = np.empty(ways.shape[1:]), _start(ways[0], is_measured & ~locked)
    for i in range(len(angles)):
        near = before + _wrapped(ways[:, i] - before)
        far = np.abs(near - before).sum(-1)
        angles[i] = np.where((far[1] < far[0] - 1e-9)[:, None], near[1], near[0])
        for j in np.flatnonzero(locked[i]):
            angles[i, j] = _in_lock(R[i, j], order, angles[i, j, 1], before[j])
        before = np.where(is_measured[i][:, None], angles[i], before)
    return angles


def _ways(R: np.ndarray, order: str, same: bool) -> tuple[np.ndarray, np.ndarray]:
    """Both triples (T, J, 3) of every turn, the customary one first; NaN where it is unknown."""
    is_finite = np.isfinite(R.sum((-2, -1)))
    safe = np.where(is_finite[..., None, None], R, np.eye(3)).reshape(-1, 3, 3)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Gimbal lock")
        angles = Rotation.from_matrix(safe).as_euler(order).reshape(*is_finite.shape, 3)
    angles = np.where(is_finite[..., None], angles, np.nan)
    other = _wrapped(angles * [1, -1, 1] + (np.pi, 0.0 if same else np.pi, np.pi))
    return (other, angles) if same else (angles, other)


def _start(angles: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Each joint's angles (J, 3) at its first usable sample; 0 where there is none."""
    start = angles[usable.argmax(0), np.arange(angles.shape[1])]
    return np.where(np.any(usable, 0, keepdims=True).T, start, 0.0)


def _in_lock(R: np.ndarray, order: str, second: float, before: np.ndarray) -> np.ndarray:
    """Angles (3,) that make a turn whose first angle is as before."""
    rest = Rotation.from_euler(order[:2], [before[0], second]).inv() * Rotation.from_matrix(R)
    third = rest.as_rotvec()["XYZ".index(order[2])]
    return np.array([before[0], second, before[2] + _wrapped(third - before[2])])


def _wrapped(angles: np.ndarray) -> np.ndarray:
    """Angles by whole turns between -pi and pi."""
    return angles - 2 * np.pi * np.round(angles / (2 * np.pi))
