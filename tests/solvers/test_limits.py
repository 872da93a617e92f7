"""Steps within limits: who is at a limit and would go on leaves, and the rest solve again."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double
from hypothesis import given
from hypothesis import strategies as st

from jaxmocap.solvers.limits import room, step_within

NEAR = 1e-3


def stepped(matrix, target, low, high, free=None, rounds=2):
    """Two equations solved by the unknowns that may move, as little as possible."""

    def step(moves):
        A = jnp.where(moves, jnp.asarray(matrix), 0.0)
        return jnp.linalg.pinv(A) @ jnp.asarray(target)

    moving = jnp.ones(len(low), bool) if free is None else jnp.asarray(free)
    actual = step_within(step, jnp.asarray(low), jnp.asarray(high), moving, NEAR, rounds)
    return np.asarray(actual)


def test_room_is_what_is_left_to_either_side():
    limits = jnp.array([[-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0], [0.0, jnp.inf]])
    low, high = room(limits, jnp.array([0.25, 1.0, 1.5, 2.0]))
    np.testing.assert_allclose(low, [-1.25, -2.0, -2.5, -2.0])
    # Beyond a limit there is no room, and none below zero.
    np.testing.assert_allclose(high, [0.75, 0.0, 0.0, np.inf])
    low, _ = room(limits, jnp.array([0.0, 0.0, -1.5, 0.0]))
    np.testing.assert_allclose(low, [-1.0, -1.0, 0.0, 0.0])


TWO_OF_THREE = np.array([[1.0, 1.0, 0.0], [0.0, 0.0, 1.0]], np.float32)
TARGET = np.array([0.4, 0.3], np.float32)
WIDE = np.full(3, 9.0, np.float32)


def test_without_limits_near_the_step_is_the_solve():
    np.testing.assert_allclose(
        stepped(TWO_OF_THREE, TARGET, -WIDE, WIDE), [0.2, 0.2, 0.3], atol=1e-6
    )


def test_what_is_at_its_limit_and_would_go_on_leaves_to_the_others():
    high = np.array([0.0, 9.0, 9.0], np.float32)
    np.testing.assert_allclose(
        stepped(TWO_OF_THREE, TARGET, -WIDE, high), [0.0, 0.4, 0.3], atol=1e-6
    )
    low = np.array([0.0, -9.0, -9.0], np.float32)
    np.testing.assert_allclose(
        stepped(TWO_OF_THREE, -TARGET, low, WIDE), [0.0, -0.4, -0.3], atol=1e-6
    )


def test_what_is_at_its_limit_and_turns_back_stays():
    high = np.array([0.0, 9.0, 9.0], np.float32)
    np.testing.assert_allclose(
        stepped(TWO_OF_THREE, -TARGET, -WIDE, high), [-0.2, -0.2, -0.3], atol=1e-6
    )


def test_what_reaches_its_limit_from_afar_stays():
    """It is cut short by who takes the step, and leaves the next one if it is still pulled."""
    high = np.array([0.1, 9.0, 9.0], np.float32)
    np.testing.assert_allclose(
        stepped(TWO_OF_THREE, TARGET, -WIDE, high), [0.2, 0.2, 0.3], atol=1e-6
    )


def test_what_may_not_move_does_not():
    free = [False, True, True]
    np.testing.assert_allclose(
        stepped(TWO_OF_THREE, TARGET, -WIDE, WIDE, free), [0.0, 0.4, 0.3], atol=1e-6
    )


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
