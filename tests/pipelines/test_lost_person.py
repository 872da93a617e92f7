"""``silhouette track`` says what it cannot know, before and after."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_point_rays import ring

from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.cli.program import main
from jaxmocap.evidence.keypoints import lines_of_sight
from jaxmocap.formats.cameras.calibration import write_calibration
from jaxmocap.formats.cameras.video_sources import VideoSource
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.recording import Recording, write_recording
from jaxmocap.pipelines.silhouettes.keypoints import (
    check_determined,
    keypoint_distances,
    lost_sentences,
    lost_status,
)
from jaxmocap.synthetic.drawing_camera import look_at
from jaxmocap.synthetic.recording import write_video

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
