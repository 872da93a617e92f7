"""Markers with orientations: files, places on the body, wrists, outputs."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import complaint
from held_devices import DEVICES, write_controllers
from hypothesis import given
from hypothesis import strategies as st
from pythonosc.osc_message_builder import OscMessageBuilder
from scipy.spatial.transform import Rotation

from jaxmocap import Recording, Settings
from jaxmocap.body.arms import arm_dofs, grips, hang
from jaxmocap.body.model import marker_sites
from jaxmocap.body.motion import Motion
from jaxmocap.body.orientations import body_turns, quaternions
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton, has_wrists, with_wrists
from jaxmocap.capture.streams.osc import MarkerMessage, parse_packet
from jaxmocap.capture.streams.sample_assembly import (
    MarkerMeasurements,
    MarkerSample,
    SampleAssembler,
)
from jaxmocap.formats.convert import ConversionOptions, convert_file
from jaxmocap.formats.motion_npz import load_motion, save_motion
from jaxmocap.formats.recordings.marker_places import MarkerPlace, bone_point_binder, bone_points
from jaxmocap.formats.recordings.recording import load_markers, write_recording
from jaxmocap.formats.time_series.axes import R_WORLD_UNITY
from jaxmocap.formats.time_series.csv import read_csv, write_csv
from jaxmocap.formats.time_series.trc import read_trc, write_trc
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.pipelines.live.recording import LiveRecording
from jaxmocap.pipelines.live.setup import LiveSetup, load_live
from jaxmocap.pipelines.live.status import _orientation_states
from jaxmocap.synthetic.movements import motions

BODY = with_wrists(Skeleton.human(1.75, proportions="winter"))
TIMES = np.arange(5) / 10


def random_turns(seed: int, *shape: int) -> np.ndarray:
    R = Rotation.random(int(np.prod(shape)), rng=np.random.default_rng(seed)).as_matrix()
    return R.reshape(*shape, 3, 3)


# Files -------------------------------------------------------------------------------------------


def test_a_csv_file_keeps_orientations_and_their_gaps(tmp_path):
    points = {"A": np.ones((5, 3)), "B": np.arange(15.0).reshape(5, 3), "C": np.zeros((5, 3))}
    turns = {"A": random_turns(0, 5), "C": random_turns(1, 5)}
    turns["A"][2] = np.nan
    write_csv(tmp_path / "a.csv", TIMES, points, turns)
    header = (tmp_path / "a.csv").read_text().splitlines()[0]
    assert header == ("time,A.x,A.y,A.z,A.qw,A.qx,A.qy,A.qz,B.x,B.y,B.z,"
                      "C.x,C.y,C.z,C.qw,C.qx,C.qy,C.qz")  # fmt: skip
    actual = read_csv(tmp_path / "a.csv")
    assert (
        set(actual.measured_orientations()) == {"A", "C"}
        and np.isnan(actual.measured_orientations()["A"][2]).all()
    )
    for name, R in turns.items():
        np.testing.assert_allclose(actual.measured_orientations()[name], R, atol=3e-6)
    for name, positions in points.items():
        np.testing.assert_allclose(actual.points()[name], positions, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,A.x,A.y,A.z,A.qw,A.qx,A.qy\n0,1,2,3,1,0,0\n", "end of the line', expected 'A.qz'"),
        ("time,A.x,A.y,A.z,A.qw,A.qx,A.qy,A.qz\n0,1,2,3,0,0,0,0\n", "line 2: the quaternion of"),
        ("time,A.x,A.y,A.z,A.qw,A.qx,A.qy,A.qz\n0,1,2,3,2,0,0,0\n", "has length 2, expected 1"),
        ("time,A.x,A.y,A.z,A.qx,A.qy,A.qz,A.qw\n0,1,2,3,0,0,0,1\n", "found 'A.qx', expected 'A.x'"),
        ("time,A.x,A.y,A.z,A.qw,A.qx,A.qy,A.qz\n0,1,2,3,1,0,0\n", "line 2: found 7 columns"),
    ],
)  # fmt: skip
def test_bad_quaternions_are_refused_in_one_sentence(tmp_path, text, message):
    (tmp_path / "a.csv").write_text(text)
    assert message in complaint(read_csv, tmp_path / "a.csv")


def test_converting_keeps_turns_or_says_that_it_does_not(tmp_path):
    turns = {"A": Rotation.from_euler("z", [[0], [10], [20], [30], [40]], degrees=True).as_matrix()}
    write_csv(tmp_path / "a.csv", TIMES, {"A": np.ones((5, 3))}, turns)
    assert convert_file(tmp_path / "a.csv", tmp_path / "b.csv", ConversionOptions(rate=20)) == []
    yaw = np.degrees(
        Rotation.from_matrix(read_csv(tmp_path / "b.csv").measured_orientations()["A"]).as_rotvec()
    )
    np.testing.assert_allclose(yaw[:, 2], np.arange(0, 41, 5), atol=1e-3)
    assert "the markers' orientations" in convert_file(tmp_path / "a.csv", tmp_path / "b.trc")[0]


# Rigid sets --------------------------------------------------------------------------------------

CLUSTER = np.array([[0.0, 0, 0], [0.08, 0, 0], [0.02, 0.06, 0], [0.03, 0.02, 0.05]])


def write_cluster(folder: Path, members: int = 4, spoil: Any = None, **place: Any) -> Path:
    """A recording of a set on the left hand, moved and turned; (T, K, 3) ``spoil`` is added."""
    R = random_turns(3, len(TIMES))
    places = np.stack([TIMES, 1 + TIMES, 0 * TIMES], 1)
    points = places[:, None] + CLUSTER[:members] @ R.swapaxes(-1, -2)
    points = points if spoil is None else points + spoil
    columns = {f"W{i}": points[:, i] for i in range(members)}
    columns["Head"] = np.tile([0.0, 0, 1.7], (len(TIMES), 1))
    write_trc(folder / "markers.trc", TIMES, columns)
    on = {"Head": {"bone": "head"}, "Set": {"bone": "hand_l", "at": 0.0} | place}
    path = write_recording(folder, "markers.trc", on)
    names = [f"W{i}" for i in range(members)]
    path.write_text(path.read_text() + f"\n[markers.rigid]\nSet = {names}\n".replace("'", '"'))
    return path


def test_a_rigid_set_is_one_marker_with_an_orientation(tmp_path):
    """Its axes: x to the second marker, z upright on the first three, origin in the middle."""
    offset = [0.0, 0.0, 0.1]
    spoil = np.zeros((5, 4, 3))
    spoil[1, 3], spoil[3, 2:] = np.nan, np.nan  # three are enough, two are not
    path = write_cluster(tmp_path, spoil=spoil, offset=offset, offset_in="marker")
    recording = Recording.load(path)
    assert recording.marker_names == ("Head", "Set")
    R, places = random_turns(3, 5), np.stack([TIMES, 1 + TIMES, 0 * TIMES], 1)
    wrist = places + R @ (CLUSTER.mean(0) - offset)
    expected = np.where(np.arange(5)[:, None] == 3, np.nan, wrist)
    np.testing.assert_allclose(recording.positions_world[:, 1], expected, atol=3e-6)


@pytest.mark.parametrize(
    ("members", "spoil", "line", "message"),
    [
        (4, 0, 'Set = ["W0", "W1"]', "expected a list of three or more different markers"),
        (4, 0, 'Set = ["W0", "W1", "W9"]', "found no marker 'W9' in the file"),
        (4, 0, 'W0 = ["W0", "W1", "W2"]', "found a marker of that name in the file"),
        (3, "line", None, "found all markers on one line"),
        (3, "apart", None, "found W0, W1, W2 in no common sample"),
    ],
)
def test_sets_that_are_none_are_refused(tmp_path, members, spoil, line, message):
    moved = None
    if spoil == "line":
        moved = np.array([0, 0, -0.06])[:, None] * random_turns(3, 5)[:, None, :, 1]
    if spoil == "apart":
        moved = np.where(np.arange(3)[None, :, None] == (np.arange(5) % 3)[:, None, None], np.nan,
                         np.zeros((5, 3, 3)))  # fmt: skip
    path = write_cluster(tmp_path, members, moved)
    if line:
        path.write_text(path.read_text().replace('Set = ["W0", "W1", "W2", "W3"]', line))
    assert message in complaint(Recording.load, path)


# Places on the body ------------------------------------------------------------------------------


def frames_of(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Joints (B, 3) and turns (B, 3, 3) of the bones, pelvis at the origin: the naive way."""
    R = body_turns(BODY, angles[None])[0]
    reach = np.asarray(BODY.lengths)[:, None] * np.asarray(BODY.directions)
    joints = np.zeros((len(R), 3))
    for bone, parent in enumerate(BODY.tree.parents):
        if parent >= 0:
            joints[bone] = joints[parent] + R[parent] @ reach[parent]
    return joints, R


@given(st.integers(0, 10**6))
def test_points_of_a_turned_marker_lie_where_its_bone_has_them(seed):
    """Whatever the pose, the points asked for are the body's own, so that it meets them exactly."""
    rng = np.random.default_rng(seed)
    low, high = np.asarray(BODY.limits, float).T
    joints, turned = frames_of(rng.uniform(low, high))
    for bone, offset_in in (("head", "marker"), ("hand_r", "marker"), ("foot_l", "bone")):
        i, held, offset = BODY.tree.bone(bone), random_turns(seed, 1)[0], rng.uniform(-0.1, 0.1, 3)
        along = 0.4 * float(BODY.lengths[i]) * np.asarray(BODY.directions[i])
        there = along + (held @ offset if offset_in == "marker" else offset)
        x, y, z = offset.tolist()
        place = MarkerPlace(bone, bone, 0.4, (x, y, z), offset_in, tuple(quaternions(held)))
        at, R = (joints[i] + turned[i] @ there)[None], (turned[i] @ held)[None]
        wanted = bone_point_binder(BODY, [place])(at, R)
        points = bone_points(BODY, [place])
        assert len(points) == 3 and {point.bone for point in points} == {bone}
        actual = [joints[i] + turned[i] @ (along + np.array(point.offset)) for point in points]
        np.testing.assert_allclose(wanted, actual, atol=1e-6)


def test_where_a_markers_orientation_is_missing_its_point_is_missing():
    place = MarkerPlace("C", "hand_l", 0.0, (0.0, 0.0, 0.1), "marker")
    R = np.full((1, 3, 3), np.nan)
    assert np.isnan(bone_point_binder(BODY, [place])(np.ones((1, 3)), R)).all()
    plain = replace(place, offset_in="bone")
    np.testing.assert_array_equal(bone_point_binder(BODY, [plain])(np.ones((1, 3)), R), 1)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"offset_in": "hand"}, "found 'hand', expected 'bone' or 'marker'"),
        ({"turn": [0, 0, 0, 0]}, "turn: found a quaternion of length 0, expected 1"),
        ({"turn": [1, 0, 0]}, "expected a quaternion w, x, y, z"),
        ({"lever": 0.2}, "expected metres above 0 beside 'turn'"),
        ({"turn": [1.0, 0, 0, 0]}, "turn needs the marker's orientation"),
        ({"offset_in": "marker"}, "offset_in = 'marker' needs the marker's orientation"),
        ({"bone": "wing"}, "unknown bone 'wing'"),
    ],
)
def test_places_that_cannot_be_are_refused_by_field(tmp_path, entry, message):
    write_trc(tmp_path / "markers.trc", TIMES, {"C": np.ones((5, 3))})
    path = write_recording(tmp_path, "markers.trc", {"C": {"bone": "hand_l"} | entry})
    sentence = complaint(Recording.load, path)
    assert message in sentence and "[markers.on] C" in sentence


def test_an_orientation_survives_a_file_with_y_up(tmp_path):
    """The same devices, written in the axes of a file with y up, ask for the same points."""
    write_controllers(tmp_path, motions.reaching(0.2, 0, 1.75), 0.2)
    there = Recording.load(tmp_path / "recording.toml")
    markers = read_csv(tmp_path / "markers.csv")
    R_file_world = np.eye(3)[[1, 2, 0]]
    write_csv(tmp_path / "markers.csv", markers.times,
              {n: p @ R_file_world.T for n, p in markers.points().items()},
              {n: R_file_world @ R
               for n, R in markers.measured_orientations().items()})  # fmt: skip
    path = tmp_path / "recording.toml"
    path.write_text(path.read_text().replace('up = "z"', 'up = "y"'))
    np.testing.assert_allclose(Recording.load(path).positions_world, there.positions_world,
                               atol=5e-6)  # fmt: skip


# Live --------------------------------------------------------------------------------------------

LIVE = """
[markers.on.Left]
bone = "hand_l"
at = 0.0
offset = [0.01, 0.02, 0.1]
offset_in = "marker"
turn = [0.6, 0.8, 0.0, 0.0]

[markers.on.Hmd]
bone = "head"
"""


def sent(name: str, position: np.ndarray, R: np.ndarray) -> bytes:
    """A device of VMC as Unity has it: left-handed, x right, y up, z forward."""
    kind = "Hmd" if name == "Hmd" else "Con"
    built = OscMessageBuilder(f"/VMC/Ext/{kind}/Pos")
    x, y, z, w = Rotation.from_matrix(R_WORLD_UNITY.T @ R @ R_WORLD_UNITY).as_quat()
    for value in (name, *(R_WORLD_UNITY.T @ position), x, y, z, w):
        built.add_arg(float(value) if not isinstance(value, str) else value)
    return built.build().dgram


def test_devices_over_osc_send_orientations_that_are_recorded(tmp_path):
    (tmp_path / "live.toml").write_text(LIVE)
    setup, samples = load_live(tmp_path / "live.toml"), []
    bind = bone_point_binder(setup.skeleton, setup.places)
    gathers = SampleAssembler(setup.marker_names, {}, setup.R_world_source, samples.append, bind)
    R, at = random_turns(7, 4, 2), np.random.default_rng(7).uniform(-1, 1, (4, 2, 3))
    for i in range(4):
        packets = (sent(n, at[i, m], R[i, m]) for m, n in enumerate(setup.marker_names))
        placed = [placed for packet in packets for placed in parse_packet(packet).markers]
        gathers.add(placed, i / 90, i / 90, is_complete=True)
    positions_world = bind(at, R)
    actual = np.stack([sample.positions_world for sample in samples])
    np.testing.assert_allclose(actual, positions_world, atol=1e-6)
    written = LiveRecording(setup, tmp_path / "out")
    for sample in samples:
        written.add(sample)
    path = written.close()
    assert path is not None
    again = Recording.load(path)
    np.testing.assert_allclose(again.positions_world, positions_world, atol=3e-6)
    # As measured it is there too, for jaxmocap offsets.
    measured, _ = load_markers(path)
    np.testing.assert_allclose(measured.positions, at, atol=1e-6)
    assert measured.orientations is not None
    np.testing.assert_allclose(measured.orientations, R, atol=3e-6)


def live_setup(folder: Path, text: str) -> LiveSetup:
    (folder / "live.toml").write_text(text)
    return load_live(folder / "live.toml")


@pytest.mark.parametrize(
    ("text", "oriented"),
    [
        ("[markers.on]\nHmd = { bone = 'head' }\n", True),
        ("[markers.on]\nhead = { bone = 'head' }\n", True),
        ("[markers.on]\nA = { bone = 'head' }\n[osc.names]\nHmd = 'A'\n", True),
        ("[markers.on]\nHmd = { bone = 'head', turn = false }\n", False),
        ("[markers.on]\nHmd = { bone = 'hand_l' }\n", False),
        ("[markers.on]\nCap = { bone = 'head' }\n", False),
        ("[markers.on]\nHmd = { bone = 'head' }\n[lsl]\nstream = 'a'\n", False),
    ],
)
def test_a_headsets_orientation_is_used_by_default_with_a_neck_that_turns(tmp_path, text, oriented):
    setup = live_setup(tmp_path, text)
    assert setup.places[0].orientation == ((1.0, 0.0, 0.0, 0.0) if oriented else None)
    assert has_wrists(setup.skeleton) == oriented


def test_without_a_neck_that_turns_the_headsets_orientation_is_left_out_with_a_warning(tmp_path):
    text = "[markers.on]\nHmd = { bone = 'head' }\n[subject]\nheight = 1.7\nwrists = false\n"
    setup = live_setup(tmp_path, text)
    assert setup.places[0].orientation is None and not has_wrists(setup.skeleton)
    (warning,) = setup.warnings
    assert "Hmd: its orientation is not used" in warning and "wrists = false" in warning


def test_a_run_whose_headset_sends_no_orientation_is_recorded_without(tmp_path):
    setup = live_setup(tmp_path, "[markers.on]\nHmd = { bone = 'head' }\n")
    written = LiveRecording(setup, tmp_path / "out")
    at, R = np.ones((1, 3)), np.full((1, 3, 3), np.nan)
    points = bone_point_binder(setup.skeleton, setup.places)(at, R)
    for i in range(3):
        written.add(MarkerSample(i / 90, points, i / 90, MarkerMeasurements(at, R)))
    path = written.close()
    assert path is not None
    again = Recording.load(path)
    assert again.marker_names == ("Hmd",) and has_wrists(again.skeleton)


def test_orientations_that_are_not_used_or_do_not_come_are_shown():
    places = (
        MarkerPlace("Hmd", "head", orientation=(1.0, 0.0, 0.0, 0.0)),
        MarkerPlace("Left", "hand_l"),
    )
    gathers = SampleAssembler(("Hmd", "Left"), {}, np.eye(3), lambda sample: None)
    assert dict(_orientation_states(gathers, places)) == {"orientations missing": "none"}
    at = (0.0, 0.0, 0.0)
    sent = [MarkerMessage(("Hmd",), at), MarkerMessage(("Left",), at, (0.0, 0, 0, 1))]
    gathers.add(sent, 0.0, 0.0, is_complete=True)
    states = dict(_orientation_states(gathers, places))
    assert states["orientations missing"] == "Hmd"
    assert states["orientations not used"].startswith("Left; 'jaxmocap live LIVE.toml --calibrate'")


def test_an_orientation_that_is_left_out_on_purpose_is_not_listed_as_not_used(tmp_path):
    text = "[markers.on]\nHmd = { bone = 'head', turn = false }\nHand = { bone = 'hand_l' }\n"
    places = live_setup(tmp_path, text).places
    gathers = SampleAssembler(("Hmd", "Hand"), {}, np.eye(3), lambda sample: None)
    turn = (0.0, 0.0, 0.0, 1.0)
    sent = [MarkerMessage((name,), (0.0, 0.0, 0.0), turn) for name in ("Hmd", "Hand")]
    gathers.add(sent, 0.0, 0.0, is_complete=True)
    assert dict(_orientation_states(gathers, places))["orientations not used"].startswith("Hand;")


def test_a_device_that_sends_no_quaternion_is_placed_but_not_turned():
    built = OscMessageBuilder("/VMC/Ext/Tra/Pos")
    for value in ("waist", 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0):
        built.add_arg(value)
    (placed,) = parse_packet(built.build().dgram).markers
    assert placed.position == (1.0, 2.0, 3.0) and placed.orientation is None


# The body ----------------------------------------------------------------------------------------


def test_wrists_come_on_top_and_leave_all_else_as_it_was():
    plain = Skeleton.human(1.75)
    assert BODY.tree.joints[:21] == plain.tree.joints and len(BODY.tree.joints) == 28
    assert with_wrists(BODY) is BODY
    angles = np.asarray(plain.relaxed, float)[None]
    more = np.concatenate([angles, np.zeros((1, 7))], 1)
    np.testing.assert_array_equal(body_turns(plain, angles), body_turns(BODY, more))


@pytest.mark.parametrize("side", ["l", "r"])
@pytest.mark.parametrize(
    ("joint", "axis", "moved"),
    [
        # Of the right hand: where the fingers, or the thumb's side, go.
        ("wrist_flex", [0.0, 0, -1], [0, 1, 0]),
        ("wrist_deviate", [0.0, 0, -1], [-1, 0, 0]),
        ("elbow_twist", [1.0, 0, 0], [0, 1, 0]),
    ],
)
def test_wrists_bend_towards_palm_and_ulna_and_twist_inwards(side, joint, axis, moved):
    angles = np.zeros((1, 28))
    angles[0, BODY.tree.joint(f"{joint}_{side}")] = np.pi / 2
    R = body_turns(BODY, angles)[0, BODY.tree.bone(f"hand_{side}")]
    mirror = [1, -1 if side == "l" else 1, 1]
    np.testing.assert_allclose(R @ axis, np.array(moved) * mirror, atol=1e-6)


def test_an_arm_that_hangs_ready_to_swing_keeps_its_bent_wrist():
    low, high = np.asarray(BODY.limits).T
    angles = jnp.asarray(low + 0.8 * (high - low))
    pose = Pose(jnp.zeros(3), jnp.eye(4)[0], angles)
    places = [MarkerPlace(s, f"hand_{s}", 0.5, (0.03, 0.0, 0.0)) for s in "lr"]
    held = grips(BODY, marker_sites(BODY, places))
    hung = jax.device_get(jax.jit(lambda pose: hang(BODY, pose, held))(pose))
    names = [BODY.tree.joints[dof] for dof in arm_dofs(BODY.tree)[0]]
    assert names == ["arm_flex_l", "arm_abduct_l", "arm_rot_l", "elbow_flex_l"]
    for side in range(2):
        R = hung.R_world_carrier[side]
        turns = [Rotation.from_rotvec(a * axis).as_matrix()
                 for a, axis in zip(hung.angles[side], hung.axes[side], strict=True)]  # fmt: skip
        R_humerus = R @ turns[0] @ turns[1] @ turns[2]
        elbow = hung.arms.shoulder[side] + R_humerus @ hung.reaches[side, 0]
        R_radius = R_humerus @ turns[3]
        np.testing.assert_allclose(elbow, hung.arms.elbow[side], atol=1e-5)
        np.testing.assert_allclose(elbow + R_radius @ hung.grip[side], hung.arms.grip[side],
                                   atol=1e-5)  # fmt: skip
        tip = elbow + R_radius @ (hung.reaches[side, 1] + hung.reaches[side, 2])
        np.testing.assert_allclose(tip, hung.arms.tip[side], atol=1e-5)


def test_subjects_have_wrists_if_they_state_so(tmp_path):
    write_trc(tmp_path / "markers.trc", TIMES, {"C": np.ones((5, 3))})
    for wrists, joints in ((True, 28), (False, 21)):
        path = write_recording(tmp_path, "markers.trc", {"C": {"bone": "head"}},
                               subject={"height": 1.7, "wrists": wrists})  # fmt: skip
        assert len(Recording.load(path).skeleton.tree.joints) == joints
    path.write_text(path.read_text().replace("wrists = false", 'wrists = "both"'))
    assert "wrists: found 'both', expected true or false" in complaint(Recording.load, path)


# End to end --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def played(tmp_path_factory) -> tuple[Motion, Path]:
    """Half a second of table tennis by head-set and controllers, solved sample by sample."""
    folder = tmp_path_factory.mktemp("played")
    recording = Recording.load(write_controllers(folder, motions.table_tennis(0.5, 1), 0.5, 1))
    tracker = HybridTracker.from_recording(recording, Settings(refine="none", balance=False))
    state, poses = tracker.init(recording.positions_world[0]), []
    for time, markers in zip(recording.times, recording.positions_world, strict=True):
        state, pose, _ = tracker.step(state, time, markers)
        poses.append(jax.device_get(pose))
    stacked = jax.tree.map(lambda *parts: np.stack(parts), *poses)
    return Motion(tracker.model.skeleton, recording.times, stacked), folder


@pytest.mark.parametrize("wrist", ["wrist_l", "wrist_r"])
def test_a_controllers_orientation_tells_where_the_wrist_is(played, wrist):
    """Its grip lies 10 cm from there, and the wrist bends by up to 27 degrees."""
    motion, folder = played
    truth = read_trc(folder / "truth.trc").points()
    assert np.linalg.norm(motion.joints()[wrist] - truth[wrist], axis=-1).mean() < 0.012


def test_how_head_and_hands_are_turned_reaches_the_outputs(played, tmp_path):
    motion, folder = played
    save_motion(tmp_path / "motion.npz", motion)
    convert_file(tmp_path / "motion.npz", tmp_path / "motion.bvh")
    convert_file(tmp_path / "motion.bvh", tmp_path / "back.npz")
    markers = read_csv(folder / "markers.csv")
    for there in (motion, load_motion(tmp_path / "back.npz")):
        R_body = body_turns(there.skeleton, np.asarray(there.poses.angles, float))
        root = Rotation.from_quat(np.asarray(there.poses.quaternion), scalar_first=True).as_matrix()
        for name, device in DEVICES.items():
            R = root @ R_body[:, there.skeleton.tree.bone(device.bone)] @ device.R_bone_device
            off = Rotation.from_matrix(
                R.swapaxes(-1, -2) @ markers.measured_orientations()[name]
            ).magnitude()
            assert np.degrees(off).max() < 4, name
