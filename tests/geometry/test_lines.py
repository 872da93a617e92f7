"""Lines: how far points are from them, rays through pixels."""

import jax
import numpy as np
from conftest import double, on_device

from jaxmocap.geometry import lines
from jaxmocap.geometry.cameras import Camera, project

PROJECT, LINES = jax.jit(project), jax.jit(lines.camera_lines)


def test_a_point_on_its_line_has_no_residual_and_any_other_its_perpendicular():
    rng = np.random.default_rng(1)
    x, n, away = rng.normal(size=(3, 50, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    away -= np.sum(away * n, 1, keepdims=True) * n
    with double():
        through = lines.lines_through(*on_device((x, n)))
        np.testing.assert_allclose(lines.incidence(through, on_device(x + 3 * n)), 0, atol=1e-14)
        far = on_device(x - 2 * n + away)
        np.testing.assert_allclose(lines.perpendiculars(through, far), away, atol=1e-14)


def test_a_pixels_ray_meets_the_point_that_it_shows():
    """Through a lens that distorts, for a turned and shifted camera."""
    matrix = np.array([[900.0, 0, 330], [0, 880, 250], [0, 0, 1]])
    lens = [-0.2, 0.06, 1e-3, -2e-3, 0.01]
    points = np.random.default_rng(2).uniform(-0.8, 0.8, (40, 3))
    with double():
        camera = Camera.create((640, 480), matrix, lens, [1.2, -0.4, 0.3], [0.1, 0.2, 4.0])
        rays = LINES(camera, PROJECT(camera, on_device(points)))
        assert np.abs(lines.perpendiculars(rays, on_device(points))).max() < 1e-6
