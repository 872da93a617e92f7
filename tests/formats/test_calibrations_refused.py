"""Calibrations of other systems that are broken or hostile: one sentence, nothing run, no file."""

import pickle
import re
import tempfile
import warnings
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from calibrations_of_others import (
    SIZE,
    WRITERS,
    anipose,
    caliscope,
    easymocap,
    freemocap,
    motive,
    opencap_table,
    place,
    qualisys,
    vicon,
)
from conftest import complaint, read_calibration, written
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxmocap.formats.calibrations.plain_pickle import read_plain_pickle
from jaxmocap.formats.calibrations.registry import convert_calibration
from jaxmocap.formats.files.errors import InputError
from jaxmocap.geometry.cameras import Camera

CAMERAS = {"cam_1": place(1), "cam_2": place(2)}
FILES = [writer for writer in WRITERS if writer.__name__ != "opencap"]


def refused(source: Path, **options) -> str:
    """The sentence; no calibration is written."""
    target = source.with_name("ours.toml")
    message = complaint(convert_calibration, source, target, **options)
    assert not target.exists()
    return message


@cache
def sample(writer) -> tuple[str, bytes, dict[str, bytes]]:
    """A file as its system writes it: its name, its bytes, and what lies beside it."""
    with tempfile.TemporaryDirectory() as folder:
        source, _ = writer(Path(folder), CAMERAS)
        files = {path.name: path.read_bytes() for path in Path(folder).iterdir()}
    return source.name, files[source.name], files


def broken(data, content: bytes) -> bytes:
    """Cut off, with some bytes replaced, or with a number that is none."""
    start = data.draw(st.integers(0, len(content) - 1))
    kind = data.draw(st.sampled_from(["cut", "bytes", "number"]))
    if kind == "cut":
        return content[:start]
    if kind == "bytes":
        return content[:start] + data.draw(st.binary(max_size=8)) + content[start + 4 :]
    digits = [i for i in range(len(content)) if content[i : i + 1].isdigit()]
    at = digits[start % len(digits)]
    word = data.draw(st.sampled_from([b"nan", b"1e999", b"-", b"", b"[]", b"true", b"x" * 99]))
    return content[:at] + word + content[at + 1 :]


@settings(max_examples=40)
@given(st.data(), st.sampled_from(FILES))
def test_a_broken_file_is_converted_or_refused_in_one_sentence(data, writer):
    name, content, files = sample(writer)
    with tempfile.TemporaryDirectory() as folder:
        for other, beside in files.items():
            written(Path(folder), other, beside)
        source = written(Path(folder), name, broken(data, content))
        try:
            convert_calibration(source, Path(folder) / "ours.toml", size=None)
        except InputError as error:
            assert "\n" not in str(error)


@settings(max_examples=60)
@given(st.data(), st.integers(2, 5))
def test_a_broken_pickle_is_read_or_refused_in_one_sentence(data, protocol):
    content = broken(data, pickle.dumps(opencap_table(place(1)), protocol=protocol))
    try:
        read_plain_pickle(Path("cam.pickle"), content)
    except InputError as error:
        assert "\n" not in str(error)


@given(st.binary(max_size=200))
def test_bytes_without_sense_are_refused(content):
    with tempfile.TemporaryDirectory() as folder:
        for name in ("a.json", "b.toml", "c.yml", "d.xcp"):
            refused(written(Path(folder), name, content))


class Runs:
    """What Python's own unpickler would run."""

    def __init__(self, path: Path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


@pytest.mark.parametrize("writer", FILES)
@pytest.mark.parametrize("number", ["1e39", "-1e24", "1e300", "-1e-300", "0"])
def test_a_number_of_any_size_is_converted_or_refused_without_a_warning(tmp_path, writer, number):
    name, content, files = sample(writer)
    for other, beside in files.items():
        (tmp_path / other).write_bytes(beside)
    coding = "utf-16" if writer is motive else "utf-8"
    text = content.decode(coding)
    numbers = list(re.finditer(r"-?\d+\.\d*(e-?\d+)?", text))
    assert numbers
    for found in numbers[:: -(-len(numbers) // 40)]:
        changed = text[: found.start()] + number + text[found.end() :]
        (tmp_path / name).write_bytes(changed.encode(coding))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with suppress(InputError):
                size = SIZE if writer is easymocap else None
                convert_calibration(tmp_path / name, tmp_path / "ours.toml", size=size)
                read_calibration(tmp_path / "ours.toml")


def test_vicons_polynomial_and_its_centre_are_bounded(tmp_path):
    name, content, _ = sample(vicon)
    start = content.index(b'VICON_RADIAL2="')
    end = content.index(b'"', start + 16)
    for numbers, says in (
        ("640 360 1e39 0 0", "times as far out"),
        ("1e24 360 0 0 0", "a principal point within"),
    ):
        text = b'VICON_RADIAL2="Vicon3Parameter ' + numbers.encode()
        path = written(tmp_path, name, content[:start] + text + content[end:])
        assert says in refused(path)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"matrix": np.diag([1e39, 500, 1])}, "focal lengths up to 1e\\+08"),
        ({"matrix": [[500, 0, 1e24], [0, 500, 240], [0, 0, 1]]}, "principal point within 65536"),
        ({"matrix": [[500, 1e9, 320], [0, 500, 240], [0, 0, 1]]}, "a skew below"),
        ({"matrix": [[500, 0, 320], [300, 500, 240], [0, 0, 1]]}, "and 0 on the left of them"),
        ({"distortion": [0, 0, 1e3]}, "p1 = 1000, expected none beyond 100"),
        ({"distortion": [1e39], "lens": "fisheye"}, "k1 = 1e\\+39"),
        ({"distortion": [np.nan]}, "k1 = nan"),
        ({"size": (1e9, 480)}, "up to 65536"),
    ],
)
def test_a_camera_that_cannot_be_is_refused_in_memory_too(changes, says):
    matrix = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    with pytest.raises(ValueError, match=says):
        Camera.create(**({"size": (640, 480), "matrix": matrix} | changes))


def test_a_pickle_that_would_run_something_runs_nothing(tmp_path):
    trace = tmp_path / "ran"
    for protocol in range(2, 6):
        hostile = opencap_table(place(1)) | {"note": Runs(trace)}
        source = written(tmp_path, "cam.pickle", pickle.dumps(hostile, protocol=protocol))
        assert "the pickle holds the name" in refused(source)
    assert not trace.exists()


@pytest.mark.parametrize(
    "value",
    [np.array([1, None], object), np.datetime64(0, "s"), {1: 2}, {("a",): 1}, {1, 2}, 1j,
     np.zeros(3, [("x", float)])],
    ids=str,
)  # fmt: skip
def test_a_pickle_of_anything_but_plain_numbers_is_refused(tmp_path, value):
    table = opencap_table(place(1)) | {"distortion": value}
    assert "cam.pickle: " in refused(written(tmp_path, "cam.pickle", pickle.dumps(table)))


def test_a_pickle_that_grows_is_refused_at_once(tmp_path):
    """Lists of the same list twice, 200 deep; keys whose hash takes as long; a claim of bytes."""
    deep: tuple = (0.0,)
    for _ in range(200):
        deep = (deep, deep)
    listed = opencap_table(place(1)) | {"distortion": [deep]}
    refused(written(tmp_path, "cam.pickle", pickle.dumps(listed)))
    # A dict whose key is that tuple: written by hand, since making it would not end.
    body = pickle.dumps(deep, protocol=2)[2:-1]
    refused(written(tmp_path, "cam.pickle", b"\x80\x02}" + body + b"K\x01s."))
    refused(written(tmp_path, "cam.pickle", b"\x80\x04\x8e" + b"\xff" * 7 + b"\x7f."))
    refused(written(tmp_path, "cam.pickle", b"\x80\x04" + b"]" * 2**20))


def test_xml_with_a_document_type_or_without_end_is_refused(tmp_path):
    entities = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 20))
    bomb = f'<!DOCTYPE x [<!ENTITY a0 "aa">{entities}]><calibration>&a19;</calibration>'
    assert "without a document type" in refused(written(tmp_path, "a.xcp", bomb))
    for encoding in ("utf-16", "utf-16-le", "utf-16-be"):
        content = bomb.encode(encoding)
        assert "without a document type" in refused(written(tmp_path, "a.xcp", content))
    refused(written(tmp_path, "a.xcp", "<a>" * 50_000))
    refused(written(tmp_path, "a.xcp", "<a>" * 50_000 + "</a>" * 50_000))
    assert "larger" in refused(written(tmp_path, "a.xcp", "<a/>" * 300_000))


def changed(folder: Path, writer, old: str, new: str) -> str:
    """What a system's files are refused with once the first of them that says so says otherwise."""
    source, _ = writer(folder, CAMERAS)
    coding = "utf-16" if writer is motive else "utf-8"
    path = next(p for p in (source, *folder.iterdir()) if old in p.read_bytes().decode(coding))
    path.write_bytes(path.read_bytes().decode(coding).replace(old, new, 1).encode(coding))
    return refused(source, size=SIZE if writer is easymocap else None)


@pytest.mark.parametrize(
    ("writer", "old", "new", "parts"),
    [
        (qualisys, "<transform", "<moved", ["camera cam_1", "<transform> is missing"]),
        (qualisys, 'r11="', 'r11="2', ["<transform> r11", "not a rotation"]),
        (qualisys, 'focalLengthU="', 'focalLengthU="-', ["matrix", "positive focal"]),
        (qualisys, "centerPointV", "centre", ["centerPointV", "missing"]),
        (qualisys, 'sensorMaxU="131071"', 'sensorMaxU="1919"', ["beyond the sensor"]),
        (qualisys, 'serial="cam_1"', 'serial="cam_2"', ["cam_2", "each once"]),
        (qualisys, 'serial="cam_1"', 'serial="../x"', ["../x", "expected a name without"]),
        (qualisys, 'serial="cam_1"', "", ["serial", "expected text"]),
        (vicon, "SENSOR_SIZE", "SENSOR", ["SENSOR_SIZE", "missing"]),
        (vicon, 'ORIENTATION="', 'ORIENTATION="9', ["ORIENTATION", "length 1"]),
        (vicon, "Vicon3Parameter", "Vicon9Parameter", ["VICON_RADIAL2", "Vicon9Parameter"]),
        (vicon, 'POSITION="', 'POSITION="1 ', ["POSITION", "3 numbers"]),
        (vicon, "</KeyFrames>", "<KeyFrame/></KeyFrames>", ["cam_1", "2 <KeyFrame>"]),
        (motive, "IntrinsicStandardCameraModel", "Other", ["IntrinsicStandardCameraModel"]),
        (motive, 'OrientMatrix4="', 'OrientMatrix4="3', ["OrientMatrix", "not a rotation"]),
        (motive, 'ImagerPixelWidth="1920"', 'ImagerPixelWidth="0"', ["size", "positive"]),
        (easymocap, "T_cam_1", "T_other", ["camera cam_1: T_cam_1 is missing"]),
        (easymocap, "cols: 3", "cols: 4", ["K_cam_1", "not a complete matrix"]),
        (caliscope, "matrix = [[", "matrix = [[0, ", ["[cam_1] matrix"]),
        (caliscope, "distortions = [", "distortions = [1e9, ", ["[cam_1] distortions"]),
        (freemocap, "rotation = [", "rotation = [9, ", ["[cam_1] rotation"]),
        (anipose, "translation = [", "translation = ['a', ", ["[cam_1] translation"]),
    ],
)
def test_a_field_that_does_not_fit_is_named(tmp_path, writer, old, new, parts):
    sentence = changed(tmp_path, writer, old, new)
    for part in parts:
        assert part in sentence


def test_a_file_of_no_system_lists_the_systems(tmp_path):
    for name, content in (("a.toml", "a = 1"), ("a.xcp", "<a/>"), ("a.yml", "a: 1"),
                          ("a.json", "{}"), ("a.pickle", pickle.dumps(None))):  # fmt: skip
        sentence = refused(written(tmp_path, name, content))
        assert "found no calibration" in sentence and "Qualisys" in sentence
    (tmp_path / "empty").mkdir()
    assert "found no calibration" in refused(tmp_path / "empty")


def test_a_file_that_holds_no_calibration_is_not_replaced_by_one(tmp_path):
    source, _ = qualisys(tmp_path, CAMERAS)
    target = written(tmp_path, "recording.toml", "[subject]\nheight = 1.75\n")
    says = complaint(convert_calibration, source, target)
    assert says.endswith("recording.toml: is there and is no calibration, expected another name")
    assert target.read_text() == "[subject]\nheight = 1.75\n"
    for _ in range(2):
        convert_calibration(source, tmp_path / "ours.toml")


def test_a_system_without_a_calibrated_camera_is_refused(tmp_path):
    text = '<Cameras><Camera DEVICEID="1" TYPE="Vue_VIDEO"><KeyFrames/></Camera></Cameras>'
    assert "no camera that is calibrated" in refused(written(tmp_path, "a.xcp", text))
