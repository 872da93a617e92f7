"""A level set function on a canvas: Φ > 0 within the person, in cells (section 4.1).

Gradient descent (4.20) of the energy (4.19), whose likelihoods count negatively (the printed sign
is a slip). Each step also draws Φ towards a distance, as Sussman et al. do between steps, and
smooths it along its gradient: both by the stencil of the curvature, so that they cost next to
nothing, and neither moves the contour.

INPUTS: Φ (..., S, S), the log-ratio log p1 - log p2 of its cells. OUTPUTS: Φ, moved.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

# Φ is cut off at so many cells: beyond, nothing moves.
BAND = 8.0
# Below this square of the gradient a contour has no direction.
FLAT = 1e-2


class LevelSetMotion(NamedTuple):
    """How a level set moves; traced numbers."""

    length: Array | float = 0.15  # ν, the weight of the contour's length against log-likelihoods
    speed: Array | float = 0.33  # the time step
    distance: Array | float = 0.4  # how fast |∇Φ| goes to 1
    smoothing: Array | float = 0.2  # of Φ along its gradient; stable below 0.25


def heaviside(phi: Array, width: Array | float) -> Array:
    """H(Φ): 1 within, 0 outside, by the error function."""
    return 0.5 * (1 + jax.lax.erf(phi / width))


def evolve(
    phi: Array, log_ratio: Array, motion: LevelSetMotion, width: Array | float, steps: int
) -> Array:
    """Φ (V, S, S) after a static number of steps."""
    return jax.lax.fori_loop(0, steps, lambda _, now: step(now, log_ratio, motion, width), phi)


def step(phi: Array, log_ratio: Array, motion: LevelSetMotion, width: Array | float) -> Array:
    """One step of (4.20) for V level sets.

    H' is taken relative to its peak, so that ``speed`` is that of the contour, in cells per unit of
    log-ratio, whatever the width.

    Args:
        phi: (V, S, S) cells.
        log_ratio: (V, S, S) log p1 - log p2.
        motion: weights and time step.
        width: of H, cells: how far off the contour cells are moved as well; may be (V, S, S).
    """
    wide = jnp.pad(phi, ((0, 0), (1, 1), (1, 1)), mode="edge")
    up, down = wide[:, :-2], wide[:, 2:]
    left, right = wide[:, 1:-1, :-2], wide[:, 1:-1, 2:]
    above, below = up[:, :, 1:-1], down[:, :, 1:-1]
    x, y = (right - left) / 2, (below - above) / 2
    xx, yy = right + left - 2 * phi, below + above - 2 * phi
    xy = (up[:, :, :-2] + down[:, :, 2:] - up[:, :, 2:] - down[:, :, :-2]) / 4
    squared = x * x + y * y + FLAT
    inverse = jax.lax.rsqrt(squared)
    across = (xx * y * y - 2 * x * y * xy + yy * x * x) / squared
    curvature, slope = across * inverse, squared * inverse
    near = jnp.exp(-((phi / width) ** 2))
    force = motion.speed * near * (log_ratio + motion.length * curvature)
    kept = motion.distance * phi * jax.lax.rsqrt(phi * phi + 1) * (1 - slope)
    along = motion.smoothing * (xx + yy - across)
    return jnp.clip(phi + force + kept + along, -BAND, BAND)


def downsample(values: Array) -> Array:
    """Means (..., S/2, S/2) of two by two cells."""
    rows = values[..., ::2, :] + values[..., 1::2, :]
    return (rows[..., ::2] + rows[..., 1::2]) / 4


def upsample(phi: Array) -> Array:
    """Φ (V, S, S) on cells of half the size (V, 2 S, 2 S), in those."""
    count, size, _ = phi.shape
    return 2 * jax.image.resize(phi, (count, 2 * size, 2 * size), "linear")
