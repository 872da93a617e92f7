"""Balance in a squat: where the centre of gravity goes, and when the heuristic keeps still."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import double, on_device, poses
from hypothesis import given

from jaxmocap.body.kinematics import forward, landmarks
from jaxmocap.body.mass import base_of_support, centre_of_gravity
from jaxmocap.body.model import Model, on_unmarked_feet
from jaxmocap.body.pose import relaxed_pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.evidence.terms import Measurements
from jaxmocap.hybrid import balance, ik
from jaxmocap.hybrid.settings import IKSettings
from jaxmocap.reference.hybrid import balance as reference

FACTORS = jax.jit(balance.bow_factors)
GRAVITY = jax.jit(lambda skeleton, pose: centre_of_gravity(skeleton, forward(skeleton, pose)))
LANDMARKS_OF = jax.jit(landmarks)
# Body heights in metres; None is the paper's subject.
HEIGHTS = [None, 1.55, 1.75, 1.95]


def body(height, unmarked):
    skeleton = Skeleton.human(height, proportions="winter")
    return on_unmarked_feet(Model.create(skeleton)).skeleton if unmarked else skeleton


@jax.jit
def squat(skeleton, start, depth, factors):
    """One depth of a squat as the tracker goes through it: solve, bow, solve again."""
    settings, goals = IKSettings(), balance.squat_goals(skeleton, depth)
    foot = skeleton.diameters[skeleton.tree.bone("foot_l"), 0]
    lift = foot - goals.targets[3, 2]
    goals = goals._replace(targets=goals.targets.at[:, 2].add(lift))
    model, measured = Model.create(skeleton, goals.sites), Measurements(goals=goals)
    pose = ik.reach(model, settings, measured, start)
    bowed, free, bows = balance.bow_on_feet(skeleton, settings, pose, factors)
    balanced = ik.reach(model, settings, measured, bowed, free)
    return pose, balanced, bows, ik.goal_distances(skeleton, goals, forward(skeleton, balanced))


def outside(skeleton, pose):
    """By how much (metres) the centre of gravity is out of the box of ankles and toes."""
    gravity = np.asarray(GRAVITY(skeleton, pose))[:2]
    points = dict(zip(LANDMARKS, np.asarray(LANDMARKS_OF(skeleton, pose)), strict=True))
    feet = np.array([points[f"{name}_{side}"] for name in ("ankle", "toe") for side in "lr"])
    low, high = base_of_support(feet)
    return np.maximum(np.maximum(low - gravity, gravity - high), 0).max()


def through_a_squat(skeleton, factors, depths=np.linspace(0, 0.3, 7)):  # noqa: B008
    pose = relaxed_pose(skeleton)
    for depth in depths:
        pose, balanced, bows, distances = squat(skeleton, pose, jnp.asarray(depth, float), factors)
        yield depth, pose, balanced, bool(bows), np.asarray(distances)


@pytest.mark.parametrize("unmarked", [False, True])
@pytest.mark.parametrize("height", HEIGHTS)
def test_the_centre_of_gravity_stays_above_the_feet_at_every_depth(height, unmarked):
    skeleton = body(height, unmarked)
    factors = FACTORS(skeleton, IKSettings())
    for depth, _, balanced, bows, distances in through_a_squat(skeleton, factors):
        assert outside(skeleton, balanced) < 1e-6, depth
        assert distances.max() < 0.02, depth
        assert bows == (depth > 0)


@pytest.mark.parametrize("height", HEIGHTS)
def test_without_the_bow_it_leaves_them(height):
    """With markers on all five, what balance is there for happens."""
    skeleton = body(height, unmarked=False)
    *_, (_, pose, _, _, _) = through_a_squat(skeleton, jnp.zeros(3))
    assert outside(skeleton, pose) > 0.01


def test_the_factors_follow_the_bodys_proportions():
    settings = IKSettings()
    paper = Skeleton.human()
    bodies = [paper, Skeleton.human(1.55), Skeleton.human(1.95)]
    long_femurs = np.array(paper.lengths)
    long_femurs[[paper.tree.bone(f"femur_{side}") for side in "lr"]] *= 1.15
    heavy_head = np.array(paper.masses)
    heavy_head[paper.tree.bone("head")] *= 3
    bodies.append(replace(paper, lengths=on_device(long_femurs)))
    bodies.append(replace(paper, masses=on_device(heavy_head)))
    actual = np.array([FACTORS(each, settings) for each in bodies])
    assert (actual > 0).all()
    assert np.ptp(actual[:, 0]) > 0.1
    gaps = np.abs(actual[:, None, 0] - actual[None, :, 0])[~np.eye(len(bodies), dtype=bool)]
    assert gaps.min() > 1e-3
    # The three bones share the bow in proportion to their ranges.
    dofs = balance.spine_dofs(paper)
    ranges = np.asarray(paper.limits)[dofs, 1] - np.asarray(paper.relaxed)[dofs]
    np.testing.assert_allclose(actual[0] / actual[0, 0], ranges / ranges[0], rtol=1e-5)


def feet_at(skeleton, left, right):
    """Ankles that much (metres) above where they stand."""
    height = float(skeleton.diameters[skeleton.tree.bone("foot_l"), 0])
    return jnp.array([[0.0, 0.1, height + left], [0.0, -0.1, height + right]]), height


@pytest.mark.parametrize(
    ("left", "right", "stands"),
    [
        (0.0, 0.0, True),
        (0.02, 0.0, True),
        (0.06, 0.0, False),  # the left foot lifted
        (0.0, 0.3, False),  # the right foot lifted
        (0.2, 0.2, False),  # in flight
    ],
)
def test_balance_is_for_those_who_stand_on_both_feet(skeleton, left, right, stands):
    ankles, height = feet_at(skeleton, left, right)
    for floor in (0.0, 1.5):
        raised = ankles.at[:, 2].add(floor)
        assert bool(balance.on_both_feet(raised, jnp.asarray(floor), height)) is stands
        assert bool(reference.on_both_feet(np.asarray(raised), floor, height)) is stands


def test_who_stands_upright_is_left_alone(skeleton):
    pose, foot = relaxed_pose(skeleton), skeleton.diameters[skeleton.tree.bone("foot_l"), 0]
    ankle = LANDMARKS_OF(skeleton, pose)[LANDMARKS.index("ankle_l"), 2]
    pose = pose._replace(position=pose.position.at[2].add(foot - ankle))
    after, free, bows = jax.jit(balance.bow_on_feet)(skeleton, IKSettings(), pose, jnp.ones(3))
    assert not bows and bool(free.all())
    np.testing.assert_array_equal(after.angles, pose.angles)


@jax.jit
def measured(skeleton, settings, pose, factors):
    bow = balance.bow_on_feet(skeleton, settings, pose, factors)
    return bow, balance.sinking(skeleton, pose), balance.imbalance(skeleton, pose)


def with_bent_legs(skeleton, pose):
    """The same trunk and arms on two feet, side by side, knees bent."""
    angles, bend = pose.angles.copy(), 0.3 + 0.5 * abs(pose.quaternion[0])
    for side in "lr":
        for name, share in (("flexion", 0.6), ("abduction", 0.1), ("rotation", 0.0)):
            angles[skeleton.tree.joint(f"hip_{name}_{side}")] = share * bend
        angles[skeleton.tree.joint(f"knee_flexion_{side}")] = bend
    half = pose.position[2]
    return pose._replace(angles=angles, quaternion=np.array([np.cos(half), 0, 0, np.sin(half)]))


@given(pose=poses())
def test_double_precision_agrees_with_the_reference(skeleton64, pose):
    factors, body64 = np.array([0.7, 1.1, 0.4]), jax.tree.map(np.asarray, skeleton64)
    foot = float(skeleton64.diameters[skeleton64.tree.bone("foot_l"), 0])
    for tried, on_feet in ((pose, False), (with_bent_legs(skeleton64, pose), True)):
        with double():
            floor = reference.ankles(body64, tried)[0, 2] - foot
            settings = IKSettings(floor=floor)
            ours, sunk, (ahead, out) = measured(
                skeleton64, settings, on_device(tried), on_device(factors)
            )
        theirs = reference.bow_on_feet(body64, settings, tried, factors)
        assert bool(ours[2]) == theirs[2]
        assert theirs[2] or not on_feet
        np.testing.assert_allclose(ours[0].angles, theirs[0].angles, rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(ours[1], theirs[1])
        assert float(sunk) == pytest.approx(reference.sinking(body64, tried), abs=1e-12)
        expected = reference.imbalance(body64, tried)
        assert float(ahead) == pytest.approx(expected[0], abs=1e-9)
        assert float(out) == pytest.approx(expected[1], abs=2e-9)
