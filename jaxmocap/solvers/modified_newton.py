"""Newton's method with the Hessian's eigenvalues made positive, for costs that are not smooth.

The cost of edges bends in every pixel, and its Hessian is seldom positive there. Several dampings
are tried at once.

INPUTS: a cost on any manifold, its slope, bounds. OUTPUTS: where it is least.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.solvers.optimum import rests

# Factors on the last step's damping that each step tries.
TRIED = (1e-3, 1e-1, 1.0, 1e1, 1e3)
FIRST_DAMPING, LEAST_DAMPING, LARGEST_DAMPING = 1e-3, 1e-9, 1e9


class Costs(NamedTuple):
    """A cost of x, and how x moves: by tangent vectors (N,) at it.

    Attributes:
        cost: x to ().
        slope: x and a tangent vector to the cost's derivative (N,) where that leads, in the tangent
            space there.
        move: x and a tangent vector to where it leads.
        room: x to the lowest and highest (N,) tangent vector within bounds.
    """

    cost: Callable[[Any], Array]
    slope: Callable[[Any, Array], Array]
    move: Callable[[Any, Array], Any]
    room: Callable[[Any], tuple[Array, Array]]


def descend(costs: Costs, start: Any, scale: Array, steps: int) -> Any:
    """The x of least cost near a start, by damped Newton steps; nothing is differentiated.

    Directions of negative curvature are gone down by as much. An unknown at its bound rests there
    while the slope pushes it outwards.

    Args:
        costs: to minimise.
        start: within the bounds.
        scale: (N,) usual sizes of a change.
        steps: at most.
    """
    still = jnp.zeros_like(scale)
    tiny = jnp.finfo(scale.dtype).eps

    def unfinished(carry: tuple[Array, Array, Array, Any]) -> Array:
        count, goes_on, damping, _ = carry
        return goes_on & (count < steps) & (damping < LARGEST_DAMPING)

    def step(carry: tuple[Array, Array, Array, Any]) -> tuple[Array, Array, Array, Any]:
        count, _, damping, x = carry
        # At one go, as the prices below: written once more, the cost would compile once more.
        H, g = jax.jacfwd(lambda step: 2 * (costs.slope(x, step),), has_aux=True)(still)
        low, high = costs.room(x)
        at_rest = rests(g, low, high)
        scaled = jnp.where(at_rest, 0.0, scale)
        values, vectors = jnp.linalg.eigh(scaled[:, None] * (H + H.T) / 2 * scaled)
        sizes, along = jnp.abs(values), jnp.matmul(scaled * g, vectors)

        def moved(damping: Array) -> Any:
            curvature = sizes + damping
            flat = curvature <= tiny * sizes[-1]
            move = -jnp.matmul(vectors, jnp.where(flat, 0.0, along / jnp.where(flat, 1, curvature)))
            return costs.move(x, jnp.clip(scaled * move, low, high))

        candidates = jnp.clip(damping * jnp.asarray(TRIED, scale.dtype), LEAST_DAMPING)
        there = jax.vmap(moved)(candidates)
        places = jax.tree.map(lambda new, old: jnp.concatenate([new, old[None]]), there, x)
        prices = jax.vmap(costs.cost)(places)
        here, best = prices[-1], jnp.argmin(jnp.nan_to_num(prices[:-1], nan=jnp.inf))
        lower = prices[best] < here
        promised = jnp.sum(along**2 / (sizes + LEAST_DAMPING)) / 2
        x = jax.tree.map(lambda new, old: jnp.where(lower, new[best], old), places, x)
        damping = jnp.where(lower, candidates[best], candidates[-1])
        return count + 1, promised > tiny * (1e-3 + here), damping, x

    damping = jnp.asarray(FIRST_DAMPING, scale.dtype)
    first = (jnp.zeros((), jnp.int32), jnp.ones((), bool), damping, start)
    return jax.lax.while_loop(unfinished, step, first)[3]
