"""What a live run leaves on disk: when it is killed, when the disk is full, when nothing came in.

The processes that are killed record for real: samples at 90 Hz and a still picture at 30 Hz.
"""

import os
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import complaint, disk_full_at
from small_recording import HEIGHT, PLACES, standing, write_small_recording

from jaxmocap import Recording
from jaxmocap.capture.streams.inbox import LiveFrame
from jaxmocap.capture.streams.sample_assembly import MarkerSample
from jaxmocap.capture.video import Video, open_video
from jaxmocap.formats.files.errors import InputError, OutputError
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.pipelines.live.files import LineFile
from jaxmocap.pipelines.live.recording import LiveRecording, check_free
from jaxmocap.pipelines.live.setup import LiveSetup, load_live

LIVE = """
[markers.on]
{places}
[[video]]
file = "cam.mp4"
camera = "cam"
[calibration]
file = "calibration.toml"
[subject]
height = 1.75
"""
# What is killed says "recorded SECONDS" after every event that it has handed on.
RECORDS = """
import sys, time
import numpy as np
sys.path[:0] = {tests!r}
from test_live_disk import live_setup, sample
from jaxmocap.capture.streams.inbox import LiveFrame
from jaxmocap.pipelines.live.recording import LiveRecording
from pathlib import Path
recording = LiveRecording(live_setup(Path(sys.argv[1])), sys.argv[2])
still, began, i = np.full((72, 96, 3), 90, np.uint8), time.monotonic(), 0
while True:
    now = time.monotonic() - began
    recording.add(sample(now))
    if i % 3 == 0:
        recording.add(LiveFrame(0, now, still, now))
    print(f"recorded {{now}}", flush=True)
    time.sleep(1 / 90)
    i += 1
"""


def live_setup(folder: Path) -> LiveSetup:
    """A live run of the small recording's person, markers and camera, from a file."""
    path = folder / "live.toml"
    if not path.exists():
        write_small_recording(folder)
        places = "\n".join(f'{name} = {{ bone = "{bone}" }}' for name, (bone, _) in PLACES.items())
        path.write_text(LIVE.format(places=places))
    return load_live(path)


def sample(at: float) -> MarkerSample:
    return MarkerSample(at, standing() + 0.01 * np.sin(at), at)


def frame(at: float, seed: int | None = None) -> LiveFrame:
    image = np.full((72, 96, 3), 90, np.uint8)
    if seed is not None:
        image = np.random.default_rng(seed).integers(0, 255, image.shape, np.uint8)
    return LiveFrame(0, at, image, at)


def record(recording: LiveRecording, seconds: float, noisy: bool = False) -> None:
    """Hand on so many seconds of samples and frames, as fast as they are written."""
    for i in range(round(90 * seconds)):
        recording.add(sample(i / 90))
        if i % 3 == 0:
            recording.add(frame(i / 90, i if noisy else None))
        while recording._queue.qsize() > 40:
            time.sleep(0.001)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


# Killed ------------------------------------------------------------------------------------------


def killed_after(seconds: float, folder: Path, out: Path) -> float:
    """Record into ``out`` until SIGKILL; the time of the last event that was handed on."""
    live_setup(folder)
    script = RECORDS.format(tests=sys.path)
    process = subprocess.Popen(
        [sys.executable, "-c", script, folder, out], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    last, end = 0.0, None
    for line in process.stdout:
        end = end or time.monotonic() + seconds
        if line.endswith("\n") and line.startswith("recorded"):
            last = float(line.split()[1])
        if time.monotonic() >= end:
            process.kill()
            break
    rest = process.stdout.read().splitlines()
    process.wait()
    process.stdout.close()
    return max([last, *(float(line.split()[1]) for line in rest[:-1])])


def check_rescued(out: Path, last: float) -> dict[str, float]:
    """A killed run's recording is read at once; how much of its end is missing, seconds."""
    text = (out / "markers.csv").read_bytes()
    widths = {line.count(b",") for line in text.splitlines()}
    assert text.endswith(b"\n") and widths == {7 * len(PLACES)}
    recording = Recording.load(out / "recording.toml")
    video = open_video(recording.videos[0])
    images = [image for _, image in video.frames()]
    assert all(image is not None for image in images)
    return {"markers": last - recording.times[-1], "video": last - video.times[-1]}


@pytest.mark.parametrize("seconds", [1.2, 2.05])
def test_a_run_that_is_killed_leaves_a_recording_that_lacks_but_its_end(tmp_path, seconds):
    last = killed_after(seconds, tmp_path, tmp_path / "out")
    lost = check_rescued(tmp_path / "out", last)
    # On a machine that is otherwise busy, too.
    assert lost["markers"] < 3 and lost["video"] < 3


@pytest.mark.slow
def test_of_a_still_picture_no_more_is_lost_whenever_the_run_is_killed(tmp_path):
    for i, seconds in enumerate([*np.linspace(0.8, 4.0, 39), 20.0]):
        folder = tmp_path / str(i)
        folder.mkdir()
        last = killed_after(seconds, folder, folder / "out")
        lost = check_rescued(folder / "out", last)
        frames = len(Video(folder / "out" / "cam.mp4"))
        print(f"killed after {last:.2f} s: {frames} frames are there; lost {lost}")
        assert max(lost.values()) < 1


def test_the_next_run_leaves_what_a_killed_one_has_rescued_and_removes_its_hidden_files(tmp_path):
    out = tmp_path / "out"
    killed_after(0.7, tmp_path, out)
    # As if it was killed while it wrote recording.toml; no such process is running.
    from jaxmocap.formats.files import writing

    hidden = writing.temporary_beside(out / "recording.toml").name
    (out / hidden.replace(f"-{os.getpid()}-", "-999999999-")).write_text("half of")
    rescued = {name: data for name, data in contents(out).items() if not name.startswith(".")}
    message = complaint(LiveRecording, live_setup(tmp_path), out)
    assert "markers.csv" in message and str(out) in message and "another folder" in message
    assert contents(out) == rescued


@pytest.mark.parametrize("name", ["markers.csv", "recording.toml", "cam.mp4", "calibration.toml"])
def test_no_file_of_the_folder_is_overwritten(tmp_path, name):
    setup, out = live_setup(tmp_path), tmp_path / "out"
    out.mkdir()
    (out / name).write_text("mine")
    for refuses in (lambda: check_free(setup, out), lambda: LiveRecording(setup, out)):
        with pytest.raises(InputError, match=name):
            refuses()
    assert contents(out) == {name: b"mine"}


def test_other_files_of_the_folder_stay(tmp_path):
    setup, out = live_setup(tmp_path), tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    recording = LiveRecording(setup, out)
    assert recording.close() is None
    assert contents(out) == {"notes.txt": b"mine"}


# Full disks --------------------------------------------------------------------------------------


def test_on_a_full_disk_what_was_written_is_a_complete_recording_and_one_sentence_says_so(tmp_path):
    setup, out = live_setup(tmp_path), tmp_path / "out"
    recording = LiveRecording(setup, out)
    with disk_full_at(60_000):
        record(recording, 8.0, noisy=True)
        path = recording.close()
    problem = str(recording.problem)
    assert problem.count("cannot be written any more") == 1 and "File too large" in problem
    assert str(out) in problem and "cam.mp4" in problem and "markers.csv" in problem
    assert "\n" not in problem and recording.dropped > 0
    again = Recording.load(str(path))
    text = (out / "markers.csv").read_bytes()
    # Just what fits, and no torn line.
    assert 60_000 - 400 < len(text) <= 60_000 and text.endswith(b"\n")
    assert len(again.times) == text.count(b"\n") - 1
    frames = [image for _, image in open_video(again.videos[0]).frames()]
    assert frames and all(image is not None for image in frames)
    assert not [name for name in contents(out) if name.startswith(".")]


def test_a_disk_that_is_full_for_the_video_leaves_the_markers_going_on(tmp_path):
    recording = LiveRecording(live_setup(tmp_path), tmp_path / "out")
    with disk_full_at(9_000):
        record(recording, 1.0, noisy=True)
        again = Recording.load(str(recording.close()))
    assert "cam.mp4" in str(recording.problem)
    assert again.videos == () and not (tmp_path / "out" / "cam.mp4").exists()


def test_a_disk_that_is_full_before_it_begins_is_reported_at_once(tmp_path):
    with disk_full_at(10), pytest.raises(OutputError, match="cannot be written"):
        LiveRecording(live_setup(tmp_path), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_disk_on_which_no_line_fits_leaves_nothing_that_looks_like_a_recording(tmp_path):
    recording = LiveRecording(live_setup(tmp_path), tmp_path / "out")
    recording._lines._file.write(b"x" * 4000)
    recording._lines._file.mark_complete()
    with disk_full_at(4000):
        recording.add(sample(0.0))
        assert recording.close() is None
    assert "markers.csv" in str(recording.problem) and not (tmp_path / "out").exists()


def test_lines_that_fit_stay_where_the_others_do_not(tmp_path):
    rows = LineFile(tmp_path / "rows.csv", "a,b")
    for i in range(100):
        rows.add(f"{i:03d},{i:03d}")
    with disk_full_at(4 + 8 * 50 + 3), pytest.raises(OSError, match="large"):
        rows.flush()
    rows.close()
    lines = (tmp_path / "rows.csv").read_text().splitlines()
    assert (
        lines[0] == "a,b"
        and lines[-1] == "049,049"
        and (rows.line_count, rows.lost_count) == (50, 50)
    )


# What is there -----------------------------------------------------------------------------------


def test_a_recording_can_be_read_while_it_grows(tmp_path):
    recording = LiveRecording(live_setup(tmp_path), tmp_path / "out")
    record(recording, 1.0)
    end = time.monotonic() + 10
    while (recording._written_state or ())[:2] != (True, [0]):
        assert time.monotonic() < end
        time.sleep(0.01)
    again = Recording.load(tmp_path / "out" / "recording.toml")
    assert len(again.times) > 20 and len(open_video(again.videos[0])) > 10
    recording.close()
    assert len(Recording.load(tmp_path / "out" / "recording.toml").times) == 90


def test_of_a_run_without_markers_the_video_stays(tmp_path):
    recording = LiveRecording(live_setup(tmp_path), tmp_path / "out")
    for i in range(30):
        recording.add(frame(i / 30))
    again = Recording.load(str(recording.close()))
    assert again.places == () and len(open_video(again.videos[0])) == 30
    assert set(contents(tmp_path / "out")) == {"recording.toml", "cam.mp4", "calibration.toml"}


def test_a_recording_holds_all_that_it_needs_wherever_it_is_moved(tmp_path):
    setup = live_setup(tmp_path)
    static = tmp_path / "trials" / "static.trc"
    static.parent.mkdir()
    points = {name: np.repeat(at[None], 3, 0) for name, at in zip(PLACES, standing(), strict=True)}
    write_trc(static, np.arange(3) / 60, points)
    (tmp_path / "trials" / "subject.toml").write_text(f"height = {HEIGHT}\nmass = 61.0\n")
    of_file = replace(setup, subject={"file": "trials/subject.toml", "wrists": True})
    of_trial = replace(setup, subject={"static": "trials/static.trc", "landmarks": {}})
    for name, each in (("file", of_file), ("trial", of_trial)):
        recording = LiveRecording(each, tmp_path / name / "out")
        record(recording, 0.3)
        recording.close()
        shutil.move(tmp_path / name / "out", tmp_path / f"moved {name}")
    again = Recording.load(tmp_path / "moved file" / "recording.toml")
    assert float(again.skeleton.masses.sum()) == pytest.approx(61.0, rel=1e-4)
    assert "wrist_flex_l" in again.skeleton.tree.joints or len(again.skeleton.tree.joints) > 21
    assert (tmp_path / "moved trial" / "static.trc").read_bytes() == static.read_bytes()


def test_a_frame_that_cannot_be_encoded_ends_its_video_alone(tmp_path):
    recording = LiveRecording(live_setup(tmp_path), tmp_path / "out")
    recording.add(LiveFrame(0, 0.0, np.zeros((1, 1, 3), np.uint8), 0.0))
    for i in range(30):
        recording.add(sample(i / 90))
    again = Recording.load(str(recording.close()))
    assert "cam.mp4" in str(recording.problem) and len(again.times) == 30 and not again.videos


@pytest.mark.parametrize("name", ["x/../../../EVIL", "..", "a\0b", "c" * 320, "con", "a\nb"])
def test_a_camera_whose_name_is_no_files_is_refused_before_anything_is_opened(tmp_path, name):
    from jaxmocap.formats.files.toml import toml_value

    live_setup(tmp_path)
    path = tmp_path / "live.toml"
    named = f"camera = {toml_value(name)}"
    path.write_text(path.read_text().replace('camera = "cam"', named))
    calibration = tmp_path / "calibration.toml"
    calibration.write_text(calibration.read_text().replace("[cam]", f"[{toml_value(name)}]"))
    complaint(load_live, path)
