"""Other bodies of the same bones: torso, legs and the whole, by model files of one format."""

from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxmocap.body.kinematics import Sites, forward, joined_sites, landmark_sites, site_positions
from jaxmocap.body.motion import Motion
from jaxmocap.body.pose import Pose, relaxed_pose
from jaxmocap.body.proportions import GIRTHS, LENGTHS, scale_skeleton
from jaxmocap.body.skeleton import (
    LANDMARK_PLACES,
    LANDMARKS,
    Skeleton,
    landmark_mismatches,
    load_skeleton,
    scale_to_height,
    with_joints,
    with_wrists,
)
from jaxmocap.body.surfaces.pieces import body_pieces
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.evidence.posture import NearPose
from jaxmocap.formats.animation.bvh import read_bvh
from jaxmocap.formats.animation.export import write_animation
from jaxmocap.formats.armatures.armature import joint_positions, rotated_armature
from jaxmocap.formats.armatures.joint_names import CONVENTIONS, joint_of
from jaxmocap.formats.motion_npz import load_motion, save_motion
from jaxmocap.formats.time_series.axes import R_WORLD_OF_UP
from jaxmocap.formats.time_series.isb import isb_angles
from jaxmocap.formats.time_series.mot import read_mot, write_isb, write_mot
from jaxmocap.formats.time_series.trc import read_trc, write_trc
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.outputs.overlay import OverlayArtist
from jaxmocap.synthetic.drawing_camera import look_at

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


# Bodies of other trees ----------------------------------------------------------------------------


TAILED = Path(__file__).parent / "tailed.toml"
POINTS = jax.jit(lambda body, pose, sites: site_positions(body, forward(body, pose), sites))


def tracked(body: Skeleton, sites: Sites, moving: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Angles (T, D) of a wave of some joints, and as the tracker gives them by the markers."""
    tracker = HybridTracker(body, markers=sites)
    pose, joints = relaxed_pose(body), [body.tree.joint(name) for name in moving]
    truth, actual, state = [], [], None
    for k in range(20):
        wave = 0.3 * np.sin(0.15 * k + np.arange(len(joints)))
        angles = pose.angles.at[np.array(joints)].add(wave)
        position = jnp.asarray([0.0, 0.0, 0.95])
        markers = POINTS(body, Pose(position, pose.quaternion, angles), sites)
        state = tracker.init(markers) if state is None else state
        state, solved, _ = tracker.step(state, k / 50, markers)
        truth.append(np.asarray(markers))
        actual.append(np.asarray(POINTS(body, solved, sites)))
    return np.array(truth), np.array(actual)


def test_a_body_with_a_tail_is_tracked_by_its_file_alone(tmp_path):
    """And with joints that the human has not, named ankle and clavicle."""
    text = TAILED.read_text().replace(
        '[[joints_of]]\nfile = "human', '[[joints_of]]\nfile = "whole'
    )
    (tmp_path / "body.toml").write_text(text)
    body = scale_to_height(load_skeleton(tmp_path / "body.toml"), 1.75, None)
    assert body.tree.names_in("tail") == ("tail1", "tail2")
    assert {name.split("_")[0] for name in body.tree.joints} >= {"ankle", "clavicle", "back"}
    names = ("vertex", "wrist_l", "wrist_r", "ankle_l", "ankle_r", "toe_l", "toe_r")
    sites = landmark_sites(body, (*names, "shoulder_l", "shoulder_r"))
    tail = Sites(body.tree.bones_in("tail"), jnp.ones(2), jnp.zeros((2, 3)))
    moving = ["ankle_dorsiflex_l", "ankle_dorsiflex_r", "clavicle_raise_l", "clavicle_raise_r"]
    moving += ["tail_raise", "tail_wag", "tail_curl"]
    truth, actual = tracked(body, joined_sites(sites, tail), moving)
    assert np.ptp(truth[:, -1], axis=0).max() > 0.1
    assert np.linalg.norm(actual - truth, axis=-1)[5:].max() < 0.02


def test_a_tail_grows_with_the_body_and_weighs_its_share():
    drawn, body = load_skeleton(TAILED), scale_to_height(load_skeleton(TAILED), 1.9, 80.0)
    human, tail = Skeleton.human(1.9, 80.0), drawn.tree.bones_in("tail")
    others = np.setdiff1d(np.arange(len(drawn.tree.bones)), tail)
    np.testing.assert_allclose(np.asarray(body.lengths)[others], human.lengths, rtol=1e-6)
    assert float(body.masses.sum()) == pytest.approx(80.0, rel=1e-5)
    grown = np.asarray(body.lengths)[others].sum() / np.asarray(drawn.lengths)[others].sum()
    np.testing.assert_allclose(body.lengths[tail], drawn.lengths[tail] * grown, rtol=1e-5)


def test_every_joint_of_our_files_has_its_usual_deviation():
    body = with_wrists(with_joints(Skeleton.human(), "whole.toml"))
    assert (np.degrees(np.asarray(body.usual_deviations)) >= 14).all()
    assert len(body.tree.groups_of_joints) == len(body.tree.searched) == len(body.tree.joints)
    assert set(body.tree.groups_of_joints) == {"spine", "shoulder", "arm", "leg", "head"}


def test_bones_are_asked_for_by_group_part_and_side():
    tree = Skeleton.human().tree
    assert tree.names_in("arm", side="l") == ("humerus_l", "radius_l", "hand_l")
    assert tree.names_in("forearm", "hand") == ("radius_l", "hand_l", "radius_r", "hand_r")
    assert tree.names_in("head") == ("neck", "head") and tree.names_in("neck") == ("neck",)
    assert tree.names_in("spine", side="") == ("spine1", "spine2", "spine3")
    assert tree.names_in("tail") == ()
    assert set(range(len(tree.bones))) - set(tree.drawn) == set(tree.bones_in("foot"))


def renamed(body: Skeleton, **names: str) -> Skeleton:
    """The same body with other names for some bones."""
    bones = tuple(names.get(name, name) for name in body.tree.bones)
    return replace(body, tree=replace(body.tree, bones=bones))


def test_a_tail_named_as_a_spine_is_not_scaled_as_one():
    factors = jnp.linspace(-0.1, 0.1, len(LENGTHS) + len(GIRTHS))
    body = load_skeleton(TAILED)
    named, other = (
        scale_skeleton(body, factors),
        scale_skeleton(renamed(body, tail1="spine_tail"), factors),
    )
    tail = body.tree.bones_in("tail")
    np.testing.assert_array_equal(other.lengths[tail], body.lengths[tail])
    np.testing.assert_array_equal(other.lengths, named.lengths)
    np.testing.assert_array_equal(other.diameters, named.diameters)


def test_bones_of_other_names_are_drawn_alike():
    camera = look_at((3.0, 0.6, 1.3), (0.0, 0.0, 0.95), size=(96, 72), focal=95.0, distortion=())
    body = load_skeleton(TAILED)
    other = renamed(body, humerus_l="UpperArm.L", radius_l="ForeArm.L", hand_r="paw")
    poses = Pose(*(np.asarray(part)[None] for part in relaxed_pose(body)))
    canvases = []
    for each in (body, other):
        canvases.append(np.zeros((72, 96, 3), np.uint8))
        OverlayArtist(camera, Motion(each, np.zeros(1), poses)).draw(canvases[-1], 0.0)
    np.testing.assert_array_equal(*canvases)
    assert canvases[0].any()


def test_landmarks_and_their_mismatches_come_from_the_humans_file():
    mismatches = dict(zip(LANDMARKS, landmark_mismatches(), strict=True))
    np.testing.assert_array_equal(mismatches["elbow_l"], [0.02, 0.02, 0.012])
    np.testing.assert_array_equal(mismatches["toe_r"], 0)
    assert LANDMARK_PLACES["wrist_l"] == ("hand_l", 0.0) and len(LANDMARKS) == 20


def test_a_motion_file_of_before_is_filled_from_the_bodies_files(tmp_path):
    body = with_wrists(Skeleton.human(1.8))
    pose = relaxed_pose(body)
    poses = Pose(*(np.tile(part, (3, 1)) for part in pose))
    save_motion(tmp_path / "motion.npz", Motion(body, np.arange(3) / 50, poses))
    stored = np.load(tmp_path / "motion.npz").files
    assert not [name for name in stored if "deviations" in name or "unmarked" in name]
    read = load_motion(tmp_path / "motion.npz").skeleton
    assert read.tree == body.tree
    for ours, theirs in zip(jax.tree.leaves(read), jax.tree.leaves(body), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-6)


@pytest.mark.parametrize("name", ["whole.toml", "supple.toml", TAILED])
def test_the_gradients_priors_know_joints_of_any_name(name):
    body = load_skeleton(name)
    deviations = NearPose().deviations(body)
    assert deviations.shape == (ROOT_DOF + len(body.tree.joints),) and (deviations > 0).all()


def test_a_body_of_more_bones_has_a_mesh_of_these_as_well():
    body = load_skeleton(TAILED)
    more = set(body.tree.bones) - set(Skeleton.human(1.75).tree.bones)
    assert more and more <= set(body_pieces(body))
