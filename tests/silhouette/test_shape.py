"""A person's shape by contours: fields of a surface, and what frames tell of their amounts."""

from dataclasses import replace
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from test_point_rays import ring
from test_rim import BODY, FORWARD, POSED, PROJECT

from jaxmocap.body.pose import relaxed_pose
from jaxmocap.body.proportions import LENGTHS, scale_skeleton, stretch_points
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.loft import generic_surface
from jaxmocap.body.surfaces.surface import BodyPoints, resample_surface, rest_nodes
from jaxmocap.geometry.cameras import stack_cameras
from jaxmocap.silhouette.fit.correspond import ContourPairs
from jaxmocap.silhouette.passes import PassLearner
from jaxmocap.silhouette.surfaces.shape import DEVIATION_M, ShapeEstimator, shape_equations
from jaxmocap.silhouette.surfaces.swelling import KINDS, fields_of, swell_surface

SURFACE, JOINTS = generic_surface(BODY), rest_joints(BODY)
FIELDS = fields_of(SURFACE, JOINTS)


def moved(*name) -> np.ndarray:
    """(N, 3) how 1 cm of one field moves the nodes at rest."""
    amounts = np.where([each == name for each in FIELDS.names], 0.01, 0.0)
    assert amounts.any()
    return rest_nodes(swell_surface(SURFACE, FIELDS, amounts), JOINTS) - rest_nodes(SURFACE, JOINTS)


def patch(name: str) -> slice:
    return next(each.nodes for each in SURFACE.patches if each.name == name)


def test_no_amounts_are_the_generic_body():
    same = swell_surface(SURFACE, FIELDS, np.zeros(len(FIELDS.names)))
    np.testing.assert_array_equal(same.points.points_bone, SURFACE.points.points_bone)


def test_a_girth_moves_its_stretch_of_both_limbs_outwards_and_nothing_else():
    off = moved("leg", "girth", 3)
    far = np.linalg.norm(off, axis=1)
    assert far[patch("leg_l")].max() == pytest.approx(0.01, rel=0.1)
    np.testing.assert_allclose(far[patch("leg_l")], far[patch("leg_r")], atol=1e-6)
    np.testing.assert_allclose(off[:, 2], 0, atol=1e-6)
    others = [far[patch(name)] for name in ("torso", "arm_l", "arm_r", "foot_l", "foot_r")]
    np.testing.assert_array_equal(np.concatenate(others), 0)


def test_both_sides_are_moved_as_in_a_mirror():
    for kind in KINDS:
        left, right = (moved("arm", kind, 2)[patch(f"arm_{side}")] for side in "lr")
        np.testing.assert_allclose(left, right * [1, -1, 1], atol=1e-6)


def test_a_trunk_is_the_same_on_both_sides():
    assert {kind for limb, kind, _ in FIELDS.names if limb == "torso"} == {"girth", "ahead", "flat"}


def test_the_fields_of_a_denser_surface_move_it_as_much():
    dense = resample_surface(SURFACE, JOINTS, 0.03)
    fields = fields_of(dense, JOINTS)
    assert fields.names == FIELDS.names
    girth = [name[1] == "girth" for name in fields.names]
    # All stretches together are the whole limb.
    far = np.linalg.norm(fields.moves[:, :, girth].sum(-1), axis=1)
    np.testing.assert_allclose(far, 1, atol=1e-5)


def test_contours_of_a_stouter_body_tell_how_much_stouter(camera_pairs):
    H, slope, amounts = camera_pairs
    poses = len(slope) - len(amounts)
    # At the true pose all that is off is the shape.
    expected = -H @ np.append(np.zeros(poses), amounts)
    np.testing.assert_allclose(slope, expected, atol=0.02 * np.abs(expected).max())


@pytest.fixture(scope="module")
def camera_pairs():
    """What one frame measures: nodes of a body in a bent pose, and where a stouter one's appear."""
    rng = np.random.default_rng(2)
    pose = relaxed_pose(BODY)
    angles = np.asarray(pose.angles) + rng.uniform(-0.1, 0.1, len(pose.angles))
    pose = pose._replace(angles=jnp.asarray(angles, jnp.float32))
    amounts = 0.002 * rng.standard_normal(len(FIELDS.names))
    stout = swell_surface(SURFACE, FIELDS, amounts)
    return *measured_shape(rng, pose, (BODY, stout)), amounts


def measured_shape(rng, pose, shown, **lengths):
    """Normal equations of our shape by the contours of another skeleton and surface."""
    cameras, nodes = stack_cameras(ring(2)), rng.integers(0, len(FIELDS.moves), (2, 300))
    every = PROJECT(cameras, POSED(FORWARD(shown[0], pose), shown[1].points))
    pixels = np.stack([np.asarray(every)[camera, nodes[camera]] for camera in range(2)])
    turns = rng.uniform(0, 2 * np.pi, nodes.shape)
    normals = np.stack([np.cos(turns), np.sin(turns)], -1).astype(np.float32)
    points = BodyPoints(*(np.asarray(part)[nodes.ravel()] for part in SURFACE.points))
    pairs = ContourPairs(points, pixels, normals, np.ones(nodes.shape, np.float32), nodes)
    H, slope = shape_equations(BODY, cameras, pose, pairs, FIELDS.moves[nodes.ravel()], **lengths)
    return np.asarray(H, float), np.asarray(slope, float)


LOGARITHMS = np.linspace(-0.02, 0.03, len(LENGTHS))


@pytest.fixture(scope="module")
def taller():
    """The same body with other bones' lengths, and its surface."""
    logarithms = jnp.asarray(LOGARITHMS, jnp.float32)
    points = stretch_points(BODY, SURFACE.points, logarithms)
    return scale_skeleton(BODY, logarithms), replace(SURFACE, points=points)


def test_a_stretched_body_lies_about_its_longer_bones_as_it_lay_about_the_shorter(taller):
    skeleton, surface = taller
    arms = ("humerus_l", "radius_r", "femur_l", "tibia_r")
    for bone in map(BODY.tree.bone, arms):
        carried = np.asarray(SURFACE.points.bones) == bone
        way, length = np.asarray(BODY.directions[bone]), float(BODY.lengths[bone])
        before, after = (
            np.asarray(each.points.points_bone)[carried] for each in (SURFACE, surface)
        )
        along = before @ way / length
        within = (along > 0) & (along < 1)
        assert within.any()
        longer = float(skeleton.lengths[bone])
        np.testing.assert_allclose(after[within] @ way / longer, along[within], atol=1e-5)
        # Across the bone, and before its joint, nothing moves.
        np.testing.assert_allclose(
            after - np.outer(after @ way, way), before - np.outer(before @ way, way), atol=1e-6
        )
        np.testing.assert_allclose(after[along < 0], before[along < 0], atol=1e-6)


def test_contours_of_a_body_with_longer_bones_tell_how_much_longer(taller):
    rng, pose = np.random.default_rng(4), relaxed_pose(BODY)
    H, slope = measured_shape(rng, pose, taller, lengths=len(LENGTHS))
    amounts = np.zeros(len(slope))
    amounts[-len(LENGTHS) :] = LOGARITHMS
    expected = -H @ amounts
    np.testing.assert_allclose(slope, expected, atol=0.04 * np.abs(expected).max())


def test_lengths_are_found_beside_the_shape_and_worn():
    rng, estimator = np.random.default_rng(5), ShapeEstimator(SURFACE, BODY, lengths=True)
    count = len(estimator.amounts)
    truth = np.append(0.005 * rng.standard_normal(count - len(LENGTHS)), LOGARITHMS)
    for _ in range(4):
        rows = rng.standard_normal((3 * count, 6 + count))
        estimator.add_equations(*equations(30 * rows, truth, 0.02 * rng.standard_normal(6)))
    skeleton, surface = estimator.estimate()
    np.testing.assert_allclose(estimator.amounts, truth, atol=5e-4)
    wanted = scale_skeleton(BODY, jnp.asarray(LOGARITHMS, jnp.float32)).lengths
    np.testing.assert_allclose(skeleton.lengths, wanted, rtol=1e-3)
    assert len(surface.points.bones) == len(SURFACE.points.bones)


def test_lengths_of_which_nothing_is_told_stay():
    skeleton, _ = ShapeEstimator(SURFACE, BODY, lengths=True).estimate()
    np.testing.assert_allclose(skeleton.lengths, BODY.lengths, rtol=1e-6)


def equations(rows: np.ndarray, shape: np.ndarray, pose: np.ndarray):
    """A frame's normal equations where pose and shape are off by so much."""
    off = rows @ np.concatenate([pose, shape])
    return rows.T @ rows, -rows.T @ off


def test_a_shape_is_found_whatever_the_poses_and_only_what_they_do_not_explain():
    rng, estimator = np.random.default_rng(0), ShapeEstimator(SURFACE, BODY)
    count = len(estimator.amounts)
    truth = 0.01 * rng.standard_normal(count)
    truth[1] = 0.0
    for _ in range(6):
        rows = rng.standard_normal((3 * count, 4 + count)) * [*[1] * 4, *[1] * count]
        # What this field does a pose does as well.
        rows[:, 5] = rows[:, 0]
        H, slope = equations(30 * rows, truth, 0.02 * rng.standard_normal(4))
        estimator.add_equations(H, slope)
    estimator.estimate()
    rest = np.arange(count) != 1
    np.testing.assert_allclose(estimator.amounts[rest], truth[rest], atol=5e-4)
    assert abs(estimator.amounts[1]) < 2e-3


def test_without_frames_a_shape_is_peoples_mean():
    estimator = ShapeEstimator(SURFACE, BODY)
    estimator.amounts = np.full(len(estimator.amounts), 0.02)
    skeleton, worn = estimator.estimate()
    assert skeleton is BODY
    np.testing.assert_allclose(estimator.amounts, 0, atol=1e-12)
    np.testing.assert_allclose(worn.points.points_bone, SURFACE.points.points_bone, atol=1e-6)


def test_one_weak_frame_counts_by_how_people_differ():
    estimator = ShapeEstimator(SURFACE, BODY)
    count = len(estimator.amounts)
    prior_information = np.asarray(estimator.fields.deviations) ** -2.0
    H = np.zeros((6 + count, 6 + count))
    # As sure as the prior among people: half-way.
    H[6:, 6:] = DEVIATION_M**2 * np.diag(prior_information)
    estimator.add_equations(H, -H @ np.append(np.zeros(6), np.full(count, 0.01)))
    estimator.estimate()
    np.testing.assert_allclose(estimator.amounts, 0.005, rtol=1e-6)


@pytest.mark.parametrize("hidden", [False, True])
def test_frames_in_which_a_part_is_hidden_say_nothing_of_the_shape(hidden):
    """What hides an arm draws the trunk's outline along."""
    frames, shape = [], SimpleNamespace(skeleton=None)
    constants = SimpleNamespace(
        cameras=SimpleNamespace(size=[]), finder=SimpleNamespace(morph=None)
    )
    estimator = SimpleNamespace(add_frame=lambda *frame: frames.append(frame))
    learner = PassLearner(constants, 1, estimator)  # type: ignore[arg-type]
    state = SimpleNamespace(body=SimpleNamespace(shape=shape), pose=np.zeros(0))
    report = SimpleNamespace(hidden=np.array([False, hidden]), pairs=None)
    learner.add_frame(state, report, {})  # type: ignore[arg-type]
    assert len(frames) == (not hidden)
