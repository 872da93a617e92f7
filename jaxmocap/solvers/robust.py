"""Outliers: pairs by how far they are off against all, Tukey's biweight; others by Student's t.

INPUTS: distances; whitened residuals. OUTPUTS: what is left of pairs' weights; shorter residuals.
"""

import jax
import jax.numpy as jnp
from jax import Array

# Between the median length of a normal error in a plane and the deviation of its components.
MEDIAN_OF_LENGTHS = 1.1774
# Degrees of freedom of Student's t: what is off by some deviations is taken for wrong, and hardly
# pulls.
TAILS = 5.0


def shorten_residuals(off: Array, tails: float = TAILS) -> Array:
    """Whitened vectors (..., N) shortened so that their squares grow as Student's t has it.

    That is as a logarithm, instead of without end; ``tails`` are its degrees of freedom.
    """
    ratio = jnp.sum(off**2, -1, keepdims=True) / tails
    small = ratio < 1e-4
    large = jnp.where(small, 1.0, ratio)
    return off * jnp.sqrt(jnp.where(small, 1 - ratio / 2, jnp.log1p(large) / large))


def robust_shares(
    squared: Array, real: Array, deviation: Array | float, reach: Array | float
) -> tuple[Array, Array, Array]:
    """What is left of the weight of pairs by how far they are off in space: Tukey's biweight.

    Args:
        squared: (N,) distances, squared.
        real: (N,) False where there is no pair.
        deviation: least spread of the distances, in their unit.
        reach: spreads beyond which a pair is an outlier; infinite for none.

    Returns:
        (N,) distances; (N,) shares from 0, an outlier, to 1; () spread of the distances.
    """
    off = squared > 0
    distances = jnp.where(off, jnp.sqrt(jnp.where(off, squared, 1.0)), 0.0)
    spread = jnp.maximum(_median(distances, real) / MEDIAN_OF_LENGTHS, deviation)
    ratio = jnp.minimum(squared / (reach * spread) ** 2, 1.0)
    return distances, (1 - ratio) ** 2, spread


def _median(values: Array, real: Array) -> Array:
    """() of those of (N,) values, none negative, that are real; 0 where none is.

    Such numbers are in the order of their bits: the median's are found one by one, the highest
    first, by counting. Sorting takes seven times as long.
    """
    bits, integer = 8 * values.dtype.itemsize, jnp.dtype(f"int{8 * values.dtype.itemsize}")
    keys = jax.lax.bitcast_convert_type(jnp.where(real, values, jnp.inf), integer)
    before = jnp.maximum(jnp.sum(real.astype(jnp.int32)) - 1, 0) // 2

    def with_bit(i: Array, found: Array) -> Array:
        tried = found | (jnp.ones((), integer) << (bits - 2 - i).astype(integer))
        below = jnp.sum((keys < tried).astype(jnp.int32))
        return jnp.where(below <= before, tried, found)

    found = jax.lax.fori_loop(0, bits - 1, with_bit, jnp.zeros((), integer))
    middle = jax.lax.bitcast_convert_type(found, values.dtype)
    return jnp.where(jnp.isfinite(middle), middle, 0.0)
