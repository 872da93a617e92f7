"""se(3): the exponential as printed and as a series, derivatives also at 0; joints as screws."""

import jax
import numpy as np
import screws
from conftest import double, on_device, vectors
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from jaxmocap.geometry import twists

EXP, MOVE, HAT = jax.jit(twists.exp), jax.jit(twists.move), jax.jit(twists.hat)
TRANSPORT, SCREW = jax.jit(screws.transport), jax.jit(screws.screw)
FORWARD, REVERSE = jax.jit(jax.jacfwd(twists.exp)), jax.jit(jax.jacrev(twists.exp))


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
        T, matrix = EXP(on_device(twist)), HAT(on_device(twist))
    np.testing.assert_allclose(T, motion(twist), atol=1e-11)
    np.testing.assert_array_equal(matrix, hat(twist))


@given(twist=some_twists(), theta=st.floats(0.1, 3.0))
def test_exp_is_the_formula_as_printed(twist, theta):
    """Equations (3.9) and (3.10), for an axis of length 1."""
    v, w = twist[:3], twist[3:] + np.array([0, 0, 1.0])
    w /= np.linalg.norm(w)
    K = hat(np.append(v, w))[:3, :3]
    R = np.eye(3) + K * np.sin(theta) + K @ K * (1 - np.cos(theta))
    t = (np.eye(3) - R) @ np.cross(w, v) + np.outer(w, w) @ v * theta
    with double():
        T = np.asarray(EXP(on_device(theta * np.append(v, w))))
    np.testing.assert_allclose(T[:3, :3], R, atol=1e-12)
    np.testing.assert_allclose(T[:3, 3], t, atol=1e-11)


@given(twist=some_twists())
def test_exp_in_float32_is_the_motion_to_rounding(twist):
    """Also where 1 - cos would be rounded away."""
    assert np.abs(EXP(on_device(twist)) - motion(np.float32(twist))).max() < 1e-5


@given(twist=some_twists())
def test_derivatives_of_exp_agree_forward_reverse_and_with_differences(twist):
    with double():
        x, h = on_device(twist), 1e-6
        forward, reverse = FORWARD(x), REVERSE(x)
    steps = h * np.eye(6)
    numeric = [(motion(twist + s) - motion(twist - s)) / (2 * h) for s in steps]
    np.testing.assert_allclose(forward, reverse, atol=1e-11)
    np.testing.assert_allclose(forward, np.stack(numeric, -1), atol=1e-7)


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
    points = np.random.default_rng(1).normal(size=(2, 3, 3))
    with double():
        all_at_once = EXP(on_device(many))
        moved = MOVE(all_at_once, on_device(points))
    T = motion(many[1, 2])
    np.testing.assert_allclose(all_at_once[1, 2], T, atol=1e-12)
    np.testing.assert_allclose(moved[1, 2], T[:3, :3] @ points[1, 2] + T[:3, 3], atol=1e-12)
