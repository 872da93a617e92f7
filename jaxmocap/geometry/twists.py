"""se(3): twists and rigid motions (second paper, section 3.1.2).

INPUTS: twists (v, omega), metres and radians; points, metres; any batch shape.
OUTPUTS: rigid motions as 4 x 4 matrices; moved points; exact and differentiable at 0.

A twist xi moves a point x at the velocity omega x x + v; exp(xi) is the screw motion that it
becomes when it goes on for a unit of time.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.geometry import rotations
from jaxmocap.geometry.rotations import rotate

# Below this squared angle the coefficients are summed as series, to double's rounding.
SMALL_SQUARED = 0.25


def hat(twists: Array) -> Array:
    """Matrices (..., 4, 4) of (..., 6) twists (v, omega): equations (3.6) to (3.8)."""
    top = jnp.concatenate([rotations.hat(twists[..., 3:]), twists[..., :3, None]], -1)
    return jnp.concatenate([top, jnp.zeros_like(top[..., :1, :])], -2)


def exp(twists: Array) -> Array:
    """Rigid motions (..., 4, 4) of (..., 6) twists: equations (3.9) and (3.10).

    (3.9)'s translation divides by the angle; here it is V v with V = I + b K + c K^2, the integral
    of the rotation, which is the same and has a limit at 0.
    """
    v, turn = twists[..., :3], twists[..., 3:]
    b, c = _coefficients(turn)
    K = rotations.hat(turn)
    shift = v + b * rotate(K, v) + c * rotate(K, rotate(K, v))
    return rigid(rotations.exp(turn), shift)


def _coefficients(turn: Array) -> tuple[Array, Array]:
    """(1 - cos t) / t^2 and (t - sin t) / t^3 (..., 1) of the turn's length t."""
    squared = jnp.sum(turn**2, -1, keepdims=True)
    small = squared < SMALL_SQUARED
    safe = jnp.where(small, 1.0, squared)
    angle = jnp.sqrt(safe)
    half = jnp.sin(angle / 2)
    b = _series(squared, (1 / 2, -1 / 24, 1 / 720, -1 / 40320, 1 / 3628800))
    c = _series(squared, (1 / 6, -1 / 120, 1 / 5040, -1 / 362880, 1 / 39916800))
    return (
        jnp.where(small, b, 2 * half * half / safe),
        jnp.where(small, c, (angle - jnp.sin(angle)) / (angle * safe)),
    )


def _series(x: Array, coefficients: tuple[float, ...]) -> Array:
    """The polynomial with these coefficients, lowest first."""
    total = jnp.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total = coefficient + x * total
    return total


def rigid(R: Array, t: Array) -> Array:
    """Matrices (..., 4, 4) of rotations (..., 3, 3) and translations (..., 3): (3.5)."""
    top = jnp.concatenate([R, t[..., None]], -1)
    last = jnp.broadcast_to(np.eye(4, dtype=R.dtype)[3:], (*R.shape[:-2], 1, 4))
    return jnp.concatenate([top, last], -2)


def move(T: Array, points: Array) -> Array:
    """Points (..., 3) moved by rigid motions (..., 4, 4)."""
    return rotate(T[..., :3, :3], points) + T[..., :3, 3]
