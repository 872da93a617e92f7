"""Selectively damped least squares against the equations term by term, and its promises."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double, on_device, poses, vectors
from hypothesis import given
from hypothesis import strategies as st

from jaxmocap.body.kinematics import forward, jacobian, site_positions
from jaxmocap.body.kinematics import landmark_sites as landmarks_on_bones
from jaxmocap.body.pose import Pose, room
from jaxmocap.reference.hybrid import sdls as reference
from jaxmocap.solvers import sdls
from jaxmocap.solvers.limits import step_within

EFFECTORS, DOF = 5, 27
LARGEST = np.pi / 4
# Step and projector in float32 may lie this far from double precision: radians of Gamma = pi / 4,
# by the ratio of two neighbouring singular values.
FLOAT32_STEP = {1.3: 2e-4, 2.0: 4e-3}


@jax.jit
def step(J, error, largest):
    solved = sdls.sdls_step(J, error, largest, 1e-6)
    return solved.primary, solved.row_space


@jax.jit
def projected(J, secondary):
    row_space = sdls.sdls_step(J, jnp.zeros(J.shape[0], J.dtype), LARGEST).row_space
    return sdls.project_secondary(row_space, secondary)


def jacobian_with(seed: int, absent: int, ratio: float, largest: float = 1.0) -> np.ndarray:
    """A random Jacobian whose singular values fall by ``ratio``; the last effectors are absent."""
    rng = np.random.default_rng(seed)
    rows = 3 * (EFFECTORS - absent)
    U = np.linalg.qr(rng.normal(size=(rows, rows)))[0]
    V = np.linalg.qr(rng.normal(size=(DOF, rows)))[0]
    J = np.zeros((3 * EFFECTORS, DOF))
    J[:rows] = U @ np.diag(largest * ratio ** -np.arange(rows, dtype=float)) @ V.T
    return J


def wanted(J: np.ndarray, seed: int, size: float) -> np.ndarray:
    """Random displacements, 0 where the effector is absent."""
    error = np.random.default_rng(seed + 1).normal(size=len(J)) * size
    return np.where(np.abs(J).sum(1) > 0, error, 0.0)


seeds = st.integers(0, 2**20)


@given(seeds, st.integers(0, 4), st.floats(1.1, 2.4), st.floats(1e-4, 1.0))
def test_double_precision_agrees_with_the_reference(seed, absent, ratio, size):
    J = jacobian_with(seed, absent, ratio)
    error = wanted(J, seed, size)
    expected, projector = reference.step(J, error, LARGEST)
    with double():
        primary, row_space = step(on_device(J), on_device(error), LARGEST)
    np.testing.assert_allclose(primary, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    rows = np.asarray(row_space)
    np.testing.assert_allclose(np.eye(DOF) - rows.T @ rows, projector, atol=1e-9)


@given(seeds, st.integers(0, 4), st.sampled_from(sorted(FLOAT32_STEP)), st.floats(1e-4, 1.0))
def test_float32_stays_within_its_tolerances(seed, absent, ratio, size):
    J = jacobian_with(seed, absent, ratio)
    error = wanted(J, seed, size)
    expected, _ = reference.step(J, error, LARGEST)
    primary, _ = step(on_device(J), on_device(error), LARGEST)
    assert primary.dtype == jnp.float32
    assert np.abs(primary - expected).max() < FLOAT32_STEP[ratio]


@given(seeds, st.floats(1e-12, 1e-7))
def test_a_vanishing_singular_value_is_dropped(seed, smallest):
    rng = np.random.default_rng(seed)
    U, _, Vt = np.linalg.svd(rng.normal(size=(3 * EFFECTORS, DOF)), full_matrices=False)
    sigma = np.append(np.linspace(2, 1, 3 * EFFECTORS - 1), smallest)
    J = U @ np.diag(sigma) @ Vt
    error = rng.normal(size=len(J))
    expected, projector = reference.step(J, error, LARGEST)
    with double():
        primary, rows = (np.asarray(part) for part in step(on_device(J), on_device(error), LARGEST))
    np.testing.assert_allclose(primary, expected, rtol=1e-7, atol=1e-9)
    assert abs(np.dot(primary, Vt[-1])) < 1e-7
    np.testing.assert_allclose(np.eye(DOF) - rows.T @ rows, projector, atol=1e-7)


def test_without_any_effector_nothing_moves():
    primary, rows = step(jnp.zeros((15, DOF)), jnp.zeros(15), LARGEST)
    np.testing.assert_array_equal(primary, np.zeros(DOF))
    np.testing.assert_array_equal(rows, np.zeros((15, DOF)))


@given(seeds, st.floats(1.05, 1.5))
def test_what_needs_no_damping_is_the_pseudoinverse(seed, ratio):
    J = jacobian_with(seed, 0, ratio)
    error = wanted(J, seed, 1e-6)
    with double():
        primary, _ = step(on_device(J), on_device(error), LARGEST)
    np.testing.assert_allclose(primary, np.linalg.pinv(J) @ error, rtol=1e-9, atol=1e-15)


def test_each_singular_direction_is_held_to_its_own_gamma():
    """One effector in the plane, two hinges: gamma by hand."""
    J = np.zeros((3, DOF))
    J[0, 0], J[1, 1] = 1.0, 0.01
    error = np.array([0.1, 0.1, 0.0])
    # Of the second direction N = 1 and M = |v| |J column| / sigma = 0.01 / 0.01 = 1.
    with double():
        primary, _ = step(on_device(J), on_device(error), LARGEST)
    np.testing.assert_allclose(primary[:2], [0.1, LARGEST], rtol=1e-12)
    # A hinge that moves two effectors apart but whose sum hardly shows is held to Gamma N / M.
    J = np.zeros((6, DOF))
    J[0, :2], J[3, :2] = [1.0, 0.99], [0.0, 0.5]
    error = np.array([0.5, 0, 0, -0.5, 0, 0])
    U, sigma, Vt = np.linalg.svd(J[[0, 3]][:, :2])
    reach = np.abs(J[0, :2]) + np.abs(J[3, :2])
    total = np.zeros(2)
    for i in range(2):
        N, M = np.abs(U[:, i]).sum(), np.abs(Vt[i]) @ reach / sigma[i]
        gamma = LARGEST * min(1, N / M)
        term = (U[:, i] @ [0.5, -0.5]) / sigma[i] * Vt[i]
        total += term * min(1, gamma / np.abs(term).max())
    with double():
        primary, _ = step(on_device(J), on_device(error), LARGEST)
    np.testing.assert_allclose(primary[:2], total * min(1, LARGEST / np.abs(total).max()))


@given(seeds, st.integers(0, 4), st.floats(1.0, 4.0), st.floats(1e-6, 1e3), st.floats(0.01, 2.0))
def test_no_component_exceeds_the_global_maximum(seed, absent, ratio, size, largest):
    J = jacobian_with(seed, absent, ratio)
    primary, _ = step(on_device(J), on_device(wanted(J, seed, size)), largest)
    assert np.isfinite(primary).all()
    assert np.abs(primary).max() <= largest * (1 + 1e-5)


@given(vectors(12, 3.0), st.floats(0.01, 5.0))
def test_only_displacements_that_are_too_long_are_clamped(values, longest):
    displacements = values.reshape(4, 3)
    with double():
        clamped = np.asarray(sdls.clamp_lengths(on_device(displacements), longest))
    lengths = np.linalg.norm(displacements, axis=1)
    short = lengths < longest * (1 - 1e-9)
    np.testing.assert_array_equal(clamped[short], displacements[short])
    expected = np.minimum(lengths, longest)
    np.testing.assert_allclose(np.linalg.norm(clamped, axis=1), expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(clamped, reference.clamp_targets(displacements, longest), rtol=1e-9)


@given(vectors(6, 3.0), st.floats(0.01, 5.0))
def test_only_vectors_with_too_large_a_component_are_clamped(vector, largest):
    with double():
        clamped = np.asarray(sdls.clamp_max_abs(on_device(vector), largest))
    if np.abs(vector).max() <= largest:
        np.testing.assert_array_equal(clamped, vector)
    np.testing.assert_allclose(clamped, reference.clamp_max_abs(vector, largest), rtol=1e-9)


def test_clamping_has_finite_gradients_at_zero():
    for clamp in (sdls.clamp_lengths, sdls.clamp_max_abs):
        slope = jax.jit(jax.grad(lambda v, clamp=clamp: jnp.sum(clamp(v, 0.1))))
        gradient = slope(jnp.zeros((2, 3)))
        assert np.isfinite(gradient).all()


@given(seeds, st.integers(0, 4), st.floats(1.05, 2.0))
def test_the_projected_secondary_task_moves_no_effector(seed, absent, ratio):
    J = jacobian_with(seed, absent, ratio)
    secondary = np.random.default_rng(seed).normal(size=DOF)
    with double():
        kept = np.asarray(projected(on_device(J), on_device(secondary)))
    np.testing.assert_allclose(J @ kept, 0, atol=1e-12)
    # What is left is all of it that moves none: projecting again changes nothing.
    with double():
        again = projected(on_device(J), on_device(kept))
    np.testing.assert_allclose(again, kept, atol=1e-12)
    assert np.linalg.norm(kept) > 0.1


@jax.jit
def arm_step(skeleton, pose, beyond):
    """The step towards a target ``beyond`` metres past the left hand, along the arm."""
    frames = forward(skeleton, pose)
    sites = landmarks_on_bones(skeleton, ("hand_l", "shoulder_l"))
    hand, shoulder = site_positions(skeleton, frames, sites)
    J = jacobian(skeleton, frames, sites.bones[:1], hand[None])[0]
    arm_only = jnp.where(jnp.arange(DOF) >= 6, J, 0.0)
    outward = (hand - shoulder) / jnp.linalg.norm(hand - shoulder)
    return sdls.sdls_step(arm_only, beyond * outward, LARGEST).primary, arm_only


@pytest.mark.parametrize("bend_degrees", [0.0, 1e-3, 0.01, 0.1, 1.0])
def test_a_stretched_arm_stays_calm_in_float32(skeleton, bend_degrees):
    angles = np.zeros(21)
    angles[skeleton.tree.joint("arm_flex_l")] = np.radians(70)
    angles[skeleton.tree.joint("elbow_flex_l")] = np.radians(bend_degrees)
    pose = on_device(Pose(np.zeros(3), np.eye(4)[0], angles))
    for beyond in (1e-4, 0.01, 0.073, 1.0):
        primary, J = arm_step(skeleton, pose, beyond)
        assert np.isfinite(primary).all()
        assert np.abs(primary).max() <= LARGEST * (1 + 1e-5)
        # The hand is not thrown about: it moves no farther than a third of the arm.
        assert np.linalg.norm(np.asarray(J) @ np.asarray(primary)) < max(0.25, 2 * beyond)


@given(pose=poses())
def test_a_bodys_own_jacobian_keeps_its_promises_in_float32(skeleton, pose):
    primary, J = arm_step(skeleton, on_device(pose), 0.05)
    secondary = on_device(np.linspace(-1, 1, DOF))
    still = projected(jnp.concatenate([J, jnp.zeros((12, DOF))]), secondary)
    assert np.isfinite(primary).all()
    assert np.abs(np.asarray(J) @ np.asarray(still)).max() < 2e-5


# Limits -------------------------------------------------------------------------------------------


NEAR = 1e-3


def stepped(matrix, target, low, high, free):
    """Two equations solved by the unknowns that may move, as little as possible."""

    def step(moves):
        A = jnp.where(moves, jnp.asarray(matrix), 0.0)
        return jnp.linalg.pinv(A) @ jnp.asarray(target)

    limits = jnp.asarray(low), jnp.asarray(high)
    return np.asarray(step_within(step, *limits, jnp.asarray(free), NEAR, 2))


def test_room_is_what_is_left_to_either_side():
    limits = jnp.array([[-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0], [0.0, jnp.inf]])
    low, high = room(limits, jnp.array([0.25, 1.0, 1.5, 2.0]))
    np.testing.assert_allclose(low, [*[-np.inf] * 6, -1.25, -2.0, -2.5, -2.0])
    # Beyond a limit there is no room, and none below zero.
    np.testing.assert_allclose(high, [*[np.inf] * 6, 0.75, 0.0, 0.0, np.inf])
    low, _ = room(limits, jnp.array([0.0, 0.0, -1.5, 0.0]))
    np.testing.assert_allclose(low[6:], [-1.0, -1.0, 0.0, 0.0])


TWO_OF_THREE = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]], np.float32)
TARGET = np.array([0.4, 0.3], np.float32)


@pytest.mark.parametrize(
    ("sign", "first", "free", "expected"),
    [
        (1, 9.0, True, [0.2, 0.2, 0.3]),  # no limit is near: the solve
        (1, 0.0, True, [0.0, 0.4, 0.3]),  # at its limit, and would go on: leaves it to the others
        (-1, 0.0, True, [-0.2, -0.2, -0.3]),  # at its limit, and turns back: stays
        # From afar it is cut short by who takes the step, and leaves the next one if still pulled.
        (1, 0.1, True, [0.2, 0.2, 0.3]),
        (1, 9.0, False, [0.0, 0.4, 0.3]),  # what may not move does not
    ],
)
def test_who_would_go_on_at_a_limit_leaves_the_step_to_the_others(sign, first, free, expected):
    wide, limits = np.full(3, 9.0, np.float32), np.array([first, 9.0, 9.0], np.float32)
    free = [free, True, True]
    actual = stepped(TWO_OF_THREE, sign * TARGET, -wide, limits, free)
    np.testing.assert_allclose(actual, expected, atol=1e-6)
    # The same at the lower limits.
    actual = stepped(TWO_OF_THREE, -sign * TARGET, -limits, wide, free)
    np.testing.assert_allclose(actual, -np.array(expected), atol=1e-6)


@pytest.mark.parametrize("rounds", [1, 2, 3])
def test_there_are_no_more_solves_than_asked_for(rounds):
    """Each solve pushes the next unknown over its limit."""
    pushes = jnp.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])

    def step(moves):
        gone = jnp.sum(~moves)
        return pushes[jnp.minimum(gone, 2)]

    actual = step_within(step, -jnp.ones(3), jnp.zeros(3), jnp.ones(3, bool), NEAR, rounds)
    np.testing.assert_array_equal(actual, np.eye(3)[rounds - 1])


def naive(matrix, target, low, high, free, rounds):
    """The same in a plain loop."""
    moving = np.array(free)
    for _ in range(rounds):
        step = np.linalg.pinv(matrix * moving) @ target
        below, above = (step < low) & (low > -NEAR), (step > high) & (high < NEAR)
        leaving = (below | above) & moving
        if not leaving.any():
            break
        moving &= ~leaving
    return step


@jax.jit
def _within(matrix, target, low, high, free):
    return step_within(
        lambda moves: jnp.linalg.pinv(jnp.where(moves, matrix, 0.0)) @ target,
        low,
        high,
        free,
        NEAR,
        3,
    )


@given(st.integers(0, 10**6))
def test_it_is_the_plain_loop(seed):
    rng = np.random.default_rng(seed)
    matrix, target = rng.normal(size=(3, 6)), rng.normal(size=3)
    low = -np.where(rng.uniform(size=6) < 0.4, 0.0, rng.uniform(0, 1, 6))
    high = np.where(rng.uniform(size=6) < 0.4, 0.0, rng.uniform(0, 1, 6))
    free = rng.uniform(size=6) < 0.8
    with double():
        actual = _within(*map(jnp.asarray, (matrix, target, low, high, free)))
    np.testing.assert_allclose(actual, naive(matrix, target, low, high, free, 3), atol=1e-9)
    np.testing.assert_allclose(np.asarray(actual)[~free], 0, atol=1e-12)
