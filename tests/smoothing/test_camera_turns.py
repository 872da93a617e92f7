"""Cameras that are turned against their calibration: the recording itself tells by how much.

Painted motions are seen by cameras about whose rotation the problem is wrong.
"""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import on_device
from hypothesis import given
from hypothesis import strategies as st
from painted_motion import CAMERAS, MODEL, PERSON, SETTINGS, disturbed, elbow_errors, problem, views

from jaxmocap.geometry.cameras import project, to_camera, turn_camera
from jaxmocap.geometry.rotations import exp
from jaxmocap.smoothing.elbow_viterbi import elbow_path
from jaxmocap.smoothing.linearise import SmoothedPoses, smooth_poses
from jaxmocap.smoothing.problem import (
    UNTURNED,
    SmoothingProblem,
    Trajectory,
    all_turned,
    among_cameras,
    move_trajectory,
    shared_prior,
)
from jaxmocap.smoothing.uncertainty import with_deviations

COUNT, SOFTNESS = 12, (3.0, 0.8)
# Half a degree, rotation vectors in the cameras' frames; a turn about the view is hardly seen.
TURNS = np.radians(0.5) * np.array([[0.6, 0.8, 0.0], [-0.9, 0.4, 0.1]], np.float32)
LOOSE = replace(SETTINGS, camera=jnp.float32(0.01))


def misstated(cameras=(0,), turns=TURNS, settings=LOOSE) -> SmoothingProblem:
    """The motion, in cameras that are turned by so much against what is stated of them."""
    true = problem(COUNT, views(COUNT, cameras))
    stated = replace(true.model, cameras=all_turned(true.model.cameras, -turns))
    return replace(true, model=stated, settings=settings)


def start(free: bool) -> Trajectory:
    """Arms turned away, and cameras that may turn or not."""
    return disturbed(COUNT)._replace(turns_cam=0 * TURNS if free else UNTURNED)


@cache
def solved(cameras=(0,), free: bool = True) -> SmoothedPoses:
    return smooth_poses(misstated(cameras), start(free), SOFTNESS)


def off(actual: SmoothedPoses) -> float:
    """Mean distance of the elbows from the truth, metres."""
    return float(elbow_errors(actual.trajectory.poses).mean())


# What is found -----------------------------------------------------------------------------------


@pytest.mark.parametrize("cameras", [(0,), (0, 1)])
def test_elbows_are_nearer_where_turned_cameras_may_turn(cameras):
    free, fixed = solved(cameras), solved(cameras, free=False)
    assert off(free) < 0.85 * off(fixed)
    assert free.cost < 0.9 * fixed.cost


def test_cameras_are_found_to_be_turned_as_they_are():
    actual = np.asarray(solved((0, 1)).trajectory.turns_cam)
    left = np.linalg.norm(actual - TURNS, axis=1)
    assert (left < 0.5 * np.linalg.norm(TURNS, axis=1)).all()


def test_a_camera_that_was_pushed_is_found_where_it_is():
    """Two degrees, where a third of one is usual: four and a half times what a calibration errs."""
    tight = replace(LOOSE, camera=jnp.float32(0.0055))
    turned = misstated((0, 1), 4 * TURNS, tight)
    found = smooth_poses(turned, start(True), SOFTNESS).trajectory.turns_cam
    left = np.linalg.norm(np.asarray(found) - 4 * TURNS, axis=1)
    assert (left < 0.25 * np.linalg.norm(4 * TURNS, axis=1)).all()


def test_a_camera_without_a_view_stays_as_it_is():
    turns = np.asarray(solved().trajectory.turns_cam)
    assert np.abs(turns[0]).max() > 1e-3 and not turns[1].any()


def test_cameras_whose_calibration_is_true_hardly_turn():
    true = smooth_poses(misstated((0, 1), 0 * TURNS), start(True), SOFTNESS)
    # Trunks are drawn as thick as at the head's distance: painted ones are not.
    assert np.degrees(np.abs(true.trajectory.turns_cam)).max() < 0.06
    assert off(true) < 0.006


def test_the_surer_a_calibration_the_less_a_camera_turns():
    sizes = []
    for deviation in (1e-5, 2e-3, 1e-2):
        settings = replace(SETTINGS, camera=jnp.float32(deviation))
        actual = smooth_poses(misstated((0, 1), settings=settings), start(True), SOFTNESS)
        sizes.append(float(np.linalg.norm(actual.trajectory.turns_cam)))
    assert sizes[0] < 1e-5 and sizes == sorted(sizes)


def test_deviations_are_no_smaller_where_cameras_may_turn():
    ends = solved().trajectory, solved()[0]._replace(turns_cam=UNTURNED)
    free, fixed = (with_deviations(misstated(), end, SOFTNESS[-1]).deviations for end in ends)
    assert np.isfinite(free).all() and free.mean() > 0.99 * fixed.mean()


# Where the turns count ---------------------------------------------------------------------------


def test_candidates_for_the_elbows_are_priced_by_the_turned_cameras():
    poses, none = start(True).poses, start(False).proportions
    true = elbow_path(misstated((0, 1), 0 * TURNS), Trajectory(poses, none)).goals
    actual = elbow_path(misstated((0, 1)), Trajectory(poses, none, TURNS)).goals
    assert (np.linalg.norm(actual - true, axis=-1) < 1e-3).mean() > 0.9


# The parts ---------------------------------------------------------------------------------------


VECTORS = st.lists(st.floats(-0.5, 0.5), min_size=3, max_size=3).map(np.float32)


@given(VECTORS, VECTORS)
def test_a_turned_camera_stays_where_it_is_and_turns_what_it_sees(turn, point):
    other = turn_camera(CAMERAS[0], on_device(turn))
    np.testing.assert_allclose(other.position_world, CAMERAS[0].position_world, atol=1e-5)
    turned_point = np.asarray(exp(on_device(turn))) @ np.asarray(
        to_camera(CAMERAS[0], on_device(point))
    )
    np.testing.assert_allclose(to_camera(other, on_device(point)), turned_point, atol=1e-5)


def test_half_a_degree_moves_what_is_seen_by_that_angle():
    ahead = CAMERAS[0].position_world + 3 * CAMERAS[0].T_cam_world[2, :3]
    sideways = turn_camera(CAMERAS[0], jnp.array([0.0, np.radians(0.5), 0.0], float))
    moved = project(sideways, ahead) - project(CAMERAS[0], ahead)
    focal = float(CAMERAS[0].matrix[0, 0])
    np.testing.assert_allclose(moved, [focal * np.tan(np.radians(0.5)), 0], atol=0.01)


def test_without_turns_cameras_are_the_very_same():
    assert all_turned(MODEL.cameras, UNTURNED) is MODEL.cameras
    held, cameras = replace(SETTINGS, camera=jnp.float32(0.0)), np.zeros(5, int)
    weights, _, _ = shared_prior(held, cameras, start(False))
    assert weights.shape == (2, 2) and np.isfinite(weights).all()


@given(st.integers(0, 10_000), st.integers(1, 3), st.integers(0, 6))
def test_views_terms_among_cameras_are_those_of_a_wide_jacobian(seed, cameras, count):
    rng, own = np.random.default_rng(seed), 4
    camera = rng.integers(0, cameras, count)
    J, r = rng.normal(size=(count, 7, own + 3)), rng.normal(size=(count, 7))
    wide = np.zeros((count, 7, own + 3 * cameras))
    wide[..., :own] = J[..., :own]
    for i, c in enumerate(camera):
        wide[i, :, own + 3 * c : own + 3 * c + 3] = J[i, :, own:]
    terms = J.swapaxes(1, 2) @ J, np.einsum("vri,vr->vi", J, r)
    hessian, gradient = among_cameras(*terms, camera, cameras)
    np.testing.assert_allclose(hessian, wide.swapaxes(1, 2) @ wide, atol=1e-9)
    np.testing.assert_allclose(gradient, np.einsum("vri,vr->vi", wide, r), atol=1e-9)
    plain = among_cameras(*terms, camera, 0)
    np.testing.assert_array_equal(plain[0], terms[0][:, :own, :own])
    np.testing.assert_array_equal(plain[1], terms[1][:, :own])


def test_the_priors_gradient_is_that_of_its_cost():
    there = start(True)._replace(proportions=np.float32([0.03, -0.05]), turns_cam=TURNS)
    cameras, eps = np.array([0, 0, 1, 0]), 1e-6
    hessian, gradient, _ = shared_prior(LOOSE, cameras, there)
    x = np.concatenate([there.proportions, there.turns_cam.ravel()]).astype(float)

    def cost(x: np.ndarray) -> float:
        at = there._replace(proportions=x[:2], turns_cam=x[2:].reshape(-1, 3))
        return shared_prior(LOOSE, cameras, at)[2]

    slope = [(cost(x + eps * e) - cost(x - eps * e)) / 4 / eps for e in np.eye(len(x))]
    np.testing.assert_allclose(gradient, slope, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(hessian @ x, gradient, rtol=1e-9)


def test_a_step_moves_proportions_and_each_cameras_turn():
    begun, steps = start(True), np.zeros((COUNT, 6 + len(PERSON.tree.joints)))
    shared = np.arange(8) / 100
    moved = move_trajectory(begun, steps, shared)
    np.testing.assert_allclose(moved.proportions, shared[:2], atol=1e-7)
    np.testing.assert_allclose(moved.turns_cam, shared[2:].reshape(2, 3), atol=1e-7)
    for now, was in zip(jax.tree.leaves(moved.poses), jax.tree.leaves(begun.poses), strict=True):
        np.testing.assert_allclose(now, was, atol=1e-6)
