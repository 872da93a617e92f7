"""A step of all events at once, by positions and velocities.

The prior ties each pose to the next two, the more strongly the closer they are in time. By poses
alone these ties cancel but for what is to be found, and at 240 events a second single precision has
none of it left. So an event's unknowns are its step x and how fast that changes, v: the next one's
is X = x + h v. Each v is eliminated in turn, and what is left is about X and the next velocity.

INPUTS: events that are linearised and tied. OUTPUTS: steps.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.scipy.linalg import solve_triangular

from jaxmocap.smoothing.window.elimination import FLOOR, multiply


class TiedEvents(NamedTuple):
    """T events linearised about a pose each, and what ties them."""

    intervals: Array  # (T - 1,) seconds to the next one
    hessian: Array  # (T, N, N) of half an event's own cost
    gradient: Array  # (T, N) of half of all costs
    jacobian: Array  # (T, M, N) of the landmarks
    # (T - 2, 3) of the landmarks of three events in turn, to their acceleration in its deviations
    stencil: Array


def solve_steps(events: TiedEvents, damping: Array) -> Array:
    """The step (T, N); not finite where the Hessian is not positive.

    Args:
        events: T of them, 3 at least.
        damping: () curvature that holds each unknown back.
    """
    size = events.gradient.shape[1]
    # What comes after the last events has no terms, and ties nothing.
    intervals = jnp.pad(events.intervals, (0, 2), constant_values=1.0)
    ties = jnp.pad(events.stencil, ((0, 2), (0, 0)))
    three = [jnp.roll(events.jacobian, -k, 0) for k in range(3)]
    own = events.hessian + damping * jnp.eye(size, dtype=damping.dtype)

    def eliminate(rest: tuple[Array, Array], event: tuple) -> tuple[tuple, tuple]:
        """What is about (x, v) to what is about (X, the next v)."""
        hessian, gradient = rest
        h, next_h, tie, first, second, third, H, g = event
        xx, xv, vv = hessian[:size, :size] + H, hessian[:size, size:], hessian[size:, size:]
        x, v = gradient[:size] + g, gradient[size:]
        vX = xv.T - h * xx
        A = jnp.block([[vv - h * (xv + xv.T) + h * h * xx, vX], [vX.T, xx]])
        A, b = jnp.pad(A, (0, size)), jnp.pad(jnp.concatenate([v - h * x, x]), (0, size))
        # The middle one of the tie's factors is minus the others' sum.
        before, after = tie[0] * h * first, tie[2] * third
        turning = tie[2] * (third - second) - tie[0] * (second - first)
        S = jnp.concatenate([-before, turning, next_h * after], 1)
        A += multiply(S.T, S)
        # Of directions that no landmark shows only rounding would be left.
        floor = FLOOR * h * h + jnp.finfo(h.dtype).eps * jnp.max(jnp.diagonal(A)[:size])
        changing = A[:size, :size] + floor * jnp.eye(size, dtype=h.dtype)
        L = jnp.tril(jax.lax.linalg.cholesky(changing, symmetrize_input=False))
        W = solve_triangular(L, A[:size, size:], lower=True)
        y = solve_triangular(L, b[:size], lower=True)
        left = A[size:, size:] - multiply(W.T, W)
        return ((left + left.T) / 2, b[size:] - multiply(y, W)), (L, W, y)

    def step(later: Array, event: tuple) -> tuple[Array, Array]:
        """(X, the next v) to (x, v)."""
        h, L, W, y = event
        v = -solve_triangular(L, y + multiply(W, later), lower=True, trans=1)
        x = later[:size] - h * v
        return jnp.concatenate([x, v]), x

    unknown = jnp.zeros((2 * size, 2 * size), own.dtype)
    start = unknown, jnp.zeros(2 * size, own.dtype)
    each = intervals[:-1], intervals[1:], ties, *three, own, events.gradient
    _, factors = jax.lax.scan(eliminate, start, each)
    still = jnp.zeros(2 * size, own.dtype)
    return jax.lax.scan(step, still, (intervals[:-1], *factors), reverse=True)[1]
