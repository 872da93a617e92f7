"""Minima within bounds that carry their own derivatives.

A loop of steps has no useful derivative; the minimum x that it ends at has one. There the slope
g(x, p) vanishes, and goes on doing so as p changes: H dx = -(dg/dp) dp, the implicit function
theorem. One step from the minimum, its Hessian H held fixed, says just that, forwards, backwards
and in batches.

The descent takes the whole Hessian, not Gauss-Newton's: out of reach, where residuals are large,
optimistix' Levenberg-Marquardt creeps, though it is ten times as quick within reach
(``python -m bench.minima``).

INPUTS: a cost on any manifold, its slope, bounds. OUTPUTS: the minimum; steps that carry
derivatives.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

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


def rests(slope: Array, low: Array, high: Array) -> Array:
    """Which unknowns (N,) are at a bound that their slope pushes them against."""
    return ((low >= 0) & (slope > 0)) | ((high <= 0) & (slope < 0))


# Of the curvature that the residuals' derivatives alone have, less is none.
LEAST_CURVATURE = 1e-2


def least_squares_step(
    jacobian: Array, second_order: Array, moves: Array, change: Array, pull: Array
) -> Array:
    """The step (N,) of a least-squares minimum as its residuals change.

    The cost's Hessian J^T J + S has the square of J's condition, and single precision cannot hold
    it where a marker counts for millimetres beside a weak prior. By J = QR the equations are

        (1 + R^-T S R^-1) (R dx) = -(Q^T dr + R^-T dJ^T r)

    and no square is formed.

    Args:
        jacobian: (K, N) of the residuals; held fixed.
        second_order: (N, N) S, the residuals' second derivatives, each times its residual; held.
        moves: (N,) which unknowns may move; the others' step is 0.
        change: (K,) of the residuals, dr.
        pull: (N,) of their pull, dJ^T r.
    """
    J, S = jax.lax.stop_gradient((jacobian, (second_order + second_order.T) / 2))
    free = moves.astype(J.dtype)
    sizes = jnp.linalg.norm(J, axis=0)
    # What no residual determines stays.
    ridge = jnp.where(moves & (sizes > 0), 10 * jnp.finfo(J.dtype).eps * sizes, 1.0)
    Q, R = jnp.linalg.qr(jnp.concatenate([J * free, jnp.diag(ridge)]))
    by_triangle = partial(jax.scipy.linalg.solve_triangular, R)
    half = by_triangle(free[:, None] * S * free, trans=1)
    values, vectors = jnp.linalg.eigh(
        jnp.eye(len(free), dtype=J.dtype) + by_triangle(half.T, trans=1)
    )
    curved = values > LEAST_CURVATURE
    inverse = jnp.where(curved, 1 / jnp.where(curved, values, 1.0), 0.0)
    right = jnp.matmul(Q[: len(J)].T, change, precision="highest") + by_triangle(
        free * pull, trans=1
    )
    along = inverse * jnp.matmul(vectors.T, right, precision="highest")
    solved = jnp.matmul(vectors, along, precision="highest")
    return -free * by_triangle(solved)


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
