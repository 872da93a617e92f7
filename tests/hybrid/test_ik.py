"""Inverse kinematics: the equations against the reference, and what it promises of bodies."""

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import LIMITS, double, on_device, poses, vectors
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxmocap.body.kinematics import Sites, forward, jacobian, landmark_sites, landmarks
from jaxmocap.body.kinematics import site_positions as positions
from jaxmocap.body.model import Model, on_unmarked_feet
from jaxmocap.body.pose import Pose, relaxed_pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.evidence.markers import Goals
from jaxmocap.evidence.terms import Measurements
from jaxmocap.geometry.rotations import quaternion_to_matrix
from jaxmocap.hybrid import feet, ik
from jaxmocap.hybrid.paper import ik as paper
from jaxmocap.hybrid.settings import IKSettings
from jaxmocap.hybrid.step import nowhere
from jaxmocap.reference import kinematics as reference_kinematics
from jaxmocap.reference.hybrid import ik as reference
from jaxmocap.synthetic.movements.exercises import exercise

NAMES = ("vertex", "wrist_l", "wrist_r", "ankle_l", "ankle_r")
# A step in float32 may lie this far from double precision, weighted radians: the singular
# directions of a nearly stretched limb are determined no better.
FLOAT32_STEP = 2e-3


def five(skeleton: Skeleton) -> Sites:
    """The paper's end effectors: head, hands, feet."""
    return landmark_sites(skeleton, NAMES)


@jax.jit
def step(skeleton, chosen, pose, targets, weights, free):
    measured = Measurements(goals=Goals(five(skeleton), targets, weights))
    return paper.ik_step(Model.create(skeleton), chosen, measured, pose, free)


@jax.jit
def step_with_secondary(skeleton, chosen, pose, targets, weights, free, elbows):
    measured = Measurements(goals=Goals(five(skeleton), targets, weights), elbows=elbows)
    return paper.ik_step(Model.create(skeleton), chosen, measured, pose, free, 0.8)


@jax.jit
def points_of(skeleton, pose):
    return positions(skeleton, forward(skeleton, pose), five(skeleton))


@jax.jit
def solve(skeleton, chosen, pose, placement, targets):
    return ik.solve_ik(Model.create(skeleton), chosen, pose, placement, targets)


@jax.jit
def place(skeleton, chosen, targets):
    return feet.place(Model.create(skeleton), chosen, targets)


@jax.jit
def secondary(skeleton, pose, chosen):
    return paper.secondary_task(skeleton, forward(skeleton, pose), pose, chosen)


@jax.jit
def slopes_at(skeleton, pose, points):
    """The geometric Jacobian of the five at their points."""
    return jacobian(skeleton, forward(skeleton, pose), five(skeleton).bones, points)


@jax.jit
def points_on(model, pose):
    """A model's own markers."""
    return positions(model.skeleton, forward(model.skeleton, pose), model.markers)


LANDMARKS_OF = jax.jit(landmarks)
EVERYTHING = np.ones(27, bool)


def goals_near(skeleton, pose, seed, size=0.1):
    """Random targets around the effectors of a pose, weights with an absent one now and then."""
    rng = np.random.default_rng(seed)
    with double():
        body, sites = plain(skeleton), plain(five(skeleton))
        frames = reference_kinematics.forward(body, pose)
        points = reference_kinematics.site_positions(body, frames, sites)
    targets = points + rng.normal(size=(5, 3)) * size
    return targets, np.array([1, 1, 1, 0.5, 0.5]) * (rng.uniform(size=5) < 0.8)


def plain(tree):
    """The same in NumPy: the reference takes one number at a time."""
    return jax.tree.map(np.asarray, tree)


def reference_step(skeleton, chosen, pose, targets, weights, free=EVERYTHING, *secondary):
    """One step by the reference, of the paper's five."""
    goals = reference.Goals(plain(five(skeleton)), targets, weights)
    return reference.ik_step(plain(skeleton), goals, chosen, pose, free, *secondary)


def compared(ours, theirs, tolerance):
    for part, expected in zip(ours[0], theirs[0], strict=True):
        np.testing.assert_allclose(part, expected, rtol=tolerance, atol=tolerance)
    np.testing.assert_allclose(ours[1:], theirs[1:], rtol=tolerance, atol=tolerance)


@given(pose=poses(), seed=st.integers(0, 2**20), size=st.floats(0.001, 0.3))
def test_a_step_is_the_references_in_double_precision(skeleton64, pose, seed, size):
    targets, weights = goals_near(skeleton64, pose, seed, size)
    free = np.random.default_rng(seed).uniform(size=27) < 0.9
    with double():
        chosen = IKSettings()
        arguments = (on_device(targets), on_device(weights), jnp.asarray(free))
        ours = step(skeleton64, chosen, on_device(pose), *arguments)
        theirs = reference_step(skeleton64, chosen, pose, targets, weights, free)
    compared(ours, theirs, 1e-9)
    # What may not move does not move at all.
    np.testing.assert_array_equal(ours[0].position[~free[:3]], pose.position[~free[:3]])
    np.testing.assert_array_equal(ours[0].angles[~free[6:]], pose.angles[~free[6:]])


@given(pose=poses(), seed=st.integers(0, 2**20))
def test_a_step_with_secondary_goals_is_the_references(skeleton64, pose, seed):
    targets, weights = goals_near(skeleton64, pose, seed)
    elbows = np.random.default_rng(seed).normal(size=(2, 3)) * 0.3
    with double():
        chosen = IKSettings()
        sites = landmark_sites(skeleton64, ("elbow_l", "elbow_r"))
        ours = step_with_secondary(
            skeleton64, chosen, on_device(pose), on_device(targets), on_device(weights),
            jnp.asarray(EVERYTHING), on_device(elbows),
        )  # fmt: skip
        theirs = reference_step(
            skeleton64, chosen, pose, targets, weights, EVERYTHING,
            reference.Goals(plain(sites), elbows, np.ones(2)), 0.8,
        )  # fmt: skip
    compared(ours, theirs, 1e-8)


@jax.jit
def solved(skeleton, chosen, pose, targets, weights):
    measured = Measurements(goals=Goals(five(skeleton), targets, weights))
    return paper.reach(Model.create(skeleton), chosen, measured, pose)


@jax.jit
def followed(skeleton, chosen, pose, targets, weights):
    measured = Measurements(goals=Goals(five(skeleton), targets, weights))
    return ik.reach(Model.create(skeleton), chosen, measured, pose)


@pytest.mark.parametrize("seed", range(4))
def test_a_whole_solve_is_the_references_in_double_precision(skeleton64, seed):
    with double():
        start = plain(relaxed_pose(skeleton64))
    targets, weights = goals_near(skeleton64, start, seed, 0.15)
    with double():
        chosen = IKSettings()
        arguments = (on_device(start), on_device(targets), on_device(weights))
        pose, count = solved(skeleton64, chosen, *arguments)
        goals = reference.Goals(plain(five(skeleton64)), targets, weights)
        expected, steps = reference.reach(plain(skeleton64), goals, chosen, start)
    assert int(count) == steps
    # Rounding grows along some tens of steps.
    for part, theirs in zip(pose, expected, strict=True):
        np.testing.assert_allclose(part, theirs, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("seed", range(20))
def test_the_pose_that_is_returned_is_the_one_that_met_its_goals(skeleton64, seed):
    # Near the limits a step that is cut short there may lead away from goals that were met.
    rng, (low, high) = np.random.default_rng(seed), LIMITS.T
    with double():
        pose = plain(relaxed_pose(skeleton64))
    near = pose.angles + rng.normal(size=len(low)) * (high - low)
    near = np.clip(near, low + 0.005, high - 0.005)
    moved = np.clip(near + 0.02 * rng.normal(size=len(low)), low, high)
    with double():
        chosen = IKSettings(settle=1, rest=0.0)
        targets = points_of(skeleton64, on_device(pose._replace(angles=moved)))
        start, weights = on_device(pose._replace(angles=near)), on_device(np.ones(5))
        actual, count = solved(skeleton64, chosen, start, targets, weights)
        missed = np.linalg.norm(points_of(skeleton64, actual) - targets, axis=1).max()
    assert missed <= float(chosen.tolerance) or int(count) == int(chosen.iterations)


@given(pose=poses(), seed=st.integers(0, 2**20))
def test_a_step_in_float32_stays_within_its_tolerance(skeleton, skeleton64, pose, seed):
    inner = pose._replace(angles=0.8 * pose.angles + 0.2 * np.asarray(skeleton64.relaxed))
    targets, weights = goals_near(skeleton64, inner, seed)
    with double():
        chosen = IKSettings()
        theirs = reference_step(skeleton64, chosen, inner, targets, weights)
    arguments = (on_device(targets), on_device(weights), jnp.asarray(EVERYTHING))
    ours = step(skeleton, IKSettings(), on_device(inner), *arguments)
    assert ours[0].angles.dtype == jnp.float32
    assert np.abs(ours[0].angles - theirs[0].angles).max() < FLOAT32_STEP
    assert np.abs(ours[0].position - theirs[0].position).max() < FLOAT32_STEP
    assert float(ours[2]) == pytest.approx(theirs[2], abs=1e-5)


@pytest.mark.parametrize("body", ["distal", "proximal"])
@given(pose=poses(beyond=0.3))
def test_the_secondary_task_is_the_references(skeleton64, body, pose):
    with double():
        chosen = IKSettings(augmented_body=body)
        start = on_device(pose)
        task = secondary(skeleton64, start, chosen)
    own = plain(skeleton64)
    frames = reference_kinematics.forward(own, pose)
    expected = reference.secondary_task(own, frames, pose, chosen)
    np.testing.assert_allclose(task, expected, rtol=1e-9, atol=1e-12)


def test_the_secondary_task_relaxes_and_rights_the_body(skeleton):
    relaxed = relaxed_pose(skeleton)
    chosen = IKSettings()
    np.testing.assert_allclose(secondary(skeleton, relaxed, chosen), 0, atol=1e-7)
    bent = relaxed._replace(
        angles=relaxed.angles + 0.2, quaternion=jnp.array([1.0, 0.1, 0, 0]) / np.sqrt(1.01)
    )
    step_back = np.asarray(secondary(skeleton, bent, chosen))
    assert (step_back[6:] <= 0).all() and step_back[6:].min() < -1e-3
    # Leaning about +x, it is turned back about -x, and about nothing else.
    assert step_back[3] < -1e-3
    np.testing.assert_allclose(step_back[[0, 1, 2, 4, 5]], 0, atol=1e-7)


@given(pose=poses(), gain=st.floats(1e-5, 1e-4))
def test_the_secondary_task_moves_no_end_effector(skeleton64, pose, gain):
    inner = pose._replace(angles=0.8 * pose.angles + 0.1)
    with double():
        chosen = IKSettings(relaxation=gain, uprightness=gain)
        start = on_device(inner)
        points = points_of(skeleton64, start)
        moved, largest, _ = step(
            skeleton64, chosen, start, points, jnp.ones(5), jnp.asarray(EVERYTHING)
        )
        apart = np.abs(np.asarray(points_of(skeleton64, moved)) - np.asarray(points)).max()
    # To first order nothing; what is left falls with the square of the step.
    assert apart < 30 * float(largest) ** 2 + 1e-12
    assert float(largest) > 1e-4 * gain


@given(pose=poses(), seed=st.integers(0, 2**20))
def test_a_small_step_is_the_cheapest_that_reaches(skeleton64, pose, seed):
    """Equation (4): of all steps that reach, the one with the least sum of (mu_j theta_j)^2."""
    inner = pose._replace(angles=0.6 * pose.angles + 0.4 * np.asarray(skeleton64.relaxed))
    rng = np.random.default_rng(seed)
    with double():
        chosen = IKSettings(relaxation=0.0, uprightness=0.0)
        start = on_device(inner)
        points = np.asarray(points_of(skeleton64, start))
        error = rng.normal(size=(5, 3)) * 1e-7
        moved, _, _ = step(
            skeleton64, chosen, start, on_device(points + error), jnp.ones(5),
            jnp.asarray(EVERYTHING),
        )  # fmt: skip
        J = np.asarray(slopes_at(skeleton64, start, on_device(points)))
    mu = np.asarray(skeleton64.costs)
    cheapest = np.linalg.pinv(J.reshape(15, 27) / mu) @ error.ravel() / mu
    low, high = LIMITS.T
    clear = (inner.angles > low + 1e-3) & (inner.angles < high - 1e-3)
    if clear.all():
        taken = np.asarray(moved.angles) - inner.angles
        np.testing.assert_allclose(taken, cheapest[6:], rtol=1e-3, atol=1e-10)


def random_pose(skeleton: Skeleton, seed: int, share: float = 0.6) -> Pose:
    """A standing pose, arms ``share`` of the way to anywhere in their range, turned anywhere."""
    rng = np.random.default_rng(seed)
    angles = np.array(skeleton.relaxed, float)
    low, high = LIMITS.T
    for i, name in enumerate(skeleton.tree.joints):
        if name.startswith(("arm", "elbow")):
            angles[i] += share * (rng.uniform(low[i], high[i]) - angles[i])
        elif name.startswith(("spine", "neck")):
            angles[i] += 0.3 * (rng.uniform(low[i], high[i]) - angles[i])
    half = rng.uniform(-np.pi, np.pi) / 2
    turned = np.array([np.cos(half), 0, 0, np.sin(half)])
    pose = on_device(Pose(np.append(rng.uniform(-1, 1, 2), 0.0), turned, angles))
    ground = float(skeleton.diameters[skeleton.tree.bone("foot_l"), 0])
    lift = ground - float(points_of(skeleton, pose)[3:, 2].min())
    return pose._replace(position=pose.position.at[2].add(lift))


def settled(skeleton, targets, frames=8):
    """The answer after some frames of the same markers, from the relaxed pose."""
    chosen = IKSettings()
    pose, placement = place(skeleton, chosen, targets)
    for _ in range(frames):
        result = solve(skeleton, chosen, pose, placement, targets)
        pose, placement = result.pose, result.feet
    return result


def misses(skeleton, pose, targets):
    apart = np.asarray(points_of(skeleton, pose))[: len(targets)] - np.asarray(targets)
    return np.linalg.norm(apart, axis=1)


@settings(max_examples=60)
@given(seed=st.integers(0, 2**20), share=st.floats(0, 0.8))
def test_from_the_relaxed_pose_it_finds_any_reachable_pose_without_help(skeleton, seed, share):
    targets = points_of(skeleton, random_pose(skeleton, seed, share))[:3]
    actual = settled(skeleton, targets)
    assert misses(skeleton, actual.pose, targets).max() < 0.005


@given(seed=st.integers(0, 2**20), yaw=st.floats(-np.pi, np.pi))
def test_turned_markers_give_the_same_answer_turned(skeleton, seed, yaw):
    targets = np.asarray(points_of(skeleton, random_pose(skeleton, seed, 0.5)))[:3]
    c, s = np.cos(yaw), np.sin(yaw)
    R, shift = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([1.0, -2.0, 0.0])
    here = settled(skeleton, on_device(targets), 6).pose
    there = settled(skeleton, on_device(targets @ R.T + shift), 6).pose
    turned = np.asarray(LANDMARKS_OF(skeleton, here)) @ R.T + shift
    # The clamps (7) are by component, and the root's are the world's: the ways differ a little.
    apart = np.linalg.norm(turned - np.asarray(LANDMARKS_OF(skeleton, there)), axis=1)
    assert apart.max() < 0.01


@given(values=vectors(15, 1.5), pose=poses())
def test_limits_are_respected_whatever_is_asked(skeleton, values, pose):
    targets = on_device(values.reshape(5, 3)[:3] + np.array([0, 0, 1.0]))
    placement = feet.FootPlacement(on_device(values.reshape(5, 3)[3:]), jnp.zeros((), bool))
    now = on_device(pose)
    for _ in range(4):
        result = solve(skeleton, IKSettings(), now, placement, targets)
        now, placement = result.pose, result.feet
        angles = np.asarray(now.angles)
        assert np.isfinite(np.concatenate([*map(np.ravel, now)])).all()
        assert (angles >= LIMITS[:, 0] - 1e-5).all() and (angles <= LIMITS[:, 1] + 1e-5).all()


@pytest.mark.parametrize("present", list(product([False, True], repeat=3)))
def test_any_marker_may_be_missing(skeleton, present):
    targets = np.array(points_of(skeleton, random_pose(skeleton, 5)))[:3]
    targets[~np.array(present)] = np.nan
    actual = settled(skeleton, on_device(targets), 4)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(actual))
    assert np.linalg.norm(actual.pose.quaternion) == pytest.approx(1, abs=1e-5)
    missed = misses(skeleton, actual.pose, np.nan_to_num(targets))[np.array(present)]
    assert missed.max(initial=0) < 0.005


def test_lost_markers_leave_the_pose_where_it_was(skeleton):
    targets = points_of(skeleton, random_pose(skeleton, 7))[:3]
    actual = settled(skeleton, targets)
    nothing = jnp.full((3, 3), jnp.nan)
    lost = solve(skeleton, IKSettings(), actual.pose, actual.feet, nothing)
    moved = LANDMARKS_OF(skeleton, lost.pose) - LANDMARKS_OF(skeleton, actual.pose)
    # It may relax, but it does not run away.
    assert np.abs(moved).max() < 0.5
    assert misses(skeleton, lost.pose, points_of(skeleton, actual.pose))[3:].max() < 0.02


def test_the_default_effectors_are_the_papers_five(skeleton):
    model = Model.create(skeleton)
    bones = [skeleton.tree.bones[bone] for bone in model.effectors.bones]
    assert bones == ["head", "hand_l", "hand_r", "foot_l", "foot_r"]
    np.testing.assert_allclose(model.effectors.at, [1, 0, 0, 0, 0])
    assert model.unmarked_feet == ("l", "r") and model.no_foot_is_marked


@pytest.mark.parametrize("bone", ["tibia_l", "foot_l"])
def test_the_ankle_of_a_leg_with_a_marker_is_no_effector(skeleton, bone):
    index = np.array([skeleton.tree.bone(bone), skeleton.tree.bone("femur_r")], np.int32)
    model = Model.create(skeleton, Sites(index, jnp.zeros(2), jnp.zeros((2, 3))))
    assert model.unmarked_feet == ("r",) and not model.no_foot_is_marked
    assert model.effectors.bones.tolist() == [*index, skeleton.tree.bone("foot_r")]


MARKER_SETS = {
    "tracked tools in both hands": (
        ["head", "hand_l", "hand_r"], [1.0, 0.6, 0.6],
        [[0.09, 0, 0.02], [0.05, 0.02, -0.04], [-0.03, 0, -0.1]],
    ),
    "trunk, upper arm and shank": (
        ["spine2", "neck", "humerus_l", "radius_r", "tibia_l", "femur_r"],
        [0.5, 0.9, 0.3, 0.8, 0.7, 0.4],
        [[0.12, 0.01, 0], [0, 0, 0.05], [0, 0.04, 0], [0.03, 0, 0], [0, 0, 0], [0.07, 0, 0]],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MARKER_SETS)
def test_markers_may_sit_anywhere_on_any_bone(skeleton, name):
    bones, at, offsets = MARKER_SETS[name]
    indices = np.array([skeleton.tree.bone(bone) for bone in bones], np.int32)
    markers = Sites(indices, on_device(np.array(at)), on_device(np.array(offsets)))
    model, chosen = Model.create(skeleton, markers), IKSettings()
    targets = points_on(model, random_pose(skeleton, 3, 0.4))
    pose, placement = jax.jit(feet.place)(model, chosen, targets)
    go = jax.jit(ik.solve_ik)
    for _ in range(10):
        result = go(model, chosen, pose, placement, targets)
        pose, placement = result.pose, result.feet
    assert float(result.distances[: len(bones)].max()) < 0.005
    np.testing.assert_allclose(points_on(model, pose), targets, atol=0.005)


def test_the_closed_form_placement_turns_the_relaxed_pose_to_the_markers(skeleton):
    for yaw in np.linspace(-3, 3, 7):
        quaternion = jnp.array([np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)], jnp.float32)
        truth = Pose(jnp.array([0.4, -2.0, 1.0]), quaternion, skeleton.relaxed)
        targets = points_of(skeleton, truth)[:3]
        placed, placement = place(skeleton, IKSettings(), targets)
        np.testing.assert_allclose(placed.position, truth.position, atol=1e-5)
        np.testing.assert_allclose(
            quaternion_to_matrix(placed.quaternion), quaternion_to_matrix(quaternion), atol=1e-5
        )
        np.testing.assert_array_equal(placed.angles, skeleton.relaxed)
        left = np.asarray(placement.ankles[0] - placement.ankles[1])
        np.testing.assert_allclose(
            left[:2], 0.17 * np.array([-np.sin(yaw), np.cos(yaw)]), atol=1e-5
        )


def standing(skeleton):
    """The relaxed body on its feet, its markers, and the state that holds it."""
    targets = points_of(skeleton, random_pose(skeleton, 0, 0.0))[:3]
    return targets, settled(skeleton, targets)


def test_feet_stay_where_they_stand_while_the_head_sways(skeleton):
    targets, actual = standing(skeleton)
    pose, placement = actual.pose, actual.feet
    for sway in np.sin(np.linspace(0, 2 * np.pi, 12)):
        moved = targets + on_device(np.array([0.1 * sway, 0.1 * sway, -0.05 * abs(sway)]))
        result = solve(skeleton, IKSettings(), pose, placement, moved)
        pose, placement = result.pose, result.feet
        assert not result.planted
        np.testing.assert_array_equal(placement.ankles, actual.feet.ankles)
        assert misses(skeleton, pose, moved).max() < 0.01
        assert np.abs(points_of(skeleton, pose)[3:] - placement.ankles).max() < 0.03


def test_feet_are_planted_again_when_the_head_leaves_the_stance(skeleton):
    targets, actual = standing(skeleton)
    away = targets + jnp.array([0.5, 0.0, 0.0])
    result = solve(skeleton, IKSettings(), actual.pose, actual.feet, away)
    assert bool(result.planted)
    middle = np.asarray(result.feet.ankles).mean(0)
    np.testing.assert_allclose(middle[:2], away[0, :2], atol=1e-5)
    again = solve(skeleton, IKSettings(), result.pose, result.feet, away)
    assert not again.planted
    assert misses(skeleton, again.pose, away).max() < 0.01


def test_feet_are_planted_again_when_a_leg_was_overstretched(skeleton):
    targets, actual = standing(skeleton)
    # Out to the side as far as the stance allows, and up on the toes.
    away = targets + jnp.array([0.35, 0.0, 0.06])
    chosen = IKSettings()
    first = solve(skeleton, chosen, actual.pose, actual.feet, away)
    assert bool(first.feet.overstretched) and not first.planted
    second = solve(skeleton, chosen, first.pose, first.feet, away)
    assert bool(second.planted)
    middle = np.asarray(second.feet.ankles).mean(0)
    np.testing.assert_allclose(middle[:2], away[0, :2], atol=1e-5)


def facing(pose):
    """Radians from the world's +x."""
    R = np.asarray(quaternion_to_matrix(pose.quaternion))
    return np.arctan2(R[1, 0], R[0, 0])


def turned_about(points, yaw):
    """Points turned about the first one's vertical."""
    c, s = np.cos(yaw), np.sin(yaw)
    away = np.asarray(points) - np.asarray(points)[0]
    return on_device(away @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + np.asarray(points)[0])


@pytest.mark.parametrize("yaw", np.linspace(-3, 3, 5))
def test_hands_say_that_a_body_faces_away(skeleton, yaw):
    model, (targets, actual) = Model.create(skeleton), standing(skeleton)
    hands = targets[0] + jnp.array([[0.0, 0.0, 0.0], [0.2, 0.25, -0.7], [0.2, -0.25, -0.7]])
    there = turned_about(hands, facing(actual.pose) + yaw)
    assert bool(feet.faces_away(model, actual.pose, there)) == (abs(yaw) > np.pi / 2)
    # Hands that are together, or one that is missing, say nothing.
    for changed in (there.at[1].set(there[2]), there.at[1].set(jnp.nan), there.at[0].set(jnp.nan)):
        assert not feet.faces_away(model, actual.pose, changed)


def test_who_turns_on_the_spot_is_turned_with(slim_woman, skeleton):
    """The feet's place held the body: it was 150 degrees off where the person had turned."""
    person, times = exercise(slim_woman, "turn", 3.0, 52), np.arange(0, 3, 1 / 60)
    truth = person.landmarks(times)
    markers = np.stack([truth[name] for name in NAMES[:3]], 1)
    hips = truth["hip_l"] - truth["hip_r"]
    pose, placement = nowhere(Model.create(skeleton))
    for there, left in zip(markers, hips, strict=True):
        result = solve(skeleton, IKSettings(), pose, placement, on_device(there))
        pose, placement = result.pose, result.feet
        off = abs(np.angle(np.exp(1j * (facing(pose) - np.arctan2(-left[0], left[1])))))
        assert np.degrees(off) < 100.0
    assert np.degrees(off) < 30.0


def test_crossed_arms_do_not_turn_a_body(skeleton):
    targets, actual = standing(skeleton)
    crossed = targets[0] + jnp.array([[0.0, 0.0, 0.0], [0.3, -0.15, -0.5], [0.3, 0.15, -0.5]])
    crossed = turned_about(crossed, facing(actual.pose))
    pose, placement = actual.pose, actual.feet
    for share in np.linspace(0, 1, 20):
        there = (1 - share) * targets + share * crossed
        result = solve(skeleton, IKSettings(), pose, placement, there)
        pose, placement = result.pose, result.feet
        assert not result.placed
    assert np.cos(facing(pose) - facing(actual.pose)) > 0.9


def test_without_a_marker_on_the_head_feet_are_never_planted_again(skeleton):
    targets, actual = standing(skeleton)
    away = (targets + jnp.array([0.8, 0.0, 0.0])).at[0].set(jnp.nan)
    result = solve(skeleton, IKSettings(), actual.pose, actual.feet, away)
    assert not result.planted


def test_algorithm_1_stops_when_it_rests_and_never_goes_on_for_ever(skeleton):
    pose, chosen = random_pose(skeleton, 0, 0.0), IKSettings(iterations=12, settle=3)
    targets, weights = points_of(skeleton, pose), jnp.ones(5)
    assert solved(skeleton, chosen, pose, targets, weights)[1] == 3
    hopeless = targets + jnp.array([0.0, 0.0, 5.0])
    assert solved(skeleton, chosen, pose, hopeless, weights)[1] <= 12


@pytest.mark.parametrize("solver", ["newton", "sdls"])
def test_both_solvers_follow_a_hand_that_moves(skeleton, solver):
    chosen = IKSettings(solver=solver)
    truth = random_pose(skeleton, 4, 0.3)
    targets, weights = points_of(skeleton, truth), jnp.ones(5)
    moved = targets.at[1, 0].add(0.04)
    pose = followed(skeleton, chosen, truth, moved, weights)
    assert misses(skeleton, pose, moved).max() < 0.002


def test_who_squats_by_head_and_hands_has_the_hips_less_far_ahead():
    """They hung 45 cm ahead of the feet, and shanks lay on the ground."""
    model, solve = on_unmarked_feet(Model.create(Skeleton.human(1.75))), jax.jit(ik.solve_ik)
    # Vertex, left and right wrist of somebody who stands and faces along x.
    points = np.array([[0.0, 0.0, 1.75], [0.1, 0.28, 0.85], [0.1, -0.28, 0.85]])
    pose, placement = nowhere(model)
    for depth in np.linspace(0, 0.42, 15):
        targets = on_device(points + np.array([0.55 * depth, 0.0, -depth]))
        pose, placement, *_ = solve(model, IKSettings(), pose, placement, targets)
    at = dict(zip(LANDMARKS, np.asarray(LANDMARKS_OF(model.skeleton, pose)), strict=True))
    assert at["hip_l"][0] - at["ankle_l"][0] < 0.3
    assert np.linalg.norm(at["vertex"] - np.asarray(targets)[0]) < 0.03
