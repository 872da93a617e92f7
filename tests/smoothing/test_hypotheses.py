"""Candidates for the elbows: their prices, the cheapest path, valleys that a solve does not leave.

A painted person moves both arms before the body; one arm is then put where a solve would never
find back from.
"""

from functools import partial
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import on_device
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import Array
from painted_motion import (
    ELBOWS,
    MODEL,
    PERSON,
    measurements,
    points_of,
    problem,
    truth,
    views,
)

from jaxmocap.body.arms import (
    GRIP,
    SHOULDER,
    arm_dofs,
    bent,
    hang,
    swing,
    turn_pose,
    unmarked_arms,
)
from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import Pose, relaxed_pose
from jaxmocap.body.proportions import PROPORTIONS
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.smoothing.batch import DECISIONS, FREE_DECISIONS, cheaper_by_stretch
from jaxmocap.smoothing.elbow_viterbi import elbow_path, turn_arms_along
from jaxmocap.smoothing.linearise import smooth_poses
from jaxmocap.smoothing.problem import Trajectory, Views
from jaxmocap.smoothing.settings import ElbowPathSettings
from jaxmocap.solvers.viterbi import cheapest_path

COUNT = 12
GRIPS = MODEL.grips
PATH = ElbowPathSettings()
PRICES = float(PATH.speed), float(PATH.largest_price)
NO_CHANGE = np.zeros(len(PROPORTIONS), np.float32)


@jax.jit
@partial(jax.vmap, in_axes=(0, None))
def _swung(pose: Pose, swivels: Array) -> Pose:
    moves = jnp.zeros((2, 4), swivels.dtype).at[:, 0].set(swivels)
    _, angles = swing(hang(PERSON, pose, GRIPS), moves)
    return pose._replace(angles=pose.angles.at[arm_dofs(PERSON.tree)].set(angles))


@jax.jit
@partial(jax.vmap, in_axes=(0, None, None))
def _arms_turned(pose: Pose, turns: Array, pivots: Array) -> Pose:
    return turn_pose(PERSON, pose, GRIPS, turns, pivots)


def with_arms_turned(degrees: tuple[float, float, float], pivot: int = GRIP) -> Pose:
    """The true motion with the right arm turned about its grip, or about another joint."""
    turns, pivots = np.radians([[0, 0, 0], degrees]), np.array([GRIP, pivot], np.int32)
    turned = _arms_turned(on_device(truth(COUNT), jnp.float32), turns.astype(np.float32), pivots)
    return jax.tree.map(np.asarray, turned)


def swivelled(degrees: tuple[float, float]) -> Pose:
    """The true motion with each arm swung about its axis from shoulder to grip."""
    poses = on_device(truth(COUNT), jnp.float32)
    return jax.tree.map(np.asarray, _swung(poses, np.radians(degrees).astype(np.float32)))


def goals_from(poses: Pose, shown: Views | None = None) -> np.ndarray:
    """Where the cheapest paths take the elbows, (T, 2, 3)."""
    given = problem(COUNT, views(COUNT) if shown is None else shown)
    return elbow_path(given, Trajectory(poses, NO_CHANGE)).goals


def off(elbows: np.ndarray) -> np.ndarray:
    """Distances (T, 2) from the true elbows, metres."""
    return np.linalg.norm(elbows - points_of(truth(COUNT))[:, ELBOWS], axis=-1)


# The path ----------------------------------------------------------------------------------------


@given(st.integers(0, 10_000), st.integers(1, 5), st.integers(1, 3))
def test_no_other_path_is_cheaper(seed, times, candidates):
    rng = np.random.default_rng(seed)
    costs = rng.uniform(0, 5, (times, candidates))
    places = rng.normal(0, 0.1, (times, candidates, 3))
    at = np.cumsum(rng.uniform(0.01, 0.1, times))

    def price(path) -> float:
        spent = costs[np.arange(times), path].sum()
        for t in range(1, times):
            way = places[t, path[t]] - places[t - 1, path[t - 1]]
            reach = float(PATH.speed) * (at[t] - at[t - 1])
            spent += min(np.sum(way**2) / reach**2 / 2, float(PATH.largest_price))
        return spent

    best = min(price(path) for path in product(range(candidates), repeat=times))
    assert price(cheapest_path(costs, places, at, *PRICES)) == pytest.approx(best)


def test_one_clear_frame_decides_for_the_ambiguous_ones_beside_it():
    places = np.broadcast_to([[0.0, 0, 0], [0.4, 0, 0]], (9, 2, 3))
    costs = np.zeros((9, 2))
    costs[4, 0] = 8.0
    assert (cheapest_path(costs, places, np.arange(9) / 30, *PRICES) == 1).all()


# Joint angles of candidates ----------------------------------------------------------------------


@jax.jit
@jax.vmap
def _bent_again(pose: Pose) -> tuple[Array, Array]:
    """Joints (J, 3) of a pose, and (2, J, 3) with either arm's angles from its places."""
    hung = hang(PERSON, pose, GRIPS)

    def joints(side: int) -> Array:
        own = jax.tree.map(lambda part: part[side], hung)
        angles = pose.angles.at[arm_dofs(PERSON.tree)[side]].set(bent(own, own.arms))
        return forward(PERSON, pose._replace(angles=angles)).joints_world

    return forward(PERSON, pose).joints_world, jnp.stack([joints(side) for side in range(2)])


@settings(max_examples=8, deadline=None)
@given(st.floats(-60, 60))
def test_an_arms_places_determine_its_joint_angles(degrees):
    were, are = _bent_again(swivelled((degrees, -degrees)))
    np.testing.assert_allclose(are, np.stack([were, were], 1), atol=2e-5)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_a_raised_arm_is_bent_within_its_ranges_wherever_it_was_before(seed):
    """Its other answer, far beyond them, kept the search from where the arm was."""
    rng = np.random.default_rng(seed)
    rows, limits = arm_dofs(PERSON.tree), np.asarray(PERSON.limits)
    low, high = np.moveaxis(limits[rows], -1, 0)
    angles = rng.uniform(low, high)
    # Of a straight arm no plane determines how it turns.
    angles[:, 3] = np.maximum(angles[:, 3], 0.2)
    before = rng.uniform(low, high)
    there, answers = _bent_from(angles.astype(np.float32), before.astype(np.float32))
    beyond = np.maximum(low - answers, 0) + np.maximum(answers - high, 0)
    assert beyond.max() < 1e-3
    are, _ = _bent_from(np.asarray(answers), before.astype(np.float32))
    np.testing.assert_allclose(are, there, atol=1e-4)


@jax.jit
def _bent_from(angles: Array, before: Array) -> tuple[Array, Array]:
    """Joints (J, 3) with arms at angles (2, 4), and their answers (2, 4) from other ones before."""
    rows, pose = arm_dofs(PERSON.tree), relaxed_pose(PERSON)
    pose = pose._replace(angles=pose.angles.at[rows].set(angles))
    hung = hang(PERSON, pose, GRIPS)
    answers = jax.vmap(bent)(hung._replace(angles=before), hung.arms)
    return forward(PERSON, pose).joints_world, answers


# Decisions ---------------------------------------------------------------------------------------


def test_arms_that_are_in_the_right_place_stay_there_give_or_take_a_candidate():
    assert off(goals_from(truth(COUNT))).max() < 0.1


@pytest.mark.parametrize("degrees", [(60.0, 0.0), (0.0, -60.0), (-50.0, 50.0)])
def test_an_arm_in_the_wrong_place_is_called_back(degrees):
    start, moved = swivelled(degrees), np.array(degrees) != 0
    wrong = off(points_of(start)[:, ELBOWS]).mean(0)[moved]
    right = off(goals_from(start)).mean(0)[moved]
    assert (wrong > 0.1).all() and (right < 0.6 * wrong).all()


def test_goals_lead_a_solve_out_of_a_valley_that_it_would_not_leave_alone():
    start, given = Trajectory(swivelled((0.0, 140.0)), NO_CHANGE), problem(COUNT, views(COUNT))
    alone = smooth_poses(given, start, (1.5, 0.8))
    guided = given.with_measured(elbows=goals_from(start.poses))
    actual = smooth_poses(given, smooth_poses(guided, start, (1.5,)).trajectory, (1.5, 0.8))
    left, led = (off(points_of(each.trajectory.poses)[:, ELBOWS]) for each in (alone, actual))
    assert left[:, 1].max() > 0.3 and led.max() < 0.03
    assert actual.cost < 0.8 * alone.cost


@pytest.mark.parametrize(("degrees", "most"), [(-120.0, 0.08), (180.0, 0.15)])
def test_a_forearm_that_points_the_other_way_is_turned_to_its_goals_before_a_solve(degrees, most):
    """With one hand unmarked for two seconds the other elbow stayed 45 cm off for one."""
    given = problem(COUNT, views(COUNT))
    start = Trajectory(with_arms_turned((0, degrees, 0)), NO_CHANGE)
    path = elbow_path(given, start)
    there = turn_arms_along(MODEL, start, path)
    apart = points_of(there.poses)[:, ELBOWS] - path.goals
    assert np.linalg.norm(apart, axis=-1).max() < 0.1
    guided = given.with_measured(elbows=path.goals)
    pulled, put = (smooth_poses(guided, each, (1.5,)).trajectory for each in (start, there))
    left, led = (off(points_of(each.poses)[:, ELBOWS])[:, 1] for each in (pulled, put))
    assert 2 * led.max() < left.max() and led.max() < most


@pytest.mark.parametrize("led_astray", [False, True])
def test_an_arm_stays_wherever_following_the_path_costs_more(led_astray):
    """A raised arm that was right was led 28 cm off for 0.4 s."""
    each = [Trajectory(poses, NO_CHANGE) for poses in (truth(COUNT), swivelled((0.0, 140.0)))]
    wrong = off(points_of(each[1].poses)[:, ELBOWS])[:, 1]
    actual = cheaper_by_stretch(problem(COUNT, views(COUNT)), *(each if led_astray else each[::-1]))
    assert wrong.min() > 0.3 and off(points_of(actual.poses)[:, ELBOWS]).max() < 0.1


@pytest.mark.parametrize("degrees", [(0, -90), (70, 70)])
def test_an_arm_without_a_marker_is_found_by_turning_it_about_shoulder_and_elbow(degrees):
    measured = measurements(COUNT)
    measured.markers[:, 2] = np.nan
    unmarked = unmarked_arms(PERSON.tree, MODEL.markers, measured.markers)
    assert not unmarked[:, 0].any() and unmarked[:, 1].all()
    given = problem(COUNT, views(COUNT), measured)
    lost = with_arms_turned((*degrees, 0), SHOULDER)

    def found(pivots: tuple[int, ...]) -> np.ndarray:
        there = Trajectory(lost, NO_CHANGE)
        for pivot in pivots:
            path = elbow_path(given, there, np.where(unmarked, pivot, GRIP))
            guided = given.with_measured(elbows=path.goals)
            there = smooth_poses(guided, turn_arms_along(MODEL, there, path), (1.5,)).trajectory
        there = smooth_poses(given, there, (0.8,)).trajectory
        wrists = [LANDMARKS.index(f"wrist_{side}") for side in "lr"]
        apart = points_of(there.poses)[:, wrists] - points_of(truth(COUNT))[:, wrists]
        return np.linalg.norm(apart, axis=-1).mean(0)

    by_grip, free = found(DECISIONS), found(FREE_DECISIONS)
    assert by_grip[1] > 0.5 and free[1] < 0.1 and free[0] < 0.01


def test_frames_without_a_view_have_no_goals():
    there = np.array([0, 1, 5, 6])
    path = elbow_path(
        problem(COUNT, views(COUNT, frames=there)), Trajectory(truth(COUNT), NO_CHANGE)
    )
    np.testing.assert_array_equal(path.turns[[2, 4]], path.turns[[1, 5]])
    goals = path.goals
    assert np.isfinite(goals[there]).all()
    assert np.isnan(np.delete(goals, there, 0)).all()


def test_two_cameras_decide_at_least_as_well_as_one():
    start = swivelled((-50.0, 50.0))
    one, two = (off(goals_from(start, views(COUNT, cameras=c))).mean() for c in ((0,), (0, 1)))
    assert two < one + 0.01
