"""The trajectory solver against dense oracles, and its promises."""

from operator import attrgetter
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares

from jaxmocap.solvers import banded
from jaxmocap.solvers.smoothness import smoothness
from jaxmocap.solvers.status import SENTENCES, Status
from jaxmocap.solvers.trajectory import (
    Linearised,
    Settings,
    covariances,
    point_variances,
    smooth,
)

EXACT = Settings(iterations=400, relative=1e-13, step=1e-12, floor=0.0)
FRAMES, LINKS = 9, 2
LENGTHS = np.array([0.5, 0.4])
ACCELERATIONS = np.array([2.0, 2.0, 3.0, 4.0, 5.0, 6.0])
VELOCITIES = np.array([2.0, np.inf, 2.0, np.inf, 3.0, 3.0])


class Arm(NamedTuple):
    """A planar arm on a sliding base: its rotations live on SO(2), its lengths may be shared."""

    base: np.ndarray  # (T, 2)
    turns: np.ndarray  # (T, LINKS) complex, of length 1
    lengths: np.ndarray  # (LINKS,)


class Watched(NamedTuple):
    """A seen arm: ranges of its joints from the origin, and its last joint's height."""

    ranges: np.ndarray  # (T, LINKS)
    heights: np.ndarray  # (T,)
    weights: np.ndarray  # (T,), 0 where nothing was seen
    shared: int  # how many lengths are free


def move(arm: Arm, steps: np.ndarray, shared: np.ndarray) -> Arm:
    lengths = arm.lengths.copy()
    lengths[: len(shared)] += shared
    return Arm(arm.base + steps[:, :2], arm.turns * np.exp(1j * steps[:, 2:]), lengths)


def joints(arm: Arm) -> np.ndarray:
    """(T, M) positions of the base and of the links' ends."""
    links = np.cumprod(arm.turns, 1) * arm.lengths
    along = np.cumsum(np.concatenate([arm.base @ [[1], [1j]], links], 1), 1)
    return np.stack([along.real, along.imag], 2).reshape(len(along), -1)


def residuals(arm: Arm, seen: Watched) -> np.ndarray:
    """(T, R) of the frames by themselves."""
    xy = joints(arm).reshape(-1, LINKS + 1, 2)[:, 1:]
    range_error = (np.hypot(xy[..., 0], xy[..., 1]) - seen.ranges) * 50
    height_error = (xy[:, -1, 1] - seen.heights) * 50
    lean = arm.base / 0.3
    bend = np.angle(arm.turns) / 1.5
    return (
        np.concatenate([range_error, height_error[:, None], lean, bend], 1) * seen.weights[:, None]
    )


def derivatives(function, arm: Arm, shared: int) -> tuple[np.ndarray, np.ndarray]:
    """Central differences (T, R, N) and (T, R, P): each frame's values know that frame only."""

    def column(steps, lengths):
        ahead, behind = move(arm, steps, lengths), move(arm, -steps, -lengths)
        return (function(ahead) - function(behind)) / 2e-6

    still, rigid = np.zeros((len(arm.base), 2 + LINKS)), np.zeros(shared)
    own = [column(still + 1e-6 * axis, rigid) for axis in np.eye(2 + LINKS)]
    common = [column(still, 1e-6 * axis) for axis in np.eye(shared)]
    values = function(arm)
    return np.stack(own, 2), np.reshape(common, (shared, *values.shape)).transpose(1, 2, 0)


def linearise(arm: Arm, seen: Watched) -> Linearised:
    r = residuals(arm, seen)
    J, K = derivatives(lambda x: residuals(x, seen), arm, seen.shared)
    Q, S = derivatives(joints, arm, seen.shared)
    # The lengths' prior, a share in each frame.
    error = (arm.lengths - LENGTHS)[: seen.shared] / 0.05 / np.sqrt(FRAMES)
    return Linearised(
        np.sum(r**2, 1) + error @ error,
        np.einsum("tri,trj->tij", J, J),
        np.einsum("tri,tr->ti", J, r),
        joints(arm),
        Q,
        np.einsum("tri,trp->tip", J, K),
        np.einsum("trp,trq->tpq", K, K) + np.eye(seen.shared) / 0.05**2 / FRAMES,
        np.einsum("trp,tr->tp", K, r) + error / 0.05 / np.sqrt(FRAMES),
        S,
    )


def evaluate(arm: Arm, seen: Watched) -> tuple[np.ndarray, np.ndarray]:
    linear = linearise(arm, seen)
    return np.asarray(linear.cost), np.asarray(linear.points)


def problem(seed: int, shared: int, absent: tuple[int, ...] = ()) -> tuple[Arm, Watched, object]:
    """A start away from an arm that was seen with noise at uneven times, and the prior."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.02, 0.2, FRAMES))
    phase = times[:, None] * [3.0, 2.0] + rng.uniform(0, 1, LINKS)
    truth = Arm(0.2 * np.cos(phase), np.exp(1j * (0.8 + 0.5 * np.sin(phase))), LENGTHS * 1.1)
    weights = np.ones(FRAMES)
    weights[list(absent)] = 0
    seen = Watched(np.zeros((FRAMES, LINKS)), np.zeros(FRAMES), weights, shared)
    xy = joints(truth).reshape(FRAMES, LINKS + 1, 2)[:, 1:]
    seen = seen._replace(
        ranges=np.linalg.norm(xy, axis=2) + 0.005 * rng.normal(size=(FRAMES, LINKS)),
        heights=xy[:, -1, 1] + 0.005 * rng.normal(size=FRAMES),
    )
    start = move(truth, 0.05 * rng.normal(size=(FRAMES, 2 + LINKS)), np.zeros(0))
    prior = smoothness(times, ACCELERATIONS, VELOCITIES)
    return start._replace(lengths=LENGTHS), seen, (times, prior)


def motion_matrix(times: np.ndarray) -> np.ndarray:
    """The prior's residuals as a dense matrix on (T * M,) points, written out term by term."""
    rows = []
    for m in range(len(ACCELERATIONS)):
        for t in range(FRAMES - 1):
            h = times[t + 1] - times[t]
            row = np.zeros((FRAMES, len(ACCELERATIONS)))
            row[[t, t + 1], m] = np.array([-1, 1]) / h * np.sqrt(h) / VELOCITIES[m]
            rows.append(row.ravel())
        for t in range(1, FRAMES - 1):
            h1, h2 = times[t] - times[t - 1], times[t + 1] - times[t]
            row = np.zeros((FRAMES, len(ACCELERATIONS)))
            ends = np.array([1 / h1, -1 / h1 - 1 / h2, 1 / h2])
            row[t - 1 : t + 2, m] = 2 * ends / (h1 + h2) * np.sqrt((h1 + h2) / 2) / ACCELERATIONS[m]
            rows.append(row.ravel())
    return np.array(rows)


def dense_residuals(arm: Arm, seen: Watched, motion: np.ndarray) -> np.ndarray:
    lengths = (arm.lengths - LENGTHS)[: seen.shared] / 0.05
    own = residuals(arm, seen).ravel()
    return np.concatenate([own, motion @ joints(arm).ravel(), lengths])


def dense_solution(start: Arm, seen: Watched, motion: np.ndarray, held: int) -> tuple[Arm, float]:
    """By SciPy, over all free unknowns at once in the chart about the start."""

    def at(z: np.ndarray) -> Arm:
        steps = np.zeros((FRAMES, 2 + LINKS))
        steps[held:] = z[: len(z) - seen.shared].reshape(-1, 2 + LINKS)
        return move(start, steps, z[len(z) - seen.shared :])

    unknowns = (FRAMES - held) * (2 + LINKS) + seen.shared
    tight = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-12}
    found = least_squares(
        lambda z: dense_residuals(at(z), seen, motion), np.zeros(unknowns), "3-point", **tight
    )
    return at(found.x), 2 * found.cost


def dense_hessian(linear: Linearised, motion: np.ndarray) -> np.ndarray:
    """(T * N + P) squared, from the frames' blocks and the motion matrix."""
    T, M, N = np.shape(linear.jacobian)
    P = np.shape(linear.shared_gradient)[-1]
    leverage = np.zeros((T, M, T * N + P))
    H = np.zeros((T * N + P, T * N + P))
    H[T * N :, T * N :] = np.sum(linear.shared_hessian, 0)
    for t in range(T):
        here = slice(t * N, (t + 1) * N)
        leverage[t, :, here] = np.asarray(linear.jacobian)[t]
        H[here, here] = np.asarray(linear.hessian)[t]
        H[here, T * N :] = np.broadcast_to(linear.cross, (T, N, P))[t]
        H[T * N :, here] = H[here, T * N :].T
    leverage[:, :, T * N :] = linear.shared_jacobian
    pulled = motion @ leverage.reshape(T * M, -1)
    return H + pulled.T @ pulled


def solve(start: Arm, seen: Watched, prior, settings: Settings = EXACT, held: int = 0):
    return smooth(
        lambda x: linearise(x, seen),
        lambda x: evaluate(x, seen),
        move,
        start,
        prior,
        settings,
        held,
    )


@st.composite
def systems(draw) -> tuple[np.ndarray, np.ndarray]:
    """Block rows of a positive definite banded matrix, and the matrix."""
    frames, size = draw(st.integers(1, 7)), draw(st.integers(1, 4))
    reach = draw(st.integers(0, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**20)))
    blocks = rng.normal(size=(frames, reach + 1, size, size))
    lower = np.zeros((frames + reach, size, frames, size))
    for t in range(frames):
        for k in range(reach + 1):
            lower[t + k, :, t] = blocks[t, k]
    lower = lower.reshape((frames + reach) * size, frames * size)
    matrix = lower.T @ lower + np.eye(frames * size)
    tiled = matrix.reshape(frames, size, frames, size)
    rows = np.zeros((frames, size, reach + 1, size))
    for t in range(frames):
        for k in range(min(reach + 1, frames - t)):
            rows[t, :, k] = tiled[t, :, t + k]
    return rows.reshape(frames, size, -1), matrix


@given(systems())
def test_packed_columns_are_the_matrix_from_its_diagonal_down(system):
    rows, matrix = system
    columns = banded.pack(rows)
    for i, column in enumerate(columns):
        below = matrix[i:, i][: len(column)]
        np.testing.assert_array_equal(column[: len(below)], below)


@given(systems())
def test_unpacking_undoes_packing(system):
    rows, _ = system
    size = rows.shape[1]
    back = banded.unpack(banded.pack(rows), len(rows))
    rows[:, :, :size] = np.triu(rows[:, :, :size])
    np.testing.assert_array_equal(back, rows)


@given(systems(), st.integers(0, 3))
def test_banded_solutions_and_inverse_blocks_are_the_dense_ones(system, sides):
    rows, matrix = system
    frames, size, _ = rows.shape
    ridge = np.linspace(0, 1, frames * size).reshape(frames, size)
    factor = banded.factorise(rows, ridge)
    inverse = np.linalg.inv(matrix + np.diag(ridge.ravel()))
    right = np.random.default_rng(0).normal(size=(frames, size, sides))
    expected = inverse @ right.reshape(frames * size, sides)
    np.testing.assert_allclose(
        banded.solve(factor, right).reshape(expected.shape), expected, rtol=1e-9, atol=1e-9
    )
    tiled = inverse.reshape(frames, size, frames, size)
    blocks = banded.inverse_blocks(factor)
    np.testing.assert_allclose(blocks, np.einsum("titj->tij", tiled), rtol=1e-9, atol=1e-9)


def test_inverse_blocks_stay_exact_over_long_stiff_trajectories():
    rng = np.random.default_rng(0)
    frames, size, points = 300, 5, 9
    jacobian = rng.normal(size=(points, size)) + 0.3 * rng.normal(size=(frames, points, size))
    prior = smoothness(np.arange(frames) / 240, np.full(points, 0.5))
    rows = prior.block_rows(jacobian)
    rows[:, :, :size] += 100 * np.eye(size)
    factor = banded.factorise(rows)
    blocks = banded.inverse_blocks(factor)
    for frame in (0, 100, 200, 299):
        unit = np.zeros((frames, size, size))
        unit[frame] = np.eye(size)
        expected = banded.solve(factor, unit)[frame]
        np.testing.assert_allclose(blocks[frame], expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("held", [0, 2])
@pytest.mark.parametrize("shared", [0, 1, 2])
@pytest.mark.parametrize("absent", [(), (4, 5)])
def test_the_minimum_is_the_dense_one(shared, held, absent):
    start, seen, (times, prior) = problem(1, shared, absent)
    found = solve(start, seen, prior, held=held)
    expected, cost = dense_solution(start, seen, motion_matrix(times), held)
    assert found.status == Status.CONVERGED
    assert found.cost == pytest.approx(cost, rel=1e-9)
    np.testing.assert_allclose(joints(found.x), joints(expected), atol=1e-6)
    np.testing.assert_allclose(found.x.lengths, expected.lengths, atol=1e-6)
    np.testing.assert_array_equal(found.x.turns[:held], start.turns[:held])


@given(st.integers(0, 2**20), st.integers(0, 2))
def test_a_solve_never_ends_above_its_start(seed, shared):
    start, seen, (_, prior) = problem(seed, shared)
    start = start._replace(turns=start.turns * np.exp(2j * (seed % 5)))
    cost, points = evaluate(start, seen)
    found = solve(start, seen, prior, Settings(iterations=4))
    cost_after, points_after = evaluate(found.x, seen)
    assert found.cost <= cost.sum() + prior.cost(points)
    assert found.cost == pytest.approx(cost_after.sum() + prior.cost(points_after), rel=1e-12)


@pytest.mark.parametrize("shared", [0, 2])
@pytest.mark.parametrize("held", [0, 2])
def test_covariances_are_blocks_of_the_dense_inverse(shared, held):
    arm, seen, (times, prior) = problem(2, shared, absent=(5,))
    linear = linearise(arm, seen)
    found = covariances(linear, prior, EXACT, held)
    free = np.arange(held * 4, FRAMES * 4 + shared)
    inverse = np.zeros((FRAMES * 4 + shared,) * 2)
    H = dense_hessian(linear, motion_matrix(times))
    inverse[np.ix_(free, free)] = np.linalg.inv(H[np.ix_(free, free)])
    frames = inverse[: FRAMES * 4, : FRAMES * 4].reshape(FRAMES, 4, FRAMES, 4)
    np.testing.assert_allclose(found.frames, np.einsum("titj->tij", frames), atol=1e-9)
    np.testing.assert_allclose(found.shared, inverse[FRAMES * 4 :, FRAMES * 4 :], atol=1e-9)
    cross = inverse[: FRAMES * 4, FRAMES * 4 :].reshape(FRAMES, 4, shared)
    np.testing.assert_allclose(found.cross, cross, atol=1e-9)
    leverage = np.zeros((FRAMES, len(ACCELERATIONS), len(inverse)))
    for t in range(FRAMES):
        leverage[t, :, t * 4 : t * 4 + 4] = np.asarray(linear.jacobian)[t]
    leverage[:, :, FRAMES * 4 :] = linear.shared_jacobian
    leverage = leverage.reshape(-1, len(inverse))
    variances = point_variances(linear.jacobian, found, linear.shared_jacobian)
    np.testing.assert_allclose(
        variances.ravel(), np.diag(leverage @ inverse @ leverage.T), atol=1e-9
    )


def line(seen: np.ndarray, weights: np.ndarray):
    """One coordinate observed directly: ``linearise``, ``evaluate`` and ``move``."""

    def linear(x: np.ndarray) -> Linearised:
        r = (x - seen) * weights
        J = np.ones((len(x), 1, 1))
        return Linearised(r**2, (weights**2)[:, None, None], (r * weights)[:, None], x[:, None], J)

    return (
        linear,
        lambda x: (((x - seen) * weights) ** 2, x[:, None]),
        lambda x, steps, _: x + steps[:, 0],
    )


def test_the_result_does_not_depend_on_the_sampling_rate():
    wave, found, spread = np.sin, [], []
    for rate in (60, 240):
        times = np.arange(4 * rate + 1) / rate
        # As much evidence each second, however it is sampled.
        weights = np.full(len(times), 20 / np.sqrt(rate))
        prior = smoothness(times, np.array([5.0]))
        assert prior.cost(wave(3 * times)[:, None]) == pytest.approx(
            81 / 25 * (2 - np.sin(24) / 12), rel=0.02
        )
        linear, *others = line(wave(3 * times) + 0.2 * wave(40 * times), weights)
        solved = smooth(linear, *others, np.zeros(len(times)), prior, EXACT)
        found.append(solved.x[:: rate // 60])
        spread.append(covariances(linear(solved.x), prior, EXACT).frames[:: rate // 60, 0, 0])
    np.testing.assert_allclose(found[0][20:-20], found[1][20:-20], atol=0.003)
    np.testing.assert_allclose(spread[0][20:-20], spread[1][20:-20], rtol=0.02)


def test_absent_frames_are_bridged_by_the_calmest_curve():
    times = np.arange(40) / 100
    weights = np.where((times > 0.145) & (times < 0.255), 0.0, 100.0)
    linear, *others = line(np.sin(8 * times), weights)
    prior = smoothness(times, np.array([3.0]))
    solved = smooth(linear, *others, np.zeros(40), prior, EXACT)
    # Least squares of second differences: a cubic.
    np.testing.assert_allclose(np.diff(solved.x, 4)[13:22], 0, atol=1e-9)
    np.testing.assert_allclose(solved.x, np.sin(8 * times), atol=0.01)
    deviations = np.sqrt(covariances(linear(solved.x), prior).frames[:, 0, 0])
    assert np.argmax(deviations) == 20
    assert deviations[20] > 2 * deviations[10]


def test_what_nothing_determines_stays_and_the_status_says_so():
    # A second coordinate that neither frames nor prior see, beside the line's first.
    keep = np.array([1.0, 0.0])
    times = np.arange(12) / 10
    linear, cost, _ = line(np.cos(times), np.ones(12))

    def both(x: np.ndarray) -> Linearised:
        seen = linear(x[:, 0])
        grown = np.asarray(seen.hessian)[:, [0, 0]][:, :, [0, 0]] * keep * keep[:, None]
        gradient = np.asarray(seen.gradient) * keep
        return seen._replace(hessian=grown, gradient=gradient, jacobian=np.ones((12, 1, 1)) * keep)

    prior = smoothness(times, np.array([1.0]))
    start = np.tile([0.0, 7.0], (12, 1))
    solved = smooth(both, lambda x: cost(x[:, 0]), lambda x, s, _: x + s, start, prior)
    assert solved.status == Status.UNDETERMINED
    assert "nothing determines" in SENTENCES[solved.status]
    np.testing.assert_array_equal(solved.x[:, 1], 7.0)
    found = covariances(both(solved.x), prior).frames
    np.testing.assert_allclose(found[:, 1, 1], 1 / Settings().floor)
    assert (found[:, 0, 0] < 1).all()


def test_terms_that_are_not_finite_leave_the_start_as_it_was():
    linear, *others = line(np.full(5, np.nan), np.ones(5))
    start = np.zeros(5)
    solved = smooth(linear, *others, start, smoothness(np.arange(5.0), np.ones(1)))
    assert solved.status == Status.BROKEN
    assert solved.x is start


def test_a_wrong_gradient_stalls():
    linear, *others = line(np.ones(5), np.ones(5))
    wrong = lambda x: linear(x)._replace(gradient=-np.asarray(linear(x).gradient))  # noqa: E731
    solved = smooth(wrong, *others, np.zeros(5), smoothness(np.arange(5.0), np.ones(1)))
    assert solved.status == Status.STALLED
    np.testing.assert_array_equal(solved.x, 0)


def test_a_solve_says_when_it_ran_out_of_steps():
    start, seen, (_, prior) = problem(3, 0)
    solved = solve(start, seen, prior, EXACT._replace(iterations=1))
    assert (solved.status, solved.iterations) == (Status.OUT_OF_STEPS, 1)


@pytest.mark.parametrize("frames", [1, 2])
def test_frames_too_few_to_accelerate_are_solved_by_themselves(frames):
    seen = np.arange(1.0, frames + 1)
    linear, *others = line(seen, np.full(frames, 10.0))
    solved = smooth(linear, *others, np.zeros(frames), smoothness(seen, np.ones(1)), EXACT)
    np.testing.assert_allclose(solved.x, seen, atol=1e-12)


def test_times_that_do_not_increase_are_refused():
    with pytest.raises(ValueError, match="must increase"):
        smoothness(np.array([0.0, 0.1, 0.1]), np.ones(1))


def pendulum_seen_from_the_side(dtype):
    """Two links on SO(2), jitted: only the heights of their ends are seen, at 120 Hz."""
    times = np.arange(120) / 120
    angles = np.stack([0.6 * np.sin(4 * times), 0.5 * np.cos(3 * times)], 1)

    def ends(state: jax.Array, step: jax.Array) -> jax.Array:
        total = jnp.cumsum(jnp.arctan2(state[:, 1], state[:, 0]) + step)
        return jnp.cumsum(jnp.stack([jnp.sin(total), -jnp.cos(total)], 1), 0).reshape(-1)

    def misfit(state: jax.Array, step: jax.Array, seen: jax.Array) -> jax.Array:
        lean = jnp.arctan2(state[:, 1], state[:, 0]) + step
        return jnp.concatenate([(ends(state, step)[1::2] - seen) * 100, lean])

    def terms(state: jax.Array, seen: jax.Array) -> Linearised:
        zero = jnp.zeros(2, state.dtype)
        r, J = misfit(state, zero, seen), jax.jacfwd(misfit, 1)(state, zero, seen)
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
    zeros = jnp.zeros((120, 2), dtype)
    noise = 0.01 * np.random.default_rng(0).normal(size=(120, 2))
    seen = jax.vmap(ends)(truth, zeros)[:, 1::2] + on(noise)
    linearise = jax.jit(lambda x: jax.vmap(terms)(x, seen))
    found = smooth(
        linearise,
        jax.jit(lambda x: attrgetter("cost", "points")(jax.vmap(terms)(x, seen))),
        jax.jit(lambda x, steps, _: jax.vmap(turn)(x, steps.astype(dtype))),
        jax.vmap(turn)(truth, on(np.full((120, 2), 0.2))),
        smoothness(times, np.full(4, 1.0)),
        Settings(relative=1e-6),
    )
    variances = covariances(linearise(found.x), smoothness(times, np.full(4, 1.0))).frames
    return found, np.asarray(jax.vmap(ends)(found.x, zeros)), variances


def test_terms_in_float32_lose_little_against_double_precision():
    single, points, variances = pendulum_seen_from_the_side(jnp.float32)
    with double():
        exact, exact_points, exact_variances = pendulum_seen_from_the_side(jnp.float64)
    assert single.status == exact.status == Status.CONVERGED
    assert single.cost == pytest.approx(exact.cost, rel=1e-4)
    np.testing.assert_allclose(points, exact_points, atol=2e-6)
    np.testing.assert_allclose(variances, exact_variances, rtol=1e-4, atol=1e-7)
