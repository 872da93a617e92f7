"""The commands: what they write and print, and how they refuse bad input."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import disk_full_at
from small_recording import OUTPUTS, SAMPLES, write_small_recording

from jaxmocap.cli import enter
from jaxmocap.cli import program as cli
from jaxmocap.cli.command import name_of
from jaxmocap.cli.program import COMMANDS, GROUPS, main
from jaxmocap.formats.files.errors import InputError, OutputError
from jaxmocap.formats.files.output_folder import OutputFolder
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.pipelines import view
from jaxmocap.pipelines.demo import standing_recording
from jaxmocap.pipelines.kept_programs import cache_folder
from jaxmocap.pipelines.signals import Terminated


@pytest.fixture
def folder(tmp_path) -> Path:
    """A small recording's files, and earlier output in ``out``."""
    write_small_recording(tmp_path)
    with OutputFolder(tmp_path / "out", "motion").writing() as stage:
        (stage / "joints.trc").write_text("earlier")
    return tmp_path


# What they do ------------------------------------------------------------------------------------


def test_track_names_markers_that_are_exchanged(folder, tmp_path):
    markers, figures = folder / "markers.trc", tmp_path / "figures.json"
    text = markers.read_text().replace("Head", "Other").replace("LWrist", "Head")
    markers.write_text(text.replace("Other", "LWrist"))
    # By the default settings, whose programs many tests of this recording ask for.
    given = [str(folder / "recording.toml"), "--out", str(tmp_path / "tracked")]
    assert main(["track", *given, "--json", str(figures)]) == 0
    says = "[markers.on] Head and LWrist: LWrist is above"
    assert any(says in warning for warning in json.loads(figures.read_text())["warnings"])


def test_a_display_is_what_the_environment_names(monkeypatch):
    monkeypatch.setattr(view.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert not view.has_display()
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert view.has_display()


def test_the_demo_shows_that_video_helps(tmp_path, capsys):
    out = tmp_path / "demo"
    assert main(["demo", "--out", str(out), "--seconds", "0.5", "--json", "-"]) == 0
    printed = capsys.readouterr()
    figures = json.loads(printed.out)
    assert figures["markers_only"]["joints"]["elbow_r"]["samples"] == 45
    before, after = (
        figures[k]["mean_over_joints"]["mean_m"] for k in ("markers_only", "with_video")
    )
    assert 0 < after < before and figures["improvement_share"] == pytest.approx(1 - after / before)
    assert "before  improved" in printed.err and "frames per second" in printed.err
    own = {"overlay_webcam.mp4", "elbow_errors.png", "recording"}
    assert {p.name for p in out.iterdir()} == OUTPUTS - {"overlay_cam.mp4"} | own
    # Its tracker, compiled ahead, has the body that the recording states.
    stated = Recording.load(out / "recording" / "recording.toml").skeleton
    np.testing.assert_array_equal(stated.lengths, standing_recording(1).skeleton.lengths)


def test_a_command_keeps_the_compilers_log_to_itself(monkeypatch):
    monkeypatch.setenv("TF_CPP_MIN_LOG_LEVEL", "")
    monkeypatch.delenv("TF_CPP_MIN_LOG_LEVEL")
    monkeypatch.setattr(sys, "argv", ["jaxmocap", "--version"])
    with pytest.raises(SystemExit):
        enter()
    assert os.environ["TF_CPP_MIN_LOG_LEVEL"] == "3"


def test_compiled_programs_are_kept_where_the_environment_says(monkeypatch, tmp_path):
    assert any((cache_folder()).iterdir())
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "jaxmocap"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert cache_folder() == Path.home() / ".cache" / "jaxmocap"


@pytest.mark.parametrize(
    ("words", "example"),
    [
        *(([name_of(each)], each.EXAMPLE) for each in COMMANDS),
        *(([name, name_of(k)], k.EXAMPLE) for name, of in GROUPS.items() for k in of.COMMANDS),
    ],
)
def test_every_command_helps_with_an_example(words, example, capsys):
    with pytest.raises(SystemExit) as done:
        main([*words, "--help"])
    assert done.value.code == 0
    assert f"example: {example}" in capsys.readouterr().out


def test_help_keeps_the_capitals_of_a_purpose(capsys):
    with pytest.raises(SystemExit):
        main(["keypoints", "--help"])
    assert "\nFind 2-D key points" in capsys.readouterr().out


# Bad input ---------------------------------------------------------------------------------------


@pytest.fixture
def untracked(folder, refusal):
    """Track what is wrong: refused, with earlier output as it was."""

    def refused() -> str:
        message = refusal("track", folder / "recording.toml", "--out", folder / "out")
        assert message.startswith("jaxmocap track: ")
        assert {path.name for path in (folder / "out").iterdir()} == {"joints.trc", "outputs.json"}
        assert (folder / "out" / "joints.trc").read_text() == "earlier"
        return message

    return refused


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


@pytest.mark.parametrize("name", ["recording.toml", "markers.trc", "cam.mp4", "calibration.toml"])
def test_a_missing_file_is_named(folder, untracked, name):
    (folder / name).unlink()
    message = untracked()
    assert "no such file" in message and str(folder / name) in message


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda content: b"", "the file is empty"),
        (lambda content: content[: len(content) // 2], "line 1"),
        (lambda content: content.replace(b"0.1000", b"0.0000", 1), "line 13: time runs backwards"),
    ],
    ids=["empty", "truncated", "backwards"],
)
def test_a_damaged_marker_file_is_named_with_its_line(folder, untracked, damage, says):
    path = folder / "markers.trc"
    path.write_bytes(damage(path.read_bytes()))
    message = untracked()
    assert str(path) in message and says in message


def test_nan_everywhere_is_refused(folder, untracked):
    times, names = np.arange(SAMPLES) / 60, ("Head", "LWrist", "RWrist", "LAnkle", "RAnkle")
    nothing = np.full((SAMPLES, 3), np.nan)
    write_trc(folder / "markers.trc", times, {name: nothing for name in names})
    message = untracked()
    assert str(folder / "recording.toml") in message and "all positions are NaN" in message


@pytest.mark.parametrize(
    ("file", "old", "new", "says"),
    [
        ("recording.toml", "Head =", "Nose =", "[markers.on] Nose: no such marker"),
        ("recording.toml", '"tibia_l"', '"shank"', "[markers.on] LAnkle: unknown bone 'shank'"),
        ("calibration.toml", "[cam]", "[other]", "section [cam] is missing, found other"),
        ("calibration.toml", "rotation = [", "rotation = [7.0, ", "[cam] rotation: found ["),
        ("calibration.toml", "size = [96.0", "size = [99.0", "the video is 96 × 72"),
        ("recording.toml", "offset = 0.004", "offset = 100.0", "no overlap: the video lasts from"),
    ],
)
def test_a_field_that_does_not_fit_is_named_with_its_file(folder, untracked, file, old, new, says):
    edit(folder / file, old, new)
    message = untracked()
    video = says.startswith(("the video", "no overlap"))
    assert says in message and str(folder / ("cam.mp4" if video else file)) in message


def test_an_output_that_is_a_file_is_refused_before_tracking(folder, refusal):
    given = ["track", folder / "recording.toml", "--out", folder / "cam.mp4" / "x"]
    assert "cam.mp4 is a file" in refusal(*given)


@pytest.mark.parametrize(
    ("work", "words"),
    [
        ("pipelines.tracking.track.track_both", "track recording.toml --out new"),
        (
            "calibration.calibrate.find_boards",
            "calibrate intrinsics cam.mp4 --board 4x7 --square 1 --camera a --out calibration.toml",
        ),
        (
            "pipelines.keypoints.detect.detect_keypoints",
            f"keypoints --write --detector mediapipe --python {sys.executable} recording.toml",
        ),
    ],
)
def test_a_full_disk_is_noticed_before_any_work(folder, capsys, monkeypatch, work, words):
    monkeypatch.setattr(f"jaxmocap.{work}", lambda *_, **__: pytest.fail("it has begun"))
    monkeypatch.chdir(folder)
    before = sorted(folder.rglob("*"))
    with disk_full_at(1000):
        assert main(words.split()) == 1
    assert f" {words.split()[-1]}: cannot be written (" in capsys.readouterr().err
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["track", "r.toml"], "jaxmocap track: the following arguments are required: --out"),
        (["track", "r.toml", "--out", "o", "--causal", "--nearest"], "not allowed with"),
        (["track", "r.toml", "--out", "o", "--refine", "magic"], "invalid choice: 'magic'"),
        (["evaluate", "d", "t", "--match", "elbow_l=A", "elbow_l=B"], "found elbow_l twice"),
        (["evaluate", "d", "t", "--match", "elbow_l"], "found 'elbow_l', expected JOINT=MARKER"),
        (["demo", "--seconds", "-1"], "found '-1', expected a positive number"),
        (["demo", "--seconds", "1e9"], "--seconds: found 1e+09, expected 0.1 to 3600"),
        (["demo", "--seconds", "0.001"], "--seconds: found 0.001, expected 0.1 to 3600"),
        (["sync", "r.toml", "--search", "1e9"], "--search: found 1e+09, expected at most 60 "),
        (["keypoints", "r.toml", "--detector", "d", "--detector-timeout", "nan"], "found 'nan'"),
        (["scale", "--height", "5'9", "--out", "o"], 'found "5\'9", expected a positive number'),
        (["evaluate", "d", "t", "--offset", "1,5"], "found '1,5', expected a finite number"),
        (["fly"], "invalid choice: 'fly'"),
        ([], "required: COMMAND"),
        (["check", "a\0b.toml"], "holds a NUL"),
        # Folders that track did not write.
        (["evaluate", "nowhere", "t.trc", "--match", "elbow_l=LElbow"], "nowhere"),
        (["evaluate", "nowhere", "t.trc", "--match", "elbow_l=LElbow"], "no such file"),
        (["view", "nowhere"], "view: nowhere"),
        (["view", "nowhere"], "no such file, expected a folder that 'jaxmocap track' wrote"),
    ],
)
def test_wrong_arguments_are_one_line_too(arguments, says, refusal):
    assert says in refusal(*arguments)


# How they end -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("raised", "code", "says"),
    [
        (InputError("a.trc", "is bad"), 2, "jaxmocap check: a.trc: is bad"),
        (OutputError("a.trc", "cannot be"), 1, "jaxmocap check: a.trc: cannot be"),
        (OSError(28, "No space left on device"), 1, "the system: No space left on device"),
        (OSError(5, "Input/output error", "x.mp4"), 1, "x.mp4: Input/output error"),
        (MemoryError(), 1, "there is not enough memory for it"),
        (KeyboardInterrupt(), 130, "jaxmocap check: interrupted"),
        (Terminated(), 143, "jaxmocap check: terminated"),
        (InputError("a\n\x1b[2J.trc", "found \u202e"), 2, r"a\n\x1b[2J.trc: found \u202e"),
        (InputError("a.trc", "x" * 10_000), 2, "xxx...xxx"),
    ],
)
def test_whatever_ends_a_command_is_one_clean_line(raised, code, says, monkeypatch, capsys):
    def fail(options):
        raise raised

    monkeypatch.setattr(cli, "check_report", fail)
    assert main(["check", "recording.toml"]) == code
    stderr = capsys.readouterr().err
    assert says in stderr and stderr.count("\n") == 1
    assert stderr[:-1].isprintable() and len(stderr) < 600


def test_a_fault_of_ours_is_not_hidden(monkeypatch):
    def fail(options):
        raise ZeroDivisionError

    monkeypatch.setattr(cli, "check_report", fail)
    with pytest.raises(ZeroDivisionError):
        main(["check", "recording.toml"])


def test_figures_never_replace_what_is_read(folder, refusal):
    for name in ("recording.toml", "markers.trc", "cam.mp4"):
        before = (folder / name).read_bytes()
        given = ["check", folder / "recording.toml", "--json", folder / name]
        assert "would be replaced while it is read" in refusal(*given)
        assert (folder / name).read_bytes() == before


def test_figures_never_replace_an_output(folder, refusal):
    (folder / "o").mkdir()
    target = folder / "m.csv"
    convert = ["convert", str(folder / "markers.trc"), str(target), "--json"]
    for asked in (
        ["track", folder / "recording.toml", "--out", folder / "o"],
        ["batch", folder, "--out", folder / "o"],
    ):
        for name in ("joints.trc", "outputs.json", "report.json", "deep/report.json", "."):
            refusal(*asked, "--json", folder / "o" / name)
            assert not list((folder / "o").iterdir())
    refusal(*convert, target)
    assert not target.exists()
    with OutputFolder(folder / "o", "points").writing() as stage:
        (stage / "cam.json").write_text("{}")
    listed = f"is in the list {folder / 'o' / 'outputs.json'}"
    assert listed in refusal(*convert, folder / "o" / "cam.json")
    assert (folder / "o" / "cam.json").read_text() == "{}"
    assert main([*convert, str(folder / "o" / "my.json")]) == 0


def test_a_recording_is_not_taken_for_the_body_that_scale_replaces(folder, refusal):
    before = (folder / "recording.toml").read_bytes()
    given = ["scale", "--height", "1.8", "--out"]
    for name in ("recording.toml", "calibration.toml"):
        assert "is no body that 'jaxmocap scale' writes" in refusal(*given, folder / name)
    assert (folder / "recording.toml").read_bytes() == before
    for _ in range(2):
        assert main([*given, str(folder / "subject.toml")]) == 0


def test_a_file_is_not_converted_into_itself(folder, refusal):
    before = (folder / "markers.trc").read_bytes()
    (folder / "link.trc").symlink_to(folder / "markers.trc")
    for target in ("markers.trc", "link.trc"):
        message = refusal("convert", folder / "markers.trc", folder / target)
        assert "would be replaced while it is read" in message
    assert (folder / "markers.trc").read_bytes() == before


def test_a_reader_that_has_gone_is_no_traceback(folder):
    command = [sys.executable, "-m", "jaxmocap.cli", "check", str(folder / "recording.toml")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    process.stdout.close()
    stderr = process.stderr.read()
    assert process.wait(60) == 1
    assert stderr == "jaxmocap check: the system: Broken pipe\n"


TERMINATED_WHILE = """
import os, signal, sys
from jaxmocap.pipelines.tracking import track as recording
def track(*_, **__):
    os.kill(os.getpid(), signal.SIGTERM)
    raise AssertionError("went on")
recording.track_both = track
from jaxmocap.cli.program import main
sys.exit(main(sys.argv[1:]))
"""


def test_sigterm_is_one_sentence_143_and_outputs_as_they_were(folder):
    command = ["track", str(folder / "recording.toml"), "--out", str(folder / "out")]
    run = [sys.executable, "-c", TERMINATED_WHILE, *command]
    done = subprocess.run(run, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (143, "jaxmocap track: terminated\n")
    assert (folder / "out" / "joints.trc").read_text() == "earlier"
    assert not [path for path in (folder / "out").iterdir() if path.name.startswith(".")]


def test_ctrl_c_while_commands_are_imported_is_one_line():
    code = (
        "import signal, sys\n"
        "class Member:\n"
        "    def __set_name__(self, *others):\n"
        "        signal.raise_signal(signal.SIGINT)\n"
        "class Interrupting:\n"
        "    def find_spec(self, name, *others):\n"
        "        if name == 'jaxmocap.cli.setup':\n"
        "            type('Class', (), {'member': Member()})\n"
        "sys.meta_path.insert(0, Interrupting())\n"
        "from jaxmocap.cli import enter\n"
        "enter()\n"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (130, "jaxmocap: interrupted\n")


def test_check_refuses_a_low_pass_that_the_markers_rate_cannot_hold(tmp_path, capsys):
    """As ``track`` does."""
    recording = write_small_recording(tmp_path)
    recording.write_text(recording.read_text() + "\n[markers.filters]\nbutterworth = 6000.0\n")
    assert main(["check", str(recording)]) == 2
    assert "butterworth: found 6000 Hz, expected less than" in capsys.readouterr().err
