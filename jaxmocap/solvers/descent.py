"""Minima of squared residuals within bounds: a damped Newton descent, alone and in batches.

Steps take second-order corrections (Nocedal, Wright, Numerical Optimization, 18.3) and the
residuals' second derivatives: out of reach, where residuals are large, Levenberg-Marquardt creeps
(``python -m bench.minima``).

INPUTS: residuals on any manifold, their derivatives, bounds. OUTPUTS: the minimum.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.custom_batching import custom_vmap
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun

from jaxmocap.solvers.sdls import HIGHEST

# Damping (Levenberg's), nats per squared metre or radian: from any start, where the start is near,
# at least, at most; and its factors after a step that lowered the cost, and after another. By the
# Hessian's diagonal, as Marquardt has it, millimetres of a marker would damp what only a prior
# determines.
FIRST_DAMPING, NEAR_DAMPING, LEAST_DAMPING, LARGEST_DAMPING = 1.0, 1e-2, 1e-3, 1e9
LOWERED, NOT_LOWERED = 0.1, 4.0
# After a step that did not lower the cost, damping is at least so many times what halves a step.
SHORTENED = 3.0
# The last step lowers the cost by less than so many precisions, nats, and by less than what
# rounding does to it; and its largest entry is less than so many roots of the precision.
LITTLE, SHORT = 100.0, 30.0
# Costs that differ by less, as a share, are alike.
ALIKE = 1e-5
# The largest entry of a step, metres and radians.
LARGEST_STEP = 0.7
# In a batch, this part of the unfinished ones is made a step at a time: the others wait for nobody.
AT_A_TIME = 1 / 8
# Most solves of a step, as unknowns meet their bounds or curvature turns out negative.
SOLVES = 5


class Local(NamedTuple):
    """Residuals about a point, to second order."""

    residuals: Array  # (R,)
    jacobian: Array  # (R, N) by a tangent vector
    second_order: Array  # (N, N) the sum of their second derivatives, each times its residual

    @property
    def cost(self) -> Array:
        """() half the sum of squares."""
        return jnp.sum(self.residuals**2) / 2

    @property
    def slope(self) -> Array:
        """(N,) the cost's derivative."""
        return jnp.matmul(self.residuals, self.jacobian, precision=HIGHEST)


class Problem(NamedTuple):
    """Squared residuals of x, and how x moves: by tangent vectors (N,) at it."""

    residuals: Callable[[Any, Any], Array]  # parameters and x to (R,)
    about: Callable[[Any, Any], Local]  # parameters and x to a ``Local``
    move: Callable[[Any, Array], Any]  # x and a tangent vector to where it leads
    # Parameters and x to the lowest and highest (N,) tangent vector within bounds.
    room: Callable[[Any, Any], tuple[Array, Array]]


class Descent(NamedTuple):
    """How a descent ended."""

    x: Any  # of least cost
    cost: Array  # () half the squares of its residuals
    rests: Array  # () whether that is a minimum; else the steps ran out


class _Progress(NamedTuple):
    """Between two steps: the best point so far, and the one that is tried next."""

    left: Array  # () steps that may be made
    best: Any  # point
    local: Local  # there
    tried: Any  # next
    damping: Array  # () of the step that leads there, negative before the first one
    shortening: Array  # () damping that shortens it
    short: Array  # () whether it is
    ended: Array  # () whether it is the last one

    @property
    def unfinished(self) -> Array:
        """() whether there is another step."""
        return ~self.ended & (self.left > 0)


def descend(
    problem: Problem, parameters: Any, start: Any, steps: Array | int, damping: Array | float
) -> Descent:
    """The x of least cost near a start; nothing is differentiated.

    A step is Newton's where the damped Hessian is positive, else Gauss-Newton's. What the residuals
    turn out to bend by along it, a second solve takes back. An unknown at its bound rests there
    while the slope pushes it outwards. The last step is short, and its Newton decrement is less
    than what rounding hides (Boyd, Vandenberghe, Convex Optimization, 9.5). In a batch each ends
    by itself.

    Args:
        problem: to solve; its functions hold no arrays.
        parameters: arrays that the problem's functions take.
        start: within the bounds.
        steps: at most.
        damping: of the first one: ``FIRST_DAMPING``, or ``NEAR_DAMPING``.
    """
    like = jax.eval_shape(problem.about, parameters, start)
    dtype = like.residuals.dtype

    def begun(start: Any, steps: Array, damping: Array) -> _Progress:
        unknown = jax.tree.map(lambda part: jnp.zeros(part.shape, part.dtype), like)
        no = jnp.zeros((), bool)
        first = -jnp.asarray(damping, dtype)
        return _Progress(
            jnp.asarray(steps), start, Local(*unknown), start, first, jnp.zeros((), dtype), no, no
        )

    def ended(now: _Progress) -> Descent:
        # The last step was too short for its cost to tell.
        done = now.ended & now.short
        return Descent(tree_where(done, now.tried, now.best), now.local.cost, now.ended)

    leaves, tree = jax.tree.flatten(parameters)

    def stepped(leaves: list[Array], now: _Progress) -> _Progress:
        return _take_step(problem, jax.tree.unflatten(tree, leaves), now)

    def by_itself(leaves: list[Array], *start: Any) -> Descent:
        step = partial(stepped, leaves)
        return ended(jax.lax.while_loop(lambda now: now.unfinished, step, begun(*start)))

    arguments = leaves, start, jnp.asarray(steps), jnp.asarray(damping, dtype)
    traced, like_end = jax.make_jaxpr(by_itself, return_shape=True)(*arguments)

    # Its constants are arguments, since a branch that is mapped maps them as well.
    @custom_vmap
    def alone(constants: list[Array], *arguments: Any) -> Descent:
        made = jaxpr_as_fun(ClosedJaxpr(traced.jaxpr, constants))(*jax.tree.leaves(arguments))
        return jax.tree.unflatten(jax.tree.structure(like_end), made)

    @alone.def_vmap
    def together(size: int, batched: list, _: Any, leaves: list[Array], *start: Any) -> tuple:
        count = max(1, round(AT_A_TIME * size))
        axes = jax.tree.map(lambda is_batched: 0 if is_batched else None, batched[1:])
        steps = jax.vmap(stepped, (axes[0], 0))

        def step(each: _Progress) -> _Progress:
            rows = jnp.argsort(~each.unfinished)[:count]
            own = [
                part if axis is None else part[rows]
                for part, axis in zip(leaves, axes[0], strict=True)
            ]
            some = jax.tree.map(lambda part: part[rows], each)
            made = jax.vmap(tree_where)(some.unfinished, steps(own, some), some)
            return jax.tree.map(lambda all, part: all.at[rows].set(part), each, made)

        each = jax.vmap(begun, axes[1:], axis_size=size)(*start)
        each = jax.lax.while_loop(lambda each: jnp.any(each.unfinished), step, each)
        descents = jax.vmap(ended)(each)
        return descents, jax.tree.map(lambda _: True, descents)

    return alone([jnp.asarray(constant) for constant in traced.consts], *arguments)


def tree_where(condition: Array, one: Any, other: Any) -> Any:
    """One of two trees of arrays, leaf by leaf."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), one, other)


def _take_step(problem: Problem, parameters: Any, now: _Progress) -> _Progress:
    """One step further."""
    # The point is linearised as it is tried, so that this is compiled once.
    there, first = problem.about(parameters, now.tried), now.damping < 0
    precision = jnp.finfo(there.cost.dtype).eps
    # Where costs differ by rounding alone, the step still says where the minimum is.
    lowered = first | now.short | (there.cost <= now.local.cost * (1 + ALIKE))
    best, local = tree_where(lowered, (now.tried, there), (now.best, now.local))
    more = jnp.maximum(NOT_LOWERED * now.damping, SHORTENED * now.shortening)
    damping = jnp.where(lowered, LOWERED * now.damping, more)
    damping = jnp.where(first, -now.damping, jnp.maximum(damping, LEAST_DAMPING))
    move = _correct_step(problem, parameters, best, local, damping)
    along = -jnp.sum(local.slope * move)
    short = jnp.max(jnp.abs(move)) < SHORT * jnp.sqrt(precision)
    short &= jnp.abs(along) / 2 < precision * (LITTLE + local.cost)
    ended = (short & (now.short | (damping <= LEAST_DAMPING))) | (damping >= LARGEST_DAMPING)
    # Damping may be what makes it short.
    damping = jnp.where(short, 0.0, damping)
    tried = problem.move(best, move)
    shortening = along / jnp.maximum(jnp.sum(move**2), precision)
    return _Progress(now.left - 1, best, local, tried, damping, shortening, short, ended)


def _correct_step(problem: Problem, parameters: Any, x: Any, local: Local, damping: Array) -> Array:
    """A damped step (N,) within bounds, less what residuals bend by along it."""
    r, J, S = local
    low, high = problem.room(parameters, x)
    slope, H = local.slope, jnp.matmul(J.T, J, precision=HIGHEST)
    sizes = jnp.diagonal(H)
    ridge = damping + jnp.finfo(slope.dtype).eps * sizes

    def unsolved(carry: tuple) -> Array:
        count, again, *_ = carry
        return again & (count < SOLVES)

    def solve(carry: tuple) -> tuple:
        count, _, curved, moves, fixed, _, _ = carry
        A = H + curved * S
        # 1 for what does not move.
        free = jnp.where(moves[:, None] & moves, A, 0.0) + jnp.diag(jnp.where(moves, ridge, 1.0))
        factor = jax.lax.linalg.cholesky(free, symmetrize_input=False)
        push = slope + jnp.matmul(A, fixed, precision=HIGHEST)
        wanted = _solve_factor(factor, jnp.where(moves, -push, 0.0))
        positive = jnp.all(jnp.isfinite(wanted))
        beyond = positive & moves & ((wanted < low) | (wanted > high))
        step = jnp.clip(jnp.where(moves, wanted, fixed), low, high)
        fixed = jnp.where(beyond, step, fixed)
        again = ~positive | jnp.any(beyond)
        curved, step = jnp.where(positive, curved, 0.0), jnp.where(positive, step, 0.0)
        return count + 1, again, curved, moves & ~beyond, fixed, step, factor

    still = jnp.zeros_like(slope)
    first = (
        jnp.zeros((), jnp.int32), jnp.ones((), bool), jnp.ones((), still.dtype),
        ~rests(slope, low, high), still, still, jnp.eye(still.size, dtype=still.dtype),
    )  # fmt: skip
    *_, moves, _, step, factor = jax.lax.while_loop(unsolved, solve, first)
    step = step * jnp.minimum(1.0, LARGEST_STEP / jnp.maximum(jnp.max(jnp.abs(step)), 1e-9))
    bent = (
        problem.residuals(parameters, problem.move(x, step))
        - r
        - jnp.matmul(J, step, precision=HIGHEST)
    )
    back = _solve_factor(factor, jnp.where(moves, -jnp.matmul(bent, J, precision=HIGHEST), 0.0))
    shorter = jnp.sum(sizes * back**2) <= jnp.sum(sizes * step**2)
    return jnp.clip(step + jnp.where(shorter, back, 0.0), low, high)


def _solve_factor(factor: Array, right: Array) -> Array:
    by = partial(jax.lax.linalg.triangular_solve, factor, left_side=True, lower=True)
    return by(by(right[:, None]), transpose_a=True)[:, 0]


def rests(slope: Array, low: Array, high: Array) -> Array:
    """Which unknowns (N,) are at a bound that their slope pushes them against."""
    return ((low >= 0) & (slope > 0)) | ((high <= 0) & (slope < 0))
