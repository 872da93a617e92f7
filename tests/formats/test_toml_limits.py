"""TOML files and calibrations that would break or occupy a parser: one clear sentence instead."""

import os
import time

import pytest
from conftest import HANG_S, complaint, read_calibration
from small_recording import write_small_recording

from jaxmocap.formats.cameras.calibration import check_camera_writable
from jaxmocap.formats.cameras.toml_sections import replace_entries
from jaxmocap.formats.files.errors import InputError, comma_list, short_repr
from jaxmocap.formats.files.toml import TomlTable, file_name_problem, parse_toml, read_toml
from jaxmocap.formats.recordings.recording import load_recording

ESCAPES = "red\x1b[31m\n\u202eright to left"


def parsed(text: str):
    return parse_toml("r.toml", text)


# What is refused before it is parsed ------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (".".join(["a"] * 5000) + " = 1", "line 1: nested too deeply, expected at most 32 parts"),
        (f"\n[{'.'.join(['a'] * 200_000)}]", "line 2: nested too deeply"),
        ("x = 1\na = " + "[" * 5000, "line 2: nested too deeply, expected at most 32 levels"),
        ("a = " + "{ b = " * 5000, "nested too deeply, expected at most 32 levels"),
        ("a = " + "9" * 4301, "line 1: found '999"),
        ("a = 0x" + "f" * 4301, "expected at most 200 characters without quotes"),
        ("a = [", "not TOML: "),
        ('a = "\\x"', "not TOML: "),
        ("a = 1\na = 2", "not TOML: "),
    ],
)
def test_what_is_too_deep_or_too_long_is_refused_with_its_line(text, says):
    assert says in complaint(parsed, text)


@pytest.mark.parametrize(
    "text",
    [
        '"' + '\\"' * 500_000,
        "'''" + "''" * 500_000,
        "a = [" + "[]," * 300_000 + "]",
        "[[a]]\n" * 150_000,
        "".join(f"{'.'.join(['a'] * 31)}.b{i} = 1\n" for i in range(14_000)),
    ],
)
def test_a_megabyte_of_anything_is_looked_through_in_seconds(text):
    begun = time.monotonic()
    try:
        parsed(text)
    except InputError as error:
        assert str(error).isprintable()
    assert time.monotonic() - begun < HANG_S


def test_dots_brackets_and_digits_within_texts_and_comments_count_for_nothing():
    text = f'# {"[" * 100} {"a." * 100}\na = \'{"[a." * 100}\'\nb = """\n{"{.a" * 100}"""\n'
    assert parsed(text) == {"a": "[a." * 100, "b": "{.a" * 100}
    assert parsed("a.b.c = [[[1.5, 2]]]") == {"a": {"b": {"c": [[[1.5, 2]]]}}}


def test_a_file_larger_than_any_recording_is_refused_unread(tmp_path):
    path = tmp_path / "r.toml"
    path.write_bytes(b"#" * (2**20 + 1))
    assert "expected at most 1 MB" in complaint(read_toml, path)


def test_a_section_of_a_large_calibration_is_replaced_in_seconds():
    text = "".join(f"[cam{i}]\nx = [\n1,\n]\n" for i in range(20_000))
    begun = time.monotonic()
    after = replace_entries(text, "cam19999", {"x": 2})
    assert time.monotonic() - begun < HANG_S
    assert after == text[: text.rindex("x")] + "x = 2\n"


# What messages show ------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [ESCAPES, [ESCAPES], {ESCAPES: ESCAPES}, "x" * 10**6, [16**5000]])
def test_messages_show_values_short_and_without_escapes(value):
    assert short_repr(value).isprintable() and len(short_repr(value)) < 80


def test_messages_show_nested_values_to_some_depth_only():
    value: list = []
    for _ in range(100_000):
        value = [value]
    assert len(short_repr(value)) < 80


def test_of_many_names_some_are_listed():
    assert comma_list(["a", "b c"]) == "a, b c"
    text = comma_list([f"m{i}" for i in range(1000)] + [ESCAPES])
    assert text.endswith("m59 and 941 more")
    assert comma_list([ESCAPES]).isprintable()


def test_fields_tables_and_keys_are_named_without_escapes(tmp_path):
    message = complaint(TomlTable, tmp_path / "r.toml", f"[{ESCAPES * 50}]", {ESCAPES: 1}, ("a",))
    assert "unknown key" in message
    fields = TomlTable(tmp_path / "r.toml", "[a]", {"b": ESCAPES})
    assert "found 'red\\x1b[31m" in complaint(fields.number, "b")


@pytest.mark.parametrize("value", [1e300, -1e13, 10**400, float("nan"), float("inf"), True, "1"])
def test_numbers_beyond_any_measurement_are_refused(tmp_path, value):
    fields = TomlTable(tmp_path / "r.toml", "[a]", {"b": value, "c": [value]})
    assert "[a] b: found" in complaint(fields.number, "b")
    if not isinstance(value, (bool, str)):
        assert "[a] c: found" in complaint(fields.array, "c", [(1,)], "a number")


def test_whole_numbers_are_asked_for_with_their_range(tmp_path):
    fields = TomlTable(tmp_path / "r.toml", "", {"a": 3, "b": 2.5, "c": 10**12})
    assert fields.integer("a", 0, 5) == 3
    assert "expected a whole number" in complaint(fields.integer, "b", 0, 5)
    assert "expected a number from 0 to 5" in complaint(fields.integer, "c", 0, 5)


# Files and names ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("pipe", "found a named pipe, expected a file"),
        ("/dev/zero", "found a device, expected a file"),
        (".", "found a folder, expected a file"),
        ("a\0b", "holds a NUL"),
        ("x" * 5000, "cannot be read"),
        ("gone\x1b[31m", "no such file"),
    ],
)
def test_what_is_no_file_is_refused_with_its_field(tmp_path, name, says):
    os.mkfifo(tmp_path / "pipe")
    fields = TomlTable(tmp_path / "r.toml", "[markers]", {"file": name})
    message = complaint(fields.file, "file")
    assert "[markers] file: " in message and says in message
    if name != ".":
        assert "[markers] file: no such folder" in complaint(fields.file, "file", True)


@pytest.mark.parametrize(
    "name",
    [
        *("x/../../../EVIL", "a\\b", "..", ".", "", ".hidden", "a\0b", "a\nb", "red\x1b[31m"),
        *("x" * 101, "ü" * 100 + "x", "\u4e16" * 70, "a:b", "a*", "nul", "COM1.x", "a\u202eb"),
    ],
)
def test_names_that_lead_elsewhere_or_that_no_system_has_are_no_cameras(tmp_path, name):
    assert file_name_problem(name)
    if name:
        assert "camera: found" in complaint(
            TomlTable(tmp_path / "r.toml", "camera:", {"name": name}).file_name, "name"
        ).replace("camera: name", "camera")
    complaint(check_camera_writable, tmp_path / "c.toml", name)


@pytest.mark.parametrize("name", ["cam 01", "Küche.links", "a-b_c", "中央", "x" * 100, "console"])
def test_ordinary_names_are(name):
    assert file_name_problem(name) is None


@pytest.fixture
def recording(tmp_path):
    """The path of a small recording that can be read."""
    return write_small_recording(tmp_path)


def test_a_camera_that_leads_out_of_the_folder_is_refused_before_anything_is_written(recording):
    for file in (recording, recording.parent / "calibration.toml"):
        text = file.read_text().replace("[cam]", '["x/../EVIL"]').replace('"cam"', '"x/../EVIL"')
        file.write_text(text)
    message = complaint(load_recording, recording)
    assert "[[video]] number 1 camera: found 'x/../EVIL'" in message


@pytest.mark.parametrize("other", ["cam", "CAM"])
def test_cameras_whose_files_would_be_called_the_same_are_refused(recording, other):
    calibration = recording.parent / "calibration.toml"
    section = calibration.read_text()
    if other != "cam":
        calibration.write_text(section + section.replace("[cam]", f"[{other}]"))
    recording.write_text(
        recording.read_text() + f'[[video]]\nfile = "cam.mp4"\ncamera = "{other}"\n'
    )
    message = complaint(load_recording, recording)
    assert f"[[video]] number 2 camera: found '{other}' beside 'cam'" in message


# Calibrations ------------------------------------------------------------------------------------

YAML = (
    "image_width: 640\nimage_height: 480\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n"
)


def test_data_over_a_hundred_thousand_lines_is_read_in_seconds(tmp_path):
    path = tmp_path / "c.yml"
    path.write_text(YAML + "   data: [ 1,\n" + "  0,\n" * 200_000)
    assert "is not a complete matrix" in complaint(read_calibration, path)


@pytest.mark.parametrize(
    ("rows", "columns"), [("-3", "-3"), ("9" * 5000, "1"), ("0", "0"), ("1", "9"), ("3", "1e3")]
)
def test_a_matrix_of_other_than_its_rows_and_columns_is_refused(tmp_path, rows, columns):
    path = tmp_path / "c.yml"
    text = YAML.replace("rows: 3", f"rows: {rows}").replace("cols: 3", f"cols: {columns}")
    path.write_text(text + "   data: [ 500, 0, 320, 0, 500, 240, 0, 0, 1 ]\n")
    complaint(read_calibration, path)
