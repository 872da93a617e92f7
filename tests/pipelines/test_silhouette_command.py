"""``silhouette track`` and ``silhouette demo``: bad input is one clear sentence and exit code 2."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from test_point_rays import ring

from jaxmocap.body.skeleton import LANDMARKS, with_joints
from jaxmocap.cli.program import main
from jaxmocap.evidence.keypoints import lines_of_sight
from jaxmocap.formats.cameras.calibration import write_calibration
from jaxmocap.formats.cameras.video_sources import VideoSource
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.recording import Recording, write_recording
from jaxmocap.formats.time_series.trc import read_trc, write_trc
from jaxmocap.pipelines.silhouettes import demo, track
from jaxmocap.pipelines.silhouettes.keypoints import (
    check_determined,
    keypoint_distances,
    lost_sentences,
    lost_status,
)
from jaxmocap.silhouette.first_pose import standing_pose_at
from jaxmocap.silhouette.settings import Settings
from jaxmocap.synthetic.drawing_camera import look_at
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
    folder, tmp_path, refusal, old, new, expected
):
    given = ["--out", tmp_path, "--at", "0,0,0"]
    assert expected in refusal("silhouette", "track", changed(folder, old, new), *given)


def test_a_recording_without_markers_and_video_is_none(folder, tmp_path, refusal):
    path = folder / "none.toml"
    path.write_text("[subject]\nheight = 1.75\n")
    sentence = refusal("silhouette", "track", path, "--out", tmp_path, "--at", "0,0,0")
    assert "none.toml: neither [markers] nor [[video]]" in sentence


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("--cameras=left,top", "no [[video]] of camera 'top', found left, right"),
        *(
            (f"--at={at}", f"--at: found {at!r}, expected X,Y,FACING")
            for at in ("here", "1,2", "-1,2", "1,2,nan", "1,inf,0", "1,2,3,4", "")
        ),
        ("--at=-80,30,0", "x = -80.00, y = 30.00 m, where no camera looks"),
        ("--at=-80,30,0", "left, right"),
        ("--lengths --once", "argument --once: not allowed with argument --lengths"),
        ("--at=0,0,0 --model-file=arms", "'arms' (choose from 'torso', 'legs', 'whole', "),
        ("--at=0,0,0 --model-file=legs --shoulders", "--shoulders: the body has no joints of the "),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_tracked(
    folder, tmp_path, refusal, given, expected
):
    recording = folder / "recording.toml"
    message = refusal("silhouette", "track", recording, "--out", tmp_path, *given.split())
    assert expected in message


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


def test_nothing_is_written_into_a_file(folder, tmp_path, refusal):
    taken = tmp_path / "taken"
    taken.write_text("mine")
    given = [folder / "recording.toml", "--out", taken, "--at", "0,0,0"]
    assert "is a file" in refusal("silhouette", "track", *given)
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
    ("by_points", "lengths", "expected"), [(True, False, 1), (True, True, 3), (False, False, 3)]
)
def test_one_camera_with_key_points_has_one_pass_unless_lengths_are_corrected(
    folder, monkeypatch, by_points, lengths, expected
):
    class AskedError(Exception):
        """Instead of passes."""

    def ask(*given):
        raise AskedError(given[5])

    recording = Recording.load(folder / "recording.toml")
    start = standing_pose_at(with_joints(recording.skeleton, Settings.body), 0.0, 0.0, 0.0)
    recording = replace(recording, videos=recording.videos[:1])
    guide = SimpleNamespace(warnings=(), skeleton=recording.skeleton) if by_points else None
    monkeypatch.setattr(track, "keypoint_guide", lambda *_: guide)
    monkeypatch.setattr(track, "run_passes", ask)
    with pytest.raises(AskedError) as asked:
        track.track_silhouettes(recording, start, lengths=lengths)
    assert asked.value.args == (expected,)


def marked(folder, metres: float = 1.0, later: float = 0.0) -> Recording:
    """The same with markers on head and foot, in another unit or at another time."""
    on = {"Head": {"bone": "head"}, "Foot": {"bone": "foot_l"}}
    places = {"Head": [0.1, 0.0, 1.7], "Foot": [0.1, 0.1, 0.05]}
    points = {name: metres * np.tile(place, (3, 1)) for name, place in places.items()}
    write_trc(folder / "m.trc", later + np.arange(3) / 30, points)
    return Recording.load(
        write_recording(
            folder / "marked.toml", "m.trc", on, VIDEOS, "calibration.toml", {"height": 1.75}
        )
    )


@pytest.mark.parametrize(
    ("metres", "later", "expected"),
    [(1000.0, 0.0, "the numbers look like millimetres"), (1.0, 60.0, "no overlap")],
)
def test_markers_that_are_followed_are_checked_as_track_does(
    folder, monkeypatch, metres, later, expected
):
    recording = marked(folder, metres, later)
    start = standing_pose_at(with_joints(recording.skeleton, Settings.body), 0.0, 0.0, 0.0)
    monkeypatch.setattr(track, "run_passes", None)
    with pytest.raises(InputError, match=expected):
        track.track_silhouettes(recording, start, markers=True)


def test_markers_are_followed_where_the_body_moves_their_bones(folder, monkeypatch):
    class AskedError(Exception):
        """Instead of passes."""

    def ask(_, __, bundles, *___):
        raise AskedError([bundle.measured.markers for bundle in bundles()])

    recording = Recording.load(folder / "recording.toml")
    recording, settings = marked(folder), Settings(body="torso.toml")
    start = standing_pose_at(with_joints(recording.skeleton, settings.body), 0.0, 0.0, 0.0)
    monkeypatch.setattr(track, "run_passes", ask)
    with pytest.raises(AskedError) as asked:
        track.track_silhouettes(recording, start, settings, markers=True)
    followed = np.isfinite(asked.value.args[0]).all(-1)
    names = list(recording.marker_names)
    assert followed[:, names.index("Head")].any() and not followed[:, names.index("Foot")].any()


def test_one_camera_whose_key_points_show_nobody_is_refused(folder, monkeypatch):
    recording = Recording.load(folder / "recording.toml")
    start = standing_pose_at(with_joints(recording.skeleton, Settings.body), 0.0, 0.0, 0.0)
    one = replace(recording, videos=recording.videos[:1])
    monkeypatch.setattr(track, "keypoint_guide", lambda *_: None)
    monkeypatch.setattr(track, "has_keypoints", lambda _: True)
    with pytest.raises(InputError, match="key points of fewer than 4 landmarks in every frame"):
        track.track_silhouettes(one, start)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (["--person", "gone.npz"], "gone.npz: no such file"),
        (["--person", "people.npz"], "people.npz: not an .npz file, or cut off"),
        (["--person", "other.npz"], "other.npz: holds no rigged meshes, expected an .npz with"),
        (["--seconds", "0.01"], "0.01 s hold no frame, expected at least 0.033 s"),
        (["--seconds", "-1"], "expected a positive number"),
        (["--seconds", "1e9"], "--seconds: found 1e+09, expected at most 3600"),
        (["--seed", "-1"], "expected a whole number from 0 on"),
        (["--exercise", "dancing"], "invalid choice: 'dancing'"),
        (["--exercise", "walking"], "--exercise: is of a rigged mesh, expected --person too"),
    ],
)
def test_a_demo_of_nobody_or_no_time_is_refused_below_its_progress(
    folder, tmp_path, monkeypatch, capsys, given, expected
):
    monkeypatch.chdir(folder)
    try:
        code = main(["silhouette", "demo", "--out", str(tmp_path / "demo"), *given])
    except SystemExit as left:
        code = left.code
    error = capsys.readouterr().err
    assert code == 2 and "Traceback" not in error and expected in error.splitlines()[-1]


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

    monkeypatch.setattr(demo, "track_from_truth", compare)
    with pytest.raises(RecordedError):
        demo.demonstrate_silhouettes(tmp_path, seconds=0.04)
    found, true = upper_arms
    assert found == pytest.approx(true, abs=0.01)


# Who is lost --------------------------------------------------------------------------------------


POINTS = np.random.default_rng(1).normal([0, 0, 1], 0.3, (2, len(LANDMARKS), 3))


def recording(tmp_path, *cameras):
    """Without markers, before some cameras."""
    named = {f"cam_{number}": camera for number, camera in enumerate(cameras, 1)}
    for name in named:
        write_video(tmp_path / f"{name}.mp4", [np.full((480, 640, 3), 120, np.uint8)] * 2)
    write_calibration(tmp_path / "calibration.toml", named)
    videos = [{"file": f"{name}.mp4", "camera": name} for name in named]
    return write_recording(tmp_path, None, {}, videos, "calibration.toml", {"height": 1.75})


def test_one_camera_alone_is_refused_before_anything_is_tracked(tmp_path, capsys):
    path = recording(tmp_path, *ring(1))
    given = ["silhouette", "track", str(path), "--out", str(tmp_path / "out"), "--at", "0,0,0"]
    assert main(given) == 2
    sentence = capsys.readouterr().err.splitlines()[-1]
    for what in ("key points", "--markers", "second camera", "--guess"):
        assert what in sentence


def test_a_guess_is_marked(tmp_path):
    loaded = Recording.load(recording(tmp_path, *ring(1)))
    (warning,) = check_determined(loaded, False, True)
    assert warning.startswith("a guess")


@pytest.mark.parametrize("helped", ["markers", "keypoints"])
def test_one_camera_with_markers_or_key_points_is_not_refused(tmp_path, helped):
    loaded = Recording.load(recording(tmp_path, *ring(1)))
    if helped == "keypoints":
        videos = (replace(loaded.videos[0], keypoints=tmp_path),)
        assert check_determined(replace(loaded, videos=videos), False, False) == ()
    else:
        assert check_determined(loaded, True, False) == ()


@pytest.mark.parametrize(("azimuth", "warned"), [(10, True), (29, True), (31, False), (175, True)])
def test_two_cameras_that_look_alike_are_warned_of(tmp_path, azimuth, warned):
    turn = np.radians(azimuth)
    cameras = [look_at((4.0, 0.0, 1.0), (0.0, 0.0, 1.0))]
    cameras += [look_at((4 * np.cos(turn), 4 * np.sin(turn), 1.0), (0.0, 0.0, 1.0))]
    warnings_before = check_determined(Recording.load(recording(tmp_path, *cameras)), False, False)
    assert len(warnings_before) == warned
    assert not warned or "cam_1 and cam_2" in warnings_before[0]


def test_where_key_points_lie_is_measured_frame_by_frame():
    (camera,) = ring(1)
    from jaxmocap.geometry.cameras import project

    pixels = np.asarray(project(camera, POINTS.astype(np.float32)))
    sure = np.array([[1.0] * len(LANDMARKS), [0.0] * len(LANDMARKS)])
    lines = lines_of_sight(camera, LANDMARKS, pixels, sure)
    off = keypoint_distances(POINTS, lines)
    assert off[0] < 1e-3 and np.isnan(off[1])
    ahead = np.asarray(lines.directions)[0, 0, 0]
    across = np.cross(ahead, [0.0, 0.0, 1.0])
    moved = keypoint_distances(POINTS + 0.4 * across / np.linalg.norm(across), lines)
    assert moved[0] == pytest.approx(0.4, abs=0.05)


@pytest.mark.parametrize(
    ("used", "distance", "needs_points", "expected"),
    [
        ([True], 0.02, True, ()),
        ([True], np.nan, False, ()),
        ([True], np.nan, True, ("lost: one camera and no key points",)),
        ([False, False], np.nan, False, ("lost: no camera's outline is explained",)),
        ([True], 0.4, True, ("lost: key points lie 40 cm off",)),
        (
            [False],
            0.4,
            False,
            ("lost: no camera's outline is explained, key points lie 40 cm off",),
        ),
    ],
)
def test_a_frame_in_which_the_person_is_lost_says_so(used, distance, needs_points, expected):
    assert lost_status(np.array(used), distance, needs_points) == expected


@pytest.mark.parametrize(("lost", "count"), [(2, 0), (3, 1)])
def test_more_than_half_of_the_frames_lost_is_not_done(lost, count):
    statuses = (("lost: somewhere",),) * lost + (("cam_1: left out",),) * (4 - lost)
    motion = SimpleNamespace(report=SimpleNamespace(statuses=statuses))
    sentences = lost_sentences(motion)  # type: ignore[arg-type]
    assert len(sentences) == count
    assert not count or sentences == ["the person is lost in 3 of 4 frames"]


def test_a_recording_in_memory_is_refused_too():
    source = VideoSource("phone", look_at((3.0, 0.0, 1.0), (0.0, 0.0, 1.0)))
    alone = SimpleNamespace(videos=(source,), error=lambda text: InputError("memory", text))
    with pytest.raises(InputError, match="one camera without key points"):
        check_determined(alone, False, False)  # type: ignore[arg-type]
