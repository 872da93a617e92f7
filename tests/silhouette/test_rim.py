"""The rim of the surface: index image, outlines, limbs before the trunk."""

from dataclasses import replace

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from references import surfaces as naive
from scipy.spatial import KDTree
from test_point_rays import ring

from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import difference, relaxed_pose, retract
from jaxmocap.body.skeleton import Skeleton, with_joints
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.loft import generic_surface
from jaxmocap.body.surfaces.surface import pose_points, skin_nodes, skin_of
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.geometry.cameras import project, stack_cameras
from jaxmocap.images.regions import Region
from jaxmocap.silhouette.fit.correspond import (
    Contour,
    ContourPairs,
    match_pairs,
    pairs_of,
)
from jaxmocap.silhouette.points import contour_rays
from jaxmocap.silhouette.pose import PoseSettings, Prior, solve_pose
from jaxmocap.silhouette.surfaces.body_shape import FULL
from jaxmocap.silhouette.surfaces.index_image import (
    body_mask,
    index_image,
    inner_boundary,
    node_keys,
    nodes_at,
    outer_boundary,
    trace_boundary,
)
from jaxmocap.silhouette.surfaces.rim import Rim, RimFinder, RimSettings

BODY = with_joints(Skeleton.human(1.75, proportions="winter"), "whole.toml")
CAMERAS = stack_cameras(ring(4))
SETTINGS = RimSettings(size=128, outer=200, inner=40, spacing=0.012, margin=0.06)
# An arm before the chest for one of the cameras, and behind it for another.
FOLDED = {"arm_flex_l": 60, "elbow_flex_l": 100, "arm_rot_l": 60, "arm_abduct_r": 60}
POSED, PROJECT = jax.jit(pose_points), jax.jit(jax.vmap(project, (0, None)))
FORWARD, SKINNED, KEYS = jax.jit(forward), jax.jit(skin_nodes), jax.jit(node_keys, static_argnums=3)
RAYS = jax.jit(contour_rays)


def bent(**degrees: float):
    pose = relaxed_pose(BODY)
    angles = np.array(pose.angles)
    for name, angle in degrees.items():
        angles[BODY.tree.joint(name)] = np.radians(angle)
    return pose._replace(angles=jnp.asarray(angles))


@pytest.fixture(scope="module")
def finder() -> RimFinder:
    return RimFinder(BODY, generic_surface(BODY), SETTINGS)


@pytest.fixture(scope="module")
def rim(finder) -> Rim:
    return finder.find(finder.initial_shape, bent(**FOLDED), CAMERAS)


def filled(finder, pose, camera: int, scale: float, origin, size: int) -> np.ndarray:
    """OpenCV's drawing of all faces of the surface on a canvas: an independent rasteriser."""
    nodes = POSED(FORWARD(BODY, pose), finder.initial_shape.surface.points)
    pixels = np.asarray(PROJECT(CAMERAS, nodes))[camera]
    cells = ((pixels - origin) / scale - 0.5) * 16
    mask = np.zeros((size, size), np.uint8)
    for patch in finder.initial_shape.surface.patches:
        grid = cells[patch.nodes].reshape(patch.along, patch.around, 2)
        beside = np.roll(grid, -1, 1)
        faces = np.stack([grid[:-1], beside[:-1], beside[1:], grid[1:]], 2).reshape(-1, 4, 2)
        for face in np.round(faces).astype(np.int32):
            cv2.fillConvexPoly(mask, face, 1, shift=4)
    return mask


def test_many_nodes_are_posed_as_few_are(finder):
    skin = skin_of(finder.initial_shape.surface, rest_joints(BODY))
    frames = FORWARD(BODY, bent(**FOLDED))
    nodes = np.stack(SKINNED(frames, skin), -1)
    np.testing.assert_allclose(nodes, POSED(frames, finder.initial_shape.surface.points), atol=2e-5)


@given(seed=st.integers(0, 99))
def test_the_index_image_and_its_boundaries_are_the_naive_ones(seed):
    """A near and a far blob of nodes, with open cells between them, partly off the canvas."""
    rng = np.random.default_rng(seed)
    size = 24
    middles = rng.uniform(2, size - 2, (2, 2))
    x, y = (middles[:, i].repeat(150) + rng.normal(0, 3.5, 300) for i in range(2))
    depths = np.repeat([2.0, 3.0], 150) + rng.uniform(0, 0.01, 300)
    x, y, depths = (part.astype(np.float32) for part in (x, y, depths))
    places, keys = (np.asarray(part) for part in KEYS(x, y, depths, size))
    image = index_image(places, keys, size)
    nodes = naive.nearest_nodes(x, y, depths, size)
    # Nodes less than a depth step apart may change places.
    off = nodes_at(image) != nodes
    assert np.array_equal(nodes < 0, nodes_at(image) < 0)
    assert np.all(np.abs(depths[nodes_at(image)[off]] - depths[nodes[off]]) < 1e-3)
    mask = body_mask(image)
    inside = slice(1, -1)
    np.testing.assert_array_equal(mask[inside, inside], naive.body_mask(nodes)[inside, inside])
    outer = outer_boundary(image, mask)
    # Specks too small to have a tangent are left out, and cells all of whose tangents cancel.
    assert {tuple(cell) for cell in outer.cells.tolist()} <= naive.boundary_cells(mask)
    large = cv2.connectedComponentsWithStats(mask, connectivity=8)[2][1:, cv2.CC_STAT_AREA].max()
    if large > 60:
        assert len(outer.cells) > 0.5 * len(naive.boundary_cells(mask))


def test_steps_in_depth_are_found_cell_by_cell():
    """A near bar before a far square: the bar's long sides are inner boundaries."""
    size = 32
    y, x = (part.ravel() for part in np.mgrid[4:28, 4:28])
    bar = (x >= 12) & (x < 18)
    depths = np.where(bar, 2.0, 3.0).astype(np.float32)
    places, keys = (np.asarray(p) for p in KEYS(np.float32(x), np.float32(y), depths, size))
    image = index_image(places, keys, size)
    actual = inner_boundary(image, depths, 0.5)
    depth = np.full((size, size), np.inf)
    depth[y, x] = depths
    assert {tuple(cell) for cell in actual.cells.tolist()} == naive.step_cells(depth, 0.5)
    assert set(actual.cells[:, 0].tolist()) == {12, 17}
    assert np.all(bar[actual.nodes])
    np.testing.assert_array_equal(actual.normals[:, 0], np.where(actual.cells[:, 0] == 12, -1, 1))


def test_a_surface_that_recedes_is_no_boundary_and_another_limb_is():
    """Two limbs side by side; the left one recedes steeply in its middle."""
    size = 32
    y, x = (part.ravel() for part in np.mgrid[4:28, 4:28])
    depths = np.where(x < 10, 2.0, np.where(x < 18, 3.0, 4.0)).astype(np.float32)
    places, keys = (np.asarray(p) for p in KEYS(np.float32(x), np.float32(y), depths, size))
    limb = (x >= 18).astype(int)
    actual = inner_boundary(index_image(places, keys, size), depths, 0.5, limb)
    assert set(actual.cells[:, 0].tolist()) == {17}
    assert len(actual.cells) == 24


def test_the_mask_is_what_opencv_fills(finder, rim):
    for camera in range(4):
        origin, scale = rim.region.origin[camera], rim.region.scale[camera]
        theirs = filled(finder, bent(**FOLDED), camera, scale, origin, SETTINGS.size).astype(bool)
        ours = rim.masks[camera].astype(bool)
        assert (ours & theirs).sum() / (ours | theirs).sum() > 0.97


def test_rim_points_lie_on_the_outline_within_a_fraction_of_a_cell(finder, rim):
    """Against OpenCV's outline of the same faces, four times as fine."""
    for camera in (0, 2):
        origin, scale = rim.region.origin[camera], rim.region.scale[camera]
        size = 4 * SETTINGS.size
        fine = filled(finder, bent(**FOLDED), camera, scale / 4, origin, size)
        chains = cv2.findContours(fine, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)[0]
        outline = (np.concatenate(chains)[:, 0] + 0.5) * (scale / 4) + origin
        outer = rim.valid[camera] & ~rim.inner[camera]
        away = KDTree(outline).query(rim.pixels_xy[camera][outer])[0]
        assert outer.sum() > 150
        assert np.median(away) < 0.35 * scale
        assert np.mean(away < scale) > 0.97


def projected_by(finder, pose, camera: int):
    """Columns, rows, depths, places and keys of all nodes, and the whole picture, of a camera."""
    every = finder._project(finder.initial_shape.skins[FULL], finder.morph, BODY, pose, CAMERAS)
    projected = jax.tree.map(lambda part: np.asarray(part)[camera], every)
    cells = (
        np.stack([projected.u, projected.v], 1) - projected.region.origin
    ) / projected.region.scale - 0.5
    return cells, projected


def test_a_bodys_outline_and_its_nodes_are_the_naive_ones(finder):
    cells, projected = projected_by(finder, bent(**FOLDED), 1)
    keys = index_image(projected.places, projected.keys, SETTINGS.size)
    ours = outer_boundary(keys, body_mask(keys))
    theirs = naive.outline(cells[:, 0], cells[:, 1], projected.depth, SETTINGS.size)
    assert len(ours.cells) > 0.95 * len(theirs) > 300
    nodes = np.array([theirs[tuple(cell)] for cell in ours.cells.tolist()])
    # A node may be another one where both are as near, to a step in depth, or on a cell's edge.
    apart = np.abs(projected.depth[nodes] - projected.depth[ours.nodes])
    assert np.mean(nodes == ours.nodes) > 0.9
    assert np.mean(apart < 1e-3) > 0.98


def test_what_the_rim_shows_no_limb_hides(finder, rim):
    """By rays against every triangle of the surface: self-occlusion, limbs before the trunk."""
    nodes = np.asarray(
        POSED(FORWARD(BODY, bent(**FOLDED)), finder.initial_shape.surface.points), float
    )
    triangles = []
    for patch in finder.initial_shape.surface.patches:
        grid = nodes[patch.nodes].reshape(patch.along, patch.around, 3)
        beside = np.roll(grid, -1, 1)
        for corners in ((grid[:-1], beside[:-1], beside[1:]), (grid[:-1], beside[1:], grid[1:])):
            triangles.append(np.stack(corners, 2).reshape(-1, 3, 3))
    faces = np.concatenate(triangles)
    for camera in (0, 2):
        T = np.linalg.inv(np.asarray(CAMERAS.T_cam_world[camera], float))
        shown = rim.nodes[camera][rim.valid[camera]][::8]
        covered = naive.hidden(T[:3, 3], nodes[shown], faces, 0.03)
        assert np.mean(covered) < 0.05
        every = naive.hidden(T[:3, 3], nodes[:: len(nodes) // 24], faces, 0.03)
        assert 0.1 < np.mean(every) < 0.9


def test_normals_point_out_of_the_body(rim):
    for camera in range(4):
        outer = rim.valid[camera] & ~rim.inner[camera]
        cells = (rim.pixels_xy[camera] - rim.region.origin[camera]) / rim.region.scale[camera] - 0.5
        normals_ = rim.normals[camera]
        np.testing.assert_allclose(np.linalg.norm(normals_[outer], axis=1), 1, atol=1e-5)
        for way, value in ((2.5, 0), (-2.5, 1)):
            column, row = np.round(cells + way * normals_)[outer].astype(int).T
            assert np.mean(rim.masks[camera][row, column] == value) > 0.9


def test_a_limb_before_the_trunk_has_an_inner_rim_and_one_behind_it_none(finder, rim):
    patches = finder.initial_shape.surface.patch_of()
    names = np.array([patch.name for patch in finder.initial_shape.surface.patches])
    arms = [
        (rim.valid[c] & rim.inner[c] & (names[patches[rim.nodes[c]]] == "arm_l")).sum()
        for c in range(4)
    ]
    # The camera ahead sees the forearm before the chest; to the one behind it is hidden.
    assert max(arms) > 15
    hidden = int(np.argmin(arms))
    assert arms[hidden] <= 3
    assert not rim.inner[:, : SETTINGS.outer].any()


def test_moving_bodies_and_cameras_are_traced_once(finder):
    rng = np.random.default_rng(1)
    finder.find(finder.initial_shape, relaxed_pose(BODY), CAMERAS)
    # Of this many cameras and others, by this finder and others of the same settings.
    compiled = finder._project.kinds
    for _ in range(5):
        step = rng.normal(0, 0.1, BODY.costs.shape).astype(np.float32)
        actual = finder.find(
            finder.initial_shape, retract(relaxed_pose(BODY), jnp.asarray(step)), CAMERAS
        )
        assert actual.valid[:, : SETTINGS.outer].mean() > 0.9
    other = finder.shape_of(BODY, finder.initial_shape.surface)
    assert finder.find(other, relaxed_pose(BODY), CAMERAS).valid.any()
    assert finder._project.kinds == compiled


def test_contour_normals_in_space_are_seen_as_in_the_image():
    (camera,) = ring(1)
    pixels = jnp.asarray([[100.0, 80.0], [320, 240], [500, 400]])
    ways = jnp.asarray([[1.0, 0.0], [0.6, 0.8], [0.0, -1.0]])
    lines, across = RAYS(camera, pixels, ways)
    np.testing.assert_allclose(jnp.sum(across * lines.directions, -1), 0, atol=1e-6)
    point = camera.position_world + 4 * lines.directions
    both = jnp.stack([point, point + 0.01 * across])
    moved = np.diff(np.asarray(PROJECT(stack_cameras([camera]), both))[0], axis=0)[0]
    moved = moved / np.linalg.norm(moved, axis=1, keepdims=True)
    assert np.all(np.sum(moved * np.asarray(ways), 1) > 0.99)


@pytest.mark.parametrize("moved", [(0.0, 0.0, 1.2), (0.0, 0.0, -1.2), (6.0, 0.0, 0.0)])
@pytest.mark.parametrize("distortion", [(0.0, 0.0), (-0.1, 0.02)])
def test_what_cameras_do_not_show_has_no_rim(finder, moved, distortion):
    """Partly beside the image, and behind a camera, where lenses' polynomials fold points back."""
    bent_lenses = [
        replace(camera, distortion=camera.distortion.at[:2].set(jnp.asarray(distortion)))
        for camera in ring(4)
    ]
    cameras, off = stack_cameras(bent_lenses), np.zeros(BODY.costs.shape, np.float32)
    off[:3] = moved
    shown = finder.find(
        finder.initial_shape, retract(relaxed_pose(BODY), jnp.asarray(off)), cameras
    )
    kept, size = shown.pixels_xy[shown.valid], np.asarray(cameras.size[0])
    assert 0 < shown.valid.mean() < 0.9
    assert (kept > -0.5).all() and (kept < size - 0.5).all()
    assert np.max(shown.region.scale) < 2000


# Contours to rims ---------------------------------------------------------------------------------


PAIRS, SOLVE = jax.jit(pairs_of), jax.jit(solve_pose)


def contour_of(phi: np.ndarray, origin: np.ndarray, scale: float) -> Contour:
    """The zero line of a level set (S, S), cells, to a fraction of a cell."""
    cells, normals = trace_boundary((phi > 0).astype(np.uint8))
    x, y = cells.T
    # The traced cells are the last within; the line lies beyond them by what phi says.
    slope_x, slope_y = (phi[y, x + 1] - phi[y, x - 1]) / 2, (phi[y + 1, x] - phi[y - 1, x]) / 2
    steepness = np.maximum(np.hypot(slope_x, slope_y), 0.2)
    beyond = np.clip(phi[y, x] / steepness, 0.0, 1.5)
    places = cells + beyond[:, None] * normals
    return Contour(origin + (places + 0.5) * scale, normals)


def level_set(finder, pose, camera: int, region: Region) -> np.ndarray:
    """Signed distances, cells, of OpenCV's drawing of the body four times as fine."""
    origin, scale = np.asarray(region.origin)[camera], float(region.scale[camera])
    fine = filled(finder, pose, camera, scale / 4, origin, 4 * SETTINGS.size)
    within, without = (cv2.distanceTransform(part, cv2.DIST_L2, 5) for part in (fine, 1 - fine))
    signed = np.where(fine > 0, within - 0.5, 0.5 - without) / 4
    size = (SETTINGS.size, SETTINGS.size)
    return cv2.resize(signed.astype(np.float32), size, interpolation=cv2.INTER_AREA)


def contours(phi: np.ndarray, region: Region) -> list[Contour]:
    origins, scales = np.asarray(region.origin), np.asarray(region.scale)
    return [contour_of(*each) for each in zip(phi, origins, scales, strict=True)]


def test_a_discs_contour_is_found_to_a_tenth_of_a_cell():
    y, x = np.mgrid[:64, :64]
    for middle, radius in (((30.3, 33.8), 20.0), ((31.0, 31.0), 12.4)):
        phi = radius - np.hypot(x - middle[0], y - middle[1])
        actual = contour_of(phi.astype(np.float32), np.array([100.0, 50.0]), 2.0)
        places = (actual.pixels_xy - [100.0, 50.0]) / 2.0 - 0.5 - middle
        assert np.abs(np.linalg.norm(places, axis=1) - radius).max() < 0.25
        assert np.abs(np.linalg.norm(places, axis=1) - radius).mean() < 0.1
        outwards = places / np.linalg.norm(places, axis=1, keepdims=True)
        assert np.sum(outwards * actual.normals, 1).min() > 0.9


def test_nothing_seen_matches_nothing(finder):
    rim = finder.find(finder.initial_shape, bent(), CAMERAS)
    phi = np.full((4, SETTINGS.size, SETTINGS.size), -5.0, np.float32)
    none = match_pairs(rim, contours(phi, rim.region))
    assert not none.valid.any()
    phi[0, 20:100, 50:70] = 5.0
    some = match_pairs(rim, contours(phi, rim.region))
    assert some.nodes.shape == none.nodes.shape
    assert some.valid[0].any() and not some.valid[1:].any()


def test_pairs_face_the_same_way_and_are_near(finder):
    truth = bent(arm_abduct_l=60)
    start = retract(truth, jnp.full(BODY.costs.shape, 0.02))
    rim = finder.find(finder.initial_shape, start, CAMERAS)
    phi = np.stack([level_set(finder, truth, c, rim.region) for c in range(4)])
    pairs = match_pairs(rim, contours(phi, rim.region))
    assert pairs.valid.mean() > 0.7
    assert pairs.distances[pairs.valid].max() < 40 * rim.region.scale.max()
    assert np.median(pairs.distances[pairs.valid]) < 15
    assert np.isfinite(pairs.pixels_xy).all()


@pytest.mark.parametrize("degrees", [5, 2])
def test_a_pose_is_found_from_four_silhouettes(finder, degrees):
    """Rims, pairs and twist equations, cycle by cycle, from 3 cm and some degrees off."""
    rng = np.random.default_rng(4)
    truth = bent(arm_abduct_l=60, elbow_flex_l=50, arm_flex_r=50, elbow_flex_r=40, arm_abduct_r=30)
    off = rng.choice([-1, 1], BODY.costs.shape) * np.radians(degrees)
    off[:3] = 0.03 / np.sqrt(3)
    start = pose = retract(truth, jnp.asarray(off.astype(np.float32)))
    # A prior must hold what outlines hardly determine: how a forearm is twisted.
    prior = Prior(start, jnp.full(BODY.costs.shape, 0.5))
    region = finder.find(finder.initial_shape, start, CAMERAS).region
    phi = np.stack([level_set(finder, truth, c, region) for c in range(4)])
    outlines = contours(phi, region)
    for _ in range(10):
        actual = match_pairs(finder.find(finder.initial_shape, pose, CAMERAS), outlines)
        weights = jnp.asarray(actual.valid, jnp.float32)
        points = finder.initial_shape.points(actual.nodes)
        pairs = (points, actual.pixels_xy, actual.normals, weights, actual.nodes)
        rays = PAIRS(CAMERAS, ContourPairs(*pairs))
        pose = SOLVE(BODY, pose, rays, PoseSettings(iterations=3, deviation=0.005), prior).pose
    wrong = np.abs(np.asarray(difference(pose, truth)))
    hinges = [
        ROOT_DOF + BODY.tree.joint(f"{name}_{side}")
        for name in ("elbow_flex", "knee_flexion")
        for side in "lr"
    ]
    joints = FORWARD(BODY, pose).joints_world - FORWARD(BODY, truth).joints_world
    assert np.degrees(wrong[hinges]).mean() < 3
    assert np.linalg.norm(joints, axis=1).mean() < 0.015
