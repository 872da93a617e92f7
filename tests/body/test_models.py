"""Other bodies of the same bones: torso, legs and the whole, by model files of one format."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap.body.motion import Motion
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton, load_skeleton, with_joints
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.formats.animation.bvh import read_bvh
from jaxmocap.formats.animation.export import write_animation
from jaxmocap.formats.armatures.armature import joint_positions, rotated_armature
from jaxmocap.formats.armatures.joint_names import CONVENTIONS, joint_of
from jaxmocap.formats.motion_npz import load_motion, save_motion
from jaxmocap.formats.time_series.axes import R_WORLD_OF_UP
from jaxmocap.formats.time_series.isb import isb_angles
from jaxmocap.formats.time_series.mot import read_mot, write_isb, write_mot
from jaxmocap.formats.time_series.trc import read_trc, write_trc

DEGREES = {"torso.toml": 21, "legs.toml": 6 + 12, "whole.toml": 33, "supple.toml": 40}


def moving(model: str, samples: int = 9) -> Motion:
    """Every joint of a body 1.8 m tall between its limits, while it walks and turns."""
    skeleton = with_joints(Skeleton.human(1.8), model)
    rng = np.random.default_rng(3)
    low, high = np.asarray(skeleton.limits, float).T
    angles = low + rng.uniform(size=(samples, len(low))) * (high - low)
    turns = Rotation.from_euler("z", np.linspace(0, 2, samples)[:, None]).as_quat(scalar_first=True)
    position = np.stack([np.linspace(0, 1, samples), np.zeros(samples), np.ones(samples)], 1)
    poses: list = [position, turns, angles]
    return Motion(skeleton, np.arange(samples) / 50, Pose(*poses))


@pytest.mark.parametrize("model", DEGREES)
def test_the_papers_degrees_of_freedom_turn_the_humans_own_bones(model):
    human, body = Skeleton.human(), load_skeleton(model)
    assert ROOT_DOF + len(body.tree.joints) == DEGREES[model] == len(body.costs)
    assert len(set(body.tree.joints)) == len(body.tree.joints)
    assert (body.tree.bones, body.tree.parents) == (human.tree.bones, human.tree.parents)
    np.testing.assert_array_equal(body.lengths, human.lengths)
    np.testing.assert_array_equal(body.masses, human.masses)
    np.testing.assert_allclose(np.linalg.norm(body.axes, axis=1), 1)
    assert np.all(body.limits[:, 0] <= body.relaxed) and np.all(body.relaxed <= body.limits[:, 1])


def test_seven_degrees_move_a_hand_against_the_chest_and_six_a_foot_against_the_pelvis():
    tree = load_skeleton("whole.toml").tree
    of_arm = set(tree.chain("hand_l")) - set(tree.chain("spine3"))
    assert sum(bone in of_arm for bone in tree.dof_bones) == 7
    assert sum(bone in tree.chain("foot_r") for bone in tree.dof_bones) == 6
    assert sum(bone in tree.chain("spine3") for bone in tree.dof_bones) == 1


@pytest.mark.parametrize("model", DEGREES)
def test_the_sides_mirror_each_other(model):
    body = load_skeleton(model)
    for dof, name in enumerate(body.tree.joints):
        if name.endswith("_l"):
            other = body.tree.joint(f"{name[:-2]}_r")
            # A turn's axis is mirrored at the sagittal plane by turning the other way.
            mirrored = np.asarray(body.axes)[other] * [-1, 1, -1]
            np.testing.assert_array_equal(np.asarray(body.axes)[dof], mirrored)
            np.testing.assert_array_equal(body.limits[dof], body.limits[other])


@pytest.mark.parametrize(
    ("joint", "landmark", "way"),
    [
        ("clavicle_raise_l", "shoulder_l", [0, 0, 1]),
        ("clavicle_protract_l", "shoulder_l", [1, 0, 0]),
        ("clavicle_protract_r", "shoulder_r", [1, 0, 0]),
        ("ankle_dorsiflex_l", "toe_l", [0, 0, 1]),
        ("back_flexion", "neck", [1, 0, 0]),
    ],
)
def test_positive_angles_go_the_way_that_the_file_says(joint, landmark, way):
    body = load_skeleton("whole.toml")
    angles = np.zeros((2, len(body.tree.joints)))
    angles[1, body.tree.joint(joint)] = 0.1
    poses: list = [np.zeros((2, 3)), np.eye(4)[[0, 0]], angles]
    points = Motion(body, np.arange(2.0), Pose(*poses)).joints()[landmark]
    moved = points[1] - points[0]
    assert moved @ way > 0.9 * np.linalg.norm(moved) > 0.005


def test_a_scaled_persons_bones_stay_theirs():
    person = Skeleton.human(1.6, 55.0)
    body = with_joints(person, "whole.toml")
    np.testing.assert_array_equal(body.lengths, person.lengths)
    np.testing.assert_array_equal(body.directions, person.directions)
    assert with_joints(body, "human.toml").tree == person.tree


@pytest.mark.parametrize("model", DEGREES)
def test_all_outputs_take_these_bodies(model, tmp_path):
    motion = moving(model)
    joints = motion.joints()
    write_trc(tmp_path / "joints.trc", motion.times, joints)
    write_mot(tmp_path / "angles.mot", motion)
    write_isb(tmp_path / "isb.mot", motion)
    save_motion(tmp_path / "motion.npz", motion)
    positions = read_trc(tmp_path / "joints.trc")
    for name, points in joints.items():
        row = list(positions.names).index(name)
        np.testing.assert_allclose(positions.positions[:, row], points, atol=1e-5)
    _, angles = read_mot(tmp_path / "angles.mot")
    for dof, name in enumerate(motion.skeleton.tree.joints):
        np.testing.assert_allclose(angles[name], motion.poses.angles[:, dof], atol=1e-6)
    again = load_motion(tmp_path / "motion.npz")
    assert again.skeleton.tree == motion.skeleton.tree
    assert np.isfinite(list(isb_angles(motion).values())).all()
    for name in ("motion.bvh", "motion.glb"):
        write_animation(tmp_path / name, motion)
    armature = rotated_armature(read_bvh(tmp_path / "motion.bvh"), R_WORLD_OF_UP["y"])
    in_file = joint_positions(armature)
    names = {landmark: CONVENTIONS["humanik"][joint_of(landmark)] for landmark in joints}
    held = {landmark: name for landmark, name in names.items() if name in armature.names}
    assert len(held) >= 15  # all but ends of limbs, which have other names there
    for landmark, name in held.items():
        actual = in_file[:, armature.names.index(name)]
        np.testing.assert_allclose(actual, joints[landmark], atol=1e-3, err_msg=landmark)
