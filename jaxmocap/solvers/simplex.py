"""The downhill simplex method (Nelder and Mead 1965), over a batch of problems at once.

All problems (the arms) go side by side, each at its own stage: with every evaluation one of them
learns a vertex of its simplex, another its reflected point, a third the point beyond or before
that. So the cost, which may be a long program, stands in one place only. A problem that has
converged is frozen.

INPUTS: a cost of a batch of points, a simplex for each problem. OUTPUTS: the best points.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

# Reflection, expansion, contraction and shrink as Nelder and Mead give them.
REFLECT, EXPAND, CONTRACT, SHRINK = 1.0, 2.0, 0.5, 0.5


class SimplexResult(NamedTuple):
    """How B problems of n variables ended."""

    points: Array  # (B, n) best found
    costs: Array  # (B,) there
    iterations: Array  # (B,) until frozen
    converged: Array  # (B,) whether both tolerances were met


class _State(NamedTuple):
    """Of B problems."""

    vertices: Array  # (B, n + 1, n), by ascending cost unless some are still to be evaluated
    costs: Array  # (B, n + 1); infinite of vertices that are still to be evaluated
    point: Array  # (B, n) to be evaluated next
    # (B,) what that is: vertex 0 to n; n + 1 the worst vertex reflected; n + 2 a second try, beyond
    # that or before it.
    stage: Array
    reflected: Array  # (B,) cost of the reflected point
    iterations: Array  # (B,) begun by a reflection and ended
    done: Array  # (B,) whether converged


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
    batch, vertices, _ = simplices.shape
    unknown = jnp.full((batch, vertices), jnp.inf, simplices.dtype)
    zero = jnp.zeros(batch, jnp.int32)
    start = _State(simplices, unknown, simplices[:, 0], zero, unknown[:, 0], zero, zero > 0)

    def going(state: _State) -> Array:
        """(B,) a simplex that was begun is evaluated completely, whatever the limits are."""
        more = ~state.done & (state.iterations < iterations)
        return more | (state.stage != vertices)

    def step(state: _State) -> _State:
        moved = _learn(state, cost(state.point), point_tolerance, cost_tolerance)
        goes = going(state)
        return jax.tree.map(lambda new, old: _where(goes, new, old), moved, state)

    end = jax.lax.while_loop(lambda state: jnp.any(going(state)), step, start)
    return SimplexResult(end.vertices[:, 0], end.costs[:, 0], end.iterations, end.done)


def _where(chosen: Array, yes: Array, no: Array) -> Array:
    """Of each of B problems, (B,) ``chosen``, the one or the other (B, ...)."""
    return jnp.where(chosen.reshape(-1, *(1,) * (yes.ndim - 1)), yes, no)


def _learn(state: _State, values: Array, point_tolerance: float, cost_tolerance: float) -> _State:
    """What follows from the (B,) costs of the present points, and the next points."""
    last = state.vertices.shape[1] - 1
    rows = np.arange(last + 1, dtype=np.int32)
    decision = _decide(state, values)
    _, f_reflected, _, seconds, shrinks, ends = decision
    vertices, costs, tried = _move_vertices(state, values, decision, rows)

    is_complete = ends | (state.stage == last)
    vertices, costs = (
        _where(is_complete, new, old)
        for new, old in zip(_order_vertices(vertices, costs), (vertices, costs), strict=True)
    )
    near = jnp.max(jnp.abs(vertices[:, 1:] - vertices[:, :1]), (1, 2)) <= point_tolerance
    flat = costs[:, -1] - costs[:, 0] <= cost_tolerance

    following = jnp.where(is_complete, last + 1, jnp.where(seconds, last + 2, state.stage + 1))
    following = jnp.where(shrinks, 1, following)
    centroid, away = _across(vertices)
    chosen = rows == following[:, None]
    point = jnp.sum(jnp.where(chosen[..., None], vertices, 0.0), 1)
    point = _where(is_complete, centroid + REFLECT * away, _where(seconds, tried, point))
    counted = state.iterations + (ends | shrinks).astype(jnp.int32)
    return _State(
        vertices, costs, point, following, f_reflected, counted, is_complete & near & flat
    )


class _Decision(NamedTuple):
    """What (B,) costs of the present points decide, one simplex each."""

    factor: Array  # of the second point, along the way from the worst vertex through the middle
    f_reflected: Array  # cost of the reflected point
    better: Array  # whether the second point is kept
    seconds: Array  # whether a second point is asked for
    shrinks: Array  # whether the simplex shrinks
    ends: Array  # whether an iteration ends with the worst vertex replaced


def _decide(state: _State, values: Array) -> _Decision:
    last = state.vertices.shape[1] - 1
    reflects, tries = state.stage == last + 1, state.stage == last + 2
    best, second, worst = state.costs[:, 0], state.costs[:, -2], state.costs[:, -1]
    f_reflected = jnp.where(tries, state.reflected, values)
    expands, contracts, outside = f_reflected < best, f_reflected >= second, f_reflected < worst
    factor = jnp.where(expands, EXPAND, jnp.where(outside, CONTRACT, -CONTRACT))
    bound = jnp.where(expands | outside, f_reflected, worst)
    better = jnp.where(outside & ~expands, values <= bound, values < bound)
    seconds = reflects & (expands | contracts)
    shrinks = tries & contracts & ~better
    ends = (reflects & ~seconds) | (tries & ~shrinks)
    return _Decision(factor, f_reflected, better, seconds, shrinks, ends)


def _move_vertices(
    state: _State, values: Array, decision: _Decision, rows: np.ndarray
) -> tuple[Array, Array, Array]:
    """Vertices and costs after a decision, not ordered, and the second point (B, n)."""
    factor, f_reflected, better, _, shrinks, ends = decision
    vertices, last = state.vertices, len(rows) - 1
    tries = state.stage == last + 2
    centroid, away = _across(vertices)
    tried = centroid + factor[:, None] * away
    kept = _where(tries & better, tried, centroid + REFLECT * away)
    replaced = vertices.at[:, -1].set(_where(ends, kept, vertices[:, -1]))
    shrunk = vertices[:, :1] + SHRINK * (vertices - vertices[:, :1])
    vertices = _where(shrinks, shrunk, replaced)

    vertex = jnp.where(state.stage <= last, state.stage, jnp.where(ends, last, -1))
    valued = rows == vertex[:, None]
    value = jnp.where(tries & ~better, f_reflected, values)
    # Of a shrunk simplex only the best vertex keeps its cost.
    forgotten = shrinks[:, None] & (rows > 0)
    costs = jnp.where(valued, value[:, None], jnp.where(forgotten, jnp.inf, state.costs))
    return vertices, costs, tried


def _across(vertices: Array) -> tuple[Array, Array]:
    """The middle (B, n) of all vertices but the worst, and the way (B, n) there from the worst."""
    centroid = jnp.mean(vertices[:, :-1], 1)
    return centroid, centroid - vertices[:, -1]


def _order_vertices(vertices: Array, costs: Array) -> tuple[Array, Array]:
    """By ascending cost."""
    order = jnp.argsort(costs, axis=1)
    return (
        jnp.take_along_axis(vertices, order[..., None], 1),
        jnp.take_along_axis(costs, order, 1),
    )
