"""Joints and skin that go along with angles: (4.21) to (4.28), their ends and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import screws
from conftest import double, in_double
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from point_rays import on_rays

from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import Pose, retract
from jaxmocap.body.skeleton import Skeleton, with_joints
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces import morphing as b
from jaxmocap.body.surfaces.loft import generic_surface
from jaxmocap.body.surfaces.surface import (
    BodyPoints,
    Surface,
    pose_points,
    resample_surface,
    rest_nodes,
    skin_nodes,
    skin_of,
)
from jaxmocap.geometry.lines import lines_through
from jaxmocap.silhouette.points import driver_point_jacobian, point_jacobian
from jaxmocap.silhouette.pose import PoseSettings, solve_pose
from jaxmocap.silhouette.surfaces import morph as m
from jaxmocap.silhouette.surfaces import swelling as s

BODY = with_joints(Skeleton.human(1.75, proportions="winter"), "supple.toml")
SURFACE, JOINTS, TREE = generic_surface(BODY), rest_joints(BODY), BODY.tree
LIFT = b.Driver(("arm_flex_l", "arm_abduct_l"))
BENT = b.Driver(("elbow_flex_l",), "squared")
TOP = b.Swelling("arm_l", LIFT, (1.2, 0.1), (0.8, 0.1), 0.03)
AHEAD = b.Swelling("torso", BENT, (0.3, 0.6), (1.0, 0.2), 0.02, (1.0, 0.0, 0.0))
SHOULDER = b.Morphing(
    (b.Follower("clavicle_raise_l", LIFT, 0.25), b.Follower("clavicle_protract_l", LIFT, -0.4)),
    (TOP, AHEAD),
)
MORPH = s.morph_around(SHOULDER, TREE, SURFACE, JOINTS)
MOVES = np.asarray(MORPH.moves)
ROWS = np.random.default_rng(0).choice(len(SURFACE.points.bones), 150, replace=False)
# Away from limits, where angles stop.
LOW, HIGH = np.asarray(BODY.limits, float).T
angles = st.lists(st.floats(0.15, 0.85), min_size=len(LOW), max_size=len(LOW)).map(
    lambda shares: LOW + np.array(shares) * (HIGH - LOW)
)


def corresponding(surface: Surface, joints: np.ndarray, like: Surface) -> Surface:
    """A surface carried by the same bones as another, node for node; at rest it stays as it is."""
    nodes, bones = rest_nodes(surface, joints), like.points.bones
    places = jnp.asarray(nodes[:, None] - joints[np.asarray(bones)], float)
    return Surface(like.patches, BodyPoints(bones, places, like.points.shares))


def interpolated(
    first: BodyPoints, second: BodyPoints, t: jax.Array | float, weighting: str = "linear"
) -> BodyPoints:
    """F_t of (4.26): the second surface's points at t = 0, the first's at t = 1."""
    weight = b.WEIGHTINGS[weighting](jnp.asarray(t))
    places, shares = (
        weight * jnp.asarray(a) + (1 - weight) * jnp.asarray(b)
        for a, b in zip(first[1:], second[1:], strict=True)
    )
    return BodyPoints(first.bones, places, shares)


def standing(at) -> Pose:
    return Pose(jnp.zeros(3, float), jnp.eye(4, dtype=float)[0], jnp.asarray(at, float))


@jax.jit
def moved_by(body, morph, points, moves, free, step):
    """Where points go with a tangent vector of the free pose."""
    full = m.with_followers(morph, retract(free, step), body)
    return pose_points(
        forward(body, full), m.moved_points(points, moves, m.driver_values(morph, full.angles))
    )


@jax.jit
def predicted(body, morph, points, moves, free):
    """(N, 3, 6 + D) the derivative that the tracker's system is made of."""
    full = m.with_followers(morph, free, body)
    frames = forward(body, full)
    gone = m.moved_points(points, moves, m.driver_values(morph, full.angles))
    by_drivers = driver_point_jacobian(frames, gone, moves) @ m.driver_jacobian(morph, full.angles)
    J = point_jacobian(body, frames, gone) + by_drivers
    return J @ m.followed_jacobian(morph, full.angles)


@settings(max_examples=5)
@given(angles)
def test_the_derivative_is_what_finite_differences_say(at):
    with double():
        body, morph = in_double(BODY), in_double(MORPH)
        points = in_double(BodyPoints(*(np.asarray(x)[ROWS] for x in SURFACE.points)))
        points = points._replace(bones=np.asarray(SURFACE.points.bones)[ROWS])
        moves, free, h = morph.moves[ROWS], standing(at), 1e-5
        # What follows may reach a limit where nothing else does, and stops there.
        followed = np.asarray(m.with_followers(morph, free, body).angles)
        assume(((followed > LOW + h) & (followed < HIGH - h)).all())
        J = np.asarray(predicted(body, morph, points, moves, free))
        for column in range(J.shape[-1]):
            step = np.zeros(J.shape[-1])
            step[column] = h
            ends = [moved_by(body, morph, points, moves, free, sign * step) for sign in (1, -1)]
            slope = np.asarray(ends[0] - ends[1]) / (2 * h)
            np.testing.assert_allclose(J[..., column], slope, atol=1e-7)


def test_a_solve_finds_the_pose_that_moved_the_skin_along():
    rng = np.random.default_rng(1)
    points = BodyPoints(*(np.asarray(part)[ROWS] for part in SURFACE.points))
    truth, start = (LOW + share * (HIGH - LOW) for share in (rng.uniform(0.3, 0.7, len(LOW)), 0.5))
    truth = start + 0.15 * np.clip(truth - start, -1, 1)
    still = jnp.zeros(6 + len(LOW))
    measured = moved_by(BODY, MORPH, points, MOVES[ROWS], standing(truth), still)
    # Two cameras' rays through each point: one of them cannot tell how far it is.
    eyes = np.repeat([[4.0, 0.3, 0.2], [0.5, 4.0, 0.4]], len(ROWS), 0)
    twice = BodyPoints(*(np.tile(part, (2,) + (1,) * (part.ndim - 1)) for part in points))
    ways = np.tile(measured, (2, 1)) - eyes
    lines = lines_through(jnp.asarray(eyes), jnp.asarray(unit(ways)))
    rays = on_rays(twice, lines)._replace(moves=np.tile(MOVES[ROWS], (2, 1, 1)))
    how = PoseSettings(deviation=0.1, iterations=40)
    first = m.with_followers(MORPH, standing(start), BODY)
    found = jax.jit(solve_pose)(BODY, first, rays, how, morph=MORPH)
    free = m.without_followers(MORPH, found.pose)
    there = moved_by(BODY, MORPH, points, MOVES[ROWS], free, still)
    np.testing.assert_allclose(there, measured, atol=1e-3)
    assert np.abs(np.asarray(first.angles) - np.asarray(found.pose.angles)).max() > 0.05


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


RAISE, PROTRACT = (TREE.joint(f"clavicle_{name}_l") for name in ("raise", "protract"))
ARM = [TREE.joint(f"arm_{name}_l") for name in ("flex", "abduct", "rot")]


@jax.jit
def transported(carried, both, turns):
    """Screws moved as two others turn, one after the other."""
    return screws.transport(screws.product_of_exponentials(both, turns), carried)


def joint_screws(frames, joints):
    """(J, 6) of joints in the world."""
    pivots = np.asarray(frames.joints_world)[np.array(TREE.dof_bones)[joints]]
    axes = np.asarray(frames.axes_world)[joints]
    return np.concatenate([np.cross(pivots, axes), axes], 1)


@settings(max_examples=10)
@given(angles)
def test_a_shoulder_s_hinges_are_carried_along_as_equation_4_21_says(at):
    at = at.copy()
    at[[RAISE, PROTRACT]] = 0.0
    free = standing(at)
    full = WITH_FOLLOWERS(MORPH, free, BODY)
    turns = np.asarray(full.angles)[[RAISE, PROTRACT]]
    assert turns[0] > 0 > turns[1]
    before = FORWARD(BODY, free)
    both = joint_screws(before, [RAISE, PROTRACT])
    lifted = transported(joint_screws(before, ARM), both, turns)
    np.testing.assert_allclose(joint_screws(FORWARD(BODY, full), ARM), lifted, atol=2e-5)


@given(angles)
def test_what_follows_can_be_taken_off_again(at):
    free = standing(at)
    back = FREE(MORPH, WITH_FOLLOWERS(MORPH, free, BODY))
    inside = np.asarray(WITH_FOLLOWERS(MORPH, free, BODY).angles)
    kept = (inside > LOW + 1e-6) & (inside < HIGH - 1e-6)
    np.testing.assert_allclose(back.angles[kept], free.angles[kept], atol=1e-6)


def test_a_hanging_arm_moves_nothing_and_a_raised_one_its_own_side():
    hanging = WITH_FOLLOWERS(MORPH, standing(np.zeros(len(LOW))), BODY)
    np.testing.assert_array_equal(hanging.angles, 0)
    raised = np.zeros(len(LOW))
    raised[TREE.joint("arm_abduct_l")] = np.radians(150)
    angles_then = np.asarray(WITH_FOLLOWERS(MORPH, standing(raised), BODY).angles)
    at = dict(zip(TREE.joints, angles_then, strict=True))
    assert at["clavicle_raise_l"] == pytest.approx(0.25 * 0.933, abs=1e-3)
    assert at["clavicle_raise_r"] == at["clavicle_protract_r"] == 0


def test_without_drivers_all_is_as_it_was():
    nothing = s.morph_around(b.Morphing(), TREE, SURFACE, JOINTS)
    pose = standing(np.linspace(0.1, 0.2, len(LOW)).clip(LOW, HIGH))
    np.testing.assert_array_equal(m.with_followers(nothing, pose, BODY).angles, pose.angles)
    assert nothing.moves is None


@jax.jit
def both_ways(skin, pose, frames):
    """Nodes as they are drawn, as they were, and as points on bones."""
    gone = m.moved_points(SURFACE.points, MOVES, m.driver_values(MORPH, pose.angles))
    worn = m.morphed_skin(skin, MORPH, pose.angles)
    return skin_nodes(frames, worn), skin_nodes(frames, skin), pose_points(frames, gone)


def test_the_worn_skin_is_where_its_points_are():
    at = np.zeros(len(LOW))
    at[[TREE.joint("arm_abduct_l"), TREE.joint("elbow_flex_l")]] = 2.0, 1.0
    pose, skin = standing(at), skin_of(SURFACE, JOINTS)
    frames = FORWARD(BODY, pose)
    drawn, still, there = both_ways(skin, pose, frames)
    np.testing.assert_allclose(np.stack(drawn, 1), there, atol=3e-6)
    assert np.linalg.norm(np.stack(drawn, 1) - np.stack(still, 1), axis=1).max() > 0.015


@pytest.mark.parametrize("name", b.WEIGHTINGS)
def test_a_weighting_goes_from_0_to_1_and_has_a_derivative_everywhere(name):
    values = jax.jit(jax.vmap(jax.value_and_grad(b.WEIGHTINGS[name])))
    weights, slopes = map(np.asarray, values(np.linspace(0, 1, 101, dtype=np.float32)))
    assert weights[0] == 0 and weights[-1] == 1 and (np.diff(weights) > 0).all()
    assert np.isfinite(slopes).all()


def test_the_root_begins_fast_and_the_square_slowly():
    root, line, square = (b.WEIGHTINGS[k](0.3) for k in ("square_root", "linear", "squared"))
    assert root > line > square


def test_one_person_becomes_another():
    other = with_joints(Skeleton.human(1.55), "supple.toml")
    joints = rest_joints(other)
    second = corresponding(generic_surface(other, 1.2), joints, SURFACE)
    was = rest_nodes(generic_surface(other, 1.2), joints)
    np.testing.assert_allclose(rest_nodes(second, joints), was, atol=1e-6)
    first, second = SURFACE.points, second.points
    np.testing.assert_allclose(interpolated(first, second, 1.0).points_bone, first.points_bone)
    np.testing.assert_allclose(interpolated(first, second, 0.0).points_bone, second.points_bone)
    half = interpolated(first, second, 0.25, "square_root").points_bone
    middle = (np.asarray(first.points_bone) + np.asarray(second.points_bone)) / 2
    np.testing.assert_allclose(half, middle, atol=1e-6)


@pytest.mark.parametrize("weighting", b.WEIGHTINGS)
def test_a_body_goes_over_into_another_as_equation_4_26_says(weighting):
    """Steered by an elbow's angle of 0 to 1 radian, node by node as ``between`` has it."""
    stouter = corresponding(generic_surface(BODY, 1.3), JOINTS, SURFACE)
    over = b.Transition(b.Driver(("elbow_flex_l",), weighting), stouter)
    morph = s.morph_around(b.Morphing(transitions=(over,)), TREE, SURFACE, JOINTS)
    for t in (0.0, 0.3, 1.0):
        at = np.zeros(len(LOW))
        at[TREE.joint("elbow_flex_l")] = t
        gone = m.moved_points(SURFACE.points, np.asarray(morph.moves), m.driver_values(morph, at))
        there = interpolated(stouter.points, SURFACE.points, t, weighting)
        frames = FORWARD(BODY, standing(at))
        np.testing.assert_allclose(pose_points(frames, gone), pose_points(frames, there), atol=2e-6)


def test_only_patches_that_are_named_go_over_and_denser_nodes_as_the_others():
    stouter = generic_surface(BODY, 1.3)
    over = b.Transition(LIFT, stouter, ("arm_l",))
    dense = resample_surface(SURFACE, JOINTS, 0.03)
    moves = s.transition_offsets(SURFACE, JOINTS, over, 0.03)
    arm = next(patch for patch in dense.patches if patch.name == "arm_l")
    assert len(moves) == len(dense.points.bones)
    assert np.linalg.norm(moves[arm.nodes], axis=1).max() > 0.01
    moves[arm.nodes] = 0.0
    np.testing.assert_array_equal(moves, 0)


def test_surfaces_of_other_patches_do_not_correspond():
    fewer = type(SURFACE)(SURFACE.patches[1:], SURFACE.points)
    with pytest.raises(ValueError, match="node for node"):
        s.transition_offsets(SURFACE, JOINTS, b.Transition(LIFT, fewer))


@given(
    st.tuples(st.floats(-np.pi, np.pi), st.floats(0, 1)),
    st.tuples(st.floats(0.2, 2), st.floats(0.05, 1)),
)
def test_the_radial_function_is_the_paper_s_around_a_limb(centre, radii):
    phi, share = np.linspace(-3, 3, 13) + centre[0], np.linspace(0, 1, 13)
    r_x, r_y = np.square(radii)
    expected = np.exp(-((phi - centre[0]) ** 2) / r_x) * np.exp(-((share - centre[1]) ** 2) / r_y)
    places = np.stack([phi + 2 * np.pi, share], 1).astype(np.float32)
    actual = s.radial(places, np.float32(centre), np.float32(radii))
    np.testing.assert_allclose(actual, expected, atol=1e-4)


def test_a_swelling_is_highest_at_its_centre_and_goes_outwards():
    moves = s.swelling_moves(SURFACE, JOINTS, (LIFT,), (TOP,))[..., 0]
    patch = next(each for each in SURFACE.patches if each.name == "arm_l")
    grid = rest_nodes(SURFACE, JOINTS)[patch.nodes].reshape(patch.along, patch.around, 3)
    places = s.patch_coordinates(patch, grid)
    far = np.linalg.norm(moves, axis=1)
    assert 0.9 * TOP.gain < far.max() <= TOP.gain + 1e-6
    assert np.abs(places[far[patch.nodes].argmax()] - TOP.centre).max() < 0.3
    outwards = (grid - grid.mean(1, keepdims=True)).reshape(-1, 3)
    strong = far[patch.nodes] > 0.01
    assert (np.sum(moves[patch.nodes] * outwards, 1)[strong] > 0).all()
    np.testing.assert_array_equal(np.delete(far, np.r_[patch.nodes]), 0)


def test_several_places_swell_at_once_each_by_its_own_driver():
    both = s.swelling_moves(SURFACE, JOINTS, (LIFT, BENT), (TOP, TOP, AHEAD))
    np.testing.assert_allclose(both[..., 0], 2 * MOVES[..., 0], atol=1e-7)
    np.testing.assert_allclose(both[..., 1], MOVES[..., 1], atol=1e-7)
    np.testing.assert_array_equal(both[:, 1:, 1], 0)


def test_the_shoulders_of_the_package_are_alike_on_both_sides():
    morphing = b.shoulders()
    count = len(morphing.followers) // 2
    for left, right in zip(morphing.followers[:count], morphing.followers[count:], strict=True):
        assert left.gain == right.gain and left.joint[:-1] == right.joint[:-1]
    assert len(morphing.drivers) == 2
    s.morph_around(morphing, TREE, SURFACE, JOINTS)


def test_a_trunk_s_swelling_is_mirrored_on_the_one_patch_that_it_has():
    row = {"patch": "torso", "steered_by": ["arm_flex"], "gain": 0.01}
    row |= {"centre": [60.0, 0.6], "radii": [45.0, 0.1], "weighting": "squared"}
    morphing = b.morphing_of({"swelling": [row]})
    left, right = np.moveaxis(
        np.asarray(s.morph_around(morphing, TREE, SURFACE, JOINTS).moves), 2, 0
    )
    at = rest_nodes(SURFACE, JOINTS)
    high = np.linalg.norm(left, axis=1).argmax()
    opposite = np.linalg.norm(at - at[high] * [1, -1, 1], axis=1).argmin()
    assert at[high, 1] > 0.05 > np.linalg.norm(at[opposite] - at[high] * [1, -1, 1])
    np.testing.assert_allclose(right[opposite], left[high] * [1, -1, 1], atol=1e-4)
    assert np.linalg.norm(left[high]) > 0.008


@pytest.mark.parametrize(
    ("morphing", "kind", "says"),
    [
        (b.Morphing((b.Follower("wing_l", LIFT, 1.0),)), KeyError, "wing_l"),
        (b.Morphing((b.Follower("arm_flex_l", LIFT, 1.0),)), ValueError, "drives and follows"),
        (b.Morphing((), (TOP._replace(patch="tail"),)), ValueError, "arm_l"),
        (b.Morphing(transitions=(b.Transition(LIFT, SURFACE, ("tail",)),)), ValueError, "tail"),
        (b.Morphing((), (TOP._replace(driver=b.Driver(("arm_rot_l",), "cubed")),)), KeyError, "sq"),
    ],
)
def test_what_cannot_go_along_is_named(morphing, kind, says):
    with pytest.raises(kind, match=says):
        s.morph_around(morphing, TREE, SURFACE, JOINTS)


FORWARD, WITH_FOLLOWERS, FREE = (
    jax.jit(forward),
    jax.jit(m.with_followers),
    jax.jit(m.without_followers),
)
