"""se(3): exponential, logarithm, adjoint; joints as screws without pitch (second paper, 3.1.2).

INPUTS: twists (v, omega), metres and radians; rigid motions as 4 x 4 matrices; any batch shape.
OUTPUTS: the same motion in another form; exact and differentiable at 0.

A twist xi moves a point x at the velocity omega x x + v. A joint about the unit axis omega through
the point o is the twist (o x omega, omega), and theta times that twist turns by theta radians.
"""

import jax.numpy as jnp
from jax import Array

from jaxmocap.geometry import rotations
from jaxmocap.geometry.rotations import HIGHEST, compose, rotate

# Below this squared angle the coefficients are summed as series, to double's rounding.
SMALL_SQUARED = 0.25


def hat(twists: Array) -> Array:
    """Matrices (..., 4, 4) of (..., 6) twists: equations (3.6) and (3.7)."""
    top = jnp.concatenate([rotations.hat(twists[..., 3:]), twists[..., :3, None]], -1)
    return jnp.concatenate([top, jnp.zeros_like(top[..., :1, :])], -2)


def exp(twists: Array) -> Array:
    """Rigid motions (..., 4, 4) of (..., 6) twists: equations (3.9) and (3.10).

    (3.9)'s translation divides by the angle; here it is V v with V = I + b K + c K^2, the integral
    of the rotation, which is the same and has a limit at 0.
    """
    v, turn = twists[..., :3], twists[..., 3:]
    _, b, c = _coefficients(turn)
    K = rotations.hat(turn)
    shift = v + b * rotate(K, v) + c * rotate(K, rotate(K, v))
    return rigid(rotations.exp(turn), shift)


def log(T: Array) -> Array:
    """Twists (..., 6) of (..., 4, 4) rigid motions; turns of at most pi."""
    turn = rotations.log(T[..., :3, :3])
    squared = jnp.sum(turn**2, -1, keepdims=True)
    a, b, _ = _coefficients(turn)
    small = squared < SMALL_SQUARED
    divisor = jnp.where(small, 1.0, squared)
    series = _series(squared, (1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160))
    d = jnp.where(small, series, (1 - a / (2 * b)) / divisor)
    K, t = rotations.hat(turn), T[..., :3, 3]
    return jnp.concatenate([t - rotate(K, t) / 2 + d * rotate(K, rotate(K, t)), turn], -1)


def _coefficients(turn: Array) -> tuple[Array, Array, Array]:
    """Three quotients (..., 1) of the turn's length t.

    They are sin t / t, (1 - cos t) / t^2 and (t - sin t) / t^3.
    """
    squared = jnp.sum(turn**2, -1, keepdims=True)
    small = squared < SMALL_SQUARED
    safe = jnp.where(small, 1.0, squared)
    angle = jnp.sqrt(safe)
    sine, half = jnp.sin(angle), jnp.sin(angle / 2)
    a = _series(squared, (1, -1 / 6, 1 / 120, -1 / 5040, 1 / 362880))
    b = _series(squared, (1 / 2, -1 / 24, 1 / 720, -1 / 40320, 1 / 3628800))
    c = _series(squared, (1 / 6, -1 / 120, 1 / 5040, -1 / 362880, 1 / 39916800))
    return (
        jnp.where(small, a, sine / angle),
        jnp.where(small, b, 2 * half * half / safe),
        jnp.where(small, c, (angle - sine) / (angle * safe)),
    )


def _series(x: Array, coefficients: tuple[float, ...]) -> Array:
    """The polynomial with these coefficients, lowest first."""
    total = jnp.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        total = coefficient + x * total
    return total


def rigid(R: Array, t: Array) -> Array:
    """Homogeneous matrices (..., 4, 4) of rotations (..., 3, 3) and translations (..., 3)."""
    top = jnp.concatenate([R, t[..., None]], -1)
    last = jnp.broadcast_to(jnp.eye(4, dtype=R.dtype)[3:], (*R.shape[:-2], 1, 4))
    return jnp.concatenate([top, last], -2)


def move(T: Array, points: Array) -> Array:
    """Points (..., 3) moved by rigid motions (..., 4, 4)."""
    return rotate(T[..., :3, :3], points) + T[..., :3, 3]


def inverse(T: Array) -> Array:
    """The motions (..., 4, 4) back."""
    R_back = jnp.swapaxes(T[..., :3, :3], -1, -2)
    return rigid(R_back, -rotate(R_back, T[..., :3, 3]))


def adjoint(T: Array) -> Array:
    """(..., 6, 6): what a motion of the frame makes of twists, ``T hat(xi) T^-1``."""
    R = T[..., :3, :3]
    upper = jnp.concatenate([R, compose(rotations.hat(T[..., :3, 3]), R)], -1)
    lower = jnp.concatenate([jnp.zeros_like(R), R], -1)
    return jnp.concatenate([upper, lower], -2)


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
