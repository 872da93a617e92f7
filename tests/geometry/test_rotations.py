"""SO(3): there and back, and derivatives, also at 0, at half turns and at gimbal lock."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double, on_device, vectors
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from jaxmocap.geometry import rotations

RIGHT_HANDED = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
LEFT_HANDED = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, -1]])
TURNED = Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix()
TRIPLES = {
    "xyz": np.eye(3),
    "flexion, abduction, rotation on the right": RIGHT_HANDED,
    "and on the left": LEFT_HANDED,
    "any orthogonal triple": RIGHT_HANDED @ TURNED,
}
EXP, LOG = jax.jit(rotations.exp), jax.jit(rotations.log)
QUATERNION_EXP = jax.jit(rotations.quaternion_exp)
TO_MATRIX = jax.jit(rotations.quaternion_to_matrix)
FROM_MATRIX = jax.jit(rotations.quaternion_from_matrix)
HINGES = jax.jit(rotations.hinges_from_matrix)


@st.composite
def rotation_vectors(draw, longest: float = np.pi):
    """Of any length up to ``longest``, and often very close to 0 or to a half turn."""
    direction = draw(vectors(3))
    assume(np.linalg.norm(direction) > 1e-3)
    distance = draw(st.sampled_from([0.0, 1e-9, 1e-6, 1e-5, 1e-4, 1e-3, 0.1])) or 0.0
    angle = draw(st.sampled_from([distance, longest - distance, 0.3 * longest]))
    return angle * direction / np.linalg.norm(direction)


def product_of_hinges(angles, axes):
    R = np.eye(3)
    for angle, axis in zip(angles, axes, strict=True):
        R = R @ Rotation.from_rotvec(float(angle) * np.asarray(axis)).as_matrix()
    return R


@given(vector=rotation_vectors())
def test_exp_is_the_matrix_exponential(vector):
    with double():
        R = EXP(on_device(vector))
        K = rotations.hat(on_device(vector))
    np.testing.assert_allclose(R, expm(np.asarray(K)), atol=1e-12)


@given(vector=rotation_vectors())
def test_log_undoes_exp(vector):
    with double():
        R = EXP(on_device(vector))
        again = LOG(R)
        np.testing.assert_allclose(EXP(again), R, atol=1e-12)
    if np.linalg.norm(vector) < np.pi - 1e-8:
        np.testing.assert_allclose(again, vector, atol=1e-11)
    assert np.linalg.norm(again) <= np.pi + 1e-12


@given(vector=rotation_vectors())
def test_log_undoes_exp_in_float32(vector):
    R = EXP(on_device(vector))
    assert np.abs(EXP(LOG(R)) - R).max() < 2e-6


@given(vector=rotation_vectors(longest=2 * np.pi), other=rotation_vectors())
def test_quaternions_turn_like_matrices(vector, other):
    with double():
        a, b = (QUATERNION_EXP(on_device(v)) for v in (vector, other))
        product = TO_MATRIX(rotations.quaternion_multiply(a, b))
        matrices = rotations.compose(EXP(on_device(vector)), EXP(on_device(other)))
        again = FROM_MATRIX(matrices)
        from_again = TO_MATRIX(again)
    np.testing.assert_allclose(product, matrices, atol=1e-12)
    np.testing.assert_allclose(from_again, matrices, atol=1e-12)
    assert np.asarray(again)[0] >= 0


@given(vector=rotation_vectors())
def test_scipy_agrees(vector):
    expected = Rotation.from_rotvec(vector)
    with double():
        wxyz = QUATERNION_EXP(on_device(vector))
        R = TO_MATRIX(wxyz)
    np.testing.assert_allclose(R, expected.as_matrix(), atol=1e-12)
    assert abs(np.dot(np.roll(wxyz, -1), expected.as_quat())) == pytest.approx(1, abs=1e-12)


def test_one_turn_about_an_axis_is_exp_of_their_product():
    axis, angles = np.array([2.0, -1, 2]) / 3, np.linspace(-4, 4, 9)
    with double():
        turns = jax.jit(rotations.about_axis)(np.tile(axis, (9, 1)), angles)
        np.testing.assert_allclose(turns, EXP(on_device(angles[:, None] * axis)), atol=1e-14)


@given(a=vectors(3), b=vectors(3))
def test_hat_is_the_cross_product(a, b):
    with double():
        product = rotations.rotate(rotations.hat(on_device(a)), on_device(b))
    np.testing.assert_allclose(product, np.cross(a, b), atol=1e-14)


MATRIX_FUNCTIONS = {
    "log of a matrix": rotations.log,
    "quaternion_from_matrix": rotations.quaternion_from_matrix,
    "hinges_from_matrix": lambda R: rotations.hinges_from_matrix(R, jnp.eye(3, dtype=R.dtype)),
}
FUNCTIONS = {
    "exp": rotations.exp,
    "log": lambda v: rotations.log(rotations.exp(v)),
    "quaternion_exp": rotations.quaternion_exp,
    "quaternion_log": lambda v: rotations.quaternion_log(rotations.quaternion_exp(v)),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_forward_reverse_and_numeric_derivatives_agree(name):
    function = jax.jit(FUNCTIONS[name])
    forward, reverse = jax.jit(jax.jacfwd(function)), jax.jit(jax.jacrev(function))
    for angle in (0.0, 1e-12, 1e-5, 1e-4, 1.0, np.pi - 1e-3, np.pi - 1e-6):
        vector = angle * np.array([0.48, -0.6, 0.64])
        steps = (1e-7 if angle > 3 else 1e-5) * np.eye(3)
        with double():
            derivative = forward(on_device(vector))
            np.testing.assert_allclose(reverse(on_device(vector)), derivative, atol=1e-9)
            ahead = [function(on_device(vector + step)) for step in steps]
            behind = [function(on_device(vector - step)) for step in steps]
        numeric = (np.stack(ahead, -1) - np.stack(behind, -1)) / (2 * steps.max())
        np.testing.assert_allclose(derivative, numeric, atol=1e-6)


@pytest.mark.parametrize("name", ["exp", "quaternion_exp", *MATRIX_FUNCTIONS])
def test_derivatives_are_finite_at_rest_and_at_half_and_quarter_turns(name):
    function = {**FUNCTIONS, **MATRIX_FUNCTIONS}[name]
    forward, reverse = jax.jit(jax.jacfwd(function)), jax.jit(jax.jacrev(function))
    axes = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0, 0.8], [0.6, 0.8, 0]])
    for axis in axes:
        for angle in (0.0, np.pi / 2, np.pi):
            vector = on_device(angle * axis)
            at = EXP(vector) if name in MATRIX_FUNCTIONS else vector
            assert np.isfinite(forward(at)).all(), (axis, angle)
            assert np.isfinite(reverse(at)).all(), (axis, angle)


@pytest.mark.parametrize("w", [1.0, -1.0, 0.0])
def test_quaternions_have_finite_derivatives_at_rest_and_at_half_turns(w):
    quaternion = jnp.array([w, 0.0, np.sqrt(1 - w * w), 0.0])
    for function in (rotations.quaternion_log, rotations.quaternion_to_matrix):
        assert np.isfinite(jax.jit(jax.jacfwd(function))(quaternion)).all()
        assert np.isfinite(jax.jit(jax.jacrev(function))(quaternion)).all()


@pytest.mark.parametrize("triple", TRIPLES)
@given(angles=st.tuples(st.floats(-3.1, 3.1), st.floats(-1.5, 1.5), st.floats(-3.1, 3.1)))
def test_hinge_angles_come_back(triple, angles):
    axes = TRIPLES[triple]
    with double():
        again = HINGES(on_device(product_of_hinges(angles, axes)), on_device(axes))
    np.testing.assert_allclose(again, angles, atol=1e-9)


@pytest.mark.parametrize("triple", TRIPLES)
@pytest.mark.parametrize("second", [np.pi / 2, -np.pi / 2])
def test_hinges_recover_the_rotation_at_gimbal_lock_and_near_it(triple, second):
    axes = TRIPLES[triple]
    for short_of in (0.0, 1e-7, 1e-6, 1e-5, 3e-5, 1e-4, 1e-3):
        for first, third in ((0.0, 0.0), (0.7, -0.4), (-2.5, 1.3), (np.pi, 0.2)):
            R = product_of_hinges((first, second - np.sign(second) * short_of, third), axes)
            with double():
                angles = HINGES(on_device(R), on_device(axes))
            assert np.abs(product_of_hinges(angles, axes) - R).max() < 2e-6
            angles = HINGES(on_device(R), on_device(axes))
            assert np.abs(product_of_hinges(angles, axes) - R).max() < 3e-6


@pytest.mark.parametrize("second", [np.pi / 2, -np.pi / 2])
def test_hinges_have_finite_derivatives_at_gimbal_lock(second):
    R = on_device(product_of_hinges((0.4, second, 0.3), RIGHT_HANDED))
    axes = on_device(RIGHT_HANDED)
    assert np.isfinite(jax.jit(jax.jacfwd(rotations.hinges_from_matrix))(R, axes)).all()
    assert np.isfinite(jax.jit(jax.jacrev(rotations.hinges_from_matrix))(R, axes)).all()


def test_leading_shapes_are_kept():
    many = on_device(np.random.default_rng(1).normal(size=(4, 5, 3)))
    R = EXP(many)
    assert R.shape == (4, 5, 3, 3)
    np.testing.assert_allclose(R[2, 3], EXP(many[2, 3]), atol=1e-6)
    assert LOG(R).shape == (4, 5, 3)
    np.testing.assert_allclose(LOG(R)[1, 1], LOG(R[1, 1]), atol=1e-6)
