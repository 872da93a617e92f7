"""se(3), which tests of kinematics use: there and back, derivatives also at 0, SciPy, screws."""

import jax
import numpy as np
import twists
from conftest import double, on_device, vectors
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

EXP, LOG = jax.jit(twists.exp), jax.jit(twists.log)
TRANSPORT, ADJOINT = jax.jit(twists.transport), jax.jit(twists.adjoint)
INVERSE, SCREW = jax.jit(twists.inverse), jax.jit(twists.screw)


@st.composite
def some_twists(draw, longest: float = np.pi):
    """Turns of any length up to ``longest``, often very close to 0 or to where series end."""
    direction = draw(vectors(3)) + np.array([0.0, 0.0, 2.0])
    near = st.sampled_from([0.0, 1e-9, 1e-5, 1e-4, 1e-3, 0.1, 0.49999, 0.50001, 0.9 * longest])
    turn = draw(near) * direction / np.linalg.norm(direction)
    return np.concatenate([3 * draw(vectors(3)), turn])


def hat(twist):
    """(4, 4) by the definition."""
    v, w = twist[:3], twist[3:]
    top = [[0, -w[2], w[1], v[0]], [w[2], 0, -w[0], v[1]], [-w[1], w[0], 0, v[2]]]
    return np.array([*top, [0, 0, 0, 0]])


def motion(twist):
    return expm(hat(np.asarray(twist)))


@given(twist=some_twists(longest=2 * np.pi))
def test_exp_is_the_matrix_exponential(twist):
    with double():
        T = EXP(on_device(twist))
    np.testing.assert_allclose(T, motion(twist), atol=1e-11)


@given(twist=some_twists())
def test_log_undoes_exp(twist):
    with double():
        np.testing.assert_allclose(LOG(EXP(on_device(twist))), twist, atol=1e-10)


@given(twist=some_twists())
def test_log_undoes_exp_in_float32(twist):
    """Also where 1 - cos would be rounded away."""
    T = EXP(on_device(twist))
    assert np.abs(T - motion(np.float32(twist))).max() < 1e-5
    assert np.abs(EXP(LOG(T)) - T).max() < 3e-5


def test_log_is_the_matrix_logarithm():
    twist = np.array([0.4, -1.0, 0.3, 0.9, -0.2, 1.1])
    with double():
        actual = LOG(on_device(motion(twist)))
        np.testing.assert_allclose(twists.hat(actual), np.real(logm(motion(twist))), atol=1e-10)


@given(twist=some_twists())
def test_derivatives_of_exp_agree_forward_reverse_and_with_differences(twist):
    with double():
        x, h = on_device(twist), 1e-6
        forward, reverse = FORWARD(x), REVERSE(x)
        steps = h * np.eye(6)
        numeric = [(motion(twist + s) - motion(twist - s)) / (2 * h) for s in steps]
    np.testing.assert_allclose(forward, reverse, atol=1e-11)
    np.testing.assert_allclose(forward, np.stack(numeric, -1), atol=1e-7)


FORWARD, REVERSE = jax.jit(jax.jacfwd(twists.exp)), jax.jit(jax.jacrev(twists.exp))
THERE_AND_BACK = jax.jit(jax.jacfwd(lambda x: twists.log(twists.exp(x))))


@given(twist=some_twists())
def test_the_derivative_of_there_and_back_is_the_identity(twist):
    with double():
        np.testing.assert_allclose(THERE_AND_BACK(on_device(twist)), np.eye(6), atol=1e-7)


@given(twist=some_twists(), other=some_twists())
def test_the_adjoint_is_what_a_motion_makes_of_a_twist(twist, other):
    T = motion(twist)
    conjugated = T @ hat(other) @ np.linalg.inv(T)
    with double():
        moved = np.asarray(ADJOINT(on_device(T))) @ other
        np.testing.assert_allclose(hat(moved), conjugated, atol=1e-9)
        np.testing.assert_allclose(TRANSPORT(*on_device((T, other))), moved, atol=1e-12)
        np.testing.assert_allclose(INVERSE(on_device(T)), np.linalg.inv(T), atol=1e-12)


@given(twist=some_twists(), point=vectors(3), axis=vectors(3), angle=st.floats(-3, 3))
def test_a_transported_joint_turns_about_the_transported_axis(twist, point, axis, angle):
    """Equation (4.21) as printed, and its meaning: the moved joint leaves its moved axis alone."""
    axis = axis + np.array([0.0, 0, 2])
    axis /= np.linalg.norm(axis)
    T = motion(twist)
    with double():
        joint = SCREW(*on_device((point, axis)))
        moved = np.asarray(TRANSPORT(on_device(T), joint))
        turn = np.asarray(EXP(angle * on_device(moved)))
    R, t = T[:3, :3], T[:3, 3]
    printed = np.concatenate([np.cross(R @ point + t, R @ axis), R @ axis])
    np.testing.assert_allclose(moved, printed, atol=1e-11)
    on_axis = R @ (point + 0.7 * axis) + t
    np.testing.assert_allclose(turn[:3, :3] @ on_axis + turn[:3, 3], on_axis, atol=1e-10)
    np.testing.assert_allclose(
        turn[:3, :3], Rotation.from_rotvec(angle * R @ axis).as_matrix(), atol=1e-10
    )


def test_batches_are_their_members():
    many = np.random.default_rng(0).normal(size=(2, 3, 6))
    with double():
        all_at_once = EXP(on_device(many))
        back = LOG(all_at_once)
    np.testing.assert_allclose(all_at_once[1, 2], motion(many[1, 2]), atol=1e-12)
    np.testing.assert_allclose(motion(back[1, 2]), all_at_once[1, 2], atol=1e-12)
