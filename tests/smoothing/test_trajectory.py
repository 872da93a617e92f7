"""The trajectory solver's promises; ``test_dense_reference`` has its minimum and covariances."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double

from jaxmocap.evidence.smoothness import Smoothness, accelerations_of, smoothness
from jaxmocap.smoothing.levenberg_marquardt import Linearised, SolverSettings, covariances, minimise
from jaxmocap.solvers.status import SENTENCES, Status

EXACT = SolverSettings(iterations=400, relative=1e-13, step=1e-12, floor=0.0)


def line(measured: np.ndarray, weights: np.ndarray):
    """One coordinate observed directly: ``linearise`` and ``move``."""

    def linear(x: np.ndarray) -> Linearised:
        r = (x - measured) * weights
        J = np.ones((len(x), 1, 1))
        return Linearised(r**2, (weights**2)[:, None, None], (r * weights)[:, None], x[:, None], J)

    return linear, lambda x, steps, _: x + steps[:, 0]


def test_the_result_does_not_depend_on_the_sampling_rate():
    wave, actual, spread = np.sin, [], []
    for rate in (60, 240):
        times = np.arange(4 * rate + 1) / rate
        # As much evidence each second, however it is sampled.
        weights = np.full(len(times), 20 / np.sqrt(rate))
        prior = smoothness(times, np.array([5.0]))
        assert prior.cost(wave(3 * times)[:, None]) == pytest.approx(
            81 / 25 * (2 - np.sin(24) / 12), rel=0.02
        )
        linear, moved = line(wave(3 * times) + 0.2 * wave(40 * times), weights)
        solved = minimise(linear, moved, np.zeros(len(times)), prior, EXACT)
        actual.append(solved.x[:: rate // 60])
        spread.append(covariances(linear(solved.x), prior, EXACT).frames[:: rate // 60, 0, 0])
    np.testing.assert_allclose(actual[0][20:-20], actual[1][20:-20], atol=0.003)
    np.testing.assert_allclose(spread[0][20:-20], spread[1][20:-20], rtol=0.02)


def test_accelerations_are_as_the_prior_counts_them():
    rng = np.random.default_rng(5)
    times = np.cumsum(rng.uniform(0.5, 1.5, 4000)) / 30
    steady = accelerations_of(times, (4.0 * times**2)[:, None])[:, 0]
    np.testing.assert_allclose(steady, 8.0 * np.sqrt((times[2:] - times[:-2]) / 2), rtol=1e-4)
    # White noise of deviation 3, held over each step, integrated twice.
    steps = np.diff(times)
    pushed = rng.normal(0, 3.0, len(steps)) / np.sqrt(steps)
    speeds = np.append(0.0, np.cumsum(pushed * steps))
    places = np.append(0.0, np.cumsum(speeds[:-1] * steps))
    actual = accelerations_of(times, places[:, None])
    assert np.sqrt((actual**2).mean()) == pytest.approx(3.0, rel=0.05)


def test_absent_frames_are_bridged_by_the_calmest_curve():
    times = np.arange(40) / 100
    weights = np.where((times > 0.145) & (times < 0.255), 0.0, 100.0)
    linear, moved = line(np.sin(8 * times), weights)
    prior = smoothness(times, np.array([3.0]))
    solved = minimise(linear, moved, np.zeros(40), prior, EXACT)
    # Least squares of second differences: a cubic.
    np.testing.assert_allclose(np.diff(solved.x, 4)[13:22], 0, atol=1e-9)
    np.testing.assert_allclose(solved.x, np.sin(8 * times), atol=0.01)
    deviations = np.sqrt(covariances(linear(solved.x), prior).frames[:, 0, 0])
    assert np.argmax(deviations) == 20
    assert deviations[20] > 2 * deviations[10]


@pytest.mark.parametrize("frames", [2, 12])
@pytest.mark.parametrize("share", [0.0, 0.3])
def test_what_nothing_determines_stays_and_the_status_says_so(share, frames):
    # Two unknowns of which frames and prior see one sum only.
    keep = np.array([1.0, share])
    times = np.arange(frames) / 10
    linear, _ = line(np.cos(times), np.ones(frames))

    def both(x: np.ndarray) -> Linearised:
        measured = linear(x @ keep)
        grown = np.asarray(measured.hessian)[:, [0, 0]][:, :, [0, 0]] * keep * keep[:, None]
        gradient = np.asarray(measured.gradient) * keep
        return measured._replace(
            hessian=grown, gradient=gradient, jacobian=np.ones((frames, 1, 1)) * keep
        )

    prior = smoothness(times, np.array([1.0]))
    start = np.tile([0.0, 7.0], (frames, 1))
    solved = minimise(both, lambda x, s, _: x + s, start, prior)
    assert solved.status == Status.UNDETERMINED
    assert "nothing determines" in SENTENCES[solved.status]
    alone = minimise(linear, lambda x, s, _: x + s[:, 0], np.zeros(frames), prior, EXACT)
    np.testing.assert_allclose(solved.x @ keep, alone.x, atol=1e-3)
    if share == 0:
        np.testing.assert_array_equal(solved.x[:, 1], 7.0)
    actual = covariances(both(solved.x), prior).frames
    undetermined = np.array([-share, 1.0]) / np.hypot(share, 1.0)
    np.testing.assert_allclose(
        undetermined @ actual @ undetermined, 1 / SolverSettings().floor, rtol=1e-5
    )
    assert (keep @ actual @ keep < 1.01).all()


def test_slow_movements_under_a_stiff_prior_take_few_linearisations():
    times = np.arange(480) / 120
    linear, moved = line(np.sin(3 * times), np.full(480, 100.0))
    prior = smoothness(times, np.array([0.5]))
    solved = minimise(linear, moved, np.zeros(480), prior)
    assert solved.status == Status.CONVERGED
    assert solved.iterations <= 4
    exact = minimise(linear, moved, np.zeros(480), prior, EXACT)
    np.testing.assert_allclose(solved.x, exact.x, atol=1e-4)


def test_negative_curvature_from_rounding_leaves_covariances_sound():
    linear, *_ = line(np.zeros(6), np.ones(6))
    rounded = np.asarray(linear(np.zeros(6)).hessian) - [[[1 + 1e-3]]]
    prior = smoothness(np.arange(6.0), np.ones(1))
    measured_once = np.where(np.arange(6)[:, None, None] == 3, 1.0, rounded)
    actual = covariances(linear(np.zeros(6))._replace(hessian=measured_once), prior).frames
    assert np.isfinite(actual).all()
    assert actual[3, 0, 0] == pytest.approx(1, rel=1e-3)
    assert (actual[:, 0, 0] >= actual[3, 0, 0]).all()


def test_terms_that_are_not_finite_leave_the_start_as_it_was():
    linear, moved = line(np.full(5, np.nan), np.ones(5))
    start = np.zeros(5)
    solved = minimise(linear, moved, start, smoothness(np.arange(5.0), np.ones(1)))
    assert solved.status == Status.BROKEN
    assert solved.x is start


def test_a_wrong_gradient_stalls():
    linear, moved = line(np.ones(5), np.ones(5))
    wrong = lambda x: linear(x)._replace(gradient=-np.asarray(linear(x).gradient))  # noqa: E731
    solved = minimise(wrong, moved, np.zeros(5), smoothness(np.arange(5.0), np.ones(1)))
    assert solved.status == Status.STALLED
    np.testing.assert_array_equal(solved.x, 0)


@pytest.mark.parametrize("frames", [1, 2])
def test_frames_too_few_to_accelerate_are_solved_by_themselves(frames):
    measured = np.arange(1.0, frames + 1)
    linear, moved = line(measured, np.full(frames, 10.0))
    solved = minimise(linear, moved, np.zeros(frames), smoothness(measured, np.ones(1)), EXACT)
    np.testing.assert_allclose(solved.x, measured, atol=1e-12)


def test_times_that_do_not_increase_are_refused():
    with pytest.raises(ValueError, match="must increase"):
        smoothness(np.array([0.0, 0.1, 0.1]), np.ones(1))


class Pendulum(NamedTuple):
    """Two links on SO(2), jitted: only the heights of their ends are measured, at 120 Hz."""

    linearise: Callable
    turned: Callable
    truth: jax.Array
    prior: Smoothness

    def solve(self, off: float, settings: SolverSettings):
        """From the truth turned by ``off`` radians."""
        start = self.turned(self.truth, np.full((120, 2), off), None)
        return start, minimise(self.linearise, self.turned, start, self.prior, settings)

    def cost(self, x: jax.Array) -> float:
        linear = self.linearise(x)
        return float(np.sum(linear.cost)) + self.prior.cost(np.asarray(linear.points))


def pendulum(dtype) -> Pendulum:
    times = np.arange(120) / 120
    angles = np.stack([0.6 * np.sin(4 * times), 0.5 * np.cos(3 * times)], 1)

    def ends(state: jax.Array, step: jax.Array) -> jax.Array:
        total = jnp.cumsum(jnp.arctan2(state[:, 1], state[:, 0]) + step)
        return jnp.cumsum(jnp.stack([jnp.sin(total), -jnp.cos(total)], 1), 0).reshape(-1)

    def misfit(state: jax.Array, step: jax.Array, measured: jax.Array) -> jax.Array:
        lean = jnp.arctan2(state[:, 1], state[:, 0]) + step
        return jnp.concatenate([(ends(state, step)[1::2] - measured) * 100, lean])

    def terms(state: jax.Array, measured: jax.Array) -> Linearised:
        zero = jnp.zeros(2, state.dtype)
        r, J = misfit(state, zero, measured), jax.jacfwd(misfit, 1)(state, zero, measured)
        return Linearised(
            r @ r, J.T @ J, J.T @ r, ends(state, zero), jax.jacfwd(ends, 1)(state, zero)
        )

    def turn(state: jax.Array, step: jax.Array) -> jax.Array:
        c, s = jnp.cos(step), jnp.sin(step)
        x, y = state[:, 0], state[:, 1]
        return jnp.stack([c * x - s * y, s * x + c * y], 1)

    def on(values: np.ndarray) -> jax.Array:
        return jnp.asarray(values, dtype)

    truth = on(np.stack([np.cos(angles), np.sin(angles)], 2))
    noise = 0.01 * np.random.default_rng(0).normal(size=(120, 2))
    measured = jax.vmap(ends)(truth, jnp.zeros((120, 2), dtype))[:, 1::2] + on(noise)
    return Pendulum(
        jax.jit(lambda x: jax.vmap(terms)(x, measured)),
        jax.jit(lambda x, steps, _: jax.vmap(turn)(x, steps.astype(dtype))),
        truth,
        smoothness(times, np.full(4, 1.0)),
    )


@pytest.mark.parametrize("off", [0.2, 0.8, 1.5, -2.5])
def test_a_solve_never_ends_above_its_start_and_says_when_its_steps_have_run_out(off):
    with double():
        arm = pendulum(jnp.float64)
        start, actual = arm.solve(off, EXACT._replace(iterations=3))
        assert (actual.status, actual.iterations) == (Status.OUT_OF_STEPS, 3)
        assert actual.cost < arm.cost(start)
        assert actual.cost == pytest.approx(arm.cost(actual.x), rel=1e-12)


def test_terms_in_float32_lose_little_against_double_precision():
    def solved(dtype):
        arm = pendulum(dtype)
        _, actual = arm.solve(0.2, SolverSettings(relative=1e-6))
        variances = covariances(arm.linearise(actual.x), arm.prior).frames
        return actual, np.asarray(actual.linear.points), variances

    single, points, variances = solved(jnp.float32)
    with double():
        exact, exact_points, exact_variances = solved(jnp.float64)
    assert single.status == exact.status == Status.CONVERGED
    assert single.cost == pytest.approx(exact.cost, rel=1e-4)
    np.testing.assert_allclose(points, exact_points, atol=2e-6)
    np.testing.assert_allclose(variances, exact_variances, rtol=1e-4, atol=1e-7)
