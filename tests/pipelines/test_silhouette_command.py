"""``silhouette track`` and ``silhouette demo``: bad input is one clear sentence and exit code 2."""

from pathlib import Path

import numpy as np
import pytest
from test_point_rays import ring

from jaxmocap.body.skeleton import with_joints
from jaxmocap.cli.program import main
from jaxmocap.formats.cameras.calibration import write_calibration
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.recording import Recording, write_recording
from jaxmocap.formats.time_series.trc import read_trc
from jaxmocap.pipelines.silhouettes import demo, track
from jaxmocap.silhouette.first_pose import standing_pose_at
from jaxmocap.silhouette.settings import Settings
from jaxmocap.synthetic.recording import write_video

VIDEOS = [{"file": f"{name}.mp4", "camera": name} for name in ("left", "right")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """An empty room, seen by two cameras for three frames."""
    made = tmp_path_factory.mktemp("empty")
    for video in VIDEOS:
        write_video(made / video["file"], [np.full((480, 640, 3), 120, np.uint8)] * 3)
    cameras = {str(video["camera"]): camera for video, camera in zip(VIDEOS, ring(2), strict=True)}
    write_calibration(made / "calibration.toml", cameras)
    write_recording(made, None, {}, VIDEOS, "calibration.toml", {"height": 1.75})
    (made / "noise.mp4").write_bytes(bytes(range(256)) * 20)
    (made / "people.npz").write_text("no people")
    np.savez(made / "other.npz", vertices=np.zeros(3))
    return made


def changed(folder, old: str, new: str):
    """The recording's file with something else in it."""
    text = (folder / "recording.toml").read_text()
    assert old in text
    path = folder / "changed.toml"
    path.write_text(text.replace(old, new))
    return path


def message_of(capsys, *arguments: str) -> str:
    """The one sentence on stderr of a command that must end with 2."""
    try:
        code = main(["silhouette", *map(str, arguments)])
    except SystemExit as left:
        code = left.code
    error = capsys.readouterr().err
    assert code == 2 and "Traceback" not in error
    return error.splitlines()[-1]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("right.mp4", "noise.mp4", "noise.mp4: is not a video"),
        ("right.mp4", "gone.mp4", "no such file"),
        ('camera = "right"', 'camera = "behind"', "[behind] is missing, found left, right"),
        ("[[video]]", "[[vide]]", "'vide'"),
    ],
)
def test_a_recording_whose_videos_do_not_fit_is_refused(
    folder, tmp_path, capsys, old, new, expected
):
    path = changed(folder, old, new)
    assert expected in message_of(capsys, "track", path, "--out", tmp_path, "--at", "0,0,0")


def test_a_recording_without_markers_and_video_is_none(folder, tmp_path, capsys):
    path = folder / "none.toml"
    path.write_text("[subject]\nheight = 1.75\n")
    sentence = message_of(capsys, "track", path, "--out", tmp_path, "--at", "0,0,0")
    assert "none.toml: neither [markers] nor [[video]]" in sentence


def test_a_camera_that_the_recording_does_not_have_is_named_with_those_that_it_has(
    folder, tmp_path, capsys
):
    given = [folder / "recording.toml", "--out", tmp_path, "--cameras", "left,top"]
    assert "no [[video]] of camera 'top', found left, right" in message_of(capsys, "track", *given)


@pytest.mark.parametrize("at", ["here", "1,2", "1,2,nan", "1,inf,0", "1,2,3,4", ""])
def test_a_place_that_is_none_is_refused(folder, tmp_path, capsys, at):
    given = [folder / "recording.toml", "--out", tmp_path, f"--at={at}"]
    assert f"--at: found {at!r}, expected X,Y,FACING" in message_of(capsys, "track", *given)


def test_lengths_are_found_by_more_than_one_pass(folder, tmp_path, capsys):
    given = [folder / "recording.toml", "--out", tmp_path, "--lengths", "--once"]
    assert "argument --once: not allowed with argument --lengths" in message_of(
        capsys, "track", *given
    )


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (
            ("--model-file", "arms"),
            "invalid choice: 'arms' (choose from 'torso', 'legs', 'whole', ",
        ),
        (("--model-file", "legs", "--shoulders"), "--shoulders: the body has no joints of the "),
    ],
)
def test_a_body_that_there_is_not_or_without_shoulders_is_refused(
    folder, tmp_path, capsys, given, expected
):
    asked = [folder / "recording.toml", "--at", "0,0,0", "--out", tmp_path, *given]
    assert expected in message_of(capsys, "track", *asked)


SWELLS = """[[swelling]]
patch = "arm"
steered_by = ["elbow_flex"]
gain = 0.01
centre = [0, 0.3]
radii = [60, 0.1]
"""


@pytest.mark.parametrize(
    ("given", "counts", "body"),
    [
        ((), (0, 0), "supple.toml"),
        (("--shoulders",), (4, 2), "supple.toml"),
        (("--morphing", "swells.toml"), (0, 2), "supple.toml"),
        (("--model-file", "torso"), (0, 0), "torso.toml"),
    ],
)
def test_settings_are_those_asked_for(folder, tmp_path, monkeypatch, given, counts, body):
    asked = {}
    (tmp_path / "swells.toml").write_text(SWELLS)
    monkeypatch.chdir(tmp_path)

    def follow(*_, settings, **__):
        asked["settings"] = settings
        raise InputError("recording.toml", "enough")

    monkeypatch.setattr(track, "track_silhouettes", follow)
    path = str(folder / "recording.toml")
    out = str(tmp_path / "out")
    assert main(["silhouette", "track", path, "--at", "0,0,0", "--out", out, *given]) == 2
    morphing = asked["settings"].morphing
    assert (len(morphing.followers), len(morphing.swellings)) == counts
    assert asked["settings"].body == body
    # Who says by hand where somebody stands says it roughly.
    assert asked["settings"].starting_cycles


def test_a_place_at_which_no_camera_looks_is_refused_before_anything_is_tracked(
    folder, tmp_path, capsys
):
    given = [folder / "recording.toml", "--out", tmp_path, "--at", "-80,30,0"]
    sentence = message_of(capsys, "track", *given)
    assert "x = -80.00, y = 30.00 m, where no camera looks" in sentence
    assert "left, right" in sentence


def test_nothing_is_written_into_a_file(folder, tmp_path, capsys):
    taken = tmp_path / "taken"
    taken.write_text("mine")
    given = [folder / "recording.toml", "--out", taken, "--at", "0,0,0"]
    assert "is a file" in message_of(capsys, "track", *given)
    assert taken.read_text() == "mine"


def test_a_recording_that_shows_nobody_is_refused(folder):
    recording, progress = Recording.load(folder / "recording.toml"), []
    start = standing_pose_at(with_joints(recording.skeleton, Settings.body), 0.0, 0.0, 0.0)
    settings = Settings(least_matched_share=2.0, settling_steps=0, particles=1)
    with pytest.raises(InputError, match="no camera shows the person in any frame"):
        track.track_silhouettes(
            recording, start, settings, passes=1, progress=lambda n, of: progress.append((n, of))
        )
    assert progress == [(1, 3), (2, 3), (3, 3)]


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (["--person", "gone.npz"], "gone.npz: no such file"),
        (["--person", "people.npz"], "people.npz: not an .npz file, or cut off"),
        (["--person", "other.npz"], "other.npz: holds no rigged meshes, expected an .npz with"),
        (["--seconds", "0.01"], "0.01 s hold no frame, expected at least 0.033 s"),
        (["--seconds", "-1"], "expected a positive number"),
        (["--seed", "-1"], "expected a whole number from 0 on"),
        (["--exercise", "dancing"], "invalid choice: 'dancing'"),
    ],
)
def test_a_demo_of_nobody_or_no_time_is_refused(
    folder, tmp_path, monkeypatch, capsys, given, expected
):
    monkeypatch.chdir(folder)
    assert expected in message_of(capsys, "demo", "--out", tmp_path / "demo", *given)


class RecordedError(Exception):
    """The demo's recording is there: no need to track it."""


def test_the_demo_states_whose_body_its_person_has(tmp_path, monkeypatch):
    """Its upper arms were taken as a quarter shorter than they are, and elbows were 13 cm off."""
    upper_arms = []

    def compare(recording: Recording, truth: Path, *_: object) -> None:
        points, skeleton = read_trc(truth).points(), recording.skeleton
        found = skeleton.lengths[skeleton.tree.bone("humerus_l")]
        upper_arms.extend([found, np.linalg.norm(points["elbow_l"][0] - points["shoulder_l"][0])])
        raise RecordedError

    monkeypatch.setattr(demo, "tracked_from_truth", compare)
    with pytest.raises(RecordedError):
        demo.demonstrate_silhouettes(tmp_path, seconds=0.04)
    found, true = upper_arms
    assert found == pytest.approx(true, abs=0.01)
