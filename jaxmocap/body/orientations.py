"""How bones are turned over time, in double precision on the host.

INPUTS: a Skeleton and angles (T, D) in radians, or quaternions (T, 4).
OUTPUTS: rotations (T, ..., 3, 3), NaN where the pose is unknown; to be written to files, where
``kinematics`` is for what is traced.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.body.skeleton import Skeleton


def local_turns(skeleton: Skeleton, angles: np.ndarray) -> np.ndarray:
    """Rotations (T, B, 3, 3) of bones in their parents' frames, of (T, D) radians."""
    axes = np.asarray(skeleton.axes, float)
    R = np.tile(np.eye(3), (len(angles), len(skeleton.tree.bones), 1, 1))
    for dof, bone in enumerate(skeleton.tree.dof_bones):
        R[:, bone] = R[:, bone] @ about(axes[dof], angles[:, dof])
    return R


def body_turns(skeleton: Skeleton, angles: np.ndarray) -> np.ndarray:
    """Rotations (T, B, 3, 3) of bones in the pelvis' frame, of (T, D) radians."""
    R = local_turns(skeleton, angles)
    for bone, parent in enumerate(skeleton.tree.parents):
        if parent >= 0:
            R[:, bone] = R[:, parent] @ R[:, bone]
    return R


def about(axis: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Rotations (T, 3, 3) by (T,) radians about a unit axis; NaN where an angle is."""
    is_finite = np.isfinite(angles)
    turn = np.where(is_finite, angles, 0.0)[:, None] * axis
    return np.where(is_finite[:, None, None], Rotation.from_rotvec(turn).as_matrix(), np.nan)


def matrices(quaternions: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) of (..., 4) wxyz; NaN where unknown."""
    # By hand: SciPy's way takes six times as long for one sample of a live run.
    w, x, y, z = np.moveaxis(np.asarray(quaternions, float), -1, 0)
    twice = 2 / (w * w + x * x + y * y + z * z)
    rows = [
        [1 - twice * (y * y + z * z), twice * (x * y - w * z), twice * (x * z + w * y)],
        [twice * (x * y + w * z), 1 - twice * (x * x + z * z), twice * (y * z - w * x)],
        [twice * (x * z - w * y), twice * (y * z + w * x), 1 - twice * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def quaternions(R: np.ndarray) -> np.ndarray:
    """Quaternions (..., 4), wxyz, w not negative, of (..., 3, 3) rotations; NaN where unknown."""
    is_finite = np.isfinite(R.sum((-2, -1)))[..., None]
    safe = np.where(is_finite[..., None], R, np.eye(3)).reshape(-1, 3, 3)
    converted = Rotation.from_matrix(safe).as_quat(canonical=True, scalar_first=True)
    return np.where(is_finite, converted.reshape(*is_finite.shape[:-1], 4), np.nan)
