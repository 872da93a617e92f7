"""OpenSim's coordinates against its own model's kinematics, and files that are Y up."""

import re
from typing import Any

import numpy as np
import pytest
from conftest import complaint
from moving_body import moving_body
from opensim_model import body_frames, coordinates

from jaxmocap.body.motion import Motion
from jaxmocap.body.orientations import body_turns, matrices
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton, with_joints, with_wrists
from jaxmocap.cli.program import main
from jaxmocap.evaluation.errors import evaluate_directory
from jaxmocap.formats.motion_npz import save_motion
from jaxmocap.formats.opensim.coordinates import COORDINATES, write_opensim
from jaxmocap.formats.recordings.recording import load_recording
from jaxmocap.formats.time_series.mot import read_mot
from jaxmocap.formats.time_series.trc import read_trc, write_trc
from jaxmocap.pipelines.writing import write_motion

# Joint centres in the model's unscaled bodies, right: the knee in the thigh, the elbow in the
# upper arm; and how far the next centre is from them.
KNEE, SHANK = np.array([-0.0050722, -0.4080045, -0.00064174]), 0.39513
ELBOW, FOREARM = np.array([0.0161342, -0.2859784, 0.0032874]), 0.24994
LIMBS = {"femur": KNEE, "humerus": ELBOW}
LANDMARKS = {
    "hip": ("femur", np.zeros(3)),
    "knee": ("femur", KNEE),
    "ankle": ("talus", np.zeros(3)),
    "shoulder": ("humerus", np.zeros(3)),
    "elbow": ("humerus", ELBOW),
    "wrist": ("hand", np.zeros(3)),
}


def random_motion(skeleton: Skeleton, samples: int = 40, seed: int = 3) -> Motion:
    """Poses anywhere within the joints' ranges, facing anywhere."""
    rng = np.random.default_rng(seed)
    low, high = np.asarray(skeleton.limits, float).T
    quaternion = rng.normal(size=(samples, 4)) * [1.0, 0.2, 0.2, 1.0]
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    angles = rng.uniform(low, high, (samples, len(low)))
    parts: list[Any] = [rng.normal(size=(samples, 3)), quaternion, angles]
    return Motion(skeleton, np.arange(samples) / 50, Pose(*parts))


def scales(motion: Motion) -> dict[str, Any]:
    """Each body of the model as long as ours, as a lab would scale it."""
    joints = {name: points[0] for name, points in motion.joints().items()}

    def apart(a: str, b: str) -> float:
        return float(np.linalg.norm(joints[a] - joints[b]))

    thigh = apart("hip_r", "knee_r") / np.linalg.norm(KNEE)
    factors: dict[str, Any] = {"pelvis": [thigh, thigh, apart("hip_l", "hip_r") / (2 * 0.07726)]}
    factors["torso"] = [1.0, 1.0, apart("shoulder_l", "shoulder_r") / (2 * 0.17)]
    for side in "lr":
        factors[f"femur_{side}"] = thigh
        for bone in ("tibia", "talus", "calcn"):
            factors[f"{bone}_{side}"] = apart("knee_r", "ankle_r") / SHANK
        factors[f"humerus_{side}"] = apart("shoulder_r", "elbow_r") / np.linalg.norm(ELBOW)
        for bone in ("ulna", "radius", "hand"):
            factors[f"{bone}_{side}"] = apart("elbow_r", "wrist_r") / FOREARM
    return factors


def modelled(motion: Motion, path) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Landmark -> (T, 3), and body -> (T, 3, 3), of the model by a file that we wrote; Y up."""
    write_opensim(path, motion)
    _, columns = read_mot(path)
    factors = scales(motion)
    frames = [
        body_frames({name: column[i] for name, column in columns.items()}, factors)
        for i in range(len(motion.times))
    ]
    landmarks = {}
    for name, (body, place) in LANDMARKS.items():
        for side, mirror in (("l", -1.0), ("r", 1.0)):
            station = place * factors[f"{body}_{side}"] * [1.0, 1.0, mirror]
            poses = [frame[f"{body}_{side}"] for frame in frames]
            landmarks[f"{name}_{side}"] = np.array([p + R @ station for R, p in poses])
    turns = {body: np.stack([frame[body][0] for frame in frames]) for body in frames[0]}
    return landmarks, turns


def ours_y_up(motion: Motion) -> dict[str, np.ndarray]:
    """Our landmarks (T, 3) by hand in OpenSim's axes: y up, z our x."""
    return {name: points[:, [1, 2, 0]] for name, points in motion.joints().items()}


def farthest(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a - b, axis=-1).max())


def degrees_between(R: np.ndarray, S: np.ndarray) -> np.ndarray:
    trace = np.einsum("tij,tij->t", R, S)
    return np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1)))


@pytest.mark.parametrize("height", [1.5, 1.75, 1.95])
def test_the_model_puts_the_joints_of_the_limbs_within_3_mm_of_ours(height, tmp_path):
    motion = random_motion(Skeleton.human(height))
    theirs, ours = modelled(motion, tmp_path / "a.mot")[0], ours_y_up(motion)
    for side in "lr":
        assert farthest(theirs[f"hip_{side}"], ours[f"hip_{side}"]) < 1e-4
        assert farthest(theirs[f"knee_{side}"], ours[f"knee_{side}"]) < 1e-3
        assert farthest(theirs[f"ankle_{side}"], ours[f"ankle_{side}"]) < 2e-3
        for joint in ("elbow", "wrist"):
            from_shoulder = [
                each[f"{joint}_{side}"] - each[f"shoulder_{side}"] for each in (theirs, ours)
            ]
            assert farthest(*from_shoulder) < 3e-3


def test_the_model_orients_pelvis_thorax_and_the_lines_of_the_limbs_within_1_degree(tmp_path):
    motion = random_motion(Skeleton.human(1.75))
    landmarks, turns = modelled(motion, tmp_path / "a.mot")
    R_pelvis = matrices(np.asarray(motion.poses.quaternion, float))
    R_thorax = R_pelvis @ body_turns(motion.skeleton, np.asarray(motion.poses.angles, float))[
        :, motion.skeleton.tree.bone("spine3")
    ]  # fmt: skip
    # The model's x forward, y up, z right in ours, x forward, y left, z up; files' in the world's.
    to_body, to_file = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.eye(3)[[1, 2, 0]]
    for body, R in (("pelvis", R_pelvis), ("torso", R_thorax)):
        assert degrees_between(turns[body], to_file @ R @ to_body).max() < 0.01
    ours = ours_y_up(motion)
    for near, far in (
        ("hip", "knee"),
        ("knee", "ankle"),
        ("shoulder", "elbow"),
        ("elbow", "wrist"),
    ):
        for side in "lr":
            lines = [each[f"{far}_{side}"] - each[f"{near}_{side}"] for each in (landmarks, ours)]
            first, second = (line / np.linalg.norm(line, axis=-1, keepdims=True) for line in lines)
            assert farthest(first, second) < np.radians(1.0)


def test_the_thigh_and_the_upper_arm_are_rotated_as_far_as_the_model_oblique_axes_ask(tmp_path):
    motion = random_motion(Skeleton.human(1.75))
    turns = modelled(motion, tmp_path / "a.mot")[1]
    R_bone = matrices(np.asarray(motion.poses.quaternion, float))[:, None] @ body_turns(
        motion.skeleton, np.asarray(motion.poses.angles, float)
    )
    to_body, to_file = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.eye(3)[[1, 2, 0]]
    for bone, least, most in (("femur_r", 1.0, 9.0), ("humerus_l", 12.0, 15.0)):
        ours = to_file @ R_bone[:, motion.skeleton.tree.bone(bone)] @ to_body
        apart = degrees_between(turns[bone], ours)
        assert apart.min() > least and apart.max() < most


@pytest.mark.parametrize(
    ("hinges", "expected"),
    [
        ({}, {"hip_flexion": 0.4, "knee_angle": 0, "elbow_flex": 5.4, "pro_sup": 90}),
        ({"hip_flexion": 40}, {"hip_flexion": 40.4}),
        ({"hip_abduction": 20}, {"hip_adduction": -20}),
        ({"hip_rotation": 20, "knee_flexion": 60}, {"hip_rotation": 22.4, "knee_angle": 60}),
        ({"arm_flex": 60}, {"arm_flex": 57}),
        ({"arm_abduct": 50}, {"arm_add": -48.5}),
        ({"elbow_flex": 80}, {"elbow_flex": 85.4, "arm_rot": -13}),
        ({"arm_rot": 30, "elbow_flex": 80}, {"arm_rot": 17}),
    ],
)
@pytest.mark.parametrize("side", ["l", "r"])
def test_signs_are_the_models(hinges, expected, side, tmp_path):
    skeleton = Skeleton.human(1.75)
    angles = np.zeros((1, len(skeleton.tree.joints)))
    for name, angle in hinges.items():
        angles[0, skeleton.tree.joint(f"{name}_{side}")] = np.radians(angle)
    parts: list[Any] = [np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), angles]
    write_opensim(tmp_path / "a.mot", Motion(skeleton, np.zeros(1), Pose(*parts)))
    columns = read_mot(tmp_path / "a.mot")[1]
    for name, angle in expected.items():
        assert np.degrees(columns[f"{name}_{side}"][0]) == pytest.approx(angle, abs=0.5)
    # Facing our world's x is facing the file's z, a quarter turn to the model's right.
    assert np.degrees(columns["pelvis_rotation"][0]) == pytest.approx(-90)


def test_forearm_wrist_and_foot_follow_where_the_body_has_such_joints(tmp_path):
    skeleton = with_wrists(Skeleton.human(1.75))
    motion = random_motion(skeleton)
    write_opensim(tmp_path / "a.mot", motion)
    columns, angles = read_mot(tmp_path / "a.mot")[1], np.asarray(motion.poses.angles, float)
    for side in "lr":
        for theirs, ours in (("wrist_flex", "wrist_flex"), ("wrist_dev", "wrist_deviate")):
            of_ours = angles[:, skeleton.tree.joint(f"{ours}_{side}")]
            assert np.abs(columns[f"{theirs}_{side}"] - of_ours).max() < 1e-6
        twist = angles[:, skeleton.tree.joint(f"elbow_twist_{side}")]
        rest = np.degrees(columns[f"pro_sup_{side}"] - twist)
        assert np.abs((rest - 103 + 180) % 360 - 180).max() < 6
    whole = with_joints(Skeleton.human(1.75), "whole.toml")
    angles = np.zeros((1, len(whole.tree.joints)))
    angles[0, whole.tree.joint("ankle_dorsiflex_r")] = np.radians(15)
    parts: list[Any] = [np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), angles]
    write_opensim(tmp_path / "b.mot", Motion(whole, np.zeros(1), Pose(*parts)))
    columns = read_mot(tmp_path / "b.mot")[1]
    assert np.degrees(columns["ankle_angle_r"][0]) == pytest.approx(15, abs=1.5)
    assert columns["ankle_angle_l"][0] == 0


def test_the_file_has_every_coordinate_and_no_missing_value(tmp_path):
    motion = moving_body()
    quaternion = np.array(motion.poses.quaternion)
    quaternion[:7] = np.nan
    gappy = Motion(motion.skeleton, motion.times, motion.poses._replace(quaternion=quaternion))
    sentences = write_opensim(tmp_path / "a.mot", gappy)
    text = (tmp_path / "a.mot").read_text()
    assert "nan" not in text.lower() and "7 samples without a pose" in sentences[1]
    assert re.search(r"\nversion=1\nnRows=53\nnColumns=40\ninDegrees=yes\nendheader\ntime\t", text)
    times, columns = read_mot(tmp_path / "a.mot")
    assert tuple(columns) == COORDINATES and times[0] == pytest.approx(gappy.times[7])
    assert set(columns) == coordinates() | {"knee_angle_r_beta", "knee_angle_l_beta"}
    nothing = Motion(
        motion.skeleton, motion.times, motion.poses._replace(quaternion=quaternion * np.nan)
    )
    assert "no sample has a pose" in complaint(write_opensim, tmp_path / "b.mot", nothing)


def test_angles_begin_near_0_with_hanging_arms_and_a_step_is_a_warning(tmp_path):
    """Arms that hang, then circle overhead, then one elbow that is bent within a sample."""
    skeleton = Skeleton.human(1.75)
    angles = np.zeros((400, len(skeleton.tree.joints)))
    angles[100:, skeleton.tree.joint("arm_flex_r")] = np.radians(np.linspace(0, 170, 300))
    angles[100:, skeleton.tree.joint("arm_abduct_r")] = np.sin(np.linspace(0, 30, 300))
    parts: list[Any] = [np.zeros((400, 3)), np.tile([1.0, 0, 0, 0], (400, 1)), angles]
    motion = Motion(skeleton, np.arange(400) / 50, Pose(*parts))
    warnings: list[str] = []
    write_motion(motion, tmp_path, warn=warnings.append, opensim=True)
    assert not [each for each in warnings if "steps" in each]
    columns = read_mot(tmp_path / "angles_opensim.mot")[1]
    assert all(abs(np.degrees(columns[f"arm_{name}_r"][0])) < 15 for name in ("flex", "add", "rot"))
    angles[380:, skeleton.tree.joint("elbow_flex_l")] = np.radians(90)
    write_motion(motion, tmp_path, warn=warnings.append, opensim=True)
    for file, joint in (("angles", "elbow_flex_l"), ("angles_isb", "elbow_flexion_l"),
                        ("angles_opensim", "elbow_flex_l")):  # fmt: skip
        expected = (
            f"{file}.mot: {joint} steps by 90° from 7.58 to 7.60 s, the largest of 1 above 60°"
        )
        assert expected in warnings


def test_convert_writes_it_and_says_what_it_cannot_be_read_for(
    tmp_path, capsys, refusal, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    save_motion("motion.npz", moving_body())
    assert main(["convert", "motion.npz", "a.mot", "--names", "opensim", "--up", "y"]) == 0
    assert "neck and clavicles" in capsys.readouterr().out
    problems = {
        "a.mot b.npz --body motion.npz": "holds OpenSim's coordinates",
        "motion.npz b.trc --names opensim": "--names opensim does not apply",
        "motion.npz b.mot --names vrm": "--names vrm does not apply",
        "motion.npz b.mot --names opensim --angles isb": "--angles does not apply",
        "motion.npz b.mot --names opensim --up z": "--up z does not apply",
        "motion.npz b.bvh --up y": "--up y does not apply",
    }
    for arguments, problem in problems.items():
        assert problem in refusal("convert", *arguments.split())


@pytest.mark.parametrize("suffix", [".trc", ".csv", ".c3d"])
def test_joints_and_markers_are_written_y_up(suffix, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_motion("motion.npz", moving_body())
    target, again = f"joints{suffix}", "again.trc"
    assert main(["convert", "motion.npz", target, "--up", "y"]) == 0
    assert main(["convert", target, again]) == 0
    assert main(["convert", "motion.npz", "z.trc"]) == 0
    assert main(["convert", "z.trc", "y.trc", "--up", "y"]) == 0
    joints = moving_body().joints()
    for file in (again, "y.trc"):
        for name, points in read_trc(file).points().items():
            assert np.abs(points - joints[name][:, [1, 2, 0]]).max() < 2e-6


def test_what_is_tracked_is_written_y_up_and_read_again_as_the_same(tmp_path):
    motion, folder = moving_body(), tmp_path / "tracked"
    folder.mkdir()
    files = write_motion(motion, folder, up="y", opensim=True)
    assert {"angles.mot", "angles_isb.mot", "angles_opensim.mot"} <= {path.name for path in files}
    marker = "wrist_l = { bone = 'hand_l', at = 0.0 }"
    text = f"[markers]\nfile = 'tracked/joints.trc'\nup = 'y'\n[markers.on]\n{marker}\n"
    (tmp_path / "recording.toml").write_text(text)
    positions = load_recording(tmp_path / "recording.toml").positions_world[:, 0]
    assert np.abs(positions - motion.joints()["wrist_l"]).max() < 2e-6
    # The reference is Z up, and so is what was tracked, whatever its joints.trc is.
    write_trc(tmp_path / "truth.trc", motion.times, motion.joints())
    assert evaluate_directory(folder, tmp_path / "truth.trc").distances.max() < 2e-6
