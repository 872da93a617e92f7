"""Forward kinematics and the Jacobian, against MuJoCo, NumPy, differences and autodiff."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import FLOAT32_TOLERANCES, double, on_device, poses, vectors
from hypothesis import given

from jaxmocap.body import kinematics
from jaxmocap.body.pose import Pose, pack, relaxed_pose, retract, unpack
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.reference import kinematics as reference

FORWARD = jax.jit(kinematics.forward)
LANDMARKS_OF = jax.jit(kinematics.landmarks)
SITE_POSITIONS, RETRACT = jax.jit(kinematics.site_positions), jax.jit(retract)
LANDMARK_BONES = np.array([0, 3, 4, 4, 6, 7, 8, 8, 15, 20], np.int32)
SITES = kinematics.Sites(
    LANDMARK_BONES,
    np.linspace(0.0, 1.0, len(LANDMARK_BONES)),
    np.linspace(-0.1, 0.1, 3 * len(LANDMARK_BONES)).reshape(-1, 3),
)


def device_sites() -> kinematics.Sites:
    return kinematics.Sites(SITES.bones, on_device(SITES.at), on_device(SITES.offsets))


@jax.jit
def points_of(skeleton, pose):
    return kinematics.site_positions(skeleton, kinematics.forward(skeleton, pose), device_sites())


@jax.jit
def jacobian_of(skeleton, pose):
    frames = kinematics.forward(skeleton, pose)
    points = kinematics.site_positions(skeleton, frames, device_sites())
    return kinematics.jacobian(skeleton, frames, SITES.bones, points)


@given(pose=poses(beyond=2.0))
def test_bones_lie_where_mujoco_puts_them(skeleton64, mujoco_body, pose):
    with double():
        frames = FORWARD(skeleton64, on_device(pose))
    mujoco_body.move(pose)
    data, ids = mujoco_body.data, mujoco_body.ids
    np.testing.assert_allclose(frames.joints_world, data.xpos[ids], rtol=1e-9, atol=1e-12)
    matrices = data.xmat[ids].reshape(-1, 3, 3)
    np.testing.assert_allclose(frames.R_world_bone, matrices, rtol=1e-9, atol=1e-12)
    axes = data.xaxis[mujoco_body.joint_ids]
    np.testing.assert_allclose(frames.axes_world, axes, rtol=1e-9, atol=1e-12)


@given(pose=poses(beyond=2.0))
def test_jacobian_is_mujocos(skeleton64, mujoco_body, pose):
    with double():
        points = np.asarray(points_of(skeleton64, on_device(pose)))
        J = np.asarray(jacobian_of(skeleton64, on_device(pose)))
    mujoco_body.move(pose)
    for bone, point, rows in zip(SITES.bones, points, J, strict=True):
        expected = mujoco_body.jacobian(bone, point)
        np.testing.assert_allclose(rows, expected, rtol=1e-9, atol=1e-12)


def moved_points(step, skeleton, pose):
    return points_of(skeleton, retract(pose, step))


MOVED = jax.jit(moved_points)
FORWARD_MODE = jax.jit(jax.jacfwd(moved_points))
REVERSE_MODE = jax.jit(jax.jacrev(moved_points))


@given(pose=poses(beyond=2.0))
def test_jacobian_is_the_derivative_of_the_points(skeleton64, pose):
    with double():
        start = on_device(pose)
        J = jacobian_of(skeleton64, start)
        forward_mode = FORWARD_MODE(jnp.zeros(27), skeleton64, start)
        reverse_mode = REVERSE_MODE(jnp.zeros(27), skeleton64, start)
    np.testing.assert_allclose(forward_mode, J, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(reverse_mode, J, rtol=1e-9, atol=1e-11)


@given(pose=poses(beyond=1.0))
def test_double_precision_agrees_with_the_reference(skeleton64, plain_skeleton, pose):
    expected = reference.forward(plain_skeleton, pose)
    expected_points = reference.site_positions(plain_skeleton, expected, SITES)
    with double():
        frames = FORWARD(skeleton64, on_device(pose))
        points = points_of(skeleton64, on_device(pose))
        J = jacobian_of(skeleton64, on_device(pose))
        marks = LANDMARKS_OF(skeleton64, on_device(pose))
    for ours, theirs in zip(frames, expected, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(points, expected_points, rtol=1e-9, atol=1e-12)
    expected_J = reference.jacobian(plain_skeleton, expected, SITES.bones, expected_points)
    np.testing.assert_allclose(J, expected_J, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(
        marks, reference.landmarks(plain_skeleton, pose), rtol=1e-9, atol=1e-12
    )


@given(pose=poses(beyond=1.0))
def test_float32_stays_within_its_tolerances(skeleton, plain_skeleton, pose):
    expected = reference.forward(plain_skeleton, pose)
    expected_points = reference.site_positions(plain_skeleton, expected, SITES)
    expected_J = reference.jacobian(plain_skeleton, expected, SITES.bones, expected_points)
    single = on_device(pose)
    frames = FORWARD(skeleton, single)
    table = FLOAT32_TOLERANCES
    assert frames.R_world_bone.dtype == jnp.float32
    assert np.abs(frames.joints_world - expected.joints_world).max() < table["positions"]
    assert np.abs(frames.R_world_bone - expected.R_world_bone).max() < table["orientations"]
    assert np.abs(points_of(skeleton, single) - expected_points).max() < table["positions"]
    assert np.abs(jacobian_of(skeleton, single) - expected_J).max() < table["jacobian"]


def test_landmarks_of_the_reference_are_those_of_the_body():
    assert list(reference.LANDMARK_ENDS) == list(LANDMARKS)


def test_joined_sites_are_where_they_were_apart(skeleton):
    ankles = kinematics.landmark_sites(skeleton, ("ankle_r", "ankle_l"))
    frames = FORWARD(skeleton, relaxed_pose(skeleton))
    both, first, second = (
        SITE_POSITIONS(skeleton, frames, sites)
        for sites in (kinematics.joined_sites(ankles, device_sites()), ankles, device_sites())
    )
    np.testing.assert_array_equal(both, np.concatenate([first, second]))
    none = kinematics.joined_sites(ankles, kinematics.landmark_sites(skeleton, ()))
    np.testing.assert_array_equal(none.bones, ankles.bones)


def test_a_standing_body_has_its_landmarks_where_table_1_puts_them(skeleton64):
    with double():
        standing = Pose(jnp.zeros(3), jnp.eye(4)[0], jnp.zeros(21))
        points = dict(zip(LANDMARKS, LANDMARKS_OF(skeleton64, standing), strict=True))
    np.testing.assert_allclose(points["vertex"], [0, 0, 0.659], atol=1e-12)
    np.testing.assert_allclose(points["wrist_l"], [0, 0.19, 0.469 - 0.65], atol=1e-12)
    np.testing.assert_allclose(points["wrist_r"], [0, -0.19, 0.469 - 0.65], atol=1e-12)
    np.testing.assert_allclose(points["toe_r"], [0.128, -0.085, -0.936], atol=1e-12)


def bent(skeleton, **degrees):
    angles = np.zeros(len(skeleton.tree.joints))
    for name, value in degrees.items():
        angles[skeleton.tree.joint(name)] = np.deg2rad(value)
    pose = on_device(Pose(np.zeros(3), np.eye(4)[0], angles))
    return dict(zip(LANDMARKS, np.asarray(LANDMARKS_OF(skeleton, pose)), strict=True))


@pytest.mark.parametrize(("side", "left"), [("l", 1.0), ("r", -1.0)])
def test_positive_angles_flex_abduct_and_turn_inward(skeleton, side, left):
    upright = bent(skeleton)
    flexed = bent(skeleton, **{f"arm_flex_{side}": 90})
    assert flexed[f"elbow_{side}"][0] > 0.29
    abducted = bent(skeleton, **{f"arm_abduct_{side}": 90})
    assert left * (abducted[f"elbow_{side}"] - upright[f"elbow_{side}"])[1] > 0.29
    inward = bent(skeleton, **{f"arm_rot_{side}": 45, f"elbow_flex_{side}": 90})
    assert left * (inward[f"wrist_{side}"] - inward[f"elbow_{side}"])[1] < -0.2
    elbow = bent(skeleton, **{f"elbow_flex_{side}": 90})
    assert elbow[f"wrist_{side}"][0] > 0.34
    assert bent(skeleton, **{f"hip_flexion_{side}": 90})[f"knee_{side}"][0] > 0.38
    assert bent(skeleton, **{f"knee_flexion_{side}": 90})[f"ankle_{side}"][0] < -0.5
    leg = bent(skeleton, **{f"hip_abduction_{side}": 30})
    assert left * (leg[f"knee_{side}"] - upright[f"knee_{side}"])[1] > 0.15
    toes = bent(skeleton, **{f"hip_rotation_{side}": 30})
    assert left * (toes[f"toe_{side}"] - toes[f"ankle_{side}"])[1] < -0.05


def test_spine_and_neck_bow_forward(skeleton):
    names = ("spine1_flexion", "spine2_flexion", "spine3_flexion", "neck_flexion")
    for name in names:
        assert bent(skeleton, **{name: 20})["vertex"][0] > 0.05


@given(pose=poses(), step=vectors(27, 0.5))
def test_a_pose_survives_packing(pose, step):
    moved = RETRACT(on_device(pose), on_device(step))
    for part, again in zip(moved, unpack(pack(moved)), strict=True):
        np.testing.assert_array_equal(part, again)
    assert np.linalg.norm(moved.quaternion) == pytest.approx(1, abs=1e-6)


def test_gradients_reach_lengths_directions_and_axes(skeleton):
    def height_of_hand(body: Skeleton):
        return kinematics.landmarks(body, relaxed_pose(body))[LANDMARK_INDEX, 2]

    LANDMARK_INDEX = LANDMARKS.index("hand_r")
    gradient = jax.jit(jax.grad(height_of_hand))(skeleton)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))
    spine, hand = skeleton.tree.bone("spine1"), skeleton.tree.bone("hand_r")
    assert gradient.lengths[spine] == pytest.approx(1.0)
    assert gradient.lengths[hand] < -0.7
    assert gradient.lengths[skeleton.tree.bone("hand_l")] == 0
    assert np.abs(gradient.relaxed).max() > 0
    assert np.abs(gradient.directions).max() > 0
    assert np.abs(gradient.axes).max() > 0


def test_new_numbers_in_a_skeleton_do_not_retrace(skeleton):
    traces = []

    @jax.jit
    def vertex(body, pose):
        traces.append(1)
        return kinematics.landmarks(body, pose)[3]

    pose = relaxed_pose(skeleton)
    vertex(skeleton, pose)
    vertex(Skeleton.human(1.6), pose)
    vertex(Skeleton.human(mass=60.0), retract(pose, jnp.full(27, 0.1)))
    assert len(traces) == 1
