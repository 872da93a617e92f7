"""The downhill simplex method (Nelder and Mead 1965), over a batch of problems at once.

All problems (the arms) go side by side: the reflected points of a step are evaluated together, and
the rarer second points and shrinks only where some problem wants one (one scalar ``cond`` for
all). A problem that has converged is frozen.

INPUTS: a cost of a batch of points, a simplex for each problem. OUTPUTS: the best points.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

# Reflection, expansion, contraction and shrink as Nelder and Mead give them.
REFLECT, EXPAND, CONTRACT, SHRINK = 1.0, 2.0, 0.5, 0.5


class SimplexResult(NamedTuple):
    """How B problems of n variables ended.

    Attributes:
        points: (B, n) best found.
        costs: (B,) there.
        iterations: (B,) until frozen.
        converged: (B,) whether both tolerances were met.
    """

    points: Array
    costs: Array
    iterations: Array
    converged: Array


class _State(NamedTuple):
    vertices: Array  # (B, n + 1, n), by ascending cost
    costs: Array  # (B, n + 1)
    iterations: Array  # (B,)
    done: Array  # (B,)


def initial_simplex(starts: Array, edges: Array) -> Array:
    """Simplices (B, n + 1, n): one vertex at each (B, n) start, (n, n) or (B, n, n) edges."""
    others = starts[:, None] + jnp.broadcast_to(edges, (*starts.shape, starts.shape[-1]))
    return jnp.concatenate([starts[:, None], others], 1)


def downhill_simplex(
    cost: Callable[[Array], Array],
    simplices: Array,
    iterations: Array | int,
    point_tolerance: float = 1e-4,
    cost_tolerance: float = 1e-4,
) -> SimplexResult:
    """Minimise each of B problems from its own simplex.

    The result has no useful derivative: differentiate through a gradient refinement instead.

    Args:
        cost: (B, n) points, one for each problem, to (B,) costs.
        simplices: (B, n + 1, n) starting vertices.
        iterations: most steps.
        point_tolerance: a problem is done when no vertex is farther from the best than this in any
            variable, and
        cost_tolerance: no cost is higher than the best by more than this (SciPy's rule).
    """
    batch = simplices.shape[0]
    # One vertex after the other: traced once, however many there are.
    costs = jax.lax.map(cost, simplices.swapaxes(0, 1)).T
    zero = jnp.zeros(batch, jnp.int32)
    start = _settle(_State(simplices, costs, zero, zero > 0), point_tolerance, cost_tolerance)

    def unfinished(carry: tuple[Array, _State]) -> Array:
        return (carry[0] < iterations) & ~jnp.all(carry[1].done)

    def step(carry: tuple[Array, _State]) -> tuple[Array, _State]:
        moved = _settle(_move(cost, carry[1]), point_tolerance, cost_tolerance)
        return carry[0] + 1, moved

    _, state = jax.lax.while_loop(unfinished, step, (jnp.zeros((), jnp.int32), start))
    return SimplexResult(state.vertices[:, 0], state.costs[:, 0], state.iterations, state.done)


def _settle(state: _State, point_tolerance: float, cost_tolerance: float) -> _State:
    """Order the vertices by cost and mark the problems that are done."""
    order = jnp.argsort(state.costs, axis=1)
    costs = jnp.take_along_axis(state.costs, order, 1)
    vertices = jnp.take_along_axis(state.vertices, order[..., None], 1)
    near = jnp.max(jnp.abs(vertices[:, 1:] - vertices[:, :1]), (1, 2)) <= point_tolerance
    flat = costs[:, -1] - costs[:, 0] <= cost_tolerance
    return _State(vertices, costs, state.iterations, state.done | (near & flat))


def _move(cost: Callable[[Array], Array], state: _State) -> _State:
    """One step of every problem that is not done."""
    vertices, costs, done = state.vertices, state.costs, state.done
    best, second, worst = costs[:, 0], costs[:, -2], costs[:, -1]
    centroid = jnp.mean(vertices[:, :-1], 1)
    away = centroid - vertices[:, -1]
    reflected = centroid + REFLECT * away
    f_reflected = cost(reflected)

    expands = f_reflected < best
    contracts = f_reflected >= second
    outside = f_reflected < worst
    reach = jnp.where(expands, EXPAND, jnp.where(outside, CONTRACT, -CONTRACT))
    wanted = (expands | contracts) & ~done
    tried = centroid + reach[:, None] * away
    f_tried = jax.lax.cond(
        jnp.any(wanted), lambda: cost(tried), lambda: jnp.full_like(f_reflected, jnp.inf)
    )
    bar = jnp.where(expands, f_reflected, jnp.where(outside, f_reflected, worst))
    accepted = wanted & jnp.where(expands | ~outside, f_tried < bar, f_tried <= bar)
    shrinks = contracts & ~accepted & ~done
    point = jnp.where(accepted[:, None], tried, reflected)
    value = jnp.where(accepted, f_tried, f_reflected)
    moves = ~(done | shrinks)
    vertices = vertices.at[:, -1].set(jnp.where(moves[:, None], point, vertices[:, -1]))
    costs = costs.at[:, -1].set(jnp.where(moves, value, costs[:, -1]))
    vertices, costs = jax.lax.cond(
        jnp.any(shrinks), lambda: _shrink(cost, vertices, costs, shrinks), lambda: (vertices, costs)
    )
    return _State(vertices, costs, state.iterations + (~done).astype(jnp.int32), done)


def _shrink(
    cost: Callable[[Array], Array], vertices: Array, costs: Array, shrinks: Array
) -> tuple[Array, Array]:
    """Draw the vertices of the problems that shrink towards their best."""
    drawn = vertices[:, :1] + SHRINK * (vertices - vertices[:, :1])
    values = jax.lax.map(cost, drawn[:, 1:].swapaxes(0, 1)).T
    vertices = jnp.where(shrinks[:, None, None], drawn, vertices)
    return vertices, costs.at[:, 1:].set(jnp.where(shrinks[:, None], values, costs[:, 1:]))
