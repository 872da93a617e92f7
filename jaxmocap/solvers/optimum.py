"""Minima within bounds that carry their own derivatives.

A loop of steps has no useful derivative; the minimum x that it ends at has one. There the slope
g(x, p) vanishes, and goes on doing so as p changes: H dx = -(dg/dp) dp, the implicit function
theorem. One Newton step from the minimum, its Hessian H held fixed, says just that, forwards,
backwards and in batches, and squares what is left of the distance besides.

The descent takes the whole Hessian, not Gauss-Newton's: out of reach, where residuals are large,
optimistix' Levenberg-Marquardt creeps, though it is ten times as quick within reach
(``python -m bench.minima``).

INPUTS: a cost on any manifold, its slope, bounds. OUTPUTS: the minimum; steps that carry
derivatives.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

# Factors on the last step's damping that each step tries.
TRIED = (1e-3, 1e-1, 1.0, 1e1, 1e3)
FIRST_DAMPING, LEAST_DAMPING, LARGEST_DAMPING = 1e-3, 1e-9, 1e9
# Undamped steps at the end: each squares the distance to the minimum.
UNDAMPED_STEPS = 3


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


class Descent(NamedTuple):
    """Where a descent ended.

    Attributes:
        x: of least cost.
        hessian: (N, N) of the cost there.
        at_rest: (N,) unknowns at a bound that their slope pushes them against.
    """

    x: Any
    hessian: Array
    at_rest: Array


def descend(costs: Costs, start: Any, scale: Array, steps: int) -> Descent:
    """The x of least cost near a start, by damped Newton steps; nothing is differentiated.

    Directions of negative curvature are gone down by as much. An unknown at its bound rests there
    while the slope pushes it outwards. Undamped steps end it.

    Args:
        costs: to minimise.
        start: within the bounds.
        scale: (N,) usual sizes of a change.
        steps: at most, before the undamped ones.
    """
    still = jnp.zeros_like(scale)
    tiny = jnp.finfo(scale.dtype).eps

    def unfinished(carry: tuple[Array, Array, Array, Descent]) -> Array:
        return carry[1] != 0

    def step(carry: tuple[Array, Array, Array, Descent]) -> tuple[Array, Array, Array, Descent]:
        count, undamped, damping, (x, _, _) = carry
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
        there = jax.vmap(moved)(jnp.append(candidates, 0.0))
        places = jax.tree.map(lambda new, old: jnp.concatenate([new, old[None]]), there, x)
        prices = jax.vmap(costs.cost)(places)
        here, best = prices[-1], jnp.argmin(jnp.nan_to_num(prices[:-2], nan=jnp.inf))
        lower = prices[best] < here
        promised = jnp.sum(along**2 / (sizes + LEAST_DAMPING)) / 2
        goes_on = (promised > tiny * (1e-3 + here)) & (count < steps) & (damping < LARGEST_DAMPING)
        # Where the costs differ by rounding alone, the slope still says where the minimum is.
        ends = jnp.isfinite(prices[-2]) & (prices[-2] <= here + 1e-3 * (1e-3 + here))
        taken, accepted = (jnp.where(undamped > 0, *pair) for pair in ((-2, best), (ends, lower)))
        x = jax.tree.map(lambda new, old: jnp.where(accepted, new[taken], old), places, x)
        damping = jnp.where(lower, candidates[best], candidates[-1])
        left = jnp.where(undamped > 0, undamped - 1, jnp.where(goes_on, -1, UNDAMPED_STEPS))
        return count + 1, left, damping, Descent(x, H, at_rest)

    first = jnp.asarray(FIRST_DAMPING, scale.dtype)
    nothing = Descent(start, jnp.zeros((scale.size, scale.size), scale.dtype), still > 0)
    counted = jnp.zeros((), jnp.int32)
    return jax.lax.while_loop(unfinished, step, (counted, counted - 1, first, nothing))[3]


def rests(slope: Array, low: Array, high: Array) -> Array:
    """Which unknowns (N,) are at a bound that their slope pushes them against."""
    return ((low >= 0) & (slope > 0)) | ((high <= 0) & (slope < 0))


def newton_step(slope: Array, hessian: Array, moves: Array) -> Array:
    """The step (N,) to where the slope vanishes, which carries its derivatives.

    Args:
        slope: (N,) of a cost at a point, differentiable by whatever it depends on.
        hessian: (N, N) there, held fixed.
        moves: (N,) which unknowns may move; the others' step is 0.
    """
    H = jax.lax.stop_gradient(hessian)
    curvature = jnp.abs(jnp.diagonal(H))
    least = jnp.finfo(H.dtype).tiny ** 0.5
    scale = jnp.where(moves & (curvature > least), 1 / jnp.sqrt(jnp.maximum(curvature, least)), 0.0)
    ridge = jnp.where(scale > 0, 10 * jnp.finfo(H.dtype).eps, 1.0)
    scaled = scale[:, None] * H * scale + jnp.diag(ridge)
    return -scale * jnp.linalg.solve(scaled, scale * slope)


def curved_step(slope: Array, hessian: Array) -> Array:
    """The step (N,) that carries the derivatives of the minimum beside a point.

    Directions in which the Hessian (N, N) is not curved upwards have none.
    """
    H = jax.lax.stop_gradient((hessian + hessian.T) / 2)
    curvature = jnp.abs(jnp.diagonal(H))
    scale = jnp.where(curvature > 0, 1 / jnp.sqrt(jnp.where(curvature > 0, curvature, 1.0)), 0.0)
    values, vectors = jnp.linalg.eigh(scale[:, None] * H * scale)
    curved = values > 100 * jnp.finfo(H.dtype).eps * jnp.max(jnp.abs(values))
    inverse = jnp.where(curved, 1 / jnp.where(curved, values, 1.0), 0.0)
    return -scale * jnp.matmul(vectors, inverse * jnp.matmul(scale * slope, vectors))
