"""ISB's joint angles: what an anatomist would call a pose, and no jumps."""

from typing import Any

import numpy as np
import pytest
from conftest import poses
from hypothesis import given
from hypothesis import strategies as st
from moving_body import RATE, moving_body
from scipy.spatial.transform import Rotation

from jaxmocap.body.motion import Motion
from jaxmocap.body.orientations import body_turns
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton, with_wrists
from jaxmocap.cli.program import main
from jaxmocap.formats.convert import ConversionOptions, convert_file
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.motion_npz import save_motion
from jaxmocap.formats.time_series.isb import LIMB_JOINTS, hinge_angles, isb_angles
from jaxmocap.formats.time_series.mot import read_mot
from jaxmocap.formats.time_series.resampling import even_times, resample_motion
from jaxmocap.geometry.euler import continuous_euler

SKELETON = Skeleton.human(1.75)
# What the 21 degrees of freedom can say of joints; pelvis and thorax in the world come on top.
OF_LIMBS = ("shoulder_plane", "shoulder_elevation", "shoulder_rotation", "elbow_flexion",
            "hip_flexion", "hip_adduction", "hip_rotation", "knee_flexion")  # fmt: skip


def motion_of(degrees: dict[str, Any], samples: int = 1, quaternion=None) -> Motion:
    """A motion whose named hinges have these angles, and all others 0."""
    angles = np.zeros((samples, len(SKELETON.tree.joints)))
    for name, angle in degrees.items():
        angles[:, SKELETON.tree.joint(name)] = np.radians(angle)
    turns = np.tile([1.0, 0, 0, 0], (samples, 1)) if quaternion is None else quaternion
    poses: list[Any] = [np.zeros((samples, 3)), turns, angles]
    return Motion(SKELETON, np.arange(samples) / 100, Pose(*poses))


def angles_of(degrees: dict[str, Any]) -> dict[str, float]:
    return {name: np.degrees(a[0]) for name, a in isb_angles(motion_of(degrees)).items()}


# Poses that have a name --------------------------------------------------------------------------


def test_the_skeleton_tells_what_its_hinges_can_and_nothing_else():
    world = {f"{part}_{angle}" for part in ("pelvis", "thorax")
             for angle in ("rotation", "lean", "tilt")}  # fmt: skip
    trunk = {"trunk_extension", "neck_extension", "neck_bending"}
    limbs = {f"{name}_{side}" for name in OF_LIMBS for side in "lr"}
    assert set(angles_of({})) == world | trunk | limbs
    unmade = {joint.name for joint in LIMB_JOINTS if not hinge_angles(SKELETON, joint, "l")}
    assert unmade == {"ankle", "wrist"}


def test_all_angles_are_0_upright_with_the_arms_hanging():
    assert max(map(abs, angles_of({}).values())) < 1e-6


@pytest.mark.parametrize("side", ["l", "r"])
@pytest.mark.parametrize(
    ("hinges", "expected"),
    [
        ({"arm_abduct": 90}, {"shoulder_plane": 0, "shoulder_elevation": -90}),
        ({"arm_flex": 90}, {"shoulder_plane": 90, "shoulder_elevation": -90}),
        ({"arm_flex": -40}, {"shoulder_plane": -90, "shoulder_elevation": -40}),
        ({"arm_abduct": 90, "arm_rot": 30}, {"shoulder_elevation": -90, "shoulder_rotation": 30}),
        ({"elbow_flex": 90}, {"elbow_flexion": 90, "shoulder_elevation": 0}),
        ({"hip_flexion": 95, "knee_flexion": 110}, {"hip_flexion": 95, "knee_flexion": 110}),
        ({"hip_abduction": 25}, {"hip_adduction": -25, "hip_flexion": 0}),
        ({"hip_rotation": 20}, {"hip_rotation": 20, "hip_adduction": 0}),
    ],
)
def test_a_pose_has_the_angles_that_an_anatomist_reads_off_it(side, hinges, expected):
    actual = angles_of({f"{name}_{side}": angle for name, angle in hinges.items()})
    other = "r" if side == "l" else "l"
    for name, angle in expected.items():
        assert actual[f"{name}_{side}"] == pytest.approx(angle, abs=1e-4), name
        assert actual[f"{name}_{other}"] == pytest.approx(0, abs=1e-4)


@pytest.mark.parametrize("side", ["l", "r"])
def test_a_body_with_wrists_has_pronation_from_the_anatomical_position(side):
    body = with_wrists(SKELETON)
    hinges = {"elbow_flex": 90, "elbow_twist": -60, "wrist_flex": 40, "wrist_deviate": 15}
    angles = np.zeros((1, len(body.tree.joints)))
    for name, angle in (hinges | {"neck_rotation": 35}).items():
        joint = name if name == "neck_rotation" else f"{name}_{side}"
        angles[0, body.tree.joint(joint)] = np.radians(angle)
    held: list[Any] = [np.zeros((1, 3)), np.eye(4)[:1], angles]
    actual = isb_angles(Motion(body, np.zeros(1), Pose(*held)))
    for name, angle in (("elbow_flexion", 90), ("elbow_pronation", 30), ("wrist_flexion", 40),
                        ("wrist_deviation", 15)):  # fmt: skip
        assert np.degrees(actual[f"{name}_{side}"][0]) == pytest.approx(angle, abs=1e-4)
    assert np.degrees(actual["neck_rotation"][0]) == pytest.approx(35, abs=1e-4)
    assert f"wrist_rotation_{side}" not in actual and f"elbow_carrying_{side}" not in actual
    # The other hangs with its thumb forward.
    assert actual[f"elbow_pronation_{'r' if side == 'l' else 'l'}"][0] == pytest.approx(np.pi / 2)


def test_a_deep_squat_with_a_bow_reads_as_one():
    bow = {f"spine{i}_flexion": 10.0 for i in (1, 2, 3)}
    legs = {f"{joint}_{s}": a for s in "lr" for joint, a in (("hip_flexion", 100.0),
                                                             ("knee_flexion", 120.0))}  # fmt: skip
    actual = angles_of(bow | legs | {"neck_bending": 15.0, "neck_flexion": -20.0})
    assert actual["trunk_extension"] == pytest.approx(-30, abs=1e-4)
    assert actual["thorax_tilt"] == pytest.approx(-30, abs=1e-4)
    assert actual["neck_extension"] == pytest.approx(20, abs=1e-4)
    assert actual["neck_bending"] == pytest.approx(15, abs=1e-4)
    assert actual["hip_flexion_l"] == actual["hip_flexion_r"] == pytest.approx(100, abs=1e-4)


@given(st.floats(-179, 179), st.floats(-80, 80), st.floats(-80, 80))
def test_lean_and_tilt_are_the_persons_whichever_way_they_face(yaw, lean, tilt):
    # In the world's axes: about z, then about the own forward axis, then about the own right.
    turn = Rotation.from_euler("ZXY", [yaw, lean, -tilt], degrees=True)
    motion = motion_of({}, quaternion=turn.as_quat(scalar_first=True)[None])
    actual = isb_angles(motion)
    for name, angle in (("rotation", yaw), ("lean", lean), ("tilt", tilt)):
        assert np.degrees(actual[f"pelvis_{name}"][0]) == pytest.approx(angle, abs=1e-6)
        np.testing.assert_allclose(actual[f"thorax_{name}"], actual[f"pelvis_{name}"], atol=1e-9)


# Against SciPy, in any pose ----------------------------------------------------------------------


@given(poses())
def test_the_angles_make_the_turn_between_the_segments(pose):
    """Right limbs; x forward, y up, z right, turned by SciPy in the order that ISB names."""
    held: list[Any] = [np.asarray(part)[None] for part in pose]
    actual = isb_angles(Motion(SKELETON, np.zeros(1), Pose(*held)))
    R = body_turns(SKELETON, held[2])[0]
    axes = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # rows: ISB's axes in ours
    for near, far, order, names, signs in (
        ("spine3", "humerus_r", "YXY", OF_LIMBS[:3], (1, 1, 1)),
        (None, "femur_r", "ZXY", OF_LIMBS[4:7], (1, 1, 1)),
        ("femur_r", "tibia_r", "ZXY", ("knee_flexion", None, None), (-1, 1, 1)),
        ("humerus_r", "radius_r", "ZXY", ("elbow_flexion", None, None), (1, 1, 1)),
    ):
        R_near = np.eye(3) if near is None else R[SKELETON.tree.bone(near)]
        expected = axes @ R_near.T @ R[SKELETON.tree.bone(far)] @ axes.T
        turns = [s * actual[f"{n}_r"][0] if n else 0.0 for n, s in zip(names, signs, strict=True)]
        np.testing.assert_allclose(Rotation.from_euler(order, turns).as_matrix(), expected,
                                   atol=3e-6)  # fmt: skip


@given(poses())
def test_left_and_right_mean_the_same(pose):
    """The mirror image of a pose exchanges the sides and nothing else."""
    angles, joints = np.asarray(pose.angles), SKELETON.tree.joints
    swapped = [name[:-2] + {"_l": "_r", "_r": "_l"}[name[-2:]] if name[-2:] in ("_l", "_r")
               else name for name in joints]  # fmt: skip
    mirrored = angles[[joints.index(name) for name in swapped]]
    mirrored[joints.index("neck_bending")] *= -1
    held: list[Any] = [np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)),
                       np.stack([angles, mirrored])]  # fmt: skip
    parts = [Pose(*(part[i : i + 1] for part in held)) for i in range(2)]
    actual, image = (isb_angles(Motion(SKELETON, np.zeros(1), part)) for part in parts)
    for name in OF_LIMBS:
        np.testing.assert_allclose(actual[f"{name}_l"], image[f"{name}_r"], atol=1e-6)


# Continuity --------------------------------------------------------------------------------------


def test_an_arm_swings_through_hanging_without_a_jump():
    swing = 40 * np.sin(np.linspace(0, 4 * np.pi, 201))
    assert 0.0 in swing[:1]
    actual = isb_angles(motion_of({"arm_flex_r": swing}, len(swing)))
    # Forwards at first; behind the body it is the other side of the same plane.
    np.testing.assert_allclose(np.degrees(actual["shoulder_plane_r"]), 90, atol=1e-4)
    np.testing.assert_allclose(np.degrees(actual["shoulder_elevation_r"]), -swing, atol=1e-4)
    np.testing.assert_allclose(np.degrees(actual["shoulder_rotation_r"]), -90, atol=1e-4)


def test_an_arm_that_comes_to_hang_keeps_its_plane():
    down = np.concatenate([np.linspace(60, 0, 31), np.zeros(20)])
    turning = np.concatenate([np.zeros(31), np.linspace(0, 45, 20)])
    actual = isb_angles(motion_of({"arm_abduct_l": down, "arm_rot_l": turning}, 51))
    np.testing.assert_allclose(actual["shoulder_plane_l"], 0, atol=1e-6)
    np.testing.assert_allclose(np.degrees(actual["shoulder_rotation_l"]), turning, atol=1e-4)


def test_turning_about_goes_on_past_180_and_over_unknown_samples():
    turning = np.linspace(0, 1080, 241)
    quaternion = Rotation.from_euler("z", turning[:, None], degrees=True).as_quat(scalar_first=True)
    quaternion[40:50] = np.nan
    actual = isb_angles(motion_of({}, len(turning), quaternion))
    assert np.isnan(actual["pelvis_rotation"][40:50]).all()
    assert np.isfinite(actual["hip_flexion_r"]).all()
    measured = np.isfinite(quaternion[:, 0])
    np.testing.assert_allclose(np.degrees(actual["pelvis_rotation"][measured]), turning[measured],
                               atol=1e-6)  # fmt: skip


def test_no_angle_of_a_lively_motion_jumps():
    """Of a shoulder's plane and rotation as much is meant as the arm is raised."""
    motion = moving_body()
    actual = isb_angles(resample_motion(motion, even_times(motion.times, 10 * RATE)))
    for name, angle in actual.items():
        raised = np.ones(len(angle) - 1)
        if name.startswith(("shoulder_plane", "shoulder_rotation")):
            raised = np.sin(actual[f"shoulder_elevation_{name[-1]}"])[1:]
        assert np.abs(np.diff(angle) * raised).max() < np.radians(8), name
        assert np.abs(np.diff(angle)).max() < np.radians(100), name


@pytest.mark.parametrize("order", ["YXY", "ZXY", "ZYX", "XZX"])
@given(st.integers(0, 10**6))
def test_continuous_angles_make_the_turns_they_were_made_of(order, seed):
    rng = np.random.default_rng(seed)
    # Every third sample is in the lock.
    angles = rng.uniform(-3, 3, (12, 2, 3))
    angles[::3, :, 1] = np.pi / 2 if order[0] != order[2] else np.pi
    R = Rotation.from_euler(order, angles.reshape(-1, 3)).as_matrix().reshape(12, 2, 3, 3)
    R[4, 1] = np.nan
    actual = continuous_euler(R, order)
    measured = np.isfinite(R[..., 0, 0])
    assert (np.isfinite(actual).all(-1) == measured).all()
    again = Rotation.from_euler(order, actual[measured]).as_matrix()
    np.testing.assert_allclose(again, R[measured], atol=3e-6)


# Files -------------------------------------------------------------------------------------------


def test_a_motion_becomes_a_table_of_isb_angles_in_degrees(tmp_path):
    motion = motion_of({"elbow_flex_r": np.linspace(0, 90, 10)}, 10)
    save_motion(tmp_path / "motion.npz", motion)
    target = tmp_path / "isb.mot"
    assert main(["convert", str(tmp_path / "motion.npz"), str(target), "--angles", "isb"]) == 0
    times, columns = read_mot(target)
    np.testing.assert_allclose(times, motion.times, atol=1e-9)
    assert set(columns) == set(isb_angles(motion))
    np.testing.assert_allclose(np.degrees(columns["elbow_flexion_r"]), np.linspace(0, 90, 10),
                               atol=1e-5)  # fmt: skip
    with pytest.raises(InputError, match="ISB's angles, which hinges cannot be read from"):
        convert_file(target, tmp_path / "b.npz", ConversionOptions(body=tmp_path / "motion.npz"))
    with pytest.raises(InputError, match="--angles does not apply to"):
        convert_file(tmp_path / "motion.npz", tmp_path / "b.bvh", ConversionOptions(angles="isb"))
