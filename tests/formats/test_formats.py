"""Marker files, calibrations, motions: what is written is read back, and bad files are refused."""

import os
import pickle
from dataclasses import fields, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import problem_of, read_calibration, shared_folder, written
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from jaxmocap.body.motion import Motion, Report, Run
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.capture.photographs import read_picture
from jaxmocap.capture.video import Video
from jaxmocap.formats.animation.bvh import read_bvh
from jaxmocap.formats.animation.gltf_in import read_gltf
from jaxmocap.formats.cameras.calibration import pick_camera, write_calibration
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.writing import replacing
from jaxmocap.formats.motion_npz import load_motion, save_motion
from jaxmocap.formats.recordings.recording import load_recording
from jaxmocap.formats.time_series.c3d import read_c3d
from jaxmocap.formats.time_series.csv import read_csv, write_csv
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.formats.time_series.mot import read_mot
from jaxmocap.formats.time_series.trc import read_trc, write_trc
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.lenses import FISHEYE

WRITERS = {"trc": (write_trc, read_trc), "csv": (write_csv, read_csv)}

TRC = """PathFileType\t4\t(X/Y/Z)\ta.trc
DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames
50\t50\t3\t2\tmm\t50\t1\t3
Frame#\tTime\tHead\t\t\tHand\t\t
\t\tX1\tY1\tZ1\tX2\tY2\tZ2

1\t0.00\t1000\t2000\t3000\t10\t20\t30
2\t0.02\t\t\t\t11\t21\t31
3\t0.04\t1002\t2002\t3002\t12\t22\t32
"""


@st.composite
def recorded_points(draw):
    """Times and points with gaps, of markers with all sorts of names."""
    count = draw(st.integers(1, 12))
    steps = draw(hnp.arrays(float, count, elements=st.floats(1e-4, 10)))
    name = st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=8)
    points = {}
    for label in draw(st.lists(name, min_size=1, max_size=4, unique=True)):
        position = st.floats(-100, 100)
        points[label] = draw(hnp.arrays(float, (count, 3), elements=position))
        points[label][draw(hnp.arrays(bool, count))] = np.nan
    return np.cumsum(steps), points


@pytest.mark.parametrize("format", WRITERS)
@settings(shared_folder, max_examples=40)
@given(recorded_points())
def test_markers_survive_a_round_trip_with_their_gaps(tmp_path, format, recorded):
    times, points = recorded
    write, read = WRITERS[format]
    write(tmp_path / "a", times, points)
    markers = read(tmp_path / "a")
    assert markers.names == tuple(points)
    np.testing.assert_allclose(markers.times, times, rtol=0, atol=1e-8)
    np.testing.assert_allclose(markers.positions, np.stack(list(points.values()), 1), atol=1e-6)
    assert markers.times.dtype == markers.positions.dtype == np.float64


@pytest.mark.parametrize(("unit", "metres"), [("m", 1.0), ("mm", 1e-3), ("cm", 1e-2), ("MM", 1e-3)])
def test_trc_units_are_honoured(tmp_path, unit, metres):
    markers = read_trc(written(tmp_path, "a.trc", TRC.replace("\tmm\t", f"\t{unit}\t")))
    np.testing.assert_allclose(markers.positions[2, 1], np.array([12, 22, 32]) * metres)
    np.testing.assert_allclose(markers.times, [0, 0.02, 0.04])


@pytest.mark.parametrize(
    "variant",
    [
        TRC.replace("\n", "\r\n"),
        TRC.replace("\n", "\r"),
        "\ufeff" + TRC,
        TRC.replace("Z2\n\n", "Z2\n"),
        TRC.replace("\n1\t", "\n\t\t\n1\t"),
        TRC.replace("30\n", "30\t\t\n").replace("Hand\t\t", "Hand\t\t\t"),
        TRC.replace("0.02\t\t\t\t", "0.02\tNaN\tnan\t\t"),
        TRC.replace("0.02\t\t\t\t", "0.02\t5\t \t6\t"),
        TRC.rstrip("\n"),
        TRC + "\n\n",
        TRC.replace("\t2\tmm", "\t7\tmm"),
    ],
)
def test_trc_variants_that_exporters_write_are_read_alike(tmp_path, variant):
    markers = read_trc(written(tmp_path, "a.trc", variant))
    expected = read_trc(written(tmp_path, "b.trc", TRC))
    assert markers.names == ("Head", "Hand")
    np.testing.assert_array_equal(markers.positions, expected.positions)
    assert np.isnan(markers.positions[1, 0]).all()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "the file is empty"),
        ("\n \n", "the file is empty"),
        (TRC.encode() + b"\0\x01\x02", "line 10: found binary data"),
        (b"\xff\xfe\x80" * 50, "line 1: found bytes that are not UTF-8"),
        ("time,Head.x\n0,1\n", "line 1: found 'time,Head.x', expected 'PathFileType'"),
        (TRC[:60], "line 2: the file ends within its header"),
        (TRC.replace("\tmm\t", "\tfurlong\t"), "line 3: unknown unit 'furlong', expected one of m"),
        (TRC.replace("Units", "Unites"), "line 2: found no 'Units'"),
        (TRC.replace("Frame#", "Rahmen"), "line 4: found 'Rahmen"),
        (TRC.replace("\tHand\t\t", ""), "line 5: found 6 coordinates, expected 3"),
        (TRC.replace("Head", "").replace("Hand", ""), "line 4: names no marker"),
        (TRC.replace("Hand", "Head"), "line 4: marker 'Head' is named twice"),
        (TRC[: TRC.index("\n1\t")], "found no frames"),
        (TRC.replace("\t12\t22\t32\n", "\t12\t22"), "line 9: found 7 columns, expected 8"),
        (TRC.replace("\t32\n", "\t32\t33\n"), "line 9: found 9 columns, expected 8"),
        (TRC[: TRC.index("3\t0.04")], "line 3: NumFrames is 3, but the file ends after 2 frames"),
        (TRC.replace("2002", "2,002"), "line 9: found '2,002', expected a number"),
        (TRC.replace("2002", "inf"), "line 9: found 'inf', expected a number"),
        (TRC.replace("0.04", "0.01"), "line 9: time runs backwards, found 0.01 s after 0.02 s"),
        (TRC.replace("0.04", "0.02"), "line 9: time runs backwards"),
        (TRC.replace("0.04", ""), "line 9: found no time"),
    ],
)
def test_bad_trc_files_are_refused_with_the_line(tmp_path, text, says):
    assert says in problem_of(read_trc, written(tmp_path, "a.trc", text))


CSV = "time,Head.x,Head.y,Head.z,Hand.x,Hand.y,Hand.z\n0,1,2,3,4,5,6\n0.5,,,,4,5,6\n"


def test_csv_is_seconds_and_metres_with_empty_cells_where_missing(tmp_path):
    markers = read_csv(written(tmp_path, "a.csv", CSV))
    assert markers.names == ("Head", "Hand")
    np.testing.assert_array_equal(markers.positions[:, 1], [[4, 5, 6], [4, 5, 6]])
    assert np.isnan(markers.positions[1, 0]).all()
    assert markers.times.tolist() == [0.0, 0.5]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "the file is empty"),
        ("frame,Head.x,Head.y,Head.z\n", "line 1: found 'frame"),
        ("\n" + CSV, "line 1: found ''"),
        ("time\n0\n", "line 1: found 'time'"),
        (CSV.replace("Head.y", "Head.q"), "line 1: found 'Head.q', expected 'Head.y'"),
        (CSV.replace(",Hand.z", ""), "line 1: found 'the end of the line', expected 'Hand.z'"),
        (CSV.replace("Hand", "Head"), "line 1: marker 'Head' is named twice"),
        (CSV.replace("4,5,6\n0.5", "4,5\n0.5"), "line 2: found 6 columns, expected 7"),
        (CSV.replace("0.5", "-1"), "line 3: time runs backwards"),
        (CSV.splitlines()[0], "found no frames"),
    ],
)
def test_bad_csv_files_are_refused_with_the_line(tmp_path, text, says):
    assert says in problem_of(read_csv, written(tmp_path, "a.csv", text))


@pytest.mark.parametrize("name", ["a\tb", "", " a", "a\n"])
def test_names_that_trc_cannot_hold_are_not_written(tmp_path, name):
    with pytest.raises(ValueError, match="cannot be written"):
        write_trc(tmp_path / "a.trc", np.arange(2.0), {name: np.zeros((2, 3))})
    assert not list(tmp_path.iterdir())


def test_marker_files_are_told_by_their_suffix(tmp_path):
    assert read_markers(written(tmp_path, "a.TRC", TRC)).names == ("Head", "Hand")
    assert read_markers(written(tmp_path, "a.csv", CSV)).names == ("Head", "Hand")
    assert "unknown suffix '.txt'" in problem_of(read_markers, written(tmp_path, "a.txt", TRC))


READERS = {
    **{"a.trc": read_markers, "a.csv": read_markers, "a.mot": read_mot, "a.c3d": read_c3d},
    **{"a.bvh": read_bvh, "a.glb": read_gltf, "a.npz": load_motion, "a.toml": read_calibration},
    **{"a.yml": read_calibration, "r.toml": load_recording, "a.png": read_picture, "a.mp4": Video},
}


@pytest.mark.parametrize("name", READERS)
def test_what_is_no_file_is_refused_before_anything_is_opened(tmp_path, name):
    read, path = READERS[name], tmp_path / name
    assert problem_of(read, path) == "no such file"
    path.mkdir()
    assert problem_of(read, path) == "found a folder, expected a file"
    path.rmdir()
    if hasattr(os, "mkfifo"):
        os.mkfifo(path)
        assert problem_of(read, path) == "found a named pipe, expected a file"
        path.unlink()
        path.symlink_to("/dev/zero")
        assert problem_of(read, path) == "found a device, expected a file"


@pytest.mark.parametrize(("name", "frames", "markers"), [("markers", 60, 5), ("truth", 60, 21)])
def test_real_trc_files_are_read(recordings, name, frames, markers):
    read = read_trc(recordings / "balancing" / f"{name}.trc")
    assert read.positions.shape == (frames, markers, 3)
    assert np.isfinite(read.positions).all()
    np.testing.assert_allclose(np.diff(read.times), 1 / 60, atol=2e-6)
    heights = read.points()["Head"][:, 2]
    assert 1.2 < heights.min() < heights.max() < 2.0


# Calibrations ------------------------------------------------------------------------------------

CAMERA = {
    "size": "[640, 480]",
    "matrix": "[[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]]",
    "distortions": "[0.1, -0.2, 0.0, 0.0]",
    "rotation": "[0.1, 0.2, 0.3]",
    "translation": "[0.0, 0.0, 3.0]",
    "fisheye": "false",
}


def calibration_text(**changes: str | None) -> str:
    entries = {k: v for k, v in (CAMERA | changes).items() if v is not None}
    lines = [f"{key} = {value}" for key, value in entries.items()]
    return "\n".join(["[cam]", *lines, "[metadata]", "error = 0.0"])


@given(
    hnp.arrays(float, 3, elements=st.floats(-1.8, 1.8)),
    hnp.arrays(float, 3, elements=st.floats(-10, 10)),
    st.lists(st.floats(-0.5, 0.5), max_size=8),
)
@settings(shared_folder, max_examples=40)
def test_cameras_survive_a_round_trip(tmp_path, rotation, translation, distortion):
    matrix = [[500.0, 0.0, 320.0], [0.0, 510.0, 240.0], [0.0, 0.0, 1.0]]
    camera = Camera.create((640, 480), np.array(matrix), distortion, rotation, translation)
    path = tmp_path / "c.toml"
    write_calibration(path, {"cam_01": camera, "the left one": camera})
    cameras = read_calibration(path)
    assert list(cameras) == ["cam_01", "the left one"]
    for read in cameras.values():
        assert read.lens == camera.lens
        for ours, theirs in zip(jax.tree.leaves(read), jax.tree.leaves(camera), strict=True):
            np.testing.assert_allclose(ours, theirs, atol=2e-5)


def test_a_fisheye_survives_a_round_trip(tmp_path):
    matrix = np.array([[300.0, 0.0, 320.0], [0.0, 301.0, 240.0], [0.0, 0.0, 1.0]])
    camera = Camera.create((640, 480), matrix, [0.05, -0.02, 0.004, -1e-3], lens=FISHEYE)
    path = tmp_path / "c.toml"
    write_calibration(path, {"cam": camera})
    assert "fisheye = true" in path.read_text()
    (read,) = read_calibration(path).values()
    assert read.lens == FISHEYE
    np.testing.assert_allclose(read.distortion, camera.distortion, atol=1e-7)


def test_a_rotation_may_be_a_matrix(tmp_path):
    text = calibration_text(rotation="[[0, 1, 0], [0, 0, 1], [1, 0, 0]]")
    path = written(tmp_path, "c.toml", text)
    T_cam_world = read_calibration(path)["cam"].T_cam_world
    np.testing.assert_array_equal(T_cam_world[:3, :3], [[0, 1, 0], [0, 0, 1], [1, 0, 0]])


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"matrix": None}, "[cam]: 'matrix' is missing"),
        ({"matrix": "[[1, 0], [0, 1]]"}, "[cam] matrix: found [[1, 0], [0, 1]], expected a 3 × 3"),
        ({"matrix": "[[1, 0, 0], [0, 1], [0, 0, 1]]"}, "expected a 3 × 3"),
        ({"matrix": "[[-5, 0, 0], [0, 5, 0], [0, 0, 1]]"}, "expected positive focal lengths"),
        ({"matrix": "[[5, 0, 0], [0, 5, 0], [0, 0, 2]]"}, "a last row of 0 0 1"),
        ({"rotation": "[1, 2]"}, "[cam] rotation: found [1, 2], expected a Rodrigues vector"),
        ({"rotation": "[1, 2, nan]"}, "expected a Rodrigues vector"),
        ({"rotation": "[1, 2, 'x']"}, "expected a Rodrigues vector"),
        ({"rotation": "[1, 2, '3']"}, "found [1, 2, '3'], expected a Rodrigues vector"),
        ({"translation": "[true, 0, 3]"}, "[cam] translation: found [True, 0, 3], expected 3"),
        ({"rotation": "[[1, 0, 0], [0, 1, 0], [0, 0, 2]]"}, "not a rotation"),
        ({"rotation": "[[1, 0, 0], [0, 1, 0], [0, 0, -1]]"}, "not a rotation"),
        ({"translation": "[1, 2]"}, "[cam] translation"),
        ({"distortions": "[1, 2, 3, 4, 5, 6, 7, 8, 9]"}, "expected at most 8 numbers"),
        ({"size": "[640, 0]"}, "expected two positive numbers"),
        ({"size": "640"}, "[cam] size: found 640, expected [width, height]"),
        # What no camera has.
        ({"size": "[1e9, 480]"}, "[cam] size: found"),
        ({"size": "[0.1, 480]"}, "[cam] size: found"),
        ({"matrix": "[[1e300, 0, 0], [0, 1, 0], [0, 0, 1]]"}, "[cam] matrix: found"),
        ({"matrix": "[[1e-300, 0, 0], [0, 1, 0], [0, 0, 1]]"}, "[cam] matrix: found"),
        # Millimetres.
        ({"matrix": "[[4.2, 0, 320], [0, 4.2, 240], [0, 0, 1]]"}, "pixels, here 25.6 or more"),
        ({"distortions": "[1e200]"}, "[cam] distortions: found"),
        ({"rotation": "[1e200, 0, 0]"}, "[cam] rotation: found"),
        ({"translation": "[1e200, 0, 0]"}, "[cam] translation: found"),
        ({"fisheye": "'yes'"}, "[cam] fisheye: found 'yes', expected true or false"),
        ({"fisheye": "true", "distortions": "[1, 2, 3, 4, 5]"}, "at most 4 numbers (k1 k2 k3 k4)"),
    ],
)
def test_bad_calibrations_are_refused_with_the_field(tmp_path, changes, says):
    path = written(tmp_path, "c.toml", calibration_text(**changes))
    assert says in problem_of(read_calibration, path)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[metadata]\n", "found no camera section"),
        ("cam = 3\n", "[cam]: found 3, expected a table"),
        ("[cam\n", "not TOML"),
        (b"\xff\xfe", "not UTF-8"),
    ],
)
def test_what_is_no_calibration_is_refused(tmp_path, text, says):
    assert says in problem_of(read_calibration, written(tmp_path, "c.toml", text))


def test_a_missing_section_lists_those_that_are_there(tmp_path):
    path = written(tmp_path, "c.toml", calibration_text())
    cameras = read_calibration(path)
    assert pick_camera(path, cameras, "cam") is cameras["cam"]
    says = problem_of(lambda p: pick_camera(p, cameras, "cam_2"), path)
    assert says == "section [cam_2] is missing, found cam"


def test_the_real_calibration_puts_the_person_into_every_picture(recordings):
    from jaxmocap.geometry.cameras import project, to_camera

    cameras = read_calibration(recordings / "balancing" / "calibration.toml")
    assert list(cameras) == ["cam_01", "cam_02", "cam_03", "cam_04"]
    head = jnp.asarray(read_trc(recordings / "balancing" / "truth.trc").points()["Neck"], float)
    for camera in cameras.values():
        pixels = np.asarray(project(camera, head))
        assert (to_camera(camera, head)[:, 2] > 1).all()
        assert (pixels > 0).all() and (pixels < np.asarray(camera.size)).all()


# Motions -----------------------------------------------------------------------------------------


def some_motion(report: Report | None) -> Motion:
    rng = np.random.default_rng(0)
    skeleton = Skeleton.human(1.68)
    quaternions = rng.normal(size=(4, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    poses = Pose(rng.normal(size=(4, 3)), quaternions, rng.normal(size=(4, 21)))
    return Motion(skeleton, np.arange(4) / 90, poses, report)


def test_a_motion_survives_a_round_trip_with_skeleton_and_report(tmp_path):
    rng = np.random.default_rng(1)
    report = Report(
        markers=("Head", "Hand"),
        marker_errors=rng.normal(size=(4, 2)),
        arm_costs=np.full((4, 2), np.nan),
        swivels=rng.normal(size=(4, 2)),
        landmarks_std=rng.uniform(size=(4, len(LANDMARKS), 3)),
        from_prior=rng.integers(0, 2, (4, len(LANDMARKS))).astype(float),
        statuses=((), ("the head was lost",), (), ("a", "b")),
        milliseconds={"solve": rng.uniform(size=5), "refine": rng.uniform(size=3)},
        run=Run(mode="own", tracker={"refine": "simplex", "lam": 0.5, "on": jnp.arange(2)}),
    )
    motion = some_motion(report)
    save_motion(tmp_path / "m.npz", motion)
    read = load_motion(tmp_path / "m.npz")
    assert read.skeleton.tree == motion.skeleton.tree
    for field in fields(Skeleton):
        if field.name != "tree":
            ours, theirs = getattr(read.skeleton, field.name), getattr(motion.skeleton, field.name)
            np.testing.assert_array_equal(ours, theirs)
            assert ours.dtype == theirs.dtype
    for ours, theirs in zip(read.poses, motion.poses, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(read.times, motion.times)
    assert read.report is not None
    for field in fields(Report):
        ours, theirs = getattr(read.report, field.name), getattr(report, field.name)
        if field.name == "run":
            theirs = replace(theirs, tracker=theirs.tracker | {"on": [0, 1]})
        np.testing.assert_equal(ours, theirs)


def test_a_motion_needs_no_report(tmp_path):
    save_motion(tmp_path / "m.npz", some_motion(None))
    assert load_motion(tmp_path / "m.npz").report is None


# Files that appear whole or not at all -----------------------------------------------------------


def test_a_writer_that_fails_leaves_the_earlier_file(tmp_path):
    path = written(tmp_path, "out.mp4", "earlier")
    with pytest.raises(RuntimeError), replacing(path) as beside:
        assert beside.suffix == ".mp4" and beside.parent == path.parent
        beside.write_text("half")
        assert path.read_text() == "earlier"
        raise RuntimeError
    assert path.read_text() == "earlier"
    assert list(tmp_path.iterdir()) == [path]


def test_a_writer_that_ends_replaces_the_file_and_makes_its_folder(tmp_path):
    path = tmp_path / "new" / "out.txt"
    for text in ("one", "two"):
        with replacing(path) as beside:
            beside.write_text(text)
        assert path.read_text() == text
    assert list(path.parent.iterdir()) == [path]


def test_an_input_error_survives_pickling():
    error = InputError("a.trc", "line 3: found nothing")
    assert str(pickle.loads(pickle.dumps(error))) == "a.trc: line 3: found nothing"
    assert isinstance(error, ValueError)
