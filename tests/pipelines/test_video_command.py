"""``jaxmocap video``: a video, a height and nothing else; what is refused."""

from contextlib import contextmanager
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.body.kinematics import landmarks
from jaxmocap.body.pose import relaxed_pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.calibration.standing_person import ANKLE_M, StandingCamera
from jaxmocap.cli.program import main
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.keypoint_models import LANDMARK_OF, MODELS
from jaxmocap.geometry.cameras import Camera, project
from jaxmocap.pipelines.keypoints import by_mediapipe
from jaxmocap.pipelines.keypoints.detect import Detector
from jaxmocap.pipelines.silhouettes import track
from jaxmocap.pipelines.silhouettes.video import USUAL_FOV_DEG, file_fov_deg, recording_of_video
from jaxmocap.synthetic.recording import write_video

COUNT, SIZE = 12, (320, 480)
PLACE = StandingCamera(1.4, 0.12, 0.0, np.zeros(3))
FOCAL = SIZE[1] / 2 / np.tan(np.radians(USUAL_FOV_DEG) / 2)
LENS = Camera.create(
    SIZE, np.array([[FOCAL, 0, (SIZE[0] - 1) / 2], [0, FOCAL, (SIZE[1] - 1) / 2], [0, 0, 1]])
)


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """A video of an empty wall."""
    path = tmp_path_factory.mktemp("clip") / "clip.mp4"
    write_video(path, [np.full((SIZE[1], SIZE[0], 3), 90, np.uint8)] * COUNT)
    return path


def walker(found: bool = True) -> Detector:
    """Finds somebody upright who walks from 3 to 5 m away, or nobody."""
    person = Skeleton.human(1.75)
    points = np.array(landmarks(person, relaxed_pose(person)))
    points[:, 2] += ANKLE_M - points[LANDMARKS.index("ankle_l"), 2]
    frames = iter(np.linspace(3, 5, COUNT))

    def detect(image, box):
        if not found:
            return None
        moved = points + np.array([next(frames), 0.0, 0.0])
        pixels = np.asarray(project(PLACE.stand_camera(LENS), jnp.asarray(moved, float)))
        marks = [LANDMARK_OF.get(name) for name in MODELS["COCO_17"]]
        rows = [pixels[LANDMARKS.index(mark)] if mark else pixels[0] for mark in marks]
        return np.column_stack([rows, np.ones(len(rows))])

    @contextmanager
    def opened():
        yield detect

    return Detector("COCO_17", opened)


def test_a_recording_is_made_of_a_video_and_can_be_refined(clip, tmp_path):
    recording, warnings = recording_of_video(clip, 1.75, None, walker(), tmp_path / "recording")
    assert recording.path == tmp_path / "recording" / "recording.toml"
    (source,) = recording.videos
    assert source.path is not None and source.path.samefile(clip)
    assert source.keypoints is not None and not recording.places
    np.testing.assert_allclose(float(source.camera.position_world[2]), PLACE.height, atol=0.1)
    assert f"{USUAL_FOV_DEG:g} degrees" in warnings[0] and "--fov" in warnings[0]
    assert "above the floor" in warnings[1]
    # Once more, into the same folder.
    again, warnings = recording_of_video(clip, 1.75, 50.0, walker(), tmp_path / "recording")
    assert len(warnings) == 1
    focal = float(again.videos[0].camera.matrix[0, 0])
    assert focal == pytest.approx(SIZE[1] / 2 / np.tan(np.radians(25)))


@pytest.mark.parametrize(
    ("height", "fov", "found", "expected"),
    [
        (9.0, None, True, "--height"),
        (1.75, 170.0, True, "--fov: found 170, expected 5 to 150"),
        (1.75, None, False, "found nobody in any frame"),
    ],
)
def test_what_cannot_be_is_refused(clip, tmp_path, height, fov, found, expected):
    with pytest.raises(InputError, match=expected):
        recording_of_video(clip, height, fov, walker(found), tmp_path / "recording")


def test_what_is_no_video_is_refused(tmp_path):
    (tmp_path / "noise.mp4").write_bytes(bytes(range(256)) * 20)
    with pytest.raises(InputError, match=r"noise.mp4: is not a video"):
        recording_of_video(tmp_path / "noise.mp4", 1.75, None, walker(), tmp_path / "recording")


def test_without_a_detector_the_sentence_says_how_to_make_its_environment(
    clip, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert main(["video", str(clip), "--height", "1.75", "--out", "tracked"]) == 2
    sentence = capsys.readouterr().err.splitlines()[-1]
    assert "-m venv mp && mp/bin/pip install mediapipe" in sentence
    assert not (tmp_path / "tracked").exists()


def test_the_recording_within_the_folder_is_not_in_the_way_of_the_outputs(
    clip, tmp_path, monkeypatch, capsys
):
    def follow(recording, *_, warnings_before, **__):
        assert recording.path == tmp_path / "tracked" / "recording" / "recording.toml"
        assert len(warnings_before) == 2
        raise InputError("recording.toml", "enough")

    monkeypatch.setattr(track, "track_silhouettes", follow)
    monkeypatch.setattr(by_mediapipe, "mediapipe_detector", lambda *_: walker())
    given = ["video", str(clip), "--height", "1.75", "--out", str(tmp_path / "tracked")]
    assert main([*given, "--python", "any"]) == 2
    assert capsys.readouterr().err.splitlines()[-1].endswith("recording.toml: enough")
    # But a file of somebody else is.
    (tmp_path / "tracked" / "joints.trc").write_text("mine")

    def nobody(*_):
        raise AssertionError("key points were detected before the folder was refused")

    monkeypatch.setattr(by_mediapipe, "mediapipe_detector", lambda *_: Detector("COCO_17", nobody))
    assert main([*given, "--python", "any"]) == 2
    assert "joints.trc" in capsys.readouterr().err.splitlines()[-1]


def test_a_folder_behind_a_symbolic_link_finds_the_video(clip, tmp_path):
    (tmp_path / "deep" / "er").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "deep" / "er")
    recording, _ = recording_of_video(clip, 1.75, 60.0, walker(), tmp_path / "link" / "recording")
    assert recording.videos[0].path.samefile(clip)


@pytest.mark.parametrize(
    ("metadata", "expected"),
    [
        ({}, None),
        ({"com.apple.quicktime.camera.focal_length.35mm_equivalent": "26"}, 69.4),
        ({"com.apple.quicktime.camera.focal_length.35mm_equivalent": "none"}, None),
        ({"com.apple.quicktime.camera.focal_length.35mm_equivalent": "0"}, None),
    ],
)
def test_a_phones_lens_is_read_from_its_file(metadata, expected):
    found = file_fov_deg(SimpleNamespace(metadata=metadata))  # type: ignore[arg-type]
    assert found == (expected if expected is None else pytest.approx(expected, abs=0.1))
