"""Converting: what both formats hold survives, what one does not hold is a warning or refused."""

import numpy as np
import pytest
from conftest import complaint, poses, shared_folder
from hypothesis import given, settings
from hypothesis import strategies as st
from moving_body import SAMPLES, moving_body, with_parts
from scipy.spatial.transform import Rotation

from jaxmocap.body.motion import Motion
from jaxmocap.body.orientations import local_turns
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.cli.program import main
from jaxmocap.evaluation.errors import evaluate, evaluate_directory
from jaxmocap.formats.animation.bvh import read_bvh
from jaxmocap.formats.convert import ConversionOptions, convert_file
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.motion_npz import load_motion, save_motion
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.formats.time_series.mot import read_mot
from jaxmocap.formats.time_series.trc import write_trc


@pytest.fixture
def folder(tmp_path):
    save_motion(tmp_path / "motion.npz", moving_body())
    return tmp_path


def options(suffix: str, folder) -> ConversionOptions:
    return ConversionOptions(body=folder / "motion.npz") if suffix == "mot" else ConversionOptions()


@pytest.mark.parametrize("suffix", ["bvh", "glb", "mot"])
@settings(shared_folder, max_examples=15)
@given(st.lists(poses(), min_size=3, max_size=3))
def test_a_motion_survives_the_way_there_and_back(tmp_path, suffix, drawn):
    """Joints, turns and bone lengths; of angles in the hinges' lock only the turn is one."""
    held = Pose(*(np.stack(parts) for parts in zip(*drawn, strict=True)))
    motion = Motion(Skeleton.human(1.8), np.arange(len(drawn)) / 50, held)
    save_motion(tmp_path / "motion.npz", motion)
    convert_file(tmp_path / "motion.npz", tmp_path / f"there.{suffix}")
    convert_file(tmp_path / f"there.{suffix}", tmp_path / "back.npz", options(suffix, tmp_path))
    back = load_motion(tmp_path / "back.npz")
    np.testing.assert_allclose(back.times, motion.times, atol=1e-7)
    np.testing.assert_allclose(back.skeleton.lengths, motion.skeleton.lengths, atol=2e-6)
    for name, points in motion.joints().items():
        np.testing.assert_allclose(back.joints()[name], points, atol=1e-5)
    turns = local_turns(motion.skeleton, np.asarray(held.angles))
    again = local_turns(back.skeleton, np.asarray(back.poses.angles))
    np.testing.assert_allclose(again, turns, atol=1e-5)


@pytest.mark.parametrize("suffix", ["bvh", "glb", "mot"])
def test_angles_within_their_limits_come_back_as_they_were(folder, suffix):
    """Of the two ways in which three hinges make a turn, the one within the limits is taken."""
    convert_file(folder / "motion.npz", folder / f"there.{suffix}")
    convert_file(folder / f"there.{suffix}", folder / "back.npz", options(suffix, folder))
    back = load_motion(folder / "back.npz")
    np.testing.assert_allclose(back.poses.angles, moving_body().poses.angles, atol=1e-5)


@pytest.mark.parametrize("names", ["jaxmocap", "vrm", "humanik", "smpl", "isb"])
def test_joints_by_any_convention_are_recognised(folder, names):
    convert_file(folder / "motion.npz", folder / "a.bvh", ConversionOptions(names=names))
    convert_file(folder / "a.bvh", folder / "b.glb", ConversionOptions(names="vrm"))
    convert_file(folder / "b.glb", folder / "back.npz")
    convert_file(folder / "a.bvh", folder / "joints.trc", ConversionOptions(names=names))
    joints = moving_body().joints()
    for name, points in load_motion(folder / "back.npz").joints().items():
        np.testing.assert_allclose(points, joints[name], atol=1e-5)
    elbow = {"vrm": "leftLowerArm", "humanik": "LeftForeArm", "smpl": "left_elbow",
             "isb": "forearm_l", "jaxmocap": "radius_l"}[names]  # fmt: skip
    actual = read_markers(folder / "joints.trc").points()[elbow]
    np.testing.assert_allclose(actual, joints["elbow_l"], atol=1e-5)


@pytest.mark.parametrize("source", ["npz", "bvh", "glb"])
@pytest.mark.parametrize("target", ["trc", "csv", "c3d"])
def test_joints_of_any_motion_become_markers_with_z_up(folder, source, target):
    if source != "npz":
        convert_file(
            folder / "motion.npz", folder / f"motion.{source}", ConversionOptions(names="smpl")
        )
    wanted = ConversionOptions(names="smpl")
    warnings = convert_file(folder / f"motion.{source}", folder / f"joints.{target}", wanted)
    assert warnings == ["left out: the bones' orientations"]
    markers, joints = read_markers(folder / f"joints.{target}").points(), moving_body().joints()
    for ours, theirs in (("elbow_l", "left_elbow"), ("hip_r", "right_hip"), ("neck", "neck")):
        np.testing.assert_allclose(markers[theirs], joints[ours], atol=1e-5)


@pytest.mark.parametrize("source", ["trc", "csv", "c3d"])
@pytest.mark.parametrize("target", ["trc", "csv", "c3d"])
def test_markers_survive_any_way(tmp_path, source, target):
    points = {"A": np.arange(12.0).reshape(4, 3) / 7, "B b": np.full((4, 3), np.nan)}
    points["B b"][2] = [0.1, -0.2, 0.3]
    write_trc(tmp_path / "first.trc", np.arange(4) / 100 + 0.05, points)
    convert_file(tmp_path / "first.trc", tmp_path / f"a.{source}")
    assert convert_file(tmp_path / f"a.{source}", tmp_path / f"b.{target}") == []
    markers = read_markers(tmp_path / f"b.{target}")
    np.testing.assert_allclose(markers.times, np.arange(4) / 100 + 0.05, atol=1e-6)
    for name, positions in points.items():
        np.testing.assert_allclose(markers.points()[name], positions, atol=1e-6)


def test_another_rate_draws_straight_lines_and_keeps_gaps(tmp_path):
    points = np.array([[0.0, 0, 1], [1, 0, 1], [np.nan] * 3, [3, 0, 1], [4, 0, 1]])
    write_trc(tmp_path / "a.trc", np.array([0, 0.1, 0.2, 0.3, 0.5]), {"A": points})
    with pytest.raises(InputError, match=r"100 to 200 ms apart.*--rate"):
        convert_file(tmp_path / "a.trc", tmp_path / "a.c3d")
    convert_file(tmp_path / "a.trc", tmp_path / "a.c3d", ConversionOptions(rate=20))
    markers = read_markers(tmp_path / "a.c3d")
    x = [0, 0.5, 1, np.nan, np.nan, np.nan, 3, 3.25, 3.5, 3.75, 4]
    np.testing.assert_allclose(markers.positions[:, 0, 0], x, atol=1e-6)


def test_a_motion_at_another_rate_turns_the_shortest_way(folder):
    convert_file(folder / "motion.npz", folder / "fast.npz", ConversionOptions(rate=240))
    fast, motion = load_motion(folder / "fast.npz"), moving_body()
    assert len(fast.times) == 4 * (SAMPLES - 1) + 1
    np.testing.assert_allclose(fast.poses.angles[::4], motion.poses.angles, atol=1e-5)
    halves = (motion.poses.angles[1:] + motion.poses.angles[:-1]) / 2
    np.testing.assert_allclose(fast.poses.angles[2::4], halves, atol=1e-5)
    a, b = (Rotation.from_quat(q, scalar_first=True) for q in
            (motion.poses.quaternion[:-1], motion.poses.quaternion[1:]))  # fmt: skip
    middle = Rotation.from_quat(fast.poses.quaternion[2::4], scalar_first=True)
    np.testing.assert_allclose((middle.inv() * a).magnitude(), (b.inv() * middle).magnitude(),
                               atol=1e-6)  # fmt: skip
    assert ((middle.inv() * a).magnitude() < (b.inv() * a).magnitude() * 0.51).all()


def test_bvh_files_say_what_they_leave_out(folder):
    motion = moving_body()
    position = np.array(motion.poses.position)
    position[4] = np.nan
    save_motion(folder / "a.npz", with_parts(motion, motion.times + 2.5, position))
    warnings = " ".join(convert_file(folder / "a.npz", folder / "a.bvh"))
    assert (
        "masses" in warnings
        and "1 samples without a pose" in warnings
        and "2.5 s, not 0" in warnings
    )


def test_a_single_joint_is_no_body_to_be_drawn(tmp_path):
    """As of a camera or a racket that was tracked."""
    joint = "ROOT racket\n{\nOFFSET 0 0 0\nCHANNELS 3 Xposition Yposition Zposition\n}\n"
    motion = "MOTION\nFrames: 2\nFrame Time: 0.01\n0 1 0\n0 2 0\n"
    (tmp_path / "racket.bvh").write_text(f"HIERARCHY\n{joint}{motion}")
    files = tmp_path / "racket.bvh", tmp_path / "racket.glb"
    assert "found no joint away from its parent" in complaint(
        convert_file, *files, ConversionOptions(unit="m")
    )
    assert not files[1].exists()


def test_what_cannot_be_converted_is_refused_in_one_sentence(folder):
    def refused(source, target, **given) -> str:
        files = folder / source, folder / target
        message = complaint(convert_file, *files, ConversionOptions(**given))
        assert not (folder / target).exists()
        return message

    convert_file(folder / "motion.npz", folder / "a.trc")
    convert_file(folder / "motion.npz", folder / "a.mot")
    convert_file(folder / "motion.npz", folder / "a.bvh", ConversionOptions(names="smpl"))
    assert "positions of markers, not orientations of bones" in refused("a.trc", "b.bvh")
    assert "unknown suffix '.fbx', expected one of .c3d, .trc" in refused("a.trc", "b.fbx")
    assert "angles without bones" in refused("a.mot", "b.bvh")
    assert "expected a .npz, .bvh or .glb" in refused("a.mot", "b.bvh", body=folder / "a.trc")
    assert "--unit does not apply to .npz to .glb" in refused("motion.npz", "b.glb", unit="cm")
    assert "--names does not apply to .trc to .csv" in refused("a.trc", "b.csv", names="smpl")
    assert "no such file" in refused("none.npz", "b.bvh")
    nameless = (folder / "a.mot").read_text().replace("\tneck_flexion", "\tneck", 1)
    (folder / "c.mot").write_text(nameless)
    problem = refused("c.mot", "b.npz", body=folder / "motion.npz")
    assert "no column 'neck_flexion'" in problem
    text = (folder / "a.bvh").read_text()
    (folder / "c.bvh").write_text(text.replace("left_elbow", "Ellbogen"))
    assert "not our skeleton, whatever its joints" in refused("c.bvh", "b.npz")
    assert "no supported naming" in refused("c.bvh", "b.glb", names="vrm")
    # The left wrist turned by 50 degrees, which ours cannot.
    lines = text.splitlines()
    values = lines[-1].split()
    armature = read_bvh(folder / "a.bvh")
    turning = [n for n in armature.names if not n.endswith("_end")]
    values[3 + 3 * turning.index("left_wrist") + 1] = "50"
    (folder / "d.bvh").write_text("\n".join([*lines[:-1], " ".join(values)]))
    assert "hand_l at 0.983333 s: rotated" in refused("d.bvh", "b.npz")
    shifted = text.replace("JOINT left_shoulder\n", "JOINT left_shoulder\n", 1)
    i = shifted.index("OFFSET", shifted.index("JOINT left_collar"))
    shifted = shifted[:i] + "OFFSET 0.05 0.2 0.0" + shifted[shifted.index("\n", i) :]
    (folder / "e.bvh").write_text(shifted)
    assert "left_collar starts elsewhere" in refused("e.bvh", "b.npz")
    # A rest pose whose arms hang: joints would be where they are, angles 90 degrees off.
    i = text.index("OFFSET", text.index("JOINT left_elbow"))
    (folder / "f.bvh").write_text(text[:i] + "OFFSET 0 -0.3 0" + text[text.index("\n", i) :])
    assert "not our T: humerus_l points 90° aside" in refused("f.bvh", "b.npz")


def test_angles_are_written_in_degrees_without_jumps(folder):
    motion = moving_body()
    convert_file(folder / "motion.npz", folder / "a.mot")
    text = (folder / "a.mot").read_text().splitlines()
    assert text[:6] == ["a", "version=1", f"nRows={SAMPLES}", "nColumns=28", "inDegrees=yes",
                        "endheader"]  # fmt: skip
    times, columns = read_mot(folder / "a.mot")
    np.testing.assert_allclose(times, motion.times, atol=1e-9)
    joint = motion.skeleton.tree.joints.index("elbow_flex_r")
    np.testing.assert_allclose(
        columns["elbow_flex_r"], np.asarray(motion.poses.angles)[:, joint], atol=1e-9
    )
    written = float(text[-1].split("\t")[text[6].split("\t").index("elbow_flex_r")])
    assert written == pytest.approx(np.degrees(np.asarray(motion.poses.angles)[-1, joint]))
    np.testing.assert_allclose(columns["pelvis_tx"], 1.5 * motion.times, atol=1e-8)
    # It yaws from -2 to 1.93 radians.
    np.testing.assert_allclose(columns["pelvis_yaw"], 4 * motion.times - 2, atol=1e-8)


# Comparing with ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("suffix", "elbow"), [("bvh", "LeftForeArm"), ("glb", "leftLowerArm")])
def test_a_motion_is_compared_with_an_animation_file(folder, suffix, elbow):
    motion = moving_body()
    convert_file(folder / "motion.npz", folder / f"truth.{suffix}")
    assert evaluate(motion, folder / f"truth.{suffix}", {"elbow_l": elbow}).mean < 1e-5
    late = {name: points + np.array([0.03, 0, 0]) for name, points in motion.joints().items()}
    (tracked := folder / "tracked").mkdir()
    write_trc(tracked / "joints.trc", motion.times + 4, late)
    arguments = ["evaluate", str(tracked), str(folder / f"truth.{suffix}")]
    arguments += ["--match", f"elbow_l={elbow}", "--json", str(folder / "errors.json")]
    assert main([*arguments, "--offset", "4"]) == 0
    errors = evaluate_directory(tracked, folder / f"truth.{suffix}", {"elbow_l": elbow}, offset=4)
    np.testing.assert_allclose(errors.offsets, np.broadcast_to([0.03, 0, 0], errors.offsets.shape),
                               atol=1e-5)  # fmt: skip
    assert main(arguments) == 2


# The command -------------------------------------------------------------------------------------


def test_the_command_converts_and_says_what_it_left_out(recordings, tmp_path, capsys):
    serve, out = recordings / "motions" / "tennis_serve.c3d", tmp_path / "serve.trc"
    assert main(["convert", str(serve), str(out)]) == 0
    message = capsys.readouterr().out
    assert "left out: the labels' prefix Derrick:" in message and f"written  {out}" in message
    there, back = read_markers(serve), read_markers(out)
    assert back.names == there.names
    np.testing.assert_allclose(back.positions, there.positions, atol=1e-6)


def test_the_command_refuses_in_one_sentence_with_exit_code_2(folder, refusal):
    assert "unknown suffix '.xyz'" in refusal("convert", folder / "motion.npz", folder / "a.xyz")
    assert "'ell'" in refusal("convert", "a.npz", "b.bvh", "--unit", "ell")
