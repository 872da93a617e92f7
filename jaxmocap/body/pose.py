"""A pose and its vector: the virtual root's place and turn, and the joints' angles.

INPUTS: a Pose or its packed vector. OUTPUTS: the other, or a pose moved by a tangent vector.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.geometry.rotations import quaternion_exp, quaternion_log, quaternion_multiply


class Pose(NamedTuple):
    """The configuration theta of a skeleton with D degrees of freedom.

    Attributes:
        position: (..., 3) of the pelvis in the world, metres.
        quaternion: (..., 4) unit, wxyz, of the pelvis: body frame to world.
        angles: (..., D) radians.
    """

    position: Array
    quaternion: Array
    angles: Array


def relaxed_pose(skeleton: Skeleton) -> Pose:
    """The relaxed pose omega, pelvis at the world's origin, facing +x."""
    dtype = skeleton.relaxed.dtype
    return Pose(jnp.zeros(3, dtype), jnp.eye(4, dtype=dtype)[0], skeleton.relaxed)


def retract(pose: Pose, step: Array) -> Pose:
    """Move a pose by a tangent vector (..., 6 + D).

    The first three entries shift the pelvis along the world's axes (metres), the next three turn
    it about them (rotation vector, radians), the rest add to the angles.
    """
    quaternion = quaternion_multiply(quaternion_exp(step[..., 3:ROOT_DOF]), pose.quaternion)
    return Pose(
        pose.position + step[..., :3],
        quaternion / jnp.linalg.norm(quaternion, axis=-1, keepdims=True),
        pose.angles + step[..., ROOT_DOF:],
    )


def difference(pose: Pose, origin: Pose) -> Array:
    """The tangent vector (..., 6 + D) that moves ``origin`` to ``pose``: ``retract``'s inverse."""
    back = origin.quaternion * jnp.asarray([1, -1, -1, -1], origin.quaternion.dtype)
    turn = quaternion_log(quaternion_multiply(pose.quaternion, back))
    return jnp.concatenate([pose.position - origin.position, turn, pose.angles - origin.angles], -1)


def halfway(pose: Pose, other: Pose) -> Pose:
    """Halfway from poses (...) to others, on the host; the pelvis turns the shorter way."""
    pose, other = (Pose(*map(np.asarray, each)) for each in (pose, other))  # type: ignore[arg-type]
    alike = np.sum(pose.quaternion * other.quaternion, -1, keepdims=True) >= 0
    turned = pose.quaternion + np.where(alike, other.quaternion, -other.quaternion)
    turned = turned / np.linalg.norm(turned, axis=-1, keepdims=True)
    return Pose((pose.position + other.position) / 2, turned, (pose.angles + other.angles) / 2)


def beyond_limits(limits: Array, angles: Array) -> Array:
    """By how much (..., D) angles lie outside (..., D, 2) limits, radians; 0 within."""
    low, high = limits[..., 0], limits[..., 1]
    return jnp.maximum(low - angles, 0.0) + jnp.maximum(angles - high, 0.0)


def room(limits: Array, angles: Array) -> tuple[Array, Array]:
    """How far degrees of freedom (6 + D,) may go down and up, never beyond 0; the root without end.

    The joints' (D,) angles have (D, 2) limits.
    """
    endless = jnp.full(ROOT_DOF, jnp.inf, angles.dtype)
    low = jnp.minimum(limits[:, 0] - angles, 0.0)
    high = jnp.maximum(limits[:, 1] - angles, 0.0)
    return jnp.concatenate([-endless, low]), jnp.concatenate([endless, high])


def pack(pose: Pose) -> Array:
    """One vector (..., 7 + D): position, quaternion, angles."""
    return jnp.concatenate(pose, -1)


def unpack(vector: Any) -> Pose:
    """The pose of a packed vector (..., 7 + D), on the host or the device."""
    return Pose(vector[..., :3], vector[..., 3:7], vector[..., 7:])
