"""Contours to rims, and the pose that follows: from silhouettes that OpenCV drew."""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_rim import BODY, CAMERAS, FORWARD, SETTINGS, bent, filled, finder  # noqa: F401

from jaxmocap.body.pose import difference, retract
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.images.regions import Region
from jaxmocap.silhouette.fit.correspond import (
    Contour,
    ContourPairs,
    match_pairs,
    pairs_of,
)
from jaxmocap.silhouette.pose import PoseSettings, Prior, solve_pose
from jaxmocap.silhouette.surfaces.index_image import trace_boundary

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


def level_set(finder, pose, camera: int, region: Region) -> np.ndarray:  # noqa: F811
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


def test_nothing_seen_matches_nothing(finder):  # noqa: F811
    rim = finder.find(finder.initial_shape, bent(), CAMERAS)
    phi = np.full((4, SETTINGS.size, SETTINGS.size), -5.0, np.float32)
    none = match_pairs(rim, contours(phi, rim.region))
    assert not none.valid.any()
    phi[0, 20:100, 50:70] = 5.0
    some = match_pairs(rim, contours(phi, rim.region))
    assert some.nodes.shape == none.nodes.shape
    assert some.valid[0].any() and not some.valid[1:].any()


def test_pairs_face_the_same_way_and_are_near(finder):  # noqa: F811
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
def test_a_pose_is_found_from_four_silhouettes(finder, degrees):  # noqa: F811
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
