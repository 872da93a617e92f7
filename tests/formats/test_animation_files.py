"""BVH and glTF files as independent readers see them: bvhsdk, pygltflib and trimesh."""

import bvhsdk
import numpy as np
import pytest
import trimesh
from conftest import complaint, problem_of
from gltf_player import Player
from moving_body import HEIGHT, RATE, SAMPLES, moving_body, with_parts
from scipy.spatial.transform import Rotation

from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.formats.animation.bvh import read_bvh, write_bvh
from jaxmocap.formats.animation.export import write_animation
from jaxmocap.formats.animation.gltf_in import read_gltf
from jaxmocap.formats.armatures.armature import joint_positions
from jaxmocap.formats.armatures.joint_names import CONVENTIONS, joint_of, landmark_names
from jaxmocap.formats.files.errors import InputError
from jaxmocap.geometry.solids import CORNERS, RINGS
from jaxmocap.outputs.scene import make_scene

MILLIMETRE = 1e-3
# Our world is Z up, facing X; the files' Y up, facing Z.
R_FILE_WORLD = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])


def joints_in_file() -> dict[str, np.ndarray]:
    """Our landmarks (T, 3) in the files' axes."""
    return {name: points @ R_FILE_WORLD.T for name, points in moving_body().joints().items()}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("animations")
    for name in ("motion.bvh", "motion.glb"):
        write_animation(folder / name, moving_body())
    return folder


# BVH ---------------------------------------------------------------------------------------------


def by_bvhsdk(path) -> tuple[dict[str, np.ndarray], float]:
    """Joints and tips (T, 3) by their names, and seconds per frame, as bvhsdk sees them."""
    animation = bvhsdk.ReadFile(str(path))
    for frame in range(animation.frames):
        bvhsdk.GetPositions(animation.root, frame)
    points = {}
    for joint in animation.getlistofjoints():
        frames = range(animation.frames)
        points[joint.name] = np.array([joint.position[f] for f in frames])
        if len(joint.endsite):
            tips = np.array([joint.getEndSitePosition(f) for f in frames])
            points[f"{joint.name}_end"] = tips
    return points, animation.frametime


def test_bvhsdk_finds_every_joint_of_every_frame_where_we_have_it(folder):
    points, step = by_bvhsdk(folder / "motion.bvh")
    assert step == pytest.approx(1 / RATE)
    names = landmark_names("humanik")
    for landmark, ours in joints_in_file().items():
        bone = CONVENTIONS["humanik"][joint_of(landmark).removesuffix("_end")]
        name = f"{bone}_end" if joint_of(landmark).endswith("_end") else names[landmark]
        assert points[name].shape == (SAMPLES, 3)
        assert np.abs(points[name] - ours).max() < MILLIMETRE, landmark


def test_a_bvh_files_rest_pose_is_a_t_that_stands_upright(folder):
    armature = read_bvh(folder / "motion.bvh")
    still = np.tile(np.eye(3), (1, len(armature.names), 1, 1))
    rest = joint_positions(
        type(armature)(armature.names, armature.parents, armature.offsets, np.zeros(1),
                       np.zeros((1, 3)), still)
    )[0]  # fmt: skip
    at = dict(zip(armature.names, rest, strict=True))
    assert at["Head_end"][1] > at["Hips"][1] > at["LeftFoot"][1]
    np.testing.assert_allclose(at["LeftHand"][1:], at["LeftArm"][1:], atol=1e-6)
    assert at["LeftHand"][0] > at["LeftArm"][0] > 0 > at["RightArm"][0] > at["RightHand"][0]
    assert at["LeftFoot_end"][2] > at["LeftFoot"][2]


def test_angles_in_a_bvh_file_do_not_jump(tmp_path):
    """One who spins twice and lifts the arms overhead: turns go on beyond 180 degrees."""
    motion = moving_body()
    yaws = np.linspace(0, 4 * np.pi, SAMPLES)
    quaternion = Rotation.from_euler("z", yaws[:, None]).as_quat(scalar_first=True)
    angles = np.zeros_like(motion.poses.angles)
    joints = motion.skeleton.tree.joints
    for side in "lr":
        angles[:, joints.index(f"arm_flex_{side}")] = np.linspace(0, np.pi, SAMPLES)
    poses = motion.poses._replace(quaternion=quaternion, angles=angles)
    write_animation(tmp_path / "a.bvh", type(motion)(motion.skeleton, motion.times, poses))
    text = (tmp_path / "a.bvh").read_text().splitlines()
    values = np.array([line.split() for line in text[text.index("MOTION") + 3 :]], float)
    # The spin takes 12.2 degrees a frame, the arms 3.
    assert np.abs(np.diff(values[:, 3:], axis=0)).max() < 12.3
    assert np.ptp(values[:, 5]) == pytest.approx(720)


FOREIGN = """HIERARCHY
ROOT Hips
{
  OFFSET 3.0 90.0 -2.0
  CHANNELS 6 Yposition Xposition Zposition Xrotation Yrotation Zrotation
  JOINT Chest
  {
    OFFSET 0.0 50.0 1.0
    CHANNELS 6 Xposition Yposition Zposition Yrotation Xrotation Zrotation
    JOINT Arm
    {
      OFFSET 20.0 5.0 0.0
      CHANNELS 1 Zrotation
      End Site
      {
        OFFSET 60.0 0.0 0.0
      }
    }
  }
  JOINT Leg
  {
    OFFSET 10.0 0.0 0.0
    CHANNELS 2 Xrotation Yrotation
    End Site
    {
      OFFSET 0.0 -85.0 0.0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.04
90 3 -2 10 20 30 0 50 1 -15 25 35 80 5 -6
91 4 -1 40 -30 0 0 50 1 -25 45 15 -80 50 60
"""


def about(axis: str, degrees: float) -> np.ndarray:
    return Rotation.from_rotvec(np.radians(degrees) * np.eye(3)["xyz".index(axis)]).as_matrix()


def test_a_bvh_file_with_other_channels_and_centimetres_is_read(tmp_path):
    """Position channels in place of offsets, turns one after the other from left to right."""
    (tmp_path / "a.bvh").write_text(FOREIGN)
    armature = read_bvh(tmp_path / "a.bvh")
    np.testing.assert_allclose(armature.times, [0, 0.04])
    hips, chest, arm, arm_end, leg, leg_end = joint_positions(armature)[1]
    R_hips = about("x", 40) @ about("y", -30) @ about("z", 0)
    R_chest = R_hips @ about("y", -25) @ about("x", 45) @ about("z", 15)
    R_arm, R_leg = R_chest @ about("z", -80), R_hips @ about("x", 50) @ about("y", 60)
    np.testing.assert_allclose(hips, [0.04, 0.91, -0.01])
    np.testing.assert_allclose(chest, hips + R_hips @ [0, 0.5, 0.01])
    np.testing.assert_allclose(arm, chest + R_chest @ [0.2, 0.05, 0])
    np.testing.assert_allclose(arm_end, arm + R_arm @ [0.6, 0, 0])
    np.testing.assert_allclose(leg, hips + R_hips @ [0.1, 0, 0])
    np.testing.assert_allclose(leg_end, leg + R_leg @ [0, -0.85, 0])


@pytest.mark.parametrize(
    ("unit", "metres"), [("m", 1), ("cm", 0.01), ("mm", 0.001), ("in", 0.0254)]
)
def test_units_of_bvh_files_are_told_by_the_bodys_size_or_asked_for(folder, tmp_path, unit, metres):
    armature = read_bvh(folder / "motion.bvh")
    write_bvh(tmp_path / "a.bvh", armature, unit)
    if unit == "in":
        with pytest.raises(InputError, match="state the unit"):
            read_bvh(tmp_path / "a.bvh")
    back = read_bvh(tmp_path / "a.bvh", unit if unit == "in" else None)
    np.testing.assert_allclose(back.positions, armature.positions, atol=2e-6)
    third = (tmp_path / "a.bvh").read_text().splitlines()[-1].split()[1]
    assert float(third) * metres == pytest.approx(armature.positions[-1, 1], abs=2e-6)


def test_a_root_on_the_floor_makes_nobody_taller(tmp_path):
    """Centimetres: from the hips to the head 125, to the foot 95; from the root to the head 225."""
    limbs = "".join(
        f"JOINT {name}\n{{\nOFFSET 0 {way} 0\nCHANNELS 3 Zrotation Xrotation Yrotation\n"
        f"End Site\n{{\nOFFSET 0 {end} 0\n}}\n}}\n"
        for name, way, end in (("Spine", 60, 65), ("Leg", -50, -45))
    )
    (tmp_path / "a.bvh").write_text(
        "HIERARCHY\nROOT Reference\n{\nOFFSET 0 0 0\nCHANNELS 3 Xposition Yposition Zposition\n"
        "JOINT Hips\n{\nOFFSET 0 100 0\nCHANNELS 3 Zrotation Xrotation Yrotation\n"
        f"{limbs}}}\n}}\nMOTION\nFrames: 1\nFrame Time: 0.01\n" + "0 " * 12 + "\n"
    )
    armature = read_bvh(tmp_path / "a.bvh")
    np.testing.assert_allclose(armature.offsets[armature.names.index("Hips")], [0, 1, 0])


def test_a_bvh_file_has_a_pose_for_every_frame_at_one_rate(tmp_path):
    motion = moving_body()
    unknown = np.array(motion.poses.position)
    unknown[:3], unknown[9] = np.nan, np.nan
    write_animation(tmp_path / "a.bvh", with_parts(motion, position=unknown))
    armature = read_bvh(tmp_path / "a.bvh")
    np.testing.assert_allclose(armature.positions[:3], armature.positions[[3, 3, 3]])
    assert len(armature.times) == SAMPLES
    uneven = motion.times.copy()
    uneven[30:] += 0.1
    write_animation(tmp_path / "b.bvh", with_parts(motion, times=uneven))
    longer = read_bvh(tmp_path / "b.bvh")
    assert len(longer.times) == SAMPLES + 6 and longer.times[1] == pytest.approx(1 / RATE)
    np.testing.assert_allclose(longer.positions[:30], read_bvh_of(motion, tmp_path)[:30], atol=2e-6)
    nowhere = with_parts(motion, position=np.full_like(unknown, np.nan))
    for name in ("c.bvh", "c.glb"):
        with pytest.raises(InputError, match="every sample's pose is missing"):
            write_animation(tmp_path / name, nowhere)


def read_bvh_of(motion, folder) -> np.ndarray:
    write_animation(folder / "whole.bvh", motion)
    return read_bvh(folder / "whole.bvh").positions


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("HIERARCHY", "HIERACHY", "line 1: found 'HIERACHY', expected 'HIERARCHY'"),
        ("OFFSET 20.0 5.0 0.0", "OFFSET 20.0 5.0", "line 12: found 'OFFSET 20.0 5.0', expected"),
        ("OFFSET 20.0", "OFFSET x", "line 12"),
        ("CHANNELS 1 Zrotation", "CHANNELS 1 Wrotation", "line 13"),
        ("CHANNELS 1 Zrotation", "CHANNELS 2 Zrotation", "expected 2 different channels"),
        ("JOINT Leg", "JOINT Arm", "joint 'Arm' is named twice"),
        ("JOINT Leg", "LEG", "line 20: found 'LEG', expected JOINT"),
        ("Frames: 2", "Frames: 3", "states 3 frames, but the file ends after 2"),
        ("Frame Time: 0.04", "Frame Time: 0", "expected seconds per frame"),
        ("Frame Time: 0.04", "Time: 0.04", "line 32: found 'Time: 0.04', expected 'Frame Time:'"),
        ("-80 50 60", "-80 50", "line 34: found 14 columns, expected 15"),
        ("-80 50 60", "-80 50 nan", "not a number"),
        ("-25 45 15", "-25 forty 15", "line 34: found 'forty', expected a number"),
        ("0 50 1 -25", "0 90 1 -25", "joint 'Chest' slides"),
        ("MOTION", "}\nMOTION", "line 30"),
        ("Frames: 2\nFrame Time: 0.04", "", "before its first frame"),
    ],
)  # fmt: skip
def test_bad_bvh_files_are_refused_in_one_sentence(tmp_path, old, new, message):
    path = tmp_path / "a.bvh"
    text = FOREIGN.replace(old, new)
    path.write_text(text.split("90 3")[0] if "before" in message else text)
    assert message in complaint(read_bvh, path)


# glTF --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def viewer(folder):
    return Player(folder / "motion.glb")


def test_pygltflib_finds_every_joint_of_every_frame_where_we_have_it(viewer):
    keys = viewer.curves[0, "translation"][0].ravel()
    np.testing.assert_allclose(keys, moving_body().times, atol=1e-6)
    names = landmark_names("vrm")
    for landmark, ours in joints_in_file().items():
        node = viewer.node(names[landmark])
        viewed = np.array([viewer.world(node, key)[:3, 3] for key in range(SAMPLES)])
        assert np.abs(viewed - ours).max() < MILLIMETRE, landmark


def test_quaternions_of_a_gltf_file_take_the_shorter_way(viewer):
    for (_, path), (_, values) in viewer.curves.items():
        if path == "rotation":
            assert (np.sum(values[1:] * values[:-1], -1) > 0).all()


@pytest.mark.parametrize("key", [None, 0, 37])
def test_the_skin_keeps_around_the_bones(viewer, key):
    """Every vertex is no farther from its bone than the flesh is thick, at rest and in motion."""
    carriers, vertices = viewer.attribute("JOINTS_0")[:, 0], viewer.vertices(key)
    joints = np.array([viewer.world(j, key)[:3, 3] for j in viewer.file.skins[0].joints])
    radii, begin = make_scene(moving_body()).radii, 0
    for child, parent in sorted(viewer.parents.items()):
        a, reach = joints[parent], joints[child] - joints[parent]
        if reach @ reach < 1e-9:
            continue
        mine = slice(begin, begin := begin + 2 * RINGS * CORNERS)
        assert (carriers[mine] == parent).all()
        along = np.clip((vertices[mine] - a) @ reach / (reach @ reach), 0, 1)
        off = np.linalg.norm(vertices[mine] - a - along[:, None] * reach, axis=1)
        assert radii.min() - MILLIMETRE < off.min() <= off.max() < radii.max() + MILLIMETRE
    assert begin == len(vertices)


def test_trimesh_sees_a_person_in_a_t_pose_upright(folder):
    scene = trimesh.load_scene(folder / "motion.glb")
    width, height, depth = scene.geometry["body"].extents
    # The mesh ends above the ankle at the sole of the foot's cone: about a person's height.
    assert abs(height - HEIGHT) < 0.1 and abs(width - HEIGHT) < 0.3 and depth < 0.4
    assert scene.geometry["body"].is_winding_consistent and scene.geometry["body"].volume > 0.03


def test_a_gltf_file_leaves_unknown_poses_out_and_keeps_the_start(tmp_path):
    motion = moving_body()
    position = np.array(motion.poses.position)
    position[:2], position[7] = np.nan, np.nan
    late = with_parts(motion, times=motion.times + 1000, position=position)
    write_animation(tmp_path / "a.glb", late)
    armature = read_gltf(tmp_path / "a.glb")
    kept = np.isfinite(position[:, 0])
    np.testing.assert_allclose(armature.times, late.times[kept], atol=1e-6)
    np.testing.assert_allclose(armature.positions, position[kept] @ R_FILE_WORLD.T, atol=1e-6)


def test_bad_gltf_files_are_refused_in_one_sentence(folder, tmp_path):
    intact, path = (folder / "motion.glb").read_bytes(), tmp_path / "a.glb"

    def refused(content: bytes) -> str:
        path.write_bytes(content)
        return problem_of(read_gltf, path)

    assert "not a binary glTF file" in refused(b"{}")
    assert "cut off" in refused(intact[:-9])
    assert "version 1" in refused(intact[:4] + b"\1" + intact[5:])
    assert "no readable JSON" in refused(intact.replace(b'{"asset"', b'x"asset"'))
    assert "nodes: found None" in refused(intact.replace(b'"nodes":[{', b'"odes" :[{'))
    assert "found 'SPLINE', expected" in refused(intact.replace(b'"LINEAR"', b'"SPLINE"'))
    assert "no animation" in refused(intact.replace(b'"animations"', b'"animatiens"'))


def test_every_convention_names_all_joints_differently():
    for convention, names in CONVENTIONS.items():
        assert set(names) == set(CONVENTIONS["jaxmocap"]), convention
        assert len(set(names.values())) == len(names), convention
        assert len(set(landmark_names(convention).values())) == len(LANDMARKS)
    assert landmark_names("vrm")["elbow_l"] == "leftLowerArm"
    assert landmark_names("humanik")["shoulder_r"] == "RightArm"
    assert landmark_names("smpl")["wrist_l"] == "left_wrist"
    assert landmark_names("isb")["hip_r"] == "femur_r"
