"""C3D: what is written is read back, with gaps; other writers' habits are read."""

import os
import struct
from functools import partial
from pathlib import Path

import ezc3d
import numpy as np
import pytest
from conftest import disk_full_at, problem_of, shared_folder
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from jaxmocap.cli.program import main
from jaxmocap.formats.files import writing
from jaxmocap.formats.time_series import c3d
from jaxmocap.formats.time_series.c3d import read_c3d, write_c3d
from jaxmocap.formats.time_series.csv import write_csv
from jaxmocap.formats.time_series.tables import Markers
from jaxmocap.formats.time_series.trc import write_trc

complaint = partial(problem_of, read_c3d)


@st.composite
def marked(draw) -> Markers:
    """Markers at an even rate, with gaps."""
    count = draw(st.integers(2, 9))
    rate = draw(st.sampled_from([25.0, 29.97, 60.0, 90.0, 1000.0]))
    letters = st.text(st.characters(codec="ascii", categories=["L", "N"]), min_size=1, max_size=9)
    names = tuple(draw(st.lists(letters, min_size=1, max_size=4, unique=True)))
    shape = (count, len(names))
    positions = draw(hnp.arrays(float, (*shape, 3), elements=st.floats(-50, 50)))
    positions[draw(hnp.arrays(bool, shape))] = np.nan
    times = (draw(st.integers(0, 900)) + np.arange(count)) / rate
    return Markers(times, names, positions)


def foreign(path: Path, points: np.ndarray, unit: str | None = "mm", labels=None, rate=100.0):
    """A file (4, M, T) as some other program writes it."""
    file = ezc3d.c3d()
    group = file["parameters"]["POINT"]
    group["RATE"]["value"] = [rate]
    group["LABELS"]["value"] = labels or [f"M{i}" for i in range(points.shape[1])]
    if unit is not None:
        group["UNITS"]["value"] = [unit]
    file["data"]["points"] = points
    file.write(str(path))
    return path


@shared_folder
@given(marked())
def test_markers_survive_a_round_trip_with_gaps_and_times(tmp_path, markers):
    write_c3d(tmp_path / "a.c3d", markers)
    back = read_c3d(tmp_path / "a.c3d")
    assert back.names == markers.names
    np.testing.assert_allclose(back.times, markers.times, rtol=1e-6)
    # 32-bit numbers hold 50 m to 4 micrometres.
    np.testing.assert_allclose(back.positions, markers.positions, rtol=2e-7, atol=2e-9)


@pytest.mark.parametrize(("options", "time"), [([], 16.68), (["--rate", "1000"], 16.683)])
def test_a_single_sample_stays_at_its_time(tmp_path, options, time):
    """By the rate that --rate states, or the file's header."""
    write_trc(tmp_path / "a.trc", np.array([16.683]), {"A": np.ones((1, 3))}, 50.0)
    paths = [str(tmp_path / name) for name in ("a.trc", "a.c3d")]
    assert main(["convert", *paths, *options]) == 0
    np.testing.assert_allclose(read_c3d(paths[1]).times, [time], rtol=1e-6)


@pytest.mark.parametrize(("step", "moved"), [(None, 0.317), (0.1, 0.017), (0.001, None)])
def test_a_first_sample_between_frames_is_moved_with_a_sentence(tmp_path, capsys, step, moved):
    times = 16.683 + np.arange(2 if step else 1) * (step or 0)
    write_csv(tmp_path / "a.csv", times, {"A": np.ones((len(times), 3))})
    paths = [str(tmp_path / name) for name in ("a.csv", "a.c3d")]
    assert main(["convert", *paths]) == 0
    printed = capsys.readouterr().out
    assert (f"moved: all times by +{moved} s" in printed) == ("moved" in printed) == bool(moved)
    np.testing.assert_allclose(read_c3d(paths[1]).times, times + (moved or 0), atol=1e-5)


def test_a_marker_at_the_origin_is_not_taken_for_a_missing_one(tmp_path):
    write_c3d(tmp_path / "a.c3d", Markers(np.zeros(1), ("O",), np.zeros((1, 1, 3))))
    np.testing.assert_allclose(read_c3d(tmp_path / "a.c3d").positions, 0, atol=2e-9)


@pytest.mark.parametrize(("unit", "metres"), [("m", 1), ("MM", 1e-3), ("cm", 0.01), ("in", 0.0254)])
def test_the_files_unit_is_converted(tmp_path, unit, metres):
    path = foreign(tmp_path / "a.c3d", np.full((4, 1, 2), 7.0), unit)
    np.testing.assert_allclose(read_c3d(path).positions, 7 * metres, rtol=1e-6)


def test_points_that_are_zero_or_no_number_are_missing(tmp_path):
    points = np.ones((4, 2, 3))
    points[:3, 0, 1], points[0, 1, 2] = 0.0, np.nan
    markers = read_c3d(foreign(tmp_path / "a.c3d", points))
    expected = [[False, False], [True, False], [False, True]]
    np.testing.assert_array_equal(np.isnan(markers.positions).all(-1), expected)


@pytest.mark.parametrize(
    ("labels", "names"),
    [
        (["Ann:HEAD", "Ann:HAND", "*110"], ("HEAD", "HAND", "*110")),
        (["Ann:HEAD", "Bob:HEAD", "Bob:HAND"], ("Ann:HEAD", "Bob:HEAD", "Bob:HAND")),
        (["Ann:HEAD", "HEAD", "HAND"], ("Ann:HEAD", "HEAD", "HAND")),
    ],
)
def test_a_prefix_that_all_labels_share_goes_and_others_stay(tmp_path, labels, names):
    assert read_c3d(foreign(tmp_path / "a.c3d", np.ones((4, 3, 1)), labels=labels)).names == names


def test_bad_files_are_refused_in_one_sentence(tmp_path):
    path = tmp_path / "a.c3d"
    path.write_text("PathFileType\t4\n" * 60)
    assert "not a C3D file" in complaint(path)
    path.write_bytes(b"")
    assert "not a C3D file" in complaint(path)
    assert "found 'furlong', expected one of m, cm" in complaint(
        foreign(path, np.ones((4, 1, 1)), "furlong")
    )
    assert "'A' is named twice" in complaint(foreign(path, np.ones((4, 2, 1)), labels=["A", "A"]))
    intact = foreign(path, np.ones((4, 3, 400))).read_bytes()
    path.write_bytes(intact[: len(intact) // 2])
    assert "the header states 400 frames, the file ends after" in complaint(path)


def test_a_damaged_file_does_not_end_the_process(tmp_path):
    path = foreign(tmp_path / "a.c3d", np.ones((4, 3, 4)))
    content = bytearray(path.read_bytes())
    # How many dimensions the labels have; ezc3d alone dies of it.
    content[content.index(b"LABELS") + 9] = 255
    path.write_bytes(content)
    assert complaint(path) == "not a C3D file, or damaged or cut off within its parameters"


def test_what_the_format_cannot_hold_is_refused(tmp_path):
    def refusal(times, names=("A",)):
        markers = Markers(np.array(times), names, np.ones((len(times), len(names), 3)))
        problem = problem_of(write_c3d, tmp_path / "a.c3d", markers)
        assert not (tmp_path / "a.c3d").exists()
        return problem

    assert "10 to 30 ms apart" in refusal([0.0, 0.01, 0.04])
    assert "C3D holds 0 to 65535" in refusal([-1.0, -0.9])
    assert "C3D holds 0 to 65535" in refusal(np.arange(65536) / 100)
    assert "names of 127 bytes" in refusal([0.0], ("x" * 128,))
    assert "256 markers" in refusal([0.0], tuple(map(str, range(256))))


def test_a_real_serve_is_read_and_written(recordings, tmp_path):
    serve = read_c3d(recordings / "motions" / "tennis_serve.c3d")
    assert len(serve.times) == 1092 and len(serve.names) == 39 and "LFHD" in serve.names
    assert serve.times[0] == 0 and serve.times[-1] == pytest.approx(1091 / 50)
    # A standing person's head, metres.
    assert 1.4 < serve.points()["LFHD"][0, 2] < 1.9
    write_c3d(tmp_path / "again.c3d", serve)
    again = read_c3d(tmp_path / "again.c3d")
    np.testing.assert_allclose(again.positions, serve.positions, atol=1e-6)
    # Other readers compare the header's scale with POINT:SCALE, and take a point for missing whose
    # fourth number is negative as 16 bits.
    written = (tmp_path / "again.c3d").read_bytes()
    (start,), scale = struct.unpack_from("<H", written, 16), struct.unpack_from("<f", written, 12)
    file = ezc3d.c3d(str(tmp_path / "again.c3d"))
    assert file["parameters"]["POINT"]["SCALE"]["value"] == pytest.approx(scale)
    points = np.frombuffer(written, "<f4", serve.positions[..., 0].size * 4, (start - 1) * 512)
    is_missing = points.reshape(-1, 4)[:, 3].astype(np.int16) < 0
    np.testing.assert_array_equal(is_missing, np.isnan(serve.positions).any(-1).ravel())


def test_what_stands_among_the_points_and_is_none_is_left_out_with_a_warning(tmp_path):
    file = ezc3d.c3d()
    group = file["parameters"]["POINT"]
    group["RATE"]["value"], group["UNITS"]["value"] = [100.0], ["mm"]
    group["LABELS"]["value"] = ["LKNE", "LKneeAngles", "LKneeMoment", "RKNE"]
    file.add_parameter("POINT", "ANGLES", ["LKneeAngles"])
    file.add_parameter("POINT", "MOMENTS", ["LKneeMoment"])
    file["data"]["points"] = np.tile(np.arange(1.0, 5)[:, None], (4, 1, 3))
    file.write(str(tmp_path / "a.c3d"))
    markers = read_c3d(tmp_path / "a.c3d")
    assert markers.names == ("LKNE", "RKNE")
    np.testing.assert_allclose(markers.positions[0, :, 0], [1e-3, 4e-3], rtol=1e-6)
    (left,) = markers.left_out
    assert left.startswith("2 angles, forces") and left.endswith("LKneeAngles, LKneeMoment")


def test_frames_beyond_what_the_header_counts_keep_their_times_or_are_refused(tmp_path):
    def counted(path: Path, first: int, last: int) -> Path:
        """Vicon Nexus: the header's numbers stop at 65535, TRIAL's are two words each."""
        file = ezc3d.c3d()
        group = file["parameters"]["POINT"]
        group["RATE"]["value"], group["UNITS"]["value"] = [200.0], ["mm"]
        group["LABELS"]["value"] = ["A"]
        for name, frame in (("ACTUAL_START_FIELD", first), ("ACTUAL_END_FIELD", last)):
            file.add_parameter("TRIAL", name, [frame & 0xFFFF, frame >> 16])
        file["data"]["points"] = np.ones((4, 1, last - first + 1))
        file.write(str(path))
        content = bytearray(path.read_bytes())
        struct.pack_into("<HH", content, 6, min(first, 65535), min(last, 65535))
        path.write_bytes(content)
        return path

    long = counted(tmp_path / "a.c3d", 1, 70000)
    assert "TRIAL states 70000 frames, 65535 of them can be read" in complaint(long)
    for first in (65301, 70001):
        later = read_c3d(counted(tmp_path / "a.c3d", first, first + 499)).times
        np.testing.assert_allclose(later, (first - 1 + np.arange(500)) / 200)


def test_a_file_without_a_rate_is_refused_in_these_words(tmp_path):
    content = foreign(tmp_path / "a.c3d", np.ones((4, 1, 4)), rate=100.0).read_bytes()
    (tmp_path / "a.c3d").write_bytes(content.replace(struct.pack("<f", 100), bytes(4)))
    message = "POINT:RATE: found 0, expected frames per second, up to 1e+06"
    assert complaint(tmp_path / "a.c3d") == message


def test_sizes_beyond_the_file_are_refused_whatever_the_header_says(tmp_path):
    path = foreign(tmp_path / "a.c3d", np.ones((4, 3, 4)))
    content = bytearray(path.read_bytes())
    used, frames = content.index(b"USED"), content.index(b"FRAMES")
    content[2:4] = content[used + 8 : used + 10] = struct.pack("<H", 60000)
    content[8:10] = content[frames + 10 : frames + 12] = struct.pack("<H", 65535)
    path.write_bytes(content)
    assert complaint(path) == "not a C3D file, or damaged or cut off within its parameters"


@pytest.mark.parametrize(
    ("most", "message"),
    [(2**31, "not read within 0.001 s"), (2**28, "damaged"), (4 * 10**8, "takes more than 0.4 GB")],
)
def test_a_file_may_take_so_much_time_and_memory_and_no_more(tmp_path, monkeypatch, most, message):
    pytest.importorskip("resource", reason="this system has no limits of file sizes")
    path = foreign(tmp_path / "a.c3d", np.ones((4, 40, 40_000)))
    monkeypatch.setattr(c3d, "MAX_MEMORY_BYTES", most)
    monkeypatch.setattr(c3d, "MAX_READ_S", 0.001 if "0.001" in message else 60)
    assert message in complaint(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("def c3d(path):\n    raise MemoryError", "takes more than"),
        ("raise ModuleNotFoundError", "ezc3d cannot be imported (pip install ezc3d)"),
    ],
)
def test_ezc3d_is_had_from_where_this_process_has_it(tmp_path, monkeypatch, content, message):
    """As below PYTHONPATH, or in the user's own folder."""
    path = foreign(tmp_path / "a.c3d", np.ones((4, 1, 2)))
    (tmp_path / "packages").mkdir()
    (tmp_path / "packages" / "ezc3d.py").write_text(content)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "packages"), prepend=os.pathsep)
    assert message in complaint(path)


@pytest.mark.parametrize("most", [100, 3000, 30_000])
def test_a_full_disk_leaves_an_earlier_file_as_it_was(tmp_path, capsys, monkeypatch, most):
    """ezc3d itself says nothing of it, and leaves half a file."""
    monkeypatch.setattr(writing, "SMALLEST_ROOM_BYTES", 0)  # it is full later only
    markers = Markers(np.arange(400) / 100, tuple("abcde"), np.ones((400, 5, 3)))
    write_csv(tmp_path / "a.csv", markers.times, markers.points())
    earlier = foreign(tmp_path / "b.c3d", np.ones((4, 1, 2))).read_bytes()
    with disk_full_at(most):
        assert main(["convert", str(tmp_path / "a.csv"), str(tmp_path / "b.c3d")]) == 1
    printed = capsys.readouterr()
    assert printed.out == ""
    problem = "cannot be written completely, is the disk full?"
    assert printed.err == f"jaxmocap convert: {tmp_path / 'b.c3d'}: {problem}\n"
    assert (tmp_path / "b.c3d").read_bytes() == earlier
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.csv", "b.c3d"]
