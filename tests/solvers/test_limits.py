"""Steps within limits: who is at a limit and would go on leaves, and the rest solve again."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double
from hypothesis import given
from hypothesis import strategies as st

from jaxmocap.body.pose import room
from jaxmocap.solvers.limits import step_within

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
