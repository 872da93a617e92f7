"""Tables of numbers that no measurement makes: refused with their line, before memory is filled."""

import numpy as np
import pytest
from conftest import problem_of, written

from jaxmocap.formats.animation.bvh import read_bvh
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.reading import MAX_LINE_CHARACTERS, numbered_lines
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.formats.time_series.mot import read_mot
from jaxmocap.formats.time_series.tables import parse_rows, row_texts
from jaxmocap.formats.time_series.trc import write_trc

TRC = (
    "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tNumFrames\tNumMarkers\tUnits\n60\t2\t1\tm\n"
    "Frame#\tTime\tHead\t\t\n\t\tX1\tY1\tZ1\n\n1\t0\t1\t2\t3\n2\t0.5\t1\t2\t3\n"
)
CSV = "time,Head.x,Head.y,Head.z\n0,1,2,3\n0.5,1,2,3\n"
MOT = "a\nversion=1\nnRows=2\nnColumns=2\ninDegrees=yes\nendheader\ntime\tknee\n0\t1\n0.5\t2\n"
BVH = """HIERARCHY
ROOT Hips
{
OFFSET 0 0 0
CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
JOINT Leg
{
OFFSET 0 -1.2 0
CHANNELS 3 Zrotation Xrotation Yrotation
End Site
{
OFFSET 0 -0.4 0
}
}
}
MOTION
Frames: 2
Frame Time: 0.02
0 1 0 0 0 0 0 0 0
0 1 0 0 0 0 0 0 0
"""
TEXTS = {".trc": TRC, ".csv": CSV, ".mot": MOT, ".bvh": BVH}


def complaint(folder, suffix: str, text: str | bytes) -> str:
    """What reading a file of that text says."""
    path = written(folder, f"a{suffix}", text)
    return problem_of(read_mot if suffix == ".mot" else read_markers, path)


@pytest.mark.parametrize("suffix", TEXTS)
def test_the_texts_are_read_as_they_are(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    path.write_text(TEXTS[suffix])
    if suffix == ".mot":
        assert read_mot(path)[0].tolist() == [0.0, 0.5]
    else:
        assert len(read_markers(path).times) == 2


@pytest.mark.parametrize(
    ("suffix", "old", "new", "says"),
    [
        (".trc", "60\t2", "60\t" + "9" * 5000, "line 3: NumFrames is '999"),
        (".trc", "60\t2", "60\t٣", None),
        (".trc", "\t1\t2\t3\n2", "\t1e200\t2\t3\n2", "line 7: found '1e+200', expected a number"),
        (".trc", "\t1\t2\t3\n2", "\t1e9\t2\t3\n2", "line 7: marker 'Head' is at 1e+09 m, expected"),
        (".trc", "0.5", "1e12", "line 8: found a time of 1e+12 s, expected one within"),
        (".trc", "Head", "He\x1bad", "line 4: found 'He\\x1bad' as a name"),
        (".trc", "Head", "H" * 201, "line 4: found 'HHH"),
        (".csv", "1,2,3\n0.5", f"1,2,{'9' * 5000}\n0.5", "line 2: found 'inf', expected a number"),
        (".csv", "1,2,3\n0.5", "1,-1e8,3\n0.5", "line 2: marker 'Head' is at -1e+08 m"),
        (".csv", "0.5,1", "0.5,²", "line 3: found '²', expected a number"),
        (".mot", "nRows=2", "nRows=" + "9" * 5000, "nRows is '999"),
        (".mot", "knee", "knee\tknee", "line 7: column 'knee' is named twice"),
        (".mot", "endheader", "endhead", "found no line 'endheader'"),
        (".mot", "inDegrees=yes", "", "neither inDegrees=yes"),
        (".mot", "time\t", "zeit\t", "line 7: found no 'time'"),
        (".mot", "nRows=2", "nRows=3", "nRows is 3, but the file ends after 2"),
        (".mot", "0\t1", "0\tx\t1", "line 8: found 3 columns, expected 2"),
        (".bvh", "Frames: 2", "Frames: nan", "line 17: found nan, expected how many frames"),
        (".bvh", "Frames: 2", "Frames: " + "9" * 5000, "line 17: found inf, expected how many"),
        (".bvh", "Frames: 2", "Frames: -1", "line 17: found -1, expected how many frames"),
        (".bvh", "0.02", "1e300", "line 18: found 1e+300, expected seconds per frame"),
        (".bvh", "0.02", "1e-300", "line 18: found 1e-300, expected seconds per frame"),
        (".bvh", "OFFSET 0 -1.2", "OFFSET 1e308 -1.2", "line 8: found 'OFFSET 1e308 -1.2 0'"),
        (".bvh", "\n0 1 0 ", "\n0 1e14 0 ", "found a place 1e+14 m away, expected places within"),
        (".bvh", "OFFSET 0 -1.2 0", "OFFSET 0 -1.2 0\nOFFSET 0 1 0", "line 9: found"),
        (".bvh", "CHANNELS 3", "CHANNELS 1 Zrotation\nCHANNELS 3", "expected CHANNELS once"),
        (".bvh", "CHANNELS 3", "CHANNELS " + "3" * 5000, "line 9: found 'CHANNELS 333"),
        (".bvh", "JOINT Leg", "JOINT L\x1b[31m", "line 6: found 'JOINT L\\x1b[31m'"),
        (".bvh", "JOINT Leg", "JOINT " + "L" * 201, "line 6: found 'JOINT LLL"),
    ],
)  # fmt: skip
def test_numbers_and_names_that_no_measurement_has_are_refused(tmp_path, suffix, old, new, says):
    text = TEXTS[suffix]
    assert old in text
    if says is None:
        (tmp_path / "a.trc").write_text(text.replace(old, new, 1))
        assert len(read_markers(tmp_path / "a.trc").times) == 2
    else:
        assert says in complaint(tmp_path, suffix, text.replace(old, new, 1))


def deep(levels: int, wide: int = 0) -> str:
    """A BVH file of joints below one another, and of others beside the last one."""
    joints = [f"{'JOINT' if i else 'ROOT'} j{i}\n{{\nOFFSET 0 0.01 0\n" for i in range(levels)]
    joints[0] += "CHANNELS 3 Zrotation Xrotation Yrotation\n"
    joints += [f"JOINT k{i}\n{{\nOFFSET 0 1 0\n}}\n" for i in range(wide)]
    ends = "}\n" * levels
    return f"HIERARCHY\n{''.join(joints)}{ends}MOTION\nFrames: 1\nFrame Time: 1\n0 0 0\n"


def test_joints_too_deep_below_one_another_or_too_many_are_refused(tmp_path):
    assert "200 deep below one another" in complaint(tmp_path, ".bvh", deep(3000))
    assert "expected at most 2000 joints" in complaint(tmp_path, ".bvh", deep(3, 2000))
    (tmp_path / "a.bvh").write_text(deep(200, 1700).replace("JOINT k0", "JOINT k"))
    assert "200 deep" in complaint(tmp_path, ".bvh", deep(200, 1))
    (tmp_path / "a.bvh").write_text(deep(199, 1700))
    assert len(read_bvh(tmp_path / "a.bvh", "m").names) == 1899


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"\n" * 6_000_000, "found more than 5000000 lines"),
        (b"PathFileType" + b"x" * 2**21, "line 1: found more than 1048576 characters"),
        (TRC.encode() + b"\n" * 300_000 + b"\xff", "line 300009: found bytes that are not UTF-8"),
        (TRC.encode() + b"\n" * 300_000 + b"\0", "line 300009: found binary data"),
        (b"\n" * 300_000, "the file is empty"),
    ],
)
def test_files_that_are_no_table_are_refused_in_seconds(tmp_path, text, says):
    assert says in complaint(tmp_path, ".trc", text)


def test_lines_are_the_same_whatever_ends_them_and_wherever_blocks_end(tmp_path):
    lines = [f"{'x' * (i * 7919 % 50_000)}é{i}" for i in range(100)]
    for end in ("\n", "\r\n", "\r"):
        (tmp_path / "a").write_bytes(("\ufeff" + end.join(lines)).encode())
        assert list(numbered_lines(tmp_path / "a")) == list(enumerate(lines, 1))
    (tmp_path / "a").write_text("\n \nx\n\ny" + "z" * (MAX_LINE_CHARACTERS - 1))
    assert [number for number, _ in numbered_lines(tmp_path / "a")] == [1, 2, 3, 4, 5]


def test_a_table_of_more_numbers_than_memory_holds_is_refused():
    with pytest.raises(InputError, match="line 4: found one row more, expected at most 3 rows"):
        parse_rows("a", ((i, ["1", "2"]) for i in range(1, 10)), 2, 7)


def test_rows_are_written_as_before_with_nothing_where_a_number_is_missing():
    values = np.array([[1.0, np.nan, -0.0], [1e-7, 123456.789, -5.0]])
    assert list(row_texts(values, ",")) == [
        "1.000000,,-0.000000", "0.000000,123456.789000,-5.000000",
    ]  # fmt: skip
    assert list(row_texts(values[:1], "\t", 1, "NaN")) == ["1.0\tNaN\t-0.0"]


def test_what_cannot_be_written_names_the_file(tmp_path):
    path = tmp_path / "a.trc"
    for times in (np.array([np.nan, 1.0]), np.array([1.0, 0.0]), np.array([0.0, 1e300])):
        problem = problem_of(write_trc, path, times, {"Head": np.zeros((2, 3))})
        assert problem.startswith("sample ")
    assert not list(tmp_path.iterdir())


def test_samples_that_follow_one_another_faster_than_any_device_measures_are_refused(tmp_path):
    rows = "".join(f"{i}e-9,1,2,3\n" for i in range(5))
    message = complaint(tmp_path, ".csv", f"time,Head.x,Head.y,Head.z\n{rows}")
    assert "found samples 1e-09 s apart, expected at least 1e-05 s" in message
