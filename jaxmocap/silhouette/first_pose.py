"""The first pose: the one whose landmarks lie nearest to the given ones.

INPUTS: a Skeleton, landmarks' positions in the world (metres), NaN where unknown.
OUTPUTS: a Pose.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import landmarks
from jaxmocap.body.orientations import quaternions
from jaxmocap.body.pose import Pose, difference, relaxed_pose, retract
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.compilation.programs import Program, program
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.silhouette.surfaces.body_shape import determined_landmarks

# Deviation of a landmark, metres.
LANDMARK_DEVIATION_M = 0.02
# Deviation of a degree of freedom about the relaxed pose, metres and radians.
RELAXED_DEVIATION = 1.0
# Of Gauss and Newton.
STEPS = 40
landmark_points = Program(landmarks, "landmarks", effort="quick")


def pose_at_landmarks(skeleton: Skeleton, points_world: np.ndarray) -> Pose:
    """The pose nearest to landmarks (L, 3) of ``LANDMARKS``, metres, NaN where unknown.

    Both hips or both shoulders must be there, they determine where the person faces. Those that the
    skeleton's joints do not move are ignored.

    Raises:
        ValueError: neither is.
    """
    determined = determined_landmarks(skeleton.tree)[:, None]
    points = np.where(determined, np.asarray(points_world, float), np.nan)
    start = _place_pose(skeleton, points)
    return _fit_pose(skeleton, start, jnp.asarray(points, skeleton.lengths.dtype))


def standing_pose_at(skeleton: Skeleton, x: float, y: float, facing: float) -> Pose:
    """A relaxed person standing on the floor at a place, metres, facing so, radians from +x."""
    pose = relaxed_pose(skeleton)
    lowest = np.asarray(landmark_points(skeleton, pose))[:, 2].min()
    dtype = pose.position.dtype
    turned = jnp.asarray([np.cos(facing / 2), 0.0, 0.0, np.sin(facing / 2)], dtype)
    return pose._replace(position=jnp.asarray([x, y, -lowest], dtype), quaternion=turned)


def _place_pose(skeleton: Skeleton, points: np.ndarray) -> Pose:
    """The relaxed pose, upright as the trunk is, placed by the landmarks."""
    at = {name: points[i] for i, name in enumerate(LANDMARKS)}
    for pair in ("hip", "shoulder"):
        left = at[f"{pair}_l"] - at[f"{pair}_r"]
        if np.isfinite(left).all():
            break
    else:
        raise ValueError("neither both hips nor both shoulders are given: no facing")
    hips = _middle(at, "hip")
    trunk = _middle(at, "shoulder") - hips
    up = trunk if np.isfinite(trunk).all() else np.array([0.0, 0.0, 1.0])
    y = left / np.linalg.norm(left)
    x = np.cross(y, up)
    x /= max(np.linalg.norm(x), 1e-9)
    R = np.stack([x, y, np.cross(x, y)], 1)
    place = hips if np.isfinite(hips).all() else np.nanmean(points, 0)
    dtype = skeleton.lengths.dtype
    pose = relaxed_pose(skeleton)
    return pose._replace(
        position=jnp.asarray(place, dtype), quaternion=jnp.asarray(quaternions(R), dtype)
    )


def _middle(at: dict[str, np.ndarray], pair: str) -> np.ndarray:
    return (at[f"{pair}_l"] + at[f"{pair}_r"]) / 2


@program("full")
def _fit_pose(skeleton: Skeleton, start: Pose, points: Array) -> Pose:
    """Gauss-Newton from a placed pose, within the limits."""
    is_measured = jnp.isfinite(points)
    targets = jnp.where(is_measured, points, 0.0)
    rest = jnp.concatenate(
        [jnp.zeros(6, points.dtype), jnp.ones_like(start.angles) / RELAXED_DEVIATION**2]
    )

    def off(pose: Pose, step: Array) -> Array:
        there = landmarks(skeleton, retract(pose, step))
        return (jnp.where(is_measured, there - targets, 0.0) / LANDMARK_DEVIATION_M).ravel()

    def once(_: int, pose: Pose) -> Pose:
        none = jnp.zeros_like(rest)
        r, J = off(pose, none), jax.jacfwd(lambda step: off(pose, step))(none)
        slope = jnp.matmul(r, J, precision=HIGHEST) + rest * difference(pose, start)
        square = jnp.matmul(J.T, J, precision=HIGHEST)
        step = -jnp.linalg.solve(square + jnp.diag(rest + 1.0), slope)
        moved = retract(pose, jnp.clip(step, -0.3, 0.3))
        return moved._replace(angles=jnp.clip(moved.angles, *skeleton.limits.T))

    return jax.lax.fori_loop(0, STEPS, once, start)
