"""Minima of squared residuals within bounds, that carry their own derivatives.

A loop of steps has no useful derivative; the minimum x that it ends at has one. There the slope
g(x, p) vanishes, and goes on doing so as p changes: H dx = -(dg/dp) dp, the implicit function
theorem. One step from the minimum, its Hessian H held fixed, says just that, forwards, backwards
and in batches.

The descent is a damped Newton method with second-order corrections (Nocedal, Wright, Numerical
Optimization, 18.3). It takes the residuals' second derivatives: out of reach, where residuals are
large, Levenberg-Marquardt creeps (``python -m bench.minima``).

INPUTS: residuals on any manifold, their derivatives, bounds. OUTPUTS: the minimum; steps that carry
derivatives.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.solvers.sdls import HIGHEST

# Damping, as shares of the Hessian's diagonal, down to the precision: from any start,
# where the start is near, at most; and its factors after a step that lowered the cost, and
# after another.
FIRST_DAMPING, NEAR_DAMPING, LARGEST_DAMPING = 0.1, 1e-3, 1e6
LOWERED, NOT_LOWERED = 0.3, 20.0
# A step whose largest entry is this many roots of the precision is short. After one the damping
# goes, and after another the descent ends.
SHORT = 3.0
# Costs that differ by less, as a share, are alike.
ALIKE = 1e-5
# The largest entry of a step, metres and radians.
LARGEST_STEP = 0.7
# Most solves of a step, as unknowns meet their bounds or curvature turns out negative.
SOLVES = 5


class Local(NamedTuple):
    """Residuals about a point, to second order.

    Attributes:
        residuals: (R,).
        jacobian: (R, N) by a tangent vector.
        second_order: (N, N) the sum of their second derivatives, each times its residual.
    """

    residuals: Array
    jacobian: Array
    second_order: Array

    @property
    def cost(self) -> Array:
        """() half the sum of squares."""
        return jnp.sum(self.residuals**2) / 2

    @property
    def slope(self) -> Array:
        """(N,) the cost's derivative."""
        return jnp.matmul(self.residuals, self.jacobian, precision=HIGHEST)


class Problem(NamedTuple):
    """Squared residuals of x, and how x moves: by tangent vectors (N,) at it.

    Attributes:
        residuals: x to (R,).
        about: x to a ``Local``.
        move: x and a tangent vector to where it leads.
        room: x to the lowest and highest (N,) tangent vector within bounds.
    """

    residuals: Callable[[Any], Array]
    about: Callable[[Any], Local]
    move: Callable[[Any, Array], Any]
    room: Callable[[Any], tuple[Array, Array]]


class Descent(NamedTuple):
    """How a descent ended.

    Attributes:
        x: of least cost.
        cost: () half the squares of its residuals.
        rests: () whether that is a minimum; else the steps ran out.
    """

    x: Any
    cost: Array
    rests: Array


class _Progress(NamedTuple):
    """Between two steps: the best point so far, and the one that is tried next."""

    made: Array
    best: Any
    local: Local
    tried: Any
    damping: Array
    short: Array
    ended: Array


def descend(
    problem: Problem, start: Any, steps: int, damping: Array | float = FIRST_DAMPING
) -> Descent:
    """The x of least cost near a start; nothing is differentiated.

    A step is Newton's where the damped Hessian is positive, else Gauss-Newton's. What the residuals
    turn out to bend by along it, a second solve takes back. An unknown at its bound rests there
    while the slope pushes it outwards.

    Args:
        problem: to solve.
        start: within the bounds.
        steps: at most.
        damping: of the first one, as a share of the Hessian's diagonal.
    """
    like = jax.eval_shape(problem.about, start)
    dtype = like.residuals.dtype
    precision = jnp.finfo(dtype).eps
    small = SHORT * jnp.sqrt(precision)

    def unfinished(now: _Progress) -> Array:
        return ~now.ended & (now.made < steps)

    def step(now: _Progress) -> _Progress:
        # The point is linearised as it is tried, so that this is compiled once.
        there, first = problem.about(now.tried), now.made == 0
        # Where costs differ by rounding alone, the step still says where the minimum is.
        lowered = first | now.short | (there.cost <= now.local.cost * (1 + ALIKE))
        best, local = jax.tree.map(
            lambda new, old: jnp.where(lowered, new, old),
            (now.tried, there), (now.best, now.local),
        )  # fmt: skip
        factor = jnp.where(first, 1.0, jnp.where(lowered, LOWERED, NOT_LOWERED))
        damping = jnp.clip(now.damping * factor, precision, LARGEST_DAMPING)
        move = _corrected_step(problem, best, local, damping)
        short = jnp.max(jnp.abs(move)) < small
        ended = (short & now.short) | (damping >= LARGEST_DAMPING)
        # Damping may be what makes it short.
        damping = jnp.where(short, precision, damping)
        tried = problem.move(best, move)
        return _Progress(now.made + 1, best, local, tried, damping, short, ended)

    unknown = jax.tree.map(lambda part: jnp.zeros(part.shape, part.dtype), like)
    begun = _Progress(
        jnp.zeros((), jnp.int32), start, Local(*unknown), start,
        jnp.asarray(damping, dtype), jnp.zeros((), bool), jnp.zeros((), bool),
    )  # fmt: skip
    end = jax.lax.while_loop(unfinished, step, begun)
    # The last step was too short for its cost to tell.
    done = end.ended & end.short
    x = jax.tree.map(lambda new, old: jnp.where(done, new, old), end.tried, end.best)
    return Descent(x, end.local.cost, end.ended)


def _corrected_step(problem: Problem, x: Any, local: Local, damping: Array) -> Array:
    """A damped step (N,) within bounds, less what residuals bend by along it."""
    r, J, S = local
    low, high = problem.room(x)
    slope, H = local.slope, jnp.matmul(J.T, J, precision=HIGHEST)
    sizes = jnp.diagonal(H)

    def unsolved(carry: tuple) -> Array:
        count, again, *_ = carry
        return again & (count < SOLVES)

    def solve(carry: tuple) -> tuple:
        count, _, curved, moves, fixed, _, _ = carry
        A = H + curved * S
        factor = _factor(A, moves, damping * sizes)
        push = slope + jnp.matmul(A, fixed, precision=HIGHEST)
        wanted = _solved(factor, jnp.where(moves, -push, 0.0))
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
    bent = problem.residuals(problem.move(x, step)) - r - jnp.matmul(J, step, precision=HIGHEST)
    back = _solved(factor, jnp.where(moves, -jnp.matmul(bent, J, precision=HIGHEST), 0.0))
    shorter = jnp.sum(sizes * back**2) <= jnp.sum(sizes * step**2)
    return jnp.clip(step + jnp.where(shorter, back, 0.0), low, high)


def _factor(A: Array, moves: Array, ridge: Array) -> Array:
    """Cholesky's factor of what moves of A (N, N), and 1 for what does not."""
    free = jnp.where(moves[:, None] & moves, A, 0.0) + jnp.diag(jnp.where(moves, ridge, 1.0))
    return jax.lax.linalg.cholesky(free, symmetrize_input=False)


def _solved(factor: Array, right: Array) -> Array:
    by = partial(jax.lax.linalg.triangular_solve, factor, left_side=True, lower=True)
    return by(by(right[:, None]), transpose_a=True)[:, 0]


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
