"""Calibration files: one section changed and nothing else, OpenCV's YAML read as TOML is."""

import re
import tomllib
from codecs import BOM_UTF8

import cv2
import numpy as np
import pytest
from conftest import complaint, read_calibration, written
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from jaxmocap.formats.cameras.calibration import (
    Intrinsics,
    pick_camera,
    read_intrinsics,
    write_camera,
)
from jaxmocap.formats.cameras.opencv_yaml import read_opencv_yaml
from jaxmocap.formats.cameras.toml_sections import replace_entries
from jaxmocap.formats.files.toml import toml_value

MATRIX = np.array([[500.25, 0, 320], [0, 510, 240], [0, 0, 1]])
LENS = Intrinsics(np.array([640.0, 480.0]), MATRIX, np.array([-0.1, 0.02, 1e-4, -2e-5]))
ROS = """image_width: 640
image_height: 480
camera_name: narrow
camera_matrix:
  rows: 3
  cols: 3
  data: [500.25, 0, 320, 0, 510, 240, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.1, 0.02, 0.0001,
         -2.0e-05, 0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]
"""


@pytest.mark.parametrize("name", ["lab.xcp", "lab.qca.txt", "cameras.json"])
def test_a_file_of_another_system_is_answered_with_what_converts_it(tmp_path, name):
    path = written(tmp_path, name, '<Cameras VERSION="1.0"></Cameras>')
    assert "jaxmocap convert makes .toml of other" in complaint(read_calibration, path)
    assert "no such file" in complaint(read_calibration, tmp_path / f"no_{name}")
    assert "line 1" in complaint(read_calibration, written(tmp_path, "c.toml", "<"))


# One section -------------------------------------------------------------------------------------

KEYS = st.text("abcxyz_ é\"'[]#=.0", min_size=1, max_size=5)
VALUES = st.one_of(
    st.integers(-5, 5),
    st.booleans(),
    st.text("ab[]#\"'\n ", max_size=6),
    st.lists(st.lists(st.floats(-2, 2), min_size=1, max_size=3), max_size=2),
)
TABLES = st.dictionaries(KEYS, st.dictionaries(KEYS, VALUES, max_size=3), max_size=4)


def as_toml(tables: dict) -> str:
    lines = ["# top"]
    for name, table in tables.items():
        lines += [f"[{toml_value(name)}] # of it"]
        lines += [f"{toml_value(key)} = {toml_value(value)}" for key, value in table.items()]
    return "\n".join(lines)


@given(TABLES, KEYS, st.dictionaries(KEYS, VALUES, min_size=1, max_size=3))
def test_a_sections_entries_change_and_all_else_means_the_same(tables, section, entries):
    before = tomllib.loads(as_toml(tables))
    after = tomllib.loads(replace_entries(as_toml(tables), section, entries))
    assert after.pop(section) == before.pop(section, {}) | entries
    assert after == before


@given(TABLES, KEYS, st.dictionaries(KEYS, VALUES, min_size=1, max_size=3))
def test_the_same_change_again_changes_nothing(tables, section, entries):
    once = replace_entries(as_toml(tables), section, entries)
    assert replace_entries(once, section, entries) == once


def test_lines_that_look_like_headers_within_values_are_none():
    text = 'a = [\n[1.0]\n]\ntext = """\n[cam]\nx = 1\n"""\n\n'
    text += "[cam]\nx = 2\n# of the next\n[cam.more]\ny = 3\n"
    after = replace_entries(text, "cam", {"x": 5, "z": [6.0]})
    assert after == text.replace("x = 2\n", "x = 5\nz = [6.0]\n")


@pytest.mark.parametrize("text", ["cam = { x = 1 }\n", "cam.x = 1\n", "[[cam]]\nx = 1\n"])
def test_a_camera_that_is_written_otherwise_is_refused_and_kept(tmp_path, text):
    path = written(tmp_path, "c.toml", text)
    assert complaint(write_camera, path, "cam", {"y": 2}).startswith(str(path))
    assert path.read_text() == text


def test_a_camera_is_added_to_a_file_and_makes_one_where_there_is_none(tmp_path):
    path = tmp_path / "new" / "c.toml"
    write_camera(path, "left one", LENS.entries())
    write_camera(path, "cam", LENS.entries())
    placed = {"rotation": np.array([0.1, 0.2, 0.3]), "translation": np.array([0, 0, 2.5])}
    assert "'rotation' is missing (jaxmocap calibrate extrinsics" in complaint(
        read_calibration, path
    )
    for name in ("left one", "cam"):
        write_camera(path, name, placed)
    cameras = read_calibration(path)
    assert list(cameras) == ["left one", "cam"]
    np.testing.assert_allclose(cameras["cam"].matrix, MATRIX)
    np.testing.assert_array_equal(read_intrinsics(path, "cam").distortions, LENS.distortions)
    assert [p.name for p in path.parent.iterdir()] == ["c.toml"]
    path.write_bytes(BOM_UTF8 + path.read_bytes().replace(b"\n", b"\r\n"))
    write_camera(path, "cam", placed)
    content = path.read_bytes()
    assert content.startswith(BOM_UTF8) and content.count(b"\r\n") == content.count(b"\n")


# OpenCV's YAML -----------------------------------------------------------------------------------


def file_storage(path, **values) -> None:
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        file.write(name, value)
    file.release()


@settings(max_examples=12)
@given(
    hnp.arrays(float, 4, elements=st.floats(80, 5000)),
    st.sampled_from([4, 5, 8]).flatmap(
        lambda n: hnp.arrays(float, n, elements=st.floats(-2, 2, allow_subnormal=False))
    ),
    hnp.arrays(float, 3, elements=st.floats(-1.5, 1.5, allow_subnormal=False)),
    st.booleans(),
)
def test_what_filestorage_writes_is_read_to_the_last_digit(
    tmp_path_factory, figures, coefficients, rvec, column
):
    path = tmp_path_factory.mktemp("yaml") / "front.yml"
    fx, fy, cx, cy = figures
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    shape = (-1, 1) if column else (1, -1)
    file_storage(
        path,
        calibration_time="Sat Nov 21 09:00:00 2026",
        image_width=1088,
        image_height=1920,
        camera_matrix=matrix,
        distortion_coefficients=coefficients.reshape(shape),
        avg_reprojection_error=0.13,
        rvec=rvec,
        tvec=np.array([0.5, -1.0, 3.0]),
        per_view_errors=np.arange(30.0).reshape(-1, 1),
    )
    lens = read_intrinsics(path, "any name")
    np.testing.assert_array_equal(lens.matrix, matrix)
    np.testing.assert_array_equal(lens.distortions, coefficients)
    np.testing.assert_array_equal(lens.size, [1088, 1920])
    camera = pick_camera(path, read_calibration(path), "front")
    R, _ = cv2.Rodrigues(rvec)
    np.testing.assert_allclose(camera.T_cam_world[:3, :3], R, atol=2e-6)
    np.testing.assert_allclose(camera.T_cam_world[:3, 3], [0.5, -1, 3])


def test_coefficients_that_are_all_0_beyond_a_lens_s_own_change_nothing(tmp_path):
    """OpenCV and what writes its numbers into TOML have up to 14."""
    path = tmp_path / "c.toml"
    write_camera(path, "cam", LENS.entries())
    entries = f"distortions = {[0.1] + 13 * [0.0]}"
    path.write_text(re.sub(r"distortions = \[.*?\]", entries, path.read_text(), flags=re.DOTALL))
    np.testing.assert_array_equal(read_intrinsics(path, "cam").distortions, [0.1] + 7 * [0.0])


def test_the_older_header_and_tilted_zeros_are_read(tmp_path):
    path = tmp_path / "old.yaml"
    coefficients = np.concatenate([LENS.distortions, np.zeros(10)])
    sizes = {"image_width": 640, "image_height": 480}
    file_storage(path, **sizes, camera_matrix=MATRIX, distortion_coefficients=coefficients)
    path.write_text(path.read_text().replace("%YAML 1.2", "%YAML:1.0"))
    lens = read_intrinsics(path, "old")
    np.testing.assert_array_equal(lens.distortions[:4], LENS.distortions)
    assert len(lens.distortions) == 8
    assert "'rotation' is missing" in complaint(read_calibration, path)


def test_what_ros_writes_is_read_by_its_cameras_name(tmp_path):
    path = written(tmp_path, "c.yml", ROS)
    assert list(read_opencv_yaml(path)) == ["narrow"]
    lens = read_intrinsics(path, "narrow")
    np.testing.assert_array_equal(lens.matrix, MATRIX)
    np.testing.assert_array_equal(lens.distortions, [*LENS.distortions, 0])


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("plumb_bob", "equidistant", "expected at most 4 numbers (k1 k2 k3 k4)"),
        ("distortion_model: plumb_bob", "fisheye_model: 1", "expected at most 4 numbers"),
        ("image_width: 640\n", "", "'size' is missing"),
        ("image_width: 640", "image_width: wide", "size: found ['wide', 480.0], expected"),
        ("camera_matrix:", "cam:", "found no camera_matrix"),
        ("[500.25, 0, 320,", "[500.25, 320,", "camera_matrix: is not a complete matrix"),
        ("[500.25,", "[wide,", "camera_matrix: is not a complete matrix"),
        ("[500.25,", "[-5,", "matrix: found [[-5.0"),
        ("-2.0e-05, 0]", "1, 1, 1, 1, 1, 1, 1]", "is not a complete matrix"),
        ("camera_name: narrow", "no yaml at all", "line 3: found 'no yaml at all'"),
    ],
)
def test_bad_yaml_is_refused_with_the_field(tmp_path, old, new, says):
    assert old in ROS
    path = written(tmp_path, "c.yml", ROS.replace(old, new))
    message = complaint(read_intrinsics, path, "narrow")
    assert message.startswith(str(path)) and says in message
