"""Smoothing over a whole recording: a painted motion is found again, whatever is missing."""

from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import on_device
from painted_motion import (
    ELBOWS,
    MODEL,
    PERSON,
    SETTINGS,
    disturbed,
    elbow_errors,
    measurements,
    points_of,
    problem,
    truth,
    views,
)

from jaxmocap.body.kinematics import joined_sites, landmark_sites
from jaxmocap.body.pose import Pose, retract
from jaxmocap.body.skeleton import LANDMARKS, landmark_mismatches
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.evidence.balance import Balance
from jaxmocap.evidence.ground import Ground
from jaxmocap.evidence.limits import JointLimits
from jaxmocap.evidence.markers import MarkerPositions
from jaxmocap.evidence.terms import residuals
from jaxmocap.smoothing.linearise import smooth_poses
from jaxmocap.smoothing.problem import Trajectory
from jaxmocap.smoothing.uncertainty import with_deviations
from jaxmocap.solvers.robust import TAILS
from jaxmocap.solvers.status import Status

# One more than a batch of views, so that a second batch holds one of them alone.
COUNT = 17
SOFTNESS = (3.0, 0.8)
WRIST_L = LANDMARKS.index("wrist_l")


class SmoothedRun(NamedTuple):
    """What a solve ended with, and how sure it is."""

    trajectory: Trajectory
    cost: float
    status: Status
    deviations: np.ndarray
    from_prior: np.ndarray


def smoothed(shown=None, measured=None, count: int = COUNT) -> SmoothedRun:
    """The disturbed motion, smoothed by views and markers; by default by all of camera 0."""
    given = problem(count, views(count) if shown is None else shown, measured)
    ended = smooth_poses(given, disturbed(count), SOFTNESS)
    sure = with_deviations(given, ended.trajectory, SOFTNESS[-1])
    assert sure.deviations is not None and sure.from_prior is not None
    return SmoothedRun(*ended[:3], sure.deviations, sure.from_prior)


def elbow_spread(actual: SmoothedRun) -> np.ndarray:
    """Standard deviations (T, 2) of the elbows, all coordinates together, metres."""
    return np.linalg.norm(actual.deviations[:, ELBOWS], axis=-1)


@pytest.fixture(scope="module")
def by_one_camera() -> SmoothedRun:
    return smoothed()


def test_who_may_keep_to_what_is_unusual_is_less_surely_guessed(by_one_camera):
    given, actual = problem(COUNT, views(COUNT)), by_one_camera.trajectory
    each = [replace(SETTINGS, persistence=jnp.asarray(s, float)) for s in (0.0, 2.0)]
    brief, lasting = (
        with_deviations(replace(given, settings=settings), actual, 0.8) for settings in each
    )
    assert (lasting.deviations >= brief.deviations - 1e-6).all()
    hips = [LANDMARKS.index(f"hip_{side}") for side in "lr"]
    assert lasting.deviations[:, hips].mean() > 1.2 * brief.deviations[:, hips].mean()


# What is found -----------------------------------------------------------------------------------


def test_disturbed_elbows_are_found_again_by_one_camera_and_markers_are_met(by_one_camera):
    assert elbow_errors(disturbed(COUNT).poses).min() > 0.05
    errors = elbow_errors(by_one_camera.trajectory.poses)
    assert errors.mean() < 0.02 and errors.max() < 0.03
    assert by_one_camera.status == Status.CONVERGED
    off = points_of(by_one_camera.trajectory.poses) - points_of(truth(COUNT))
    for name in ("vertex", "wrist_l", "wrist_r"):
        assert np.linalg.norm(off[:, LANDMARKS.index(name)], axis=1).max() < 0.015, name


def test_two_cameras_are_better_than_either(by_one_camera):
    both = smoothed(views(COUNT, (0, 1)))
    errors, alone = (
        elbow_errors(both.trajectory.poses),
        elbow_errors(by_one_camera.trajectory.poses),
    )
    assert errors.mean() < 0.01 and errors.mean() < 0.7 * alone.mean()
    assert (elbow_spread(both) < elbow_spread(by_one_camera)).all()


def test_the_result_depends_neither_on_the_batches_nor_on_the_order_of_views(by_one_camera):
    order = np.random.default_rng(0).permutation(COUNT)
    assert not np.array_equal(order[:16], np.arange(16))
    mixed = smoothed(jax.tree.map(lambda part: part[order], views(COUNT)))
    for actual, expected in zip(
        mixed.trajectory.poses, by_one_camera.trajectory.poses, strict=True
    ):
        np.testing.assert_allclose(actual, expected, atol=1e-4)
    np.testing.assert_allclose(mixed.deviations, by_one_camera.deviations, rtol=1e-3)


def test_smoothing_starts_again_from_its_own_end_without_moving(by_one_camera):
    again = smooth_poses(problem(COUNT, views(COUNT)), by_one_camera.trajectory, SOFTNESS[-1:])
    off = points_of(again.trajectory.poses) - points_of(by_one_camera.trajectory.poses)
    assert np.abs(off).max() < 2e-3
    assert again.cost <= by_one_camera.cost * (1 + 1e-4)


# How sure it is ----------------------------------------------------------------------------------


def test_deviations_are_finite_and_positive_and_smallest_where_markers_hold(by_one_camera):
    assert by_one_camera.deviations.shape == (COUNT, len(LANDMARKS), 3)
    assert np.isfinite(by_one_camera.deviations).all()
    assert (by_one_camera.deviations > 0).all()
    held = np.linalg.norm(by_one_camera.deviations[:, WRIST_L], axis=-1)
    assert (held[:, None] < 0.7 * elbow_spread(by_one_camera)).all()
    assert (elbow_spread(by_one_camera) > landmark_mismatches()[ELBOWS].max()).all()
    assert set(np.unique(by_one_camera.from_prior)) <= {0.0, 1.0}
    assert not by_one_camera.from_prior[:, ELBOWS].any()


def test_a_stretch_without_views_is_bridged_and_reported_as_a_guess():
    count, gap = 44, slice(6, 38)
    there = np.delete(np.arange(count), gap)
    actual = smoothed(views(count, frames=there), count=count)
    spread, unbroken = elbow_spread(actual), elbow_spread(smoothed(count=count))
    middle = slice(18, 26)
    assert (spread[middle] > 1.2 * unbroken[middle]).all()
    assert (spread[middle].min(0) > spread[there[1:-1]].mean(0)).all()
    assert actual.from_prior[middle][:, ELBOWS].all()
    assert not actual.from_prior[there][:, ELBOWS].any()
    # The markers hold the wrists all the same.
    assert not actual.from_prior[:, WRIST_L].any()
    errors = elbow_errors(actual.trajectory.poses)
    assert errors[there].mean() < 0.03
    # The truth lies within the deviations.
    assert (errors[middle] < 3 * spread[middle]).all()
    steps = np.linalg.norm(np.diff(points_of(actual.trajectory.poses)[:, ELBOWS], axis=0), axis=-1)
    assert steps.max() < 0.06


@pytest.mark.parametrize("weightless", [True, False])
def test_without_silhouettes_the_elbows_are_guesses(weightless, by_one_camera):
    shown = views(COUNT).none
    if weightless:
        grids = views(COUNT).grids.each_grid(lambda grid: grid._replace(weight=0 * grid.weight))
        shown = views(COUNT)._replace(grids=grids)
    actual = smoothed(shown)
    assert actual.from_prior[:, ELBOWS].all() and not actual.from_prior[:, WRIST_L].any()
    assert (elbow_spread(actual) > elbow_spread(by_one_camera)).all()
    assert all(np.isfinite(part).all() for part in actual.trajectory.poses)
    off = points_of(actual.trajectory.poses) - points_of(truth(COUNT))
    assert np.linalg.norm(off[:, WRIST_L], axis=1).max() < 0.015


# What is missing ---------------------------------------------------------------------------------


def test_missing_markers_are_bridged():
    measured = measurements(COUNT)
    measured.markers[5:10, 1], measured.markers[12] = np.nan, np.nan
    actual = smoothed(measured=measured)
    assert all(np.isfinite(part).all() for part in actual.trajectory.poses)
    off = points_of(actual.trajectory.poses) - points_of(truth(COUNT))
    assert np.linalg.norm(off[:, WRIST_L], axis=1).max() < 0.03
    assert elbow_errors(actual.trajectory.poses).mean() < 0.025
    spread = np.linalg.norm(actual.deviations[:, WRIST_L], axis=-1)
    assert spread[7] > spread[2]


def test_a_frame_without_measurements_lies_between_its_neighbours(by_one_camera):
    measured, there = measurements(COUNT), np.delete(np.arange(COUNT), 8)
    measured.markers[8] = np.nan
    actual = smoothed(views(COUNT, frames=there), measured)
    off = points_of(actual.trajectory.poses) - points_of(by_one_camera.trajectory.poses)
    assert np.linalg.norm(off[8], axis=-1).max() < 0.01
    assert np.isfinite(actual.deviations).all()


# The residuals -----------------------------------------------------------------------------------


def one_frame(index: int = 3):
    """Pose and measurements of one frame of the truth."""
    pose = Pose(*(jnp.asarray(part[index], float) for part in truth(COUNT)))
    return pose, on_device(jax.tree.map(lambda part: part[index], measurements(COUNT)))


@jax.jit
def moved(step, pose, frame, settings, model=MODEL):
    """The residuals of a frame whose pose is moved by a tangent vector."""
    return residuals(settings.terms, model, retract(pose, step), frame)


SLOPES = jax.jit(jax.jacfwd(moved))
STILL = np.zeros(ROOT_DOF + len(PERSON.tree.joints), np.float32)
# Nothing outside the body holds it.
ADRIFT = replace(
    SETTINGS,
    markers=MarkerPositions(deviation=1e3),
    ground=Ground(height=1e3, place=1e3),
    balance=Balance(deviation=1e3),
)
# With both feet held by markers, which are missing.
MARKED_FEET = replace(
    MODEL, markers=joined_sites(MODEL.markers, landmark_sites(PERSON, ("ankle_l", "ankle_r")))
)


def priced(pose, frame, settings=SETTINGS, step=STILL, model=MODEL) -> float:
    """The sum of squares of a frame."""
    missing = len(model.markers.bones) - len(frame.markers)
    markers = jnp.pad(frame.markers, ((0, missing), (0, 0)), constant_values=jnp.nan)
    given = frame._replace(markers=markers)
    return float(jnp.sum(moved(step, pose, given, settings, model) ** 2))


def test_a_marker_off_its_place_costs_by_its_deviation():
    pose, frame = one_frame()
    deviation = SETTINGS.markers.deviation
    off = frame._replace(markers=frame.markers.at[1, 2].add(3 * deviation))
    assert priced(pose, off) - priced(pose, frame) == pytest.approx(9, rel=1e-2)
    gone = frame._replace(markers=frame.markers.at[1].set(jnp.nan))
    assert priced(pose, gone) == pytest.approx(priced(pose, frame), rel=1e-3)


def test_a_missing_marker_leaves_the_derivatives_finite():
    pose, frame = one_frame()
    gone = frame._replace(markers=jnp.full_like(frame.markers, jnp.nan))
    assert np.isfinite(np.asarray(SLOPES(STILL, pose, gone, SETTINGS))).all()
    assert np.isfinite(priced(pose, gone))


@pytest.mark.parametrize("side", [0, 1])
def test_a_joint_beyond_its_range_costs(side):
    pose, frame = one_frame()
    joint = PERSON.tree.joint("elbow_flex_l")
    at_limit = pose._replace(angles=pose.angles.at[joint].set(PERSON.limits[joint, side]))
    by = (2 * side - 1) * 3 * SETTINGS.limits.deviation
    beyond = at_limit._replace(angles=at_limit.angles.at[joint].add(by))
    ranges = replace(ADRIFT, limits=JointLimits(deviation=1e3))
    by_range, otherwise = (
        priced(beyond, frame, each) - priced(at_limit, frame, each) for each in (ADRIFT, ranges)
    )
    assert by_range - otherwise == pytest.approx(9, rel=1e-3)


def test_a_body_that_turns_or_leans_from_the_markers_pose_costs():
    pose, frame = one_frame()
    steps = np.zeros((4, STILL.size), np.float32)
    steps[1:, 3:6] = 0.3 * np.eye(3)

    def costs(model) -> list[float]:
        still, *turned = (priced(pose, frame, ADRIFT, step, model) for step in steps)
        return [cost - still for cost in turned]

    held, free = costs(MARKED_FEET), costs(MODEL)
    pelvis = SETTINGS.pelvis
    facing, lean = (np.sin(0.3) ** 2 / float(s) ** 2 for s in (pelvis.facing, pelvis.lean))
    assert held[2] == pytest.approx(facing, rel=1e-2)
    assert min(held[:2]) >= 0.99 * lean
    # A trunk may be off the vertical, by Student's t.
    assert min(free[:2]) >= 0.95 * TAILS * np.log1p(lean / TAILS)
    # Without markers on the feet it is less sure where the body faces, but not open.
    assert 0.01 * facing < free[2] < 0.5 * facing


def test_feet_that_a_marker_holds_are_left_to_it():
    pose, frame = one_frame()
    lifted = frame._replace(ankles=frame.ankles + 0.2)
    assert priced(pose, lifted) > priced(pose, frame) + 1
    held, own = (priced(pose, each, model=MARKED_FEET) for each in (lifted, frame))
    assert held == pytest.approx(own, rel=1e-6)


def test_free_feet_stand_below_the_centre_of_gravity():
    pose, frame = one_frame()
    aside = frame._replace(ankles=frame.ankles + np.array([0.15, 0.0, 0.0], np.float32))
    there = 0.15 * np.eye(len(STILL), dtype=np.float32)[0]
    firm = replace(ADRIFT, balance=SETTINGS.balance)
    # The whole body moves, and stays as balanced as it was.
    assert priced(pose, aside, firm, there) == pytest.approx(priced(pose, frame, firm), rel=1e-3)
    bowed = STILL.copy()
    bowed[4] = 0.5
    free, loose = (priced(pose, frame, each, bowed) for each in (firm, ADRIFT))
    assert free > loose + 1
