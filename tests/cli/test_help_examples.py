"""The example in each command's --help runs: short ones here, long ones by name."""

import glob
import json
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from drawn_boards import BOARD, LENS, draw, write_views
from held_devices import DEVICES, pivoting
from small_recording import OUTPUTS, SAMPLES, write_small_recording

from jaxmocap.calibration.extrinsics import board_to_world
from jaxmocap.cli.command import name_of
from jaxmocap.cli.program import COMMANDS, GROUPS, main
from jaxmocap.formats.recordings.keypoint_models import LANDMARK_OF, MODELS
from jaxmocap.formats.recordings.recording import Recording, write_recording
from jaxmocap.formats.time_series.csv import write_csv
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.formats.time_series.trc import read_trc, write_trc
from jaxmocap.geometry.cameras import project
from jaxmocap.pipelines import view
from jaxmocap.pipelines.keypoints.mediapipe_process import NUMBERS
from jaxmocap.synthetic.drawing_camera import look_at
from jaxmocap.synthetic.people.rigged_mesh import load_rig
from jaxmocap.synthetic.photographs import write_photographs
from jaxmocap.synthetic.recording import write_table_tennis

EXAMPLES = {name_of(command): command.EXAMPLE for command in COMMANDS} | {
    f"{group} {name_of(kind)}": kind.EXAMPLE
    for group, kinds in GROUPS.items()
    for kind in kinds.COMMANDS
}
# After ``track``, in turn and in its folder; and the exit code of each: 24 samples determine no
# video's offset.
SHORT = {
    "help": 0,
    "check": 0,
    "evaluate": 0,
    "view": 0,
    "convert": 0,
    "scale": 0,
    "retarget": 0,
    "sync": 1,
    "offsets": 0,
    "calibrate intrinsics": 0,
    "calibrate extrinsics": 0,
}
LONG = {"demo", "plan", "warmup", "batch", "live", "silhouette demo", "silhouette track"}
LONG |= {"silhouette model", "video"}
# Stands in for MediaPipe: where the truth's joints are, frame by frame, as shares of the image.
DETECTOR = """
import json, pathlib
FRAMES = iter(json.loads((pathlib.Path(__file__).parent / "frames.json").read_text()))
class Mark:
    def __init__(self, x, y): self.x, self.y, self.visibility = x, y, 1.0
class Pose:
    def __init__(self, model_complexity): pass
    def process(self, image):
        marks = type("Marks", (), {"landmark": [Mark(*at) for at in next(FRAMES)]})
        return type("Result", (), {"pose_landmarks": marks})
class solutions:
    class pose:
        Pose = Pose
"""
LIVE = "[osc]\nlisten = 39571\n[subject]\nheight = 1.75\n[markers.on]\nHead = { bone = 'head' }\n"
# Their examples need what no test has.
EXCEPTED = {"keypoints": "MediaPipe needs an environment of its own and an older NumPy"}


def test_every_example_is_run_or_excepted():
    assert set(EXAMPLES) == {"track", *SHORT, *LONG, *EXCEPTED}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """What the short examples read."""
    folder = tmp_path_factory.mktemp("examples")
    write_small_recording(folder)
    times = np.arange(20 * 90) / 90
    write_csv(folder / "turning.csv", times, *pivoting(times, 6))
    on = {name: {"bone": device.bone, "at": 0.0} for name, device in DEVICES.items()}
    (folder / "turning").mkdir()
    text = write_recording(folder / "turning", "../turning.csv", on).read_text()
    (folder / "turning.toml").write_text(text.replace("../turning.csv", "turning.csv"))
    for i, path in enumerate(write_views(folder)):
        cv2.imwrite(str(folder / f"board{i}.jpg"), cv2.imread(path))
    (focal, _, _), *_ = LENS.matrix
    camera = look_at((1.0, 0.9, 0.8), (0.4, 1.35, 0.0), size=(640, 480), focal=focal, distortion=())
    T_cam_board = np.asarray(camera.T_cam_world) @ board_to_world((0.5, 1.2, 0.0, 0.0, 0.0, 90.0))
    cv2.imwrite(str(folder / "floor.jpg"), draw(BOARD, T_cam_board))
    return folder


def arguments(name: str) -> list[str]:
    """Of a command's example, the names of files as a shell would list them."""
    program, *words = shlex.split(EXAMPLES[name])
    assert program == "jaxmocap"
    return [each for word in words for each in (sorted(glob.glob(word)) or [word])]


@pytest.fixture(scope="module")
def tracked(folder):
    """What the example of ``track`` left, and printed on stdout and stderr."""
    with pytest.MonkeyPatch.context() as patch:
        printed, stderr = (folder / "stdout").open("w"), (folder / "stderr").open("w")
        patch.chdir(folder)
        patch.setattr(sys, "stdout", printed)
        patch.setattr(sys, "stderr", stderr)
        code = main([*arguments("track"), "--json", "-"])
        printed.close()
        stderr.close()
    assert code == 0
    return folder / "tracked", (folder / "stdout").read_text(), (folder / "stderr").read_text()


@pytest.mark.parametrize("name", SHORT)
def test_a_short_example_runs_and_its_figures_are_json(name, folder, tracked, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    monkeypatch.setattr(view, "has_display", lambda: False)
    if name == "evaluate" and not Path("truth.trc").exists():
        joints = read_trc(Path("tracked/joints.trc"))
        named = {"LElbow": joints.names.index("elbow_l"), "RElbow": joints.names.index("elbow_r")}
        positions = {new: joints.positions[:, at] for new, at in named.items()}
        write_trc(Path("truth.trc"), joints.times, positions)
    json_option = [] if name == "help" else ["--json", "-"]
    assert main([*arguments(name), *json_option]) == SHORT[name]
    printed = capsys.readouterr().out
    if json_option:
        assert json.loads(printed, parse_constant=pytest.fail)


# What they leave ---------------------------------------------------------------------------------


def test_track_writes_every_file_and_leaves_nothing_half_written(tracked):
    out, _, _ = tracked
    assert {path.name for path in out.iterdir()} == OUTPUTS


def test_track_prints_figures_as_json_and_the_summary_beside_them(tracked):
    _, printed, stderr = tracked
    figures = json.loads(printed, parse_constant=pytest.fail)
    assert figures["frames"] == SAMPLES and figures["frames_per_second"] > 0
    assert figures["settings"]["recording"].endswith("recording.toml")
    for text in ("tracking", "video frames: first pass", str(Path("tracked", "joints.trc"))):
        assert text in stderr


def test_evaluate_compares_with_a_reference_by_time_stamp(tracked, capsys, tmp_path):
    out, _, _ = tracked
    truth, file = str(out.parent / "markers.trc"), tmp_path / "errors.json"
    wrists = ["--match", "wrist_l=LWrist", "wrist_r=RWrist"]
    assert main(["evaluate", str(out), truth, *wrists, "--json", str(file)]) == 0
    assert "wrist_l" in capsys.readouterr().out
    figures = json.loads(file.read_text())
    assert figures["joints"]["wrist_r"]["samples"] == SAMPLES
    assert figures["mean_over_joints"]["mean_m"] < 0.02
    assert main(["evaluate", str(out), truth, *wrists, "--up", "y", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["mean_over_joints"]["mean_m"] > 0.5


def test_evaluate_says_so_where_the_references_other_axis_upwards_fits(tracked, capsys, tmp_path):
    out, _, _ = tracked
    truth, wrists = out.parent / "markers.trc", ["--match", "wrist_l=LWrist", "wrist_r=RWrist"]
    upright = read_markers(truth)
    y_up = {name: points[:, [1, 2, 0]] for name, points in upright.points().items()}
    write_trc(tmp_path / "y.trc", upright.times, y_up)
    for reference, warns in ((truth, False), (tmp_path / "y.trc", True)):
        assert main(["evaluate", str(out), str(reference), *wrists]) == 0
        assert ("warning  with --up y the mean is" in capsys.readouterr().out) == warns


def test_view_says_how_to_open_the_recording_where_there_is_no_display(
    tracked, capsys, monkeypatch
):
    monkeypatch.setattr(view, "has_display", lambda: False)
    assert main(["view", str(tracked[0])]) == 0
    assert capsys.readouterr().out.splitlines() == [
        str(tracked[0] / "recording.rrd"),
        f"no display here; in a browser: jaxmocap view {tracked[0]} --web",
    ]


def test_view_opens_the_viewer_where_there_is_a_display(tracked, capsys, monkeypatch):
    started = []
    monkeypatch.setattr(view, "has_display", lambda: True)
    monkeypatch.setattr(view.subprocess, "Popen", lambda line, **_: started.append(line))
    assert main(["view", str(tracked[0])]) == 0
    assert "rerun" in started[0][0] and started[0][1:3] == ["--bind", "127.0.0.1"]
    assert started[0][-1] == str(tracked[0] / "recording.rrd")
    assert "opened" in capsys.readouterr().out


def test_an_unknown_joint_or_marker_is_refused_with_a_list(tracked, refusal):
    out, _, _ = tracked
    given = ["evaluate", out, out.parent / "markers.trc", "--match"]
    assert "no joint 'elbow', expected one of" in refusal(*given, "elbow=LWrist")
    assert "no marker 'Elbow', expected one of Head, LWrist" in refusal(*given, "elbow_l=Elbow")


# Long ones ---------------------------------------------------------------------------------------


def run(name: str, folder: Path, *more: str) -> None:
    """Run an example in a process of its own; it ends with 0."""
    command = [sys.executable, "-m", "jaxmocap.cli", *arguments(name), *more]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", ["demo", "plan", "silhouette demo"])
def test_an_example_that_needs_nothing_runs(name, tmp_path):
    run(name, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["warmup", "batch"])
def test_an_example_with_recordings_runs(name, tmp_path):
    write_table_tennis(tmp_path, seconds=1.0)
    write_table_tennis(tmp_path / "recordings", seconds=1.0)
    run(name, tmp_path)


@pytest.fixture
def squatting(tmp_path) -> Path:
    """The recording of the silhouettes' demo: its person squats about the origin."""
    given = ["silhouette", "demo", "--out", "demo", "--seconds", "0.4"]
    subprocess.run([sys.executable, "-m", "jaxmocap.cli", *given], cwd=tmp_path, check=True)
    return tmp_path / "demo" / "recording"


@pytest.mark.slow
def test_the_example_of_silhouette_track_runs(squatting, tmp_path):
    for path in squatting.iterdir():
        path.rename(tmp_path / path.name)
    run("silhouette track", tmp_path)
    report = json.loads((tmp_path / "tracked" / "report.json").read_text())
    assert report["warnings"] == [] and "left out" not in report


@pytest.mark.slow
def test_the_example_of_video_runs(squatting, tmp_path):
    """One camera of the recording; MediaPipe's place is taken."""
    (squatting / "cam_1.mp4").rename(tmp_path / "clip.mp4")
    camera = Recording.load(squatting / "recording.toml").videos[0].camera
    points = read_trc(squatting / "truth.trc").points()
    rows = {
        number: LANDMARK_OF.get(name)
        for number, name in zip(NUMBERS, MODELS["COCO_17"], strict=True)
    }
    size, frames = np.asarray(camera.size), []
    for frame in range(len(points["hip_l"])):
        places = [points[rows.get(n) or "head"][frame] for n in range(33)]
        pixels = np.asarray(project(camera, np.array(places, np.float32)))
        frames.append(((pixels + 0.5) / size).tolist())
    (tmp_path / "stand_in").mkdir()
    (tmp_path / "stand_in" / "mediapipe.py").write_text(DETECTOR)
    (tmp_path / "stand_in" / "frames.json").write_text(json.dumps(frames))
    python = tmp_path / "mp" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(f'#!/bin/sh\nPYTHONPATH={tmp_path}/stand_in exec {sys.executable} "$@"\n')
    python.chmod(0o755)
    run("video", tmp_path)
    report = json.loads((tmp_path / "tracked" / "report.json").read_text())
    assert len(report["warnings"]) == 2 and "--fov" in report["warnings"][0]
    made = tmp_path / "tracked" / "recording"
    assert {path.name for path in made.iterdir()} >= {"recording.toml", "calibration.toml"}
    assert (tmp_path / "tracked" / "overlay_camera.mp4").is_file()


@pytest.mark.slow
def test_the_example_of_silhouette_model_runs(recordings, tmp_path):
    write_photographs(tmp_path, load_rig(recordings / "person" / "person.npz", "slim_woman"))
    run("silhouette model", tmp_path)


@pytest.mark.slow
def test_the_example_of_live_without_any_marker_ends_with_1(tmp_path):
    (tmp_path / "live.toml").write_text(LIVE)
    command = [sys.executable, "-m", "jaxmocap.cli", *arguments("live")]
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    lines = []
    while not (lines and "listening" in lines[-1]):
        lines.append(process.stderr.readline())
        assert lines[-1], lines
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    rest = process.communicate(timeout=120)[1]
    assert process.returncode == 1 and "no marker came in" in rest.splitlines()[-1]
    assert not (tmp_path / "session").exists()
