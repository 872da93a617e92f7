"""The camera against OpenCV, the NumPy reference and itself."""

from types import SimpleNamespace

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import FLOAT32_TOLERANCES, double, on_device, vectors
from hypothesis import given

from jaxmocap.geometry import cameras

MATRIX = np.array([[1680.0, 0, 540], [0, 1675, 960], [0, 0, 1]])
ROTATION, TRANSLATION = np.array([1.3, -0.4, 0.6]), np.array([0.1, -0.2, 4.0])
DISTORTION = np.array([-0.12, 0.08, 1e-3, -2e-3, 0.02, 0.05, -0.03, 0.01])
PROJECT, RAYS = jax.jit(cameras.project), jax.jit(cameras.pixel_rays)


def camera(distortion=DISTORTION) -> cameras.Camera:
    return cameras.Camera.create((1080, 1920), MATRIX, distortion, ROTATION, TRANSLATION)


def plain(ours):
    """What the reference takes: the same numbers, without JAX."""
    return SimpleNamespace(**{key: np.asarray(part) for key, part in vars(ours).items()})


def scattered(count=40):
    """World points in front of the camera, some at the picture's edge."""
    return np.random.default_rng(3).uniform(-1, 1, (count, 3)) * [0.9, 0.9, 0.9]


@pytest.mark.parametrize("coefficients", [0, 4, 5, 8])
def test_projection_is_opencvs(coefficients):
    points, distortion = scattered(), DISTORTION[:coefficients]
    expected, _ = cv2.projectPoints(points, ROTATION, TRANSLATION, MATRIX, distortion)
    with double():
        pixels = PROJECT(camera(distortion), on_device(points))
    np.testing.assert_allclose(pixels, expected[:, 0], rtol=1e-9, atol=1e-9)


def test_float32_stays_within_its_tolerances():
    points = scattered()
    with double():
        expected = np.asarray(PROJECT(camera(), on_device(points)))
        expected_rays = np.asarray(RAYS(camera(), on_device(expected)))
    pixels = PROJECT(camera(), on_device(points))
    assert pixels.dtype == jnp.float32
    assert np.abs(pixels - expected).max() < FLOAT32_TOLERANCES["pixels"]
    rays = RAYS(camera(), on_device(expected))
    assert np.abs(rays - expected_rays).max() < FLOAT32_TOLERANCES["rays"]


@given(point=vectors(3, 0.8))
def test_the_ray_through_a_points_pixel_meets_the_point(point):
    with double():
        eye = np.asarray(camera().position_world)
        pixel = PROJECT(camera(), on_device(point[None]))
        ray = np.asarray(RAYS(camera(), pixel))[0]
    assert np.linalg.norm(ray) == pytest.approx(1, abs=1e-12)
    along = np.dot(point - eye, ray)
    assert along > 0
    # A tenth of a millimetre, four metres away: a fiftieth of a pixel.
    assert np.linalg.norm(eye + along * ray - point) < 1e-4


def test_the_centre_of_projection_is_the_origin_of_the_camera_frame():
    with double():
        eye = camera().position_world
        np.testing.assert_allclose(
            cameras.to_camera(camera(), eye[None]), np.zeros((1, 3)), atol=1e-12
        )


@pytest.mark.parametrize("depth", [-3.0, -1e-3, 0.0, 1e-6, 0.05, 2.0])
def test_behind_the_camera_pixels_and_gradients_are_finite(depth):
    single = camera()
    R, t = np.asarray(single.T_cam_world)[:3, :3], np.asarray(single.T_cam_world)[:3, 3]
    for aside in (0.0, 0.4):
        point = on_device(R.T @ (np.array([aside, 0.1, depth]) - t))
        assert np.isfinite(PROJECT(single, point)).all()
        gradient = jax.jit(jax.jacrev(cameras.project, argnums=(0, 1)))(single, point)
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))
        assert (cameras.to_camera(single, point)[2] <= 0) == (depth <= 0) or abs(depth) < 1e-5


def test_a_rotation_may_come_as_a_vector_or_as_a_matrix():
    as_matrix, _ = cv2.Rodrigues(ROTATION)
    other = cameras.Camera.create((1080, 1920), MATRIX, DISTORTION, as_matrix, TRANSLATION)
    np.testing.assert_allclose(other.T_cam_world, camera().T_cam_world, atol=1e-6)


def test_more_than_eight_coefficients_are_refused():
    with pytest.raises(ValueError, match="at most 8 distortion coefficients, found 12"):
        cameras.Camera.create((640, 480), MATRIX, np.zeros(12))
