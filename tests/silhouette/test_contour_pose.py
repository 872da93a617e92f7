"""Pose of a rigid object by its contour: descriptors, the linear system, given poses, limits."""

import doctest

import jax
import numpy as np
import pytest
from conftest import double, on_device
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from bench.contour_pose import (
    Trial,
    camera_at,
    drawn_outline,
    errors,
    errors_of,
    partly_hidden,
    posed_start,
    random_curve,
    trial,
    with_wrong_pixels,
)
from jaxmocap.geometry import twists
from jaxmocap.geometry.cameras import project, stack_cameras
from jaxmocap.geometry.fourier import fourier_series, phase_vectors
from jaxmocap.geometry.lines import incidence, lines_through
from jaxmocap.silhouette import (
    ContourPoseSettings,
    RigidSurface,
    contour_pose,
    contour_step,
    solve_contour_pose,
)
from jaxmocap.solvers.status import Status

USUAL, WHOLE = ContourPoseSettings(), ContourPoseSettings(harmonics=())
CAMERAS = [camera_at(0.8 * k) for k in range(4)]
LINEARISED = jax.jit(contour_step.linearise_pairs)
NEAREST, INCIDENCE = jax.jit(contour_step.nearest_points), jax.jit(incidence)
ALL_COUNT = USUAL._replace(reach=np.inf)
OFF = jax.jit(jax.vmap(lambda lines, x, xi: incidence(lines, twists.move(twists.exp(xi), x)),
                       (None, None, 0)))  # fmt: skip
PHASES = 2 * np.pi * np.arange(240) / 240


@pytest.mark.parametrize("count", [40, 41])
def test_a_curve_s_descriptors_are_the_transform_as_printed(count):
    points = np.random.default_rng(0).normal(size=(count, 3))
    half, n = count // 2, np.arange(count)
    vectors = phase_vectors(points)
    printed = [np.exp(-2j * np.pi * k * n / count) @ points / count for k in range(half)]
    np.testing.assert_allclose(vectors[:half], printed, atol=1e-12)
    # (3.15): from -N to N, in samples of the curve.
    both = np.concatenate([vectors[:0:-1].conj(), vectors])
    waves = np.exp(2j * np.pi * np.outer(n, np.arange(-half, half + 1)) / count)
    back = waves @ both
    np.testing.assert_allclose(back, points, atol=1e-10)
    np.testing.assert_allclose(fourier_series(vectors, 2 * np.pi * n / count), points, atol=1e-10)


def test_a_low_pass_curve_is_the_nearest_of_its_frequencies():
    points = np.random.default_rng(1).normal(size=(64, 3))
    phases = 2 * np.pi * np.arange(64) / 64
    low = fourier_series(phase_vectors(points), phases, 3)
    waves = np.concatenate(
        [np.ones((64, 1))] + [f(k * phases)[:, None] for k in (1, 2, 3) for f in (np.cos, np.sin)],
        1,
    )
    np.testing.assert_allclose(low, waves @ np.linalg.lstsq(waves, points)[0], atol=1e-12)


def test_the_system_is_the_derivative_of_the_incidence_equation():
    """(3.12) against differences of (3.11), in full and with pairs that may slide along."""
    rng = np.random.default_rng(2)
    x, at, n, along = rng.normal(size=(4, 20, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    with double():
        lines, x = lines_through(*on_device((at, n))), on_device(x)
        A, b = LINEARISED(x, on_device(along), lines, on_device(1.0))
        steps = 1e-6 * np.concatenate([np.eye(6), -np.eye(6)])
        off = np.asarray(OFF(lines, x, on_device(steps)))
        residuals = np.asarray(INCIDENCE(lines, x))
        sliding, b_sliding = LINEARISED(x, on_device(along), lines, on_device(0.0))
    slopes = np.moveaxis(off[:6] - off[6:], 0, -1) / 2e-6
    np.testing.assert_allclose(A, slopes, atol=1e-8)
    np.testing.assert_allclose(b, -residuals, atol=1e-12)
    way = np.cross(along, n)
    np.testing.assert_allclose(np.sum(np.asarray(b_sliding) * way, 1), 0, atol=1e-12)
    np.testing.assert_allclose(np.sum(np.asarray(sliding) * way[..., None], 1), 0, atol=1e-12)


def test_the_nearest_point_lies_between_samples():
    """Of a circle, of which a dense one has a point as near."""
    phases = 2 * np.pi * np.arange(16) / 16
    ring = np.stack([np.cos(phases), np.sin(phases), 0 * phases], 1)
    dense = np.linspace(ring, np.roll(ring, -1, 0), 400).reshape(-1, 3)
    rng = np.random.default_rng(3)
    n = rng.normal(size=(1, 30, 3))
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    with double():
        lines = lines_through(*on_device((rng.normal(size=(1, 30, 3)), n)))
        points, _ = NEAREST(lines, contour_step.contour_of_wire(*on_device((ring, np.eye(4))), 1))
        near = np.linalg.norm(np.asarray(INCIDENCE(lines, points)), axis=-1)[0]
        every = np.linalg.norm(
            np.cross(dense[None], np.asarray(lines.directions)[0][:, None])
            - np.asarray(lines.moments)[0][:, None],
            axis=-1,
        ).min(1)
    np.testing.assert_allclose(near, every, atol=1e-4)


@pytest.mark.parametrize("number", [1, 4])
def test_a_known_pose_is_found_from_exact_and_from_noisy_outlines(number):
    """Half a pixel of noise at 6 pixels a centimetre: below a fifth of a degree and a millimetre
    across the view; one camera's depth is coarser."""
    off = [errors(CAMERAS[:number], trial(CAMERAS[:number], (k, 7), False, (20.0, 0.03)),
                  USUAL) for k in range(3)]  # fmt: skip
    assert np.max(off, 0)[0] < 0.3 and np.max(off, 0)[1] < (0.004 if number == 1 else 0.001)
    exact = trial(CAMERAS[:number], (0, 7), False, (20.0, 0.03))
    assert isinstance(exact.shape, np.ndarray)
    world = fourier_series(exact.shape, PHASES) @ exact.truth[:3, :3].T + exact.truth[:3, 3]
    outlines = [np.asarray(project(each, on_device(world))) for each in CAMERAS[:number]]
    there = errors(CAMERAS[:number], exact._replace(outlines=outlines), USUAL)
    assert there[0] < 0.05 and there[1] < 5e-4


def between_lobes(tilt: list[float], degrees: float) -> tuple[np.ndarray, np.ndarray]:
    """A pose (4, 4) at the origin, and a start turned about the object's axis."""
    truth, start = np.eye(4), np.eye(4)
    truth[:3, :3] = Rotation.from_euler("xyz", tilt).as_matrix()
    start[:3, :3] = truth[:3, :3] @ Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    return truth, start


@pytest.mark.parametrize(("depth", "degrees"), [(0.3, 30)])
def test_low_pass_curves_lead_to_the_right_one_of_seven_lobes(depth, degrees):
    """The whole curve alone is caught with its lobes between others."""
    radii = 0.15 * (1 + depth * np.cos(7 * PHASES))
    height = 0.03 * np.sin(2 * PHASES)
    flower = np.stack([1.3 * radii * np.cos(PHASES), radii * np.sin(PHASES), height], 1)
    truth, start = between_lobes([0.3, 0.4, 0], degrees)
    outlines = [
        np.asarray(project(each, on_device(flower @ truth[:3, :3].T))) for each in CAMERAS[:2]
    ]
    each = Trial(phase_vectors(flower), outlines, truth, start)
    low, whole = (errors(CAMERAS[:2], each, how) for how in (USUAL, WHOLE))
    assert low[0] < 0.1 and low[1] < 5e-4
    assert whole[0] > 20


def test_half_an_outline_does_where_only_rays_look_for_points():
    """An object that is hidden in part: the curve's hidden points would be drawn to what is not."""
    each = trial(CAMERAS[:2], (3, 3), False, (10.0, 0.01))
    half = each._replace(outlines=[outline[:120] for outline in each.outlines])
    one, both = (errors(CAMERAS[:2], half, WHOLE._replace(both_ways=way)) for way in (False, True))
    assert one[0] < 0.5 and one[1] < 0.002
    assert both[0] > 2 * one[0]


def test_a_camera_that_shows_nothing_of_it_counts_for_nothing():
    each = trial(CAMERAS[:2], (4, 4), False, (10.0, 0.01))
    found = solve_contour_pose(
        each.shape, CAMERAS[:2], [each.outlines[0], np.empty((0, 2))], each.start
    )
    alone = solve_contour_pose(each.shape, CAMERAS[:1], each.outlines[:1], each.start)
    np.testing.assert_allclose(found.T_world_object, alone.T_world_object, atol=1e-4)
    assert [len(off) for off in found.distances] == [128, 0]
    assert found.status == Status.CONVERGED


def test_a_circle_keeps_the_turn_about_its_axis_that_nothing_shows():
    ring = 0.1 * np.stack([np.cos(PHASES), np.sin(PHASES), 0 * PHASES], 1)
    truth = Rotation.from_euler("xy", [0.3, 0.2]).as_matrix()
    outlines = [np.asarray(project(each, on_device(ring @ truth.T))) for each in CAMERAS[:2]]
    found = solve_contour_pose(phase_vectors(ring), CAMERAS[:2], outlines, np.eye(4))
    R = found.T_world_object[:3, :3]
    np.testing.assert_allclose(R[:, 2], truth[:, 2], atol=2e-3)
    assert abs(np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1])) < 0.1


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"shape": np.zeros((5, 2))}, r"descriptors \(5, 2\), expected \(N \+ 1, 3\)"),
        ({"outlines": [np.zeros((9, 2))]}, "1 outlines, expected one of each of the 2 cameras"),
        ({"outlines": [np.zeros((9, 2)), np.zeros((9, 3))]}, r"outline 1 \(9, 3\), expected"),
        ({"outlines": [np.zeros((0, 2))] * 2}, "no pixel"),
        ({"start": np.eye(3)}, r"start \(3, 3\), expected \(4, 4\)"),
    ],
)
def test_other_shapes_are_named(change, says):
    given = {
        "shape": random_curve(np.random.default_rng(0), False),
        "cameras": CAMERAS[:2],
        "outlines": [np.zeros((9, 2))] * 2,
        "start": np.eye(4),
    }
    with pytest.raises(ValueError, match=says):
        solve_contour_pose(**given | change)


def ellipsoid(axes: np.ndarray) -> np.ndarray:
    theta, phi = np.linspace(0, np.pi, 40)[:, None], 2 * np.pi * np.arange(60) / 60
    unit = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi
    return axes * np.stack(unit, -1)


AXES = np.array([0.1, 0.15, 0.22])
ELLIPSOID = RigidSurface(ellipsoid(AXES))


def exact_outline(camera, axes, T) -> np.ndarray:
    """Of an ellipsoid: the plane of the points where rays touch it is the pole's polar."""
    R, shift = T[:3, :3], T[:3, 3]
    eye = (np.asarray(camera.position_world) - shift) @ R / axes
    squared = eye @ eye
    _, _, (_, x, y) = np.linalg.svd(eye[None])
    ring = np.cos(PHASES)[:, None] * x + np.sin(PHASES)[:, None] * y
    rim = eye / squared + np.sqrt(1 - 1 / squared) * ring
    return np.asarray(project(camera, on_device((axes * rim) @ R.T + shift)))


def ellipsoid_trial(seed: int, off: tuple[float, float]) -> Trial:
    truth, start = posed_start(np.random.default_rng([seed, 11]), off)
    outlines = [exact_outline(camera, AXES, truth) for camera in CAMERAS[:2]]
    return Trial(ELLIPSOID, outlines, truth, start)


@pytest.mark.parametrize("seed", range(2))
def test_a_surface_s_pose_is_found_from_exact_outlines_of_two_cameras(seed):
    """Half a degree at 15 cm is a pixel."""
    off = errors(CAMERAS[:2], ellipsoid_trial(seed, (20.0, 0.03)), USUAL)
    assert off[0] < 0.4 and off[1] < 2e-4


def test_the_rim_lies_on_the_exact_outline():
    each = ellipsoid_trial(0, (0.0, 0.0))
    rim = ELLIPSOID.rim(on_device(each.truth), stack_cameras(CAMERAS[:2]))
    for camera in range(2):
        fine = each.outlines[camera]
        fine = np.linspace(fine, np.roll(fine, -1, 0), 50, axis=1).reshape(-1, 2)
        near = KDTree(fine).query(rim.pixels_xy[camera][rim.valid[camera]])[0]
        assert np.median(near) < 0.1 and near.max() < 0.3


def test_a_surface_is_found_with_a_fifth_of_wrong_pixels_and_they_are_told():
    each = ellipsoid_trial(1, (15.0, 0.02))
    wrong = with_wrong_pixels(each, 1)
    found = solve_contour_pose(ELLIPSOID, CAMERAS[:2], wrong.outlines, each.start)
    alone, all_count = errors_of(found, wrong), errors(CAMERAS[:2], wrong, ALL_COUNT)
    assert alone[0] < 0.5 and alone[1] < 1e-3
    assert all_count[0] > 5 * alone[0]
    for ours, theirs, shares in zip(each.outlines, wrong.outlines, found.shares, strict=True):
        chosen = np.arange(128) * len(ours) // 128
        moved = np.linalg.norm(ours - theirs, axis=1)[chosen]
        assert (shares[moved == 0] > 0.9).all()
        # Some of the wrong ones lie on the outline by chance.
        assert np.mean(shares[moved > 0] < 0.1) > 0.7


def test_a_curve_is_found_with_a_fifth_of_wrong_pixels():
    wrong = with_wrong_pixels(trial(CAMERAS[:2], (1, 2), False, (15.0, 0.02)), 1)
    alone, all_count = (errors(CAMERAS[:2], wrong, how) for how in (USUAL, ALL_COUNT))
    assert alone[0] < 0.5 and alone[1] < 1e-3
    assert all_count[0] > 2 * alone[0]


def test_a_surface_is_found_where_another_thing_hides_a_part_of_its_outline():
    hidden = partly_hidden(ellipsoid_trial(2, (10.0, 0.02)), 2)
    alone, all_count = (errors(CAMERAS[:2], hidden, how) for how in (USUAL, ALL_COUNT))
    assert alone[0] < 1.5 and alone[1] < 2e-3
    assert all_count[0] > 5 * alone[0]


def test_low_pass_surfaces_lead_to_the_right_one_of_seven_lobes():
    """A star of seven arms turned to between two of them; all frequencies stay there."""
    grid = ellipsoid(np.array([0.2, 0.15, 0.06]))
    grid[..., :2] *= (1 + 0.3 * np.cos(7 * 2 * np.pi * np.arange(60) / 60))[None, :, None]
    truth, start = between_lobes([0.9, 0.6, 0], 30)
    outlines = [drawn_outline(each, grid @ truth[:3, :3].T) for each in CAMERAS[:2]]
    each = Trial(RigidSurface(grid), outlines, truth, start)
    low, whole = (errors(CAMERAS[:2], each, how) for how in (USUAL, WHOLE))
    assert low[0] < 1 and low[1] < 1e-3
    assert whole[0] > 10


def test_a_surface_s_step_is_traced_once_for_all_cycles():
    contour_pose._move_pose._clear_cache()  # type: ignore[attr-defined]
    errors(CAMERAS[:2], ellipsoid_trial(0, (10.0, 0.02)), USUAL)
    assert contour_pose._move_pose._cache_size() == 1  # type: ignore[attr-defined]


def test_another_grid_or_harmonics_that_a_surface_lacks_are_named():
    with pytest.raises(ValueError, match=r"grid \(5, 3\), expected \(V, U, 3\)"):
        RigidSurface(np.zeros((5, 3)))
    with pytest.raises(
        ValueError, match=r"harmonics \[3\], expected of the surface's \(1, 2, 4, 8\)"
    ):
        solve_contour_pose(
            ELLIPSOID, CAMERAS[:1], [np.zeros((9, 2))], np.eye(4), USUAL._replace(harmonics=(1, 3))
        )


def test_the_examples_do_what_they_say():
    assert doctest.testmod(contour_pose) == (0, 26)
