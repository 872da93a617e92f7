"""Cameras and their lenses against OpenCV, in NumPy and JAX, and what every lens promises."""

from dataclasses import replace
from functools import partial

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import FLOAT32_TOLERANCES, double, on_device

from jaxmocap.geometry import cameras
from jaxmocap.geometry.lenses import BROWN_CONRADY, FISHEYE, LENSES

SIZE, MATRIX = (1280, 960), np.array([[420.0, 0, 655], [0, 418, 470], [0, 0, 1]])
ROTATION, TRANSLATION = np.array([1.3, -0.4, 0.6]), np.array([0.1, -0.2, 4.0])
BROWN_K = np.array([-0.12, 0.08, 1e-3, -2e-3, 0.02, 0.05, -0.03, 0.01])
FISHEYE_K = np.array([0.05, -0.02, 0.004, -0.0008])
COEFFICIENTS = {BROWN_CONRADY: BROWN_K, FISHEYE: FISHEYE_K}
# Degrees from the axis up to which points are looked at.
WIDEST = {BROWN_CONRADY: 35, FISHEYE: 75}
PROJECT, RAYS = jax.jit(cameras.project), jax.jit(cameras.pixel_rays)
TO_PIXELS, PLANE = jax.jit(cameras.to_pixels), jax.jit(cameras.plane_components)
SLOPES = jax.jit(cameras.projection_jacobian)


def camera(lens=FISHEYE, coefficients=None, matrix=MATRIX) -> cameras.Camera:
    k = COEFFICIENTS[lens] if coefficients is None else coefficients
    return cameras.Camera.create(SIZE, matrix, k, ROTATION, TRANSLATION, lens)


def in_view(lens, count=60):
    """World points away from the lens's axis as far as it shows, one of them upon it."""
    rng = np.random.default_rng(5)
    angle = np.radians(rng.uniform(0, WIDEST[lens], count))
    azimuth = rng.uniform(-np.pi, np.pi, count)
    angle[0] = 0.0
    along = np.sin(angle)
    ways = np.stack([along * np.cos(azimuth), along * np.sin(azimuth), np.cos(angle)], -1)
    points_cam = rng.uniform(0.8, 4.0, (count, 1)) * ways
    return (points_cam - TRANSLATION) @ cv2.Rodrigues(ROTATION)[0]


@pytest.mark.parametrize(
    ("lens", "coefficients"), [*((BROWN_CONRADY, n) for n in (0, 4, 5, 8)), (FISHEYE, 4)]
)
def test_projection_is_opencvs(lens, coefficients):
    points, k = in_view(lens), COEFFICIENTS[lens][:coefficients]
    pose = ROTATION.reshape(3, 1), TRANSLATION.reshape(3, 1)
    opencvs = cv2.fisheye.projectPoints if lens == FISHEYE else cv2.projectPoints
    expected = opencvs(points[:, None], *pose, MATRIX, k)[0].reshape(-1, 2)
    with double():
        pixels = PROJECT(camera(lens, k), on_device(points))
    np.testing.assert_allclose(pixels, expected, rtol=1e-9, atol=1e-9)


def test_a_fisheyes_distortion_is_undone_as_by_opencv():
    pixels = np.random.default_rng(1).uniform([0, 0], SIZE, (50, 2))
    expected = cv2.fisheye.undistortPoints(pixels[:, None], MATRIX, FISHEYE_K)[:, 0]
    with double():
        ours = np.stack(PLANE(camera(), *on_device(pixels.T)), -1)
    # OpenCV stops its own iteration at 1e-8.
    np.testing.assert_allclose(ours, expected, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("lens", LENSES)
def test_float32_stays_within_its_tolerances(lens):
    points = in_view(lens)
    with double():
        expected = np.asarray(PROJECT(camera(lens), on_device(points)))
        expected_rays = np.asarray(RAYS(camera(lens), on_device(expected)))
    pixels = PROJECT(camera(lens), on_device(points))
    assert pixels.dtype == jnp.float32
    assert np.abs(pixels - expected).max() < FLOAT32_TOLERANCES["pixels"]
    rays = RAYS(camera(lens), on_device(expected))
    assert np.abs(rays - expected_rays).max() < FLOAT32_TOLERANCES["rays"]


@pytest.mark.parametrize(("lens", "within"), [(BROWN_CONRADY, 1e-4), (FISHEYE, 1e-9)])
def test_the_ray_through_a_points_pixel_meets_the_point(lens, within):
    """An ordinary lens's to a tenth of a millimetre, four metres away."""
    points = in_view(lens)
    with double():
        eye = np.asarray(camera(lens).position_world)
        rays = np.asarray(RAYS(camera(lens), PROJECT(camera(lens), on_device(points))))
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1, atol=1e-12)
    along = np.sum((points - eye) * rays, 1, keepdims=True)
    assert (along > 0).all()
    assert np.linalg.norm(eye + along * rays - points, axis=1).max() < within


def test_the_centre_of_projection_is_the_origin_of_the_camera_frame():
    with double():
        eye = camera().position_world
        np.testing.assert_allclose(cameras.to_camera(camera(), eye), np.zeros(3), atol=1e-12)


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
@pytest.mark.parametrize("depth", [-3.0, -1e-3, 0.0, 1e-6, 0.05, 2.0])
@pytest.mark.parametrize("aside", [0.0, 0.4])
def test_pixels_rays_and_gradients_are_finite_everywhere(lens, depth, aside):
    one = camera(lens)
    R, t = np.asarray(one.T_cam_world)[:3, :3], np.asarray(one.T_cam_world)[:3, 3]
    for up in (0.0, 0.1):
        point = on_device(R.T @ (np.array([aside, up, depth]) - t))
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(shown_at(one, point)))
        assert (cameras.to_camera(one, point)[2] <= 0) == (depth <= 0) or abs(depth) < 1e-5
    # Far beyond the image, and in its very middle.
    for pixel in (np.array([4000.0, -900.0]), MATRIX[:2, 2]):
        rays, gradient = ray_of(one, on_device(pixel))
        assert np.isfinite(rays).all()
        assert np.isfinite(gradient).all() or lens == BROWN_CONRADY


@pytest.mark.parametrize("lens", LENSES)
def test_the_projections_jacobian_is_its_derivative(lens):
    with double():
        # Derivatives leave an ordinary lens's mild distortion out, and have one focal length.
        even = np.array([[419.0, 0, 655], [0, 419, 470], [0, 0, 1]])
        one = camera(lens, FISHEYE_K if lens == FISHEYE else (), even)
        points = on_device(in_view(lens, 8))
        expected = jax.jit(jax.vmap(jax.jacfwd(partial(cameras.project, one))))(points)
        actual = SLOPES(one, points)
    np.testing.assert_allclose(actual, expected, rtol=1e-9, atol=1e-9)


def test_small_discs_keep_the_area_that_a_fisheye_shows_of_them():
    with double():
        one, radius = camera(), 1e-4
        at = on_device(np.array([1.1, -0.7]))
        around = np.linspace(0, 2 * np.pi, 400, endpoint=False)
        rim = np.asarray(at) + radius * np.stack([np.cos(around), np.sin(around)], -1)
        x, y = np.asarray(TO_PIXELS(one, on_device(rim))).T
        shown = float(cameras.radii_in_pixels(one, at, jnp.asarray(radius)))
    area = abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2
    assert np.pi * shown**2 == pytest.approx(area, rel=5e-3)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("wide", [1.0, 1.6])
def test_an_outlines_normal_stays_square_to_it_in_the_image(lens, wide):
    at, along = np.array([0.5, -0.3]), np.array([0.8, 0.6])
    with double():
        one = camera(lens)
        matrix = one.matrix.at[0, 0].mul(wide).at[0, 1].set(20.0)
        one = replace(one, matrix=matrix)
        move = jax.jvp(partial(cameras.to_pixels, one), (on_device(at),), (on_device(along),))[1]
        normal = cameras.normals_in_pixels(
            one, tuple(on_device(at)), *on_device(np.array([-0.6, 0.8]))
        )
    cosine = np.dot(move, normal) / np.linalg.norm(move) / np.linalg.norm(normal)
    assert abs(cosine) < 1e-9


def strong(k, focal):
    return cameras.Camera.create((1920, 1080), [[focal, 0, 960], [0, focal, 540], [0, 0, 1]], k)


@pytest.mark.parametrize(
    ("k", "focal"),
    [
        ((0.15, 0.1), 1000.0),
        ((-0.25,), 1500.0),
        ((-0.45, 0.3, 0, 0, -0.1), 1400.0),
        ((0.3, 0.5), 1000.0),
    ],
)
def test_strong_distortion_is_undone_at_the_corners(k, focal):
    host = cameras.on_host(strong(k, focal))
    corners = np.array([[0.0, 0], [1920, 0], [1920, 1080], [0, 1080], [960, 540]])
    plane = cameras.plane_components(host, *corners.T)
    back = np.stack(cameras.pixel_components(host, *plane), -1)
    np.testing.assert_allclose(back, corners, atol=1e-6)


def test_a_point_moves_in_the_image_as_its_derivative_has_it():
    """Wide, with pixels that are not square and a skew."""
    with double():
        one = strong((-0.3, 0.05, 1e-3, -2e-3), 1600.0)
        one = replace(one, matrix=one.matrix.at[0, 0].mul(0.8).at[0, 1].set(9.0))
        point = on_device(np.array([[0.9, 0.45, 2.0]]))
        expected = jax.jit(jax.jacfwd(partial(cameras.project, one)))(point)[0, :, 0]
        np.testing.assert_allclose(SLOPES(one, point)[0], expected, rtol=1e-9)


@pytest.mark.parametrize("lens", LENSES)
def test_numpy_and_jax_agree(lens):
    points = np.random.default_rng(4).uniform(-0.3, 0.3, (9, 2))
    with double():
        one, host = camera(lens), cameras.on_host(camera(lens))
        pixels = np.stack(cameras.pixel_components(host, *points.T), -1)
        assert type(pixels) is np.ndarray
        np.testing.assert_allclose(TO_PIXELS(one, on_device(points)), pixels, rtol=1e-12)
    back = np.stack(cameras.plane_components(host, *pixels.T), -1)
    np.testing.assert_allclose(back, points, atol=1e-12)


def test_a_lens_is_static_and_its_numbers_are_traced():
    traces = []

    @jax.jit
    def pixel(one):
        traces.append(one.lens)
        return cameras.project(one, jnp.zeros(3))

    for one in (camera(), camera(FISHEYE, FISHEYE_K / 2), camera(BROWN_CONRADY)):
        pixel(one)
    assert traces == [FISHEYE, BROWN_CONRADY]


def test_a_rotation_may_come_as_a_vector_or_as_a_matrix():
    as_matrix, _ = cv2.Rodrigues(ROTATION)
    other = cameras.Camera.create(SIZE, MATRIX, BROWN_K, as_matrix, TRANSLATION)
    np.testing.assert_allclose(other.T_cam_world, camera().T_cam_world, atol=1e-6)


@pytest.mark.parametrize(("lens", "most", "found"), [(BROWN_CONRADY, 8, 12), (FISHEYE, 4, 5)])
def test_more_coefficients_than_a_lens_has_are_refused(lens, most, found):
    sentence = f"at most {most} distortion coefficients, found {found}"
    with pytest.raises(ValueError, match=sentence):
        camera(lens, np.zeros(found))


def test_lenses_of_several_kinds_are_not_stacked():
    with pytest.raises(ValueError, match="several kinds"):
        cameras.stack_cameras([camera(), camera(BROWN_CONRADY)])
