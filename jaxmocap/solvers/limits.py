"""Steps within limits: an unknown at its limit that would go on leaves, and the rest solve again.

INPUTS: a step as a function of the unknowns that may move, their limits. OUTPUTS: a step.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array


def step_within(
    step: Callable[[Array], Array],
    low: Array,
    high: Array,
    free: Array,
    at_limit: float,
    rounds: int,
) -> Array:
    """A step (N,), of which those leave that are at their limit and would go on.

    Args:
        step: which (N,) unknowns may move, to their step.
        low: (N,) how far each may still go down; 0 or less.
        high: (N,) how far each may still go up.
        free: (N,) unknowns that may move at all.
        at_limit: an unknown this near to its limit is at it.
        rounds: most solves.
    """

    def unsolved(carry: tuple[Array, Array, Array, Array]) -> Array:
        count, _, _, newly = carry
        return (count == 0) | ((count < rounds) & newly)

    def solve(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        count, _, gone, _ = carry
        stays = free & ~gone
        taken = step(stays)
        onwards = ((taken < low) & (low > -at_limit)) | ((taken > high) & (high < at_limit))
        leaving = onwards & stays
        return count + 1, taken, gone | leaving, jnp.any(leaving)

    nothing = jnp.zeros(free.shape, bool)
    start = (jnp.zeros((), jnp.int32), jnp.zeros_like(low), nothing, jnp.zeros((), bool))
    return jax.lax.while_loop(unsolved, solve, start)[1]
