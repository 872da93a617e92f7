"""The downhill simplex against SciPy's Nelder-Mead and the textbook, over a zoo of problems."""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double, on_device
from references import simplex as reference
from scipy import optimize

from jaxmocap.solvers.simplex import downhill_simplex, initial_simplex

TOLERANCE = 1e-8
MOST = 2000


class Problem(NamedTuple):
    """A function (..., n) -> (...) of NumPy or JAX arrays, where to start, where it is lowest."""

    cost: object
    start: tuple[float, ...]
    lowest: float


def sphere(x):
    return (x**2).sum(-1)


def stretched(x):
    return (x**2 * np.array([1.0, 30.0, 300.0, 3000.0])).sum(-1)


def rosenbrock(x):
    a, b = x[..., :-1], x[..., 1:]
    return (100 * (b - a**2) ** 2 + (1 - a) ** 2).sum(-1)


def powell(x):
    a, b, c, d = (x[..., i] for i in range(4))
    return (a + 10 * b) ** 2 + 5 * (c - d) ** 2 + (b - 2 * c) ** 4 + 10 * (a - d) ** 4


def beale(x):
    a, b = x[..., 0], x[..., 1]
    return (1.5 - a + a * b) ** 2 + (2.25 - a + a * b**2) ** 2 + (2.625 - a + a * b**3) ** 2


def himmelblau(x):
    a, b = x[..., 0], x[..., 1]
    return (a**2 + b - 11) ** 2 + (a + b**2 - 7) ** 2


def absolute(x):
    return (abs(x) * np.array([1.0, 2.0, 3.0])).sum(-1)


def valley(x):
    a, b = x[..., 0], x[..., 1]
    return (a + b - 1) ** 2 * 1e4 + (a - b) ** 2


ZOO = {
    "sphere": Problem(sphere, (1.0, -2.0), 0.0),
    "stretched quadratic": Problem(stretched, (1.0, 1.0, -1.0, 0.5), 0.0),
    "rosenbrock in 2": Problem(rosenbrock, (-1.2, 1.0), 0.0),
    "rosenbrock in 4": Problem(rosenbrock, (-1.2, 1.0, -0.5, 0.7), 0.0),
    "powell": Problem(powell, (3.0, -1.0, 0.0, 1.0), 0.0),
    "beale": Problem(beale, (1.0, 1.0), 0.0),
    "himmelblau": Problem(himmelblau, (0.5, 0.5), 0.0),
    "sum of absolute values": Problem(absolute, (1.0, -1.5, 0.7), 0.0),
    "narrow valley": Problem(valley, (-1.0, 2.0), 0.0),
}


def first_simplex(problem: Problem) -> np.ndarray:
    start = np.array(problem.start)
    return np.vstack([start, start + 0.3 * np.eye(len(start))])


def scipys(problem: Problem):
    return optimize.minimize(
        problem.cost, problem.start, method="Nelder-Mead",
        options={
            "initial_simplex": first_simplex(problem), "xatol": TOLERANCE, "fatol": TOLERANCE,
            "maxiter": MOST, "maxfev": 10 * MOST,
        },
    )  # fmt: skip


@pytest.mark.parametrize("name", ZOO)
def test_it_finds_scipys_minimum_with_as_many_evaluations(name):
    problem, calls = ZOO[name], []

    def counted(points):
        jax.debug.callback(lambda: calls.append(1))
        return problem.cost(points)

    with double():
        simplices = on_device(first_simplex(problem)[None])
        actual = downhill_simplex(counted, simplices, MOST, TOLERANCE, TOLERANCE)
        jax.effects_barrier()
    theirs = scipys(problem)
    assert bool(actual.converged[0]) and theirs.success
    assert actual.costs[0] == pytest.approx(problem.lowest, abs=1e-7)
    np.testing.assert_allclose(actual.points[0], theirs.x, atol=2e-3)
    assert len(calls) <= 1.1 * theirs.nfev + 5
    assert len(calls) >= 0.9 * theirs.nfev - 5


@pytest.mark.parametrize("name", ZOO)
def test_it_goes_the_textbooks_way_step_by_step(name):
    problem = ZOO[name]
    with double():
        solve = jax.jit(lambda s, most: downhill_simplex(problem.cost, s, most, 0.0, 0.0))
        for iterations in (0, 1, 2, 5, 12, 25):
            point, cost = reference.minimise(problem.cost, first_simplex(problem), iterations)
            actual = solve(on_device(first_simplex(problem)[None]), iterations)
            np.testing.assert_allclose(actual.points[0], point, rtol=1e-9, atol=1e-12)
            np.testing.assert_allclose(actual.costs[0], cost, rtol=1e-9, atol=1e-12)
            assert actual.iterations[0] == iterations


def mixed(points):
    """Four problems side by side: one of the zoo each, in two dimensions."""
    return jnp.stack(
        [sphere(points[0]), rosenbrock(points[1]), beale(points[2]), valley(points[3])]
    )


STARTS = np.array([[1.0, -2.0], [-1.2, 1.0], [1.0, 1.0], [-1.0, 2.0]])


def test_a_lane_is_not_moved_by_its_neighbours():
    with double():
        simplices = initial_simplex(on_device(STARTS), 0.3 * jnp.eye(2))
        together = downhill_simplex(mixed, simplices, MOST, TOLERANCE, TOLERANCE)
        for lane, cost in enumerate((sphere, rosenbrock, beale, valley)):
            alone = downhill_simplex(cost, simplices[lane : lane + 1], MOST, TOLERANCE, TOLERANCE)
            np.testing.assert_allclose(together.points[lane], alone.points[0], rtol=1e-12)
            assert together.iterations[lane] == alone.iterations[0]
    assert bool(together.converged.all())
    assert len(set(np.asarray(together.iterations).tolist())) > 1


def test_a_lane_that_is_done_is_frozen():
    with double():
        simplices = initial_simplex(on_device(STARTS), 0.3 * jnp.eye(2))
        ends = downhill_simplex(mixed, simplices, MOST, TOLERANCE, TOLERANCE)
        first = int(jnp.min(ends.iterations))
        early = downhill_simplex(mixed, simplices, first, TOLERANCE, TOLERANCE)
    lane = int(jnp.argmin(ends.iterations))
    np.testing.assert_array_equal(early.points[lane], ends.points[lane])
    np.testing.assert_array_equal(early.converged, np.arange(4) == lane)


def test_more_iterations_never_make_it_worse_and_the_limit_is_kept():
    solve = jax.jit(
        lambda most: downhill_simplex(
            mixed, initial_simplex(on_device(STARTS), 0.3 * jnp.eye(2)), most, 1e-4, 1e-4
        )
    )
    costs = [np.asarray(solve(most).costs) for most in (0, 3, 10, 40)]
    for earlier, later in itertools.pairwise(costs):
        assert (later <= earlier).all()
    assert (solve(10).iterations <= 10).all()
    assert solve(40).points.dtype == jnp.float32


def test_the_first_simplex_stands_at_the_start():
    starts = on_device(STARTS)
    own = jnp.stack([k * jnp.eye(2) for k in (1.0, 2.0, 3.0, 4.0)])
    for edges in (0.5 * jnp.eye(2), own):
        simplices = initial_simplex(starts, edges)
        np.testing.assert_array_equal(simplices[:, 0], starts)
        np.testing.assert_allclose(
            simplices[:, 1:] - simplices[:, :1], np.broadcast_to(edges, (4, 2, 2)), atol=1e-6
        )


def test_a_cost_that_is_not_a_number_is_never_taken_for_the_best():
    def half_undefined(points):
        return jnp.where(points[..., 0] < 0, jnp.nan, sphere(points - 0.1))

    with double():
        simplices = initial_simplex(on_device(np.ones((1, 2))), 0.3 * jnp.eye(2))
        actual = downhill_simplex(half_undefined, simplices, 200, 1e-6, 1e-6)
    np.testing.assert_allclose(actual.points[0], [0.1, 0.1], atol=1e-3)
