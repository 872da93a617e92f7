"""Lenses: a fisheye against OpenCV and the NumPy reference, and what both kinds promise."""

from functools import partial

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double, on_device

from jaxmocap.geometry import cameras
from jaxmocap.geometry.lenses import BROWN_CONRADY, FISHEYE, LENSES

MATRIX = np.array([[420.0, 0, 655], [0, 418, 470], [0, 0, 1]])
ROTATION, TRANSLATION = np.array([1.3, -0.4, 0.6]), np.array([0.1, -0.2, 1.5])
FISHEYE_K = np.array([0.05, -0.02, 0.004, -0.0008])
BROWN_K = np.array([-0.12, 0.08, 1e-3, -2e-3, 0.02, 0.05, -0.03, 0.01])
COEFFICIENTS = {BROWN_CONRADY: BROWN_K, FISHEYE: FISHEYE_K}
PROJECT, RAYS = jax.jit(cameras.project), jax.jit(cameras.pixel_rays)


def camera(lens=FISHEYE):
    given = COEFFICIENTS[lens]
    return cameras.Camera.create((1280, 960), MATRIX, given, ROTATION, TRANSLATION, lens)


def wide(count=60):
    """World points up to 75 degrees away from the fisheye's axis, one of them upon it."""
    rng = np.random.default_rng(5)
    angle, azimuth = np.radians(rng.uniform(0, 75, count)), rng.uniform(-np.pi, np.pi, count)
    angle[0] = 0.0
    along = np.sin(angle)
    ways = np.stack([along * np.cos(azimuth), along * np.sin(azimuth), np.cos(angle)], -1)
    points_cam = rng.uniform(0.8, 4.0, (count, 1)) * ways
    R, _ = cv2.Rodrigues(ROTATION)
    return (points_cam - TRANSLATION) @ R


def test_a_fisheye_projects_as_opencvs():
    points = wide()
    pose = ROTATION.reshape(3, 1), TRANSLATION.reshape(3, 1)
    expected, _ = cv2.fisheye.projectPoints(points[:, None], *pose, MATRIX, FISHEYE_K)
    with double():
        pixels = PROJECT(camera(), on_device(points))
    np.testing.assert_allclose(pixels, expected[:, 0], rtol=1e-9, atol=1e-9)


def test_a_fisheyes_distortion_is_undone_as_by_opencv():
    pixels = np.random.default_rng(1).uniform([0, 0], [1280, 960], (50, 2))
    expected = cv2.fisheye.undistortPoints(pixels[:, None], MATRIX, FISHEYE_K)[:, 0]
    with double():
        ours = jnp.stack(cameras.plane_components(camera(), *on_device(pixels.T)), -1)
    # OpenCV stops its own iteration at 1e-8.
    np.testing.assert_allclose(ours, expected, rtol=1e-6, atol=1e-7)


def test_the_ray_through_a_pixel_meets_the_point():
    points = wide()
    with double():
        eye = np.asarray(camera().position_world)
        rays = np.asarray(RAYS(camera(), PROJECT(camera(), on_device(points))))
    off = np.cross(points - eye, rays)
    assert np.abs(off).max() < 1e-9


def test_float32_is_a_thousandth_of_a_pixel():
    points = wide()
    with double():
        expected = np.asarray(PROJECT(camera(), on_device(points)))
    pixels = PROJECT(camera(), on_device(points))
    assert pixels.dtype == jnp.float32
    assert np.abs(pixels - expected).max() < 1e-3


@jax.jit
def shown_at(one, point):
    """A point's pixel, its Jacobian, and the gradients of both."""
    both = cameras.project, cameras.projection_jacobian
    values = [function(one, point) for function in both]
    return values, [jax.jacrev(function, argnums=(0, 1))(one, point) for function in both]


@jax.jit
def ray_of(one, pixel):
    """The ray through a pixel, and its gradient."""
    return cameras.pixel_rays(one, pixel), jax.jacrev(cameras.pixel_rays, 1)(one, pixel)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("depth", [-3.0, 0.0, 1e-6, 0.05, 2.0])
@pytest.mark.parametrize("aside", [0.0, 0.4])
def test_pixels_rays_and_gradients_are_finite_everywhere(lens, depth, aside):
    one = camera(lens)
    R, t = np.asarray(one.T_cam_world)[:3, :3], np.asarray(one.T_cam_world)[:3, 3]
    point = on_device(R.T @ (np.array([aside, 0.0, depth]) - t))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(shown_at(one, point)))
    # Far beyond the image, and in its very middle.
    for pixel in (np.array([4000.0, -900.0]), MATRIX[:2, 2]):
        rays, gradient = ray_of(one, on_device(pixel))
        assert np.isfinite(rays).all()
        assert np.isfinite(gradient).all() or lens == BROWN_CONRADY


@pytest.mark.parametrize("lens", LENSES)
def test_the_projections_jacobian_is_its_derivative(lens):
    points = wide(8) if lens == FISHEYE else np.random.default_rng(3).uniform(-0.2, 0.2, (8, 3))
    with double():
        # Derivatives leave an ordinary lens's mild distortion out, and have one focal length.
        even = np.array([[419.0, 0, 655], [0, 419, 470], [0, 0, 1]])
        given = FISHEYE_K if lens == FISHEYE else ()
        one = cameras.Camera.create((1280, 960), even, given, ROTATION, TRANSLATION, lens)
        expected = jax.vmap(jax.jacfwd(partial(cameras.project, one)))(on_device(points))
        actual = cameras.projection_jacobian(one, on_device(points))
    np.testing.assert_allclose(actual, expected, rtol=1e-9, atol=1e-9)


def test_small_discs_keep_the_area_that_a_fisheye_shows_of_them():
    with double():
        one, radius = camera(), 1e-4
        at = on_device(np.array([1.1, -0.7]))
        around = np.linspace(0, 2 * np.pi, 400, endpoint=False)
        rim = np.asarray(at) + radius * np.stack([np.cos(around), np.sin(around)], -1)
        x, y = np.asarray(cameras.to_pixels(one, on_device(rim))).T
        shown = float(cameras.radii_in_pixels(one, at, jnp.asarray(radius)))
    area = abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2
    assert np.pi * shown**2 == pytest.approx(area, rel=5e-3)


def test_an_outlines_normal_stays_square_to_it_in_a_fisheyes_image():
    at, along = np.array([1.1, -0.7]), np.array([0.8, 0.6])
    with double():
        one = camera()
        move = jax.jvp(partial(cameras.to_pixels, one), (on_device(at),), (on_device(along),))[1]
        normal = cameras.normals_in_pixels(
            one, tuple(on_device(at)), *on_device(np.array([-0.6, 0.8]))
        )
    cosine = np.dot(move, normal) / np.linalg.norm(move) / np.linalg.norm(normal)
    # Both focal lengths are taken as one; without the lens it would be 0.6.
    assert abs(cosine) < 0.01


@pytest.mark.parametrize("lens", LENSES)
def test_numpy_and_jax_agree(lens):
    points = np.random.default_rng(4).uniform(-0.3, 0.3, (9, 2))
    with double():
        one, host = camera(lens), cameras.on_host(camera(lens))
        pixels = np.stack(cameras.pixel_components(host, *points.T), -1)
        assert type(pixels) is np.ndarray
        np.testing.assert_allclose(cameras.to_pixels(one, on_device(points)), pixels, rtol=1e-12)
    back = np.stack(cameras.plane_components(host, *pixels.T, iterations=30), -1)
    np.testing.assert_allclose(back, points, atol=1e-12)


def test_a_lens_is_static_and_its_numbers_are_traced():
    traces = []

    @jax.jit
    def pixel(one):
        traces.append(one.lens)
        return cameras.project(one, jnp.zeros(3))

    pixel(camera())
    pixel(cameras.Camera.create((640, 480), MATRIX, FISHEYE_K / 2, ROTATION, TRANSLATION, FISHEYE))
    pixel(camera(BROWN_CONRADY))
    assert traces == [FISHEYE, BROWN_CONRADY]


def test_a_fisheye_has_four_coefficients_at_most():
    with pytest.raises(ValueError, match="at most 4 distortion coefficients, found 5"):
        cameras.Camera.create((640, 480), MATRIX, np.zeros(5), lens=FISHEYE)


def test_lenses_of_several_kinds_are_not_stacked():
    with pytest.raises(ValueError, match="several kinds"):
        cameras.stack_cameras([camera(), camera(BROWN_CONRADY)])
