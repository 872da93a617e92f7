"""Centres of gravity, augmented bodies, base of support, flesh."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import FLOAT32_TOLERANCES, double, on_device, poses
from hypothesis import given

from jaxmocap.body import mass
from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import Pose, relaxed_pose
from jaxmocap.body.surfaces import cones
from jaxmocap.reference import kinematics as reference_kinematics
from jaxmocap.reference.hybrid import mass as reference


@jax.jit
def weighed(skeleton, pose):
    """Bone centres, centre of gravity and both kinds of augmented bodies."""
    frames = forward(skeleton, pose)
    return (
        mass.bone_centres(skeleton, frames),
        mass.centre_of_gravity(skeleton, frames),
        mass.augmented_bodies(skeleton, frames),
        mass.augmented_bodies(skeleton, frames, proximal=True),
    )


@given(pose=poses(beyond=2.0))
def test_centre_of_gravity_is_mujocos(skeleton64, mujoco_body, pose):
    with double():
        centres, total, _, _ = weighed(skeleton64, on_device(pose))
    mujoco_body.move(pose)
    data = mujoco_body.data
    np.testing.assert_allclose(total, data.subtree_com[0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(centres, data.xipos[mujoco_body.ids], rtol=1e-9, atol=1e-12)


@given(pose=poses(beyond=2.0))
def test_augmented_bodies_are_mujocos_subtrees(skeleton64, mujoco_body, pose):
    with double():
        _, _, bodies, _ = weighed(skeleton64, on_device(pose))
    mujoco_body.move(pose)
    ids = [mujoco_body.ids[bone] for bone in skeleton64.tree.dof_bones]
    subtrees = mujoco_body.data.subtree_com[ids]
    anchors = mujoco_body.data.xanchor[mujoco_body.joint_ids]
    np.testing.assert_allclose(bodies.masses, mujoco_body.model.body_subtreemass[ids], rtol=1e-12)
    arms = np.linalg.norm((subtrees - anchors)[:, :2], axis=1)
    np.testing.assert_allclose(bodies.arms, arms, rtol=1e-9, atol=1e-6)


@given(pose=poses(beyond=1.0))
def test_double_precision_agrees_with_the_reference(skeleton64, plain_skeleton, pose):
    frames = reference_kinematics.forward(plain_skeleton, pose)
    with double():
        centres, total, distal, proximal = weighed(skeleton64, on_device(pose))
    exact = {"rtol": 1e-9, "atol": 1e-12}
    np.testing.assert_allclose(centres, reference.bone_centres(plain_skeleton, frames), **exact)
    np.testing.assert_allclose(total, reference.centre_of_gravity(plain_skeleton, frames), **exact)
    for ours, apart in ((distal, False), (proximal, True)):
        theirs = reference.augmented_bodies(plain_skeleton, frames, proximal=apart)
        np.testing.assert_allclose(ours.masses, theirs.masses, **exact)
        # Arms below a micrometre are taken as none, so that their gradient is finite.
        np.testing.assert_allclose(ours.arms, theirs.arms, rtol=1e-9, atol=1e-6)


@given(pose=poses())
def test_float32_stays_within_its_tolerances(skeleton, plain_skeleton, pose):
    frames = reference_kinematics.forward(plain_skeleton, pose)
    expected = reference.augmented_bodies(plain_skeleton, frames)
    _, total, bodies, _ = weighed(skeleton, on_device(pose))
    table = FLOAT32_TOLERANCES
    centre = reference.centre_of_gravity(plain_skeleton, frames)
    assert np.abs(total - centre).max() < table["centre_of_gravity"]
    assert np.abs(bodies.masses - expected.masses).max() < table["masses"]
    assert np.abs(bodies.arms - expected.arms).max() < table["arms"]


def test_the_first_spine_joint_has_nothing_between_it_and_the_root(skeleton):
    _, _, distal, proximal = weighed(skeleton, relaxed_pose(skeleton))
    spine1 = skeleton.tree.joint("spine1_flexion")
    assert proximal.masses[spine1] == 0
    assert proximal.arms[spine1] == 0
    trunk_and_arms = 80.67 - 2 * (5.715 + 10.05 + 3.51 + 1.11)
    assert distal.masses[spine1] == pytest.approx(trunk_and_arms, abs=1e-4)
    wrist_side = skeleton.tree.joint("elbow_flex_l")
    assert distal.masses[wrist_side] == pytest.approx(1.31 + 0.52, abs=1e-6)
    assert proximal.masses[wrist_side] == pytest.approx(15.71 + 4.13 + 2.18, abs=1e-4)


def test_a_stretched_arm_lies_half_a_metre_from_the_shoulder(skeleton):
    angles = np.zeros(21)
    angles[skeleton.tree.joint("arm_flex_l")] = np.pi / 2
    _, _, bodies, _ = weighed(skeleton, on_device(Pose(np.zeros(3), np.eye(4)[0], angles)))
    lever = 2.18 * 0.436 * 0.3 + 1.31 * (0.3 + 0.43 * 0.35) + 0.52 * (0.65 + 0.506 * 0.08)
    arm = bodies.arms[skeleton.tree.joint("arm_flex_l")]
    assert arm == pytest.approx(lever / (2.18 + 1.31 + 0.52), abs=1e-5)


def test_base_of_support_is_the_box_of_the_feet():
    feet = np.array([[0.1, 0.2, 0.0], [-0.1, 0.25, 0.3], [0.15, -0.3, 0.1]])
    for module in (mass, reference):
        low, high = module.base_of_support(jnp.asarray(feet) if module is mass else feet)
        np.testing.assert_allclose(low, [-0.1, -0.3], atol=1e-7)
        np.testing.assert_allclose(high, [0.15, 0.25], atol=1e-7)


def test_gradients_reach_masses_and_centres(skeleton):
    def height(body):
        return mass.centre_of_gravity(body, forward(body, relaxed_pose(body)))[2]

    gradient = jax.jit(jax.grad(height))(skeleton)
    head, foot = (skeleton.tree.bone(name) for name in ("head", "foot_l"))
    assert gradient.masses[head] > 0 > gradient.masses[foot]
    assert gradient.centres[head] == pytest.approx(0.1 * 4.39 / 80.67, rel=1e-4)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))


def test_gradients_of_the_arms_are_finite_when_a_limb_hangs_straight_down(skeleton):
    standing = on_device(Pose(np.zeros(3), np.eye(4)[0], np.zeros(21)))

    def effort(angles):
        frames = forward(skeleton, standing._replace(angles=angles))
        return jnp.sum(mass.augmented_bodies(skeleton, frames).arms)

    assert np.isfinite(jax.jit(jax.grad(effort))(standing.angles)).all()


def volumes(flesh):
    """Volumes (N,) of the truncated cones without their round ends, cubic metres."""
    a, b = flesh.radii[:, 0], flesh.radii[:, 1]
    return jnp.pi / 3 * jnp.linalg.norm(flesh.far - flesh.near, axis=-1) * (a * a + a * b + b * b)


def test_gradients_reach_diameters_through_the_flesh(skeleton):
    bones = np.array([skeleton.tree.bone(name) for name in ("humerus_l", "radius_l")])

    def volume(body):
        frames = forward(body, relaxed_pose(body))
        return jnp.sum(volumes(cones.cones(body, frames, bones)))

    value, gradient = jax.jit(jax.value_and_grad(volume))(skeleton)
    # Truncated cones by the prismoid formula: the middle disc counts four times.
    prismoids = 0.0
    for length, near, far in ((0.3, 0.105, 0.085), (0.35, 0.085, 0.056)):
        discs = near**2 + 4 * ((near + far) / 2) ** 2 + far**2
        prismoids += np.pi / 4 * length * discs / 6
    assert value == pytest.approx(prismoids, rel=1e-5)
    assert (np.asarray(gradient.diameters)[bones] > 0).all()
    assert np.abs(np.delete(gradient.diameters, bones, axis=0)).max() == 0
