"""Selectively damped least squares (section 4.3; Buss and Kim 2005).

INPUTS: a Jacobian of k stacked end effectors, their desired displacements.
OUTPUTS: a damped step, and the projector that keeps a secondary task from moving the effectors.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

# A GPU's TF32 would cost millimetres at the hand.
HIGHEST = jax.lax.Precision.HIGHEST


class SdlsStep(NamedTuple):
    """One step of n degrees of freedom."""

    primary: Array  # (n,) equation (7), clamped once more to the global maximum
    row_space: Array  # (r, n) orthonormal rows v_i; those of dropped singular values are 0


def clamp_lengths(vectors: Array, longest: Array | float) -> Array:
    """Shorten those of the (k, 3) vectors that are longer than ``longest`` (section 4.1)."""
    squared = jnp.sum(vectors**2, -1, keepdims=True)
    too_long = squared > longest**2
    return vectors * jnp.where(too_long, longest / jnp.sqrt(jnp.where(too_long, squared, 1.0)), 1.0)


def clamp_max_abs(vector: Array, largest: Array | float) -> Array:
    """Scale (..., n) vectors whose largest component exceeds ``largest`` (ClampMaxAbs of (7))."""
    peak = jnp.max(jnp.abs(vector), -1, keepdims=True)
    scale = jnp.where(peak > largest, largest / jnp.where(peak > 0, peak, 1.0), 1.0)
    return vector * scale


def sdls_step(
    J: Array, error: Array, largest: Array | float, rank_tolerance: float = 1e-5
) -> SdlsStep:
    """The damped step of equations (5) to (8).

    Each singular direction i is limited by gamma_i, which falls with the ratio of the
    displacement that is asked for (N_i) to the one that it would cause undamped (M_i).

    Args:
        J: (3k, n) Jacobian, weighted; rows of absent effectors are 0.
        error: (3k,) desired displacements, clamped; 0 for absent effectors.
        largest: Gamma, the global maximum of one step's components, in the units of the step.
        rank_tolerance: singular values below this fraction of the largest count as zero.

    Returns:
        The step; not differentiable where singular values repeat.
    """
    U, sigma, Vt = jnp.linalg.svd(J, full_matrices=False)
    kept = sigma > rank_tolerance * sigma[0]
    inverse = jnp.where(kept, 1 / jnp.where(kept, sigma, 1.0), 0.0)
    effectors = J.shape[0] // 3
    N = jnp.sum(jnp.linalg.norm(U.reshape(effectors, 3, -1), axis=1), 0)
    reach = jnp.sum(jnp.linalg.norm(J.reshape(effectors, 3, -1), axis=1), 0)
    M = inverse * jnp.matmul(jnp.abs(Vt), reach, precision=HIGHEST)
    gamma = largest * jnp.minimum(1.0, N / jnp.where(kept, M, 1.0))
    alpha = jnp.matmul(error, U, precision=HIGHEST)
    terms = clamp_max_abs((inverse * alpha)[:, None] * Vt, gamma[:, None])
    primary = clamp_max_abs(jnp.sum(jnp.where(kept[:, None], terms, 0.0), 0), largest)
    return SdlsStep(primary, jnp.where(kept[:, None], Vt, 0.0))


def project_secondary(row_space: Array, secondary: Array) -> Array:
    """``(I - J^+ J) secondary`` of equation (1): the part (..., n) that moves no end effector."""
    along = jnp.matmul(secondary, row_space.T, precision=HIGHEST)
    return secondary - jnp.matmul(along, row_space, precision=HIGHEST)


def damped_step(J: Array, error: Array, damping: Array | float) -> Array:
    """Damped least squares (Nakamura and Hanafusa 1986): ``J^T (J J^T + damping^2 I)^-1 error``.

    Args:
        J: (m, n); rows of absent goals are 0.
        error: (m,).
        damping: in the units of J's singular values.
    """
    square = jnp.matmul(J, J.T, precision=HIGHEST)
    ridge = damping**2 * jnp.eye(len(error), dtype=J.dtype)
    factor = jax.scipy.linalg.cho_factor(square + ridge)
    return jnp.matmul(jax.scipy.linalg.cho_solve(factor, error), J, precision=HIGHEST)
