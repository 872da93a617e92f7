"""Recording files: everything they may say, and every way in which they may be wrong."""

from pathlib import Path

import numpy as np
import pytest
from conftest import complaint
from small_recording import write_small_recording

from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.calibration.sync import estimate_video_offsets
from jaxmocap.formats.cameras.calibration import write_calibration
from jaxmocap.formats.convert import convert_file
from jaxmocap.formats.recordings.recording import (
    MarkerPlace,
    Recording,
    VideoSource,
    load_recording,
    write_recording,
)
from jaxmocap.formats.time_series.csv import write_csv
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.geometry.cameras import Camera
from jaxmocap.pipelines.check import check
from jaxmocap.pipelines.tracking.track import track
from jaxmocap.pipelines.warmup import warm_up

MARKERS = '[markers]\nfile = "m.trc"\n'
ON = '[markers.on]\nHead = { bone = "head" }\n'
VIDEO = '[[video]]\nfile = "v.mp4"\ncamera = "cam"\n'
CALIBRATION = '[calibration]\nfile = "c.toml"\n'
SUBJECT = "[subject]\nheight = 1.7\n"
COMPLETE = MARKERS + ON + VIDEO + CALIBRATION + SUBJECT
changed = COMPLETE.replace
KEYPOINTS = MARKERS + ON + CALIBRATION + VIDEO + 'keypoints = "keys"\n'
STATIC = '[subject]\nstatic = "static.trc"\n[subject.landmarks]\n'
STANDING = {
    "Neck": (0.0, 0.0, 1.45),
    "LHip": (0.0, 0.1, 0.9),
    "RHip": (0.0, -0.1, 0.9),
    "LSho": (0.0, 0.2, 1.4),
    "RSho": (0.0, -0.2, 1.4),
    "LElb": (0.0, 0.2, 1.1),
    "Gone": (np.nan, np.nan, np.nan),
}
NEEDED = 'neck = "Neck"\nhip_l = "LHip"\nhip_r = "RHip"\nshoulder_l = "LSho"\nshoulder_r = "RSho"\n'


@pytest.fixture
def folder(tmp_path) -> Path:
    """Marker files, a calibration, something in the place of a video, and no recording file."""
    times = np.arange(3) / 10
    head = np.arange(9.0).reshape(3, 3)
    write_trc(tmp_path / "m.trc", times, {"Head": head, "Gone": np.full((3, 3), np.nan)})
    write_trc(tmp_path / "static.trc", times, {k: np.tile(v, (3, 1)) for k, v in STANDING.items()})
    matrix = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
    camera = Camera.create((640, 480), matrix)
    write_calibration(tmp_path / "c.toml", {"cam": camera, "cam b": camera})
    (tmp_path / "v.mp4").touch()
    (tmp_path / "keys").mkdir()
    return tmp_path


def load(folder: Path, text: str) -> Recording:
    path = folder / "r.toml"
    path.write_text(text, encoding="utf-8")
    return load_recording(path)


def test_a_recording_holds_what_its_file_says(folder):
    on = '[markers.on]\nHead = { bone = "radius_l", at = 0.5, offset = [0.1, 0, 0] }\n'
    video = VIDEO + 'offset = -0.5\nkeypoints = "keys"\nbackground = "v.mp4"\n'
    other = VIDEO.replace('"cam"', '"cam b"')
    recording = load(folder, MARKERS + on + video + other + CALIBRATION + SUBJECT)
    assert recording.places == (MarkerPlace("Head", "radius_l", 0.5, (0.1, 0.0, 0.0)),)
    assert recording.marker_names == ("Head",) and recording.name == "r"
    np.testing.assert_array_equal(recording.positions_world[:, 0], np.arange(9).reshape(3, 3))
    assert recording.times.dtype == np.float64 and recording.times.tolist() == [0.0, 0.1, 0.2]
    first, second = recording.videos
    assert (first.offset, first.keypoints) == (-0.5, folder / "keys")
    assert (second.offset, second.keypoints) == (0.0, None)
    assert (first.keypoints_model, first.keypoints_first) == (None, None)
    assert (first.background, second.background) == (folder / "v.mp4", None)
    assert first.path == folder / "v.mp4" and first.camera_name == "cam"
    assert np.asarray(first.camera.size).tolist() == [640, 480]
    np.testing.assert_array_equal(recording.skeleton.lengths, Skeleton.human(1.7).lengths)
    assert recording.warnings == ()


@pytest.mark.parametrize(
    ("axes", "expected"),
    [
        ('up = "z"', [0, 1, 2]),
        ('up = "y"', [2, 0, 1]),
        ("to_world = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]", [0, -2, 1]),
        ("to_world = [[1, 0, 0], [0, 0, 1], [0, 1, 0]]", [0, 2, 1]),
    ],
)
def test_markers_are_turned_into_the_world(folder, axes, expected):
    recording = load(folder, f"{MARKERS}{axes}\n{ON}{SUBJECT}")
    assert recording.positions_world[0, 0].tolist() == expected


def test_without_a_subject_a_height_is_assumed_and_said(folder):
    recording = load(folder, MARKERS + ON)
    np.testing.assert_array_equal(recording.skeleton.lengths, Skeleton.human(1.75).lengths)
    assert "no [subject], a height of 1.75 m is assumed" in recording.warnings[0]
    assert recording.videos == ()


def test_a_marker_that_is_never_seen_is_a_warning(folder):
    recording = load(folder, MARKERS + ON + 'Gone = { bone = "hand_l" }\n' + SUBJECT)
    assert (
        len(recording.warnings) == 1
        and "'Gone' is missing in every sample" in recording.warnings[0]
    )


@pytest.mark.parametrize("suffix", [".trc", ".csv"])
def test_a_position_at_exactly_zero_is_missing_and_counted(folder, suffix):
    head = np.array([[1e-6, 0, 0], [0, 0, 1.5], [1e-6, 0, 0]])
    path = folder / f"m{suffix}"
    (write_trc if suffix == ".trc" else write_csv)(path, np.arange(3) / 10, {"Head": head})
    path.write_text(path.read_text().replace("0.000001", "0"))
    recording = load(folder, MARKERS.replace(".trc", suffix) + ON + SUBJECT)
    assert np.isnan(recording.positions_world[:, 0]).all(-1).tolist() == [True, False, True]
    (warning,) = recording.warnings
    assert "marker 'Head' is at exactly 0, 0, 0 in 2 of 3 samples" in warning
    (warning,) = convert_file(path, folder / "a.c3d")
    assert warning == "left out: 2 positions at exactly 0, 0, 0, as missing"


def test_a_static_trial_scales_the_skeleton(folder):
    skeleton = load(folder, MARKERS + ON + STATIC + NEEDED + 'elbow_l = "LElb"\n').skeleton
    humerus = skeleton.tree.bone("humerus_l")
    assert float(skeleton.lengths[humerus]) == pytest.approx(0.3, abs=1e-5)


def test_a_static_trial_has_axes_and_a_mass_of_its_own(folder):
    points = {k: np.tile(np.array(v)[[1, 2, 0]], (2, 1)) for k, v in STANDING.items()}
    write_trc(folder / "y.trc", np.arange(2) / 10, points)
    text = STATIC.replace("static.trc", "y.trc").replace("\n[sub", '\nup = "y"\nmass = 60\n[sub')
    in_y_up = load(folder, MARKERS + ON + text + NEEDED).skeleton
    straight = load(folder, MARKERS + ON + STATIC + NEEDED).skeleton
    np.testing.assert_allclose(in_y_up.lengths, straight.lengths, atol=1e-6)
    np.testing.assert_allclose(in_y_up.directions, straight.directions, atol=1e-6)
    assert float(in_y_up.masses.sum()) == pytest.approx(60, rel=1e-5)


def test_a_subject_may_have_a_file_with_paths_of_its_own(folder):
    (folder / "people").mkdir()
    (folder / "static.trc").rename(folder / "people" / "static.trc")
    landmarks = "[landmarks]\n" + NEEDED
    (folder / "people" / "anna.toml").write_text('static = "static.trc"\n' + landmarks)
    (folder / "people" / "bert.toml").write_text("height = 1.9\nmass = 90\n")
    for file, mass in (("anna", None), ("bert", 90)):
        text = f'{MARKERS}{ON}[subject]\nfile = "people/{file}.toml"\n'
        skeleton = load(folder, text).skeleton
        assert mass is None or float(skeleton.masses.sum()) == pytest.approx(mass, rel=1e-3)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "r.toml: neither [markers] nor [[video]]"),
        ("[markers", "not TOML"),
        (
            COMPLETE + "[extra]\n",
            "unknown key 'extra', expected markers, video, calibration, subject",
        ),
        (
            COMPLETE + "[osc]\n",
            "found [osc], as in the file of a live run, expected a recording's; 'jaxmocap live' ta",
        ),
        (changed("m.trc", "n.trc"), "[markers] file: no such file: "),
        (changed('"m.trc"', "3"), "[markers] file: found 3, expected text"),
        (changed("file =", "fiel =", 1), "[markers]: unknown key 'fiel', expected file, up"),
        (MARKERS + 'up = "x"\n' + ON, "[markers] up: found 'x', expected 'z' or 'y'"),
        (MARKERS + "to_world = [[1, 0], [0, 1]]\n" + ON, "[markers] to_world: found [[1, 0]"),
        (MARKERS + "to_world = [[2, 0, 0], [0, 1, 0], [0, 0, 1]]\n" + ON, "unit rows"),
        (MARKERS + 'up = "z"\nto_world = 3\n' + ON, "found both 'up' and 'to_world'"),
        (MARKERS, "on: is missing, expected [markers.on], or set = ... of a common set"),
        (MARKERS + "[markers.on]\n", "[markers.on]: names no marker"),
        (changed("Head =", "Haed ="), "[markers.on] Haed: no such marker in "),
        (changed("Head =", "Haed ="), "found Head, Gone"),
        (changed('"head"', '"skull"'), "[markers.on] Head: unknown bone 'skull', expected"),
        (changed('"head"', '"skull"'), "radius_l"),
        (changed('"head"', '"\\u001b[31m"'), "unknown bone '\\x1b[31m'"),
        (changed('{ bone = "head" }', "1"), "[markers.on] Head: found 1, expected a table"),
        (changed('bone = "head"', "at = 1"), "[markers.on] Head: 'bone' is missing"),
        (changed('"head"', '"head", at = 1.5'), "Head at: found 1.5, expected a fraction"),
        (changed('"head"', '"head", at = true'), "Head at: found True, expected a number"),
        (changed('"head"', '"head", offset = [1]'), "Head offset: found [1], expected 3"),
        (changed('"head"', '"head", offset = [1e200, 0, 0]'), "expected none beyond 10"),
        (changed('"head"', '"head", to = 1'), "unknown key 'to', expected bone, at, offset"),
        (changed("Head = ", "Gone = "), "all positions are NaN"),
        (changed("v.mp4", "w.mp4"), "[[video]] number 1 file: no such file"),
        (changed("[[video]]", "[video]"), "expected [[video]] in double brackets"),
        (changed('camera = "cam"', ""), "[[video]] number 1: 'camera' is missing"),
        (changed('"cam"', '"cam_2"'), "c.toml: section [cam_2] is missing, found cam"),
        (changed('"cam"', '"cam"\noffset = "1"'), "offset: found '1', expected a number"),
        (changed('"cam"', '"cam"\noffset = nan'), "offset: found nan, expected a number"),
        (changed('"cam"', '"cam"\noffset = 1e300'), "number 1 offset: found 1e+300, exp"),
        (changed('"cam"', '"cam"\nkeypoints = "k"'), "keypoints: no such folder"),
        (changed('"cam"', '"cam"\nkeypoints = "k.json"'), "keypoints: no such file"),
        (changed('"cam"', '"cam"\nkeypoints = 3'), "keypoints: found 3, expected text"),
        (KEYPOINTS + 'keypoints_model = "BODY"\n', "number 1 keypoints_model: found 'BODY', expec"),
        (KEYPOINTS + 'keypoints_model = "BODY"\n', "one of BODY_25, BODY_25B, COCO_18, COCO_17"),
        (KEYPOINTS + "keypoints_first = 0.5\n", "keypoints_first: found 0.5, expected a whole"),
        (KEYPOINTS + "keypoints_first = '1'\n", "keypoints_first: found '1', expected a number"),
        (KEYPOINTS + "keypoints_first = 1e300\n", "number 1 keypoints_first: found 1e+300"),
        (
            changed('"cam"', '"cam"\nkeypoints_model = "BODY_25"'),
            "[[video]] number 1 keypoints_model: found without 'keypoints'",
        ),
        (changed(CALIBRATION, ""), "[calibration] is missing"),
        (changed("c.toml", "d.toml"), "[calibration] file: no such file"),
        (changed("1.7", "17"), "[subject]: height = 17.0: expected metres between"),
        (changed("1.7", "1e300"), "[subject] height: found 1e+300"),
        (changed("height = 1.7", ""), "[subject]: found none, expected one of file, height"),
        (COMPLETE + "static = 'a'\n", "[subject]: found height and static, expected one of"),
        (COMPLETE + "up = 'z'\n", "[subject]: unknown key 'up', expected height, mass"),
        (MARKERS + ON + STATIC + NEEDED.replace("LHip", "Hip"), "marker 'Hip' is not in"),
        (MARKERS + ON + STATIC + NEEDED.replace("LHip", "Gone"), "needs the landmark 'hip_l'"),
        (MARKERS + ON + STATIC, "[subject.landmarks]: a static trial needs the landmark 'neck'"),
        (MARKERS + ON + "[subject]\nstatic = 'static.trc'\n", "'landmarks' is missing"),
        (MARKERS + ON + "[subject]\nstatic = 'none.trc'\n", "[subject] static: no such file"),
        (MARKERS + ON + "[subject]\nfile = 'none.toml'\n", "[subject] file: no such file"),
        (MARKERS + ON + "[subject]\nfile = 'r.toml'\n", "unknown key 'markers', expected file"),
    ],
)
def test_bad_recordings_are_refused_with_file_and_field(folder, text, says):
    message = complaint(load, folder, text)
    assert says in message and message.startswith(str(folder))


def test_videos_alone_make_a_recording_which_no_marker_tracker_takes(folder):
    recording = load(folder, VIDEO + CALIBRATION + SUBJECT)
    assert recording.marker_names == () and recording.positions_world.shape == (0, 0, 3)
    assert recording.times.shape == (0,) and recording.videos[0].camera_name == "cam"
    for user in (Recording.require_markers, track, check, estimate_video_offsets, warm_up):
        assert "r.toml: [markers] is missing" in complaint(user, recording)
    marked = load(folder, COMPLETE)
    assert marked.require_markers() is marked


def test_a_recording_without_markers_is_written_without_them(folder):
    videos = [{"file": "v.mp4", "camera": "cam"}]
    path = write_recording(folder, None, {}, videos, "c.toml", {"height": 1.7})
    assert "markers" not in path.read_text(encoding="utf-8")
    assert load_recording(path).videos[0].path == folder / "v.mp4"


def test_an_unknown_landmark_is_answered_with_all_of_them(folder):
    message = complaint(load, folder, MARKERS + ON + STATIC + "nose = 'Neck'\n")
    assert "unknown key 'nose', expected pelvis" in message
    assert all(name in message for name in LANDMARKS)


def test_neck_and_hips_that_are_never_seen_together_are_refused(folder):
    points = {k: np.tile(v, (2, 1)) for k, v in STANDING.items()}
    points["Neck"][0] = points["LHip"][1] = np.nan
    write_trc(folder / "static.trc", np.arange(2.0), points)
    assert "in no common frame" in complaint(load, folder, MARKERS + ON + STATIC + NEEDED)


def test_a_recording_needs_no_file_on_disk():
    camera = Camera.create((64, 48), np.eye(3))
    images = np.zeros((2, 48, 64, 3), np.uint8)
    recording = Recording(
        Skeleton.human(1.8),
        np.arange(4) / 90,
        np.zeros((4, 1, 3)),
        (MarkerPlace("Head", "head"),),
        (VideoSource("webcam", camera, frames=(np.array([0.0, 0.033]), images)),),
    )
    assert recording.path is None and recording.videos[0].frames is not None


@pytest.mark.parametrize(
    ("times", "shape", "bone", "says"),
    [
        ([0, 1], (2, 2, 3), "head", "found shape (2, 2, 3), expected (2, 1, 3)"),
        ([1, 0], (2, 1, 3), "head", "marker sample 1: time runs backwards"),
        ([0, np.nan], (2, 1, 3), "head", "marker sample 1: found no time"),
        ([0, 1], (2, 1, 3), "tail", "unknown bone 'tail'"),
    ],
)
def test_parts_in_memory_are_checked_as_well(times, shape, bone, says):
    parts = Skeleton.human(), np.array(times), np.zeros(shape), (MarkerPlace("A", bone),)
    message = complaint(Recording, *parts, name="x")
    assert message.startswith("x: ") and says in message


def test_a_written_recording_is_read_back(folder):
    names = ["a b", 'q"uo\\te', "Ünicode.x", "dash—"]
    times = np.arange(2.0)
    (folder / "cam.json").touch()
    write_trc(folder / "n.trc", times, {name: np.ones((2, 3)) for name in names})
    on = {name: {"bone": "hand_l", "at": np.float64(0.25)} for name in names}
    on[names[0]] = {"bone": "head", "offset": (0.1, 0.2, 1e-9)}
    path = write_recording(
        folder,
        "n.trc",
        on,
        [
            {
                **{"file": Path("v.mp4"), "camera": "cam", "offset": 1 / 3, "keypoints": "keys"},
                **{"keypoints_model": "BODY_25B", "keypoints_first": 1},
            },
            {"file": "v.mp4", "camera": "cam b", "keypoints": Path("cam.json")},
        ],
        "c.toml",
        {"static": "static.trc", "landmarks": dict(line.split(' = "') for line in _pairs())},
        up="y",
    )
    assert path == folder / "recording.toml"
    recording = load_recording(path)
    assert recording.marker_names == tuple(names)
    assert recording.places[0] == MarkerPlace("a b", "head", 1.0, (0.1, 0.2, 1e-9))
    assert recording.places[1] == MarkerPlace(names[1], "hand_l", 0.25)
    assert [video.offset for video in recording.videos] == [1 / 3, 0.0]
    first, second = recording.videos
    assert (first.keypoints, second.keypoints) == (folder / "keys", folder / "cam.json")
    assert (first.keypoints_model, first.keypoints_first) == ("BODY_25B", 1)


def _pairs() -> list[str]:
    return [line.rstrip('"') for line in NEEDED.splitlines()]


@pytest.mark.parametrize("which", ["cam_01", "cam_02", "cam_03", "cam_04", "all_cameras"])
def test_the_real_recordings_are_read(recordings, which):
    recording = Recording.load(recordings / "balancing" / f"recording_{which}.toml")
    assert recording.marker_names == ("Head", "LWrist", "RWrist", "LAnkle", "RAnkle")
    assert recording.positions_world.shape == (60, 5, 3)
    assert np.isfinite(recording.positions_world).all()
    assert len(recording.videos) == (4 if which == "all_cameras" else 1)
    bones = recording.skeleton.tree
    # The README of the recordings gives the standing trial's means, in millimetres.
    for bone, length in (("femur_l", 0.368), ("humerus_l", 0.280), ("humerus_r", 0.277)):
        assert float(recording.skeleton.lengths[bones.bone(bone)]) == pytest.approx(
            length, abs=2e-3
        )
    assert recording.warnings == ()


def test_a_camera_that_is_not_used_need_not_have_been_placed(tmp_path):
    file = write_small_recording(tmp_path)
    with (tmp_path / "calibration.toml").open("a") as calibration:
        calibration.write(
            "\n[other]\nsize = [96, 72]\nmatrix = [[95, 0, 48], [0, 95, 36], [0, 0, 1]]\n"
        )
    assert [video.camera_name for video in load_recording(file).videos] == ["cam"]
    file.write_text(file.read_text().replace('camera = "cam"', 'camera = "other"'))
    assert "[other]: 'rotation' is missing" in complaint(load_recording, file)
