"""Joints as screws without pitch (second paper, 3.2 and 4.2.1), as the paper writes them.

INPUTS: points and axes, metres; rigid motions as 4 x 4 matrices; any batch shape.
OUTPUTS: twists (v, omega); what a chain of them moves.

A joint about the unit axis omega through the point o is the twist (o x omega, omega), and theta
times that twist turns by theta radians. The package's kinematics carries joints along bone by bone,
which these hold it against.
"""

import jax.numpy as jnp
from jax import Array

from jaxmocap.geometry.rotations import HIGHEST, rotate
from jaxmocap.geometry.twists import exp


def screw(points: Array, axes: Array) -> Array:
    """Joints (..., 6) about unit axes (..., 3) through points (..., 3): no pitch."""
    return jnp.concatenate([jnp.cross(points, axes), axes], -1)


def transport(T: Array, screws: Array) -> Array:
    """Joints (..., 6) carried along by rigid motions (..., 4, 4): equation (4.21).

    (R o + t) x R omega is R v + t x R omega, so that no point o on the axis is needed.
    """
    axes = rotate(T[..., :3, :3], screws[..., 3:])
    moments = rotate(T[..., :3, :3], screws[..., :3]) + jnp.cross(T[..., :3, 3], axes)
    return jnp.concatenate([moments, axes], -1)


def product_of_exponentials(screws: Array, angles: Array) -> Array:
    """The motion (4, 4) of what hangs on a chain of n joints, from where it rests.

    Args:
        screws: (n, 6) at rest, the one nearest to the root first.
        angles: (n,) radians.
    """
    T = jnp.eye(4, dtype=screws.dtype)
    for turn in exp(angles[:, None] * screws):
        T = jnp.matmul(T, turn, precision=HIGHEST)
    return T
