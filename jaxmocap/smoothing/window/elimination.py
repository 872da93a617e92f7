"""The equations of a window, solved by eliminating one event after the other.

Each event is a quadratic of its own step; the prior on the motion ties three successive ones. So an
event that is eliminated reaches the next two and no farther, and what is left over of the oldest
ones is the marginal prior about those that stay.

    Evidence, MarginalPrior -> eliminate -> Eliminated -> steps, variances; the next MarginalPrior

Unknowns are tangent steps (E, N) from the poses about which the events were linearised.

INPUTS: linearised events. OUTPUTS: steps, variances, a MarginalPrior.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.scipy.linalg import solve_triangular

from jaxmocap.evidence.smoothness import REACH
from jaxmocap.geometry.rotations import HIGHEST

# Curvature that every unknown has about its present value,
FLOOR = 1e-6
# times this where rounding has left less than nothing, and again, so many times.
RAISED, ATTEMPTS = 1000.0, 4


class MarginalPrior(NamedTuple):
    """Evidence of the events before a window about its first two, as a quadratic of their steps."""

    hessian: Array  # (2 N, 2 N) of half the cost
    gradient: Array  # (2 N,) likewise, at no step

    @classmethod
    def none(cls, size: int, dtype: jnp.dtype) -> "MarginalPrior":
        """Of a beginning; N is the size."""
        return cls(jnp.zeros((REACH * size, REACH * size), dtype), jnp.zeros(REACH * size, dtype))

    def about(self, steps: Array) -> "MarginalPrior":
        """The same by further steps from steps (2, N)."""
        return self._replace(gradient=self.gradient + multiply(self.hessian, jnp.ravel(steps)))


class Evidence(NamedTuple):
    """What E events cost about a pose each, and what ties them."""

    hessian: Array  # (E, N, N) of half an event's own cost
    gradient: Array  # (E, N) likewise
    points: Array  # (E, M) landmarks, world, metres
    jacobian: Array  # (E, M, N) of these
    # (E, 3) of the points of an event and of the next two, to their acceleration in its deviations;
    # 0 where there are none.
    stencil: Array

    def points_at(self, steps: Array) -> Array:
        """(E, M) steps (E, N) on, as far as the derivatives tell."""
        return self.points + jnp.einsum("emn,en->em", self.jacobian, steps, precision=HIGHEST)

    def accelerations(self, steps: Array) -> Array:
        """(E, M) at steps (E, N), in their deviations."""
        points = self.points_at(steps)
        # The stencil is 0 where the roll begins again.
        each = [self.stencil[:, k, None] * jnp.roll(points, -k, 0) for k in range(REACH + 1)]
        return jnp.sum(jnp.stack(each), 0)


class Eliminated(NamedTuple):
    """The factor of the events' equations, and what it leaves over."""

    own: Array  # (E, N, N) lower triangle L of each event
    ahead: Array  # (E, N, 2 N) W, by which it is tied to the next two
    pull: Array  # (E, N) y
    rest: MarginalPrior  # about the two events after the last one that was eliminated


def eliminate(
    evidence: Evidence, marginal: MarginalPrior, ridge: Array, count: Array | int
) -> Eliminated:
    """The first so many events in turn.

    Args:
        evidence: of E events.
        marginal: about the first two.
        ridge: (N,) curvature that holds each unknown back.
        count: ().
    """
    size = len(ridge)
    added = (0, size)

    def one(i: Array, so_far: Eliminated) -> Eliminated:
        rest = so_far.rest
        tie = jax.lax.dynamic_slice_in_dim(evidence.jacobian, i, REACH + 1)
        there = jax.lax.dynamic_slice_in_dim(evidence.points, i, REACH + 1)
        # Where three events do not follow, these rows are others: the stencil is 0 there.
        stencil = evidence.stencil[i]
        S = (stencil[:, None, None] * tie).swapaxes(1, 2).reshape(-1, tie.shape[1])
        A = jnp.pad(rest.hessian, (added, added)) + multiply(S, S.T)
        b = jnp.pad(rest.gradient, added) + multiply(S, multiply(stencil, there))
        A = A.at[:size, :size].add(evidence.hessian[i] + jnp.diag(ridge))
        b = b.at[:size].add(evidence.gradient[i])
        L = _cholesky(A[:size, :size])
        right = jnp.concatenate([A[:size, size:], b[:size, None]], 1)
        solved = solve_triangular(L, right, lower=True)
        W, y = solved[:, :-1], solved[:, -1]
        hessian = A[size:, size:] - multiply(W.T, W)
        gradient = b[size:] - multiply(y, W)
        own, ahead, pull, _ = so_far
        return Eliminated(
            own.at[i].set(L), ahead.at[i].set(W), pull.at[i].set(y),
            MarginalPrior((hessian + hessian.T) / 2, gradient),
        )  # fmt: skip

    events, dtype = len(evidence.gradient), ridge.dtype
    nothing = Eliminated(
        jnp.broadcast_to(jnp.eye(size, dtype=dtype), (events, size, size)),
        jnp.zeros((events, size, REACH * size), dtype), jnp.zeros((events, size), dtype), marginal,
    )  # fmt: skip
    return jax.lax.fori_loop(0, count, one, nothing)


def steps_of(eliminated: Eliminated, count: Array | int) -> Array:
    """Steps (E, N) of the first so many events, all of which were eliminated."""
    own, ahead, pull, _ = eliminated
    events, size = pull.shape

    def one(done: Array, steps: Array) -> Array:
        i = count - 1 - done
        later = jnp.ravel(jax.lax.dynamic_slice_in_dim(steps, i + 1, REACH))
        right = pull[i] + multiply(ahead[i], later)
        return steps.at[i].set(-solve_triangular(own[i], right, lower=True, trans=1))

    still = jnp.zeros((events + REACH, size), pull.dtype)
    return jax.lax.fori_loop(0, count, one, still)[:events]


def point_variances(eliminated: Eliminated, jacobian: Array, count: Array, chosen: Array) -> Array:
    """Variances (M,) of one event's points, given all events.

    Given what follows it, an event is a multiple of the next two events and noise that does not
    depend on them (Takahashi); each block is a sum of positive parts.

    Args:
        eliminated: of all events.
        jacobian: (M, N) of the points.
        count: () of the events.
        chosen: () which event.
    """
    size = eliminated.pull.shape[1]
    eye = jnp.eye(size, dtype=jacobian.dtype)

    def one(done: Array, ahead: Array) -> Array:
        """The covariance (2 N, 2 N) of an event and the next, from that of the two after it."""
        i = count - 1 - done
        inverse = solve_triangular(eliminated.own[i], eye, lower=True)
        U = multiply(inverse.T, eliminated.ahead[i])
        across = -multiply(U, ahead)
        block = multiply(inverse.T, inverse) - multiply(across, U.T)
        block = (block + block.T) / 2
        beside = across[:, :size]
        return jnp.block([[block, beside], [beside.T, ahead[:size, :size]]])

    unknown = jnp.zeros((REACH * size, REACH * size), jacobian.dtype)
    covariance = jax.lax.fori_loop(0, count - chosen, one, unknown)[:size, :size]
    return jnp.maximum(jnp.sum(multiply(jacobian, covariance) * jacobian, 1), 0.0)


def _cholesky(matrix: Array) -> Array:
    """With a floor, and a higher one where that is not enough."""
    eye = jnp.eye(len(matrix), dtype=matrix.dtype)

    def fails(tried: tuple[Array, Array]) -> Array:
        attempt, L = tried
        return (attempt < ATTEMPTS) & ~jnp.all(jnp.isfinite(L))

    def again(tried: tuple[Array, Array]) -> tuple[Array, Array]:
        attempt, _ = tried
        floor = FLOOR * RAISED ** attempt.astype(matrix.dtype)
        L = jax.lax.linalg.cholesky(matrix + floor * eye, symmetrize_input=False)
        return attempt + 1, jnp.tril(L)

    return jax.lax.while_loop(fails, again, (jnp.zeros((), jnp.int32), jnp.nan * matrix))[1]


def multiply(one: Array, other: Array) -> Array:
    """Their matrix product, at full float32."""
    return jnp.matmul(one, other, precision=HIGHEST)
