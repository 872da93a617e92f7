"""Nonlinear least squares: the only door to optimistix.

Levenberg-Marquardt, Gauss-Newton, or BFGS on half the squared sum. A solution is differentiable by
whatever the residuals depend on, through the implicit function theorem (and not by its start).

INPUTS: residuals as a function of a vector, a start. OUTPUTS: the solution, and how it ended.
"""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import lineax
import optimistix
from jax import Array

from jaxmocap.solvers.status import Status

Method = Literal["levenberg-marquardt", "gauss-newton", "bfgs"]


class LeastSquaresResult(NamedTuple):
    """How a solve of N unknowns ended."""

    point: Array  # (N,) the solution; the start where the solve broke down
    cost: Array  # () half the sum of squares there
    # () made, each one evaluation of the residuals and, but for BFGS's line search, of their
    # derivatives.
    steps: Array
    status: Array  # () int32, a ``Status``


def least_squares(
    residuals: Callable[[Array, Any], Array],
    start: Array,
    args: Any = None,
    *,
    method: Method = "levenberg-marquardt",
    largest_steps: int = 30,
    tolerance: float = 1e-3,
) -> LeastSquaresResult:
    """Minimise half the sum of squared residuals, usable inside jit and vmap.

    Scale the unknowns so that 1 is a usual size of each: Levenberg-Marquardt damps all alike.

    Args:
        residuals: (N,) point and ``args`` to (R,) residuals.
        start: (N,).
        args: what else the residuals take; the solution is differentiable by it.
        method: static.
        largest_steps: static.
        tolerance: a solve has converged when neither its point nor its residuals change by more
            than this, and this share of their largest entry.
    """
    # Its own numbers are of JAX's present precision, whatever the start's.
    wide, own = jnp.result_type(float), start.dtype

    # Optimistix masks trees with booleans, which our settings refuse.
    leaves, tree = jax.tree.flatten(args)

    def widened(point: Array, leaves: list[Array]) -> Array:
        return residuals(point.astype(own), jax.tree.unflatten(tree, leaves)).astype(wide)

    solution = optimistix.least_squares(
        widened,
        _solver(method, tolerance),
        jax.lax.stop_gradient(start).astype(wide),
        leaves,
        max_steps=largest_steps,
        throw=False,
    )
    point = solution.value.astype(own)
    cost = jnp.sum(residuals(point, args) ** 2) / 2
    sound = jnp.isfinite(cost) & jnp.all(jnp.isfinite(point))
    converged = solution.result == optimistix.RESULTS.successful
    ended = jnp.where(converged, int(Status.CONVERGED), int(Status.OUT_OF_STEPS))
    return LeastSquaresResult(
        jnp.where(sound, point, start),
        cost,
        jnp.asarray(solution.stats["num_steps"], jnp.int32),
        jnp.where(sound, ended, int(Status.BROKEN)).astype(jnp.int32),
    )


def _solver(method: Method, tolerance: float) -> Any:
    if method == "bfgs":
        return optimistix.BFGS(tolerance, tolerance)
    linear = lineax.QR()
    if method == "gauss-newton":
        return optimistix.GaussNewton(tolerance, tolerance, linear_solver=linear)
    return optimistix.LevenbergMarquardt(tolerance, tolerance, linear_solver=linear)
