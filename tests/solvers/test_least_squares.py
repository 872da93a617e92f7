"""Least squares: SciPy's minima, failures returned as data, derivatives of the solution."""

from collections.abc import Callable
from typing import NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double
from scipy import optimize

from jaxmocap.solvers.least_squares import Method, least_squares
from jaxmocap.solvers.optimum import least_squares_step
from jaxmocap.solvers.status import SENTENCES, Status

METHODS = get_args(Method)
TIMES = np.linspace(0, 3, 12)


class Problem(NamedTuple):
    """Residuals of NumPy or JAX arrays, and where to start."""

    residuals: Callable
    start: tuple[float, ...]


def rosenbrock(x, xp):
    return xp.stack([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def powell(x, xp):
    a, b, c, d = x
    return xp.stack([a + 10 * b, 5**0.5 * (c - d), (b - 2 * c) ** 2, 10**0.5 * (a - d) ** 2])


def decay(x, xp):
    """A curve through points that it cannot meet: residuals that stay."""
    measured = 2 * np.exp(-1.5 * TIMES) + 0.3 + 0.1 * np.sin(5 * TIMES)
    return x[0] * xp.exp(-x[1] * TIMES.astype(x.dtype)) + x[2] - measured.astype(x.dtype)


def straight(x, xp):
    return xp.stack([x[0] + 2 * x[1] - 3, 3 * x[0] - x[1] - 2, x[0] - x[1] + 1])


PROBLEMS = {
    "rosenbrock": Problem(rosenbrock, (-1.2, 1.0)),
    "powell": Problem(powell, (3.0, -1.0, 0.0, 1.0)),
    "decay": Problem(decay, (1.0, 1.0, 0.0)),
    "straight": Problem(straight, (5.0, -5.0)),
}


def scipys_cost(problem) -> float:
    actual = optimize.least_squares(
        lambda x: problem.residuals(x, np), problem.start, xtol=1e-14, ftol=1e-14, gtol=1e-14
    )
    return float(actual.cost)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", PROBLEMS)
def test_every_method_finds_the_minimum_that_scipy_finds(name, method):
    problem = PROBLEMS[name]
    with double():
        actual = jax.jit(
            lambda start: least_squares(
                lambda x, _: problem.residuals(x, jnp), start, method=method,
                largest_steps=400, tolerance=1e-6,
            )
        )(jnp.asarray(problem.start))  # fmt: skip
    assert int(actual.status) == Status.CONVERGED
    assert float(actual.cost) <= scipys_cost(problem) + 1e-9


def test_single_precision_stays_single_and_finds_it_too():
    problem = PROBLEMS["decay"]
    start = jnp.asarray(problem.start, jnp.float32)
    actual = least_squares(lambda x, _: problem.residuals(x, jnp), start, largest_steps=60)
    assert actual.point.dtype == actual.cost.dtype == jnp.float32
    assert actual.status.dtype == actual.steps.dtype == jnp.int32
    assert float(actual.cost) == pytest.approx(scipys_cost(problem), rel=1e-3)


def test_running_out_of_steps_is_reported_and_never_raised():
    problem = PROBLEMS["rosenbrock"]
    start = jnp.asarray(problem.start, jnp.float32)
    actual = least_squares(lambda x, _: problem.residuals(x, jnp), start, largest_steps=2)
    assert int(actual.status) == Status.OUT_OF_STEPS and int(actual.steps) == 2
    assert "not converged" in SENTENCES[Status(int(actual.status))]


@pytest.mark.parametrize("method", METHODS)
def test_residuals_that_break_down_leave_the_start(method):
    start = jnp.array([1.0, 2.0], jnp.float32)
    actual = jax.jit(
        lambda start: least_squares(lambda x, _: jnp.log(x - 5.0), start, method=method)
    )(start)
    assert int(actual.status) == Status.BROKEN
    np.testing.assert_array_equal(actual.point, start)


def test_a_batch_is_each_problem_by_itself():
    aims = jnp.array([[1.0, 2.0], [-3.0, 0.5], [4.0, 4.0]], jnp.float32)

    def solve(aim):
        return least_squares(lambda x, a: jnp.append(jnp.exp(x) - 2, x - a), jnp.zeros(2), aim)

    together = jax.jit(jax.vmap(solve))(aims)
    for i, aim in enumerate(aims):
        alone = solve(aim)
        np.testing.assert_allclose(together.point[i], alone.point, atol=2e-6)
        assert int(together.status[i]) == int(alone.status) == Status.CONVERGED


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev])
def test_the_solution_moves_with_its_parameters_as_finite_differences_say(method, derivative):
    """Residuals stay, so that a Gauss-Newton Hessian in place of the true one would be noticed."""
    with double():
        parameters = jnp.array([1.3, 0.4, 0.7])

        def residuals(x, p):
            times = jnp.asarray(TIMES)
            measured = 2 * jnp.exp(-1.5 * times) + 0.1 * jnp.sin(5 * p[2] * times)
            return (
                x[0] * jnp.exp(-x[1] * times) + 0.02 * p[0] * x[0] * times + 0.1 * p[1] - measured
            )

        def solution(p):
            return least_squares(
                residuals, jnp.array([1.8, 1.3]), p, method=method,
                largest_steps=500, tolerance=1e-9,
            ).point  # fmt: skip

        solve, step = jax.jit(solution), 1e-3
        actual = np.asarray(jax.jit(derivative(solution))(parameters))
        columns = [
            (solve(parameters.at[i].add(step)) - solve(parameters.at[i].add(-step))) / (2 * step)
            for i in range(3)
        ]
    assert np.abs(actual).min() > 1e-3
    np.testing.assert_allclose(actual, np.stack(columns, 1), rtol=1e-3, atol=1e-5)


# The step of a minimum as its residuals change ---------------------------------------------------


def step_problems(dtype) -> tuple[jax.Array, ...]:
    """Eight, their columns of very different size, one unknown held."""
    rng = np.random.default_rng(0)
    J = rng.normal(size=(8, 12, 5)) * np.array([250.0, 30.0, 1.0, 0.3, 4.0])
    S = 0.02 * rng.normal(size=(8, 5, 5))
    moves = np.tile([True, True, False, True, True], (8, 1))
    parts = (J, S + S.swapaxes(1, 2), moves, rng.normal(size=(8, 12)), rng.normal(size=(8, 5)))
    return tuple(jnp.asarray(part, dtype if part.dtype != bool else bool) for part in parts)


@pytest.mark.parametrize(("dtype", "within"), [("float64", 1e-8), ("float32", 1e-3)])
def test_the_step_is_that_of_the_dense_equations(dtype, within):
    with double():
        J, S, moves, change, pull = map(np.asarray, step_problems(jnp.float64))
        actual = jax.jit(jax.vmap(least_squares_step))(*step_problems(dtype))
    for i, step in enumerate(np.asarray(actual, float)):
        free = moves[i]
        hessian = (J[i].T @ J[i] + S[i])[np.ix_(free, free)]
        expected = -np.linalg.solve(hessian, (J[i].T @ change[i] + pull[i])[free])
        np.testing.assert_allclose(step[free], expected, rtol=within, atol=within * 1e-2)
        assert step[~free] == 0


def test_a_batch_of_steps_has_nothing_that_hangs_on_two_cores():
    """QR and triangular solves of a batch wait for one another (jaxlib 0.10.2)."""
    program = str(jax.make_jaxpr(jax.vmap(least_squares_step))(*step_problems(jnp.float32)))
    assert "svd[" in program and "qr[" not in program and "triangular_solve[" not in program
