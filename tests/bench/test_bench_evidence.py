"""Kinds of evidence, one against another: made key points, flat backgrounds, a quick run."""

from types import SimpleNamespace

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from small_recording import CAMERA, small_recording

from bench import evidence
from bench.clips import Clip
from bench.evidence import flat_frame, flattened
from jaxmocap.body.pose import relaxed_pose
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.capture.footage import open_footage
from jaxmocap.formats.recordings.keypoints import read_keypoints
from jaxmocap.formats.time_series.trc import write_trc
from jaxmocap.geometry.cameras import project
from jaxmocap.images.background_model import Background
from jaxmocap.pipelines.tracking.events import RecordingEvents

FRAMES = 200


def test_made_key_points_lie_near_the_truth_but_for_some(tmp_path):
    times = np.arange(FRAMES) / 30
    points = {
        name: np.full((FRAMES, 3), [0.0, 0.02 * i, 0.3 + 0.05 * i])
        for i, name in enumerate(LANDMARKS)
    }
    write_trc(tmp_path / "truth.trc", times, points)
    same = {name: name for name in LANDMARKS}
    clip = Clip("tennis", "clip", tmp_path / "recording.toml", same, seed=3)
    evidence.write_keypoints(tmp_path / "points", clip, CAMERA, times)
    actual = read_keypoints(tmp_path / "points", evidence.MODEL)
    assert actual.numbers.tolist() == list(range(FRAMES))
    assert {"elbow_l", "elbow_r", "wrist_l", "vertex"} <= set(actual.landmarks)
    true = np.stack(
        [np.asarray(project(CAMERA, jnp.asarray(points[name]))) for name in actual.landmarks], 1
    )
    off = np.linalg.norm(actual.pixels_xy[:, 0] - true, axis=-1)
    assert np.median(off) == pytest.approx(1.18 * evidence.NOISE_PX, rel=0.1)
    assert 0.5 * evidence.FALSE < np.mean(off > 15) < 1.2 * evidence.FALSE
    assert actual.confidences.min() >= 0.19 and actual.confidences.max() <= 1


# A background made flat --------------------------------------------------------------------------


WALL = np.full((120, 160, 3), 90, np.uint8)
WALL[:, ::16] = 150
LEARNED = Background(
    WALL.astype(np.float32), np.full((120, 160), 3.0, np.float32), np.ones((120, 160))
)
BODY = np.s_[30:90, 50:110]


def steepest(image: np.ndarray, where) -> int:
    """The largest difference of neighbouring columns there."""
    return int(np.abs(np.diff(image[where].astype(int), axis=1)).max())


def test_what_is_like_the_background_is_flat_and_what_is_before_it_stays():
    frame = np.clip(WALL + np.random.default_rng(0).normal(0, 2, WALL.shape), 0, 255)
    frame[BODY] = 220
    frame[BODY][:, 25:35] = 180
    frame = frame.astype(np.uint8)
    flat = flat_frame(frame, LEARNED)
    assert flat.shape == frame.shape[:2] and flat.dtype == np.uint8
    assert steepest(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY), np.s_[:, :40]) > 50
    assert steepest(flat, np.s_[:, :40]) < 5 and steepest(flat, np.s_[:, 120:]) < 5
    inner = flat[38:82, 58:102].astype(int)
    np.testing.assert_allclose(
        inner, cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)[38:82, 58:102], atol=1
    )
    # Its border and what is within it are edges as before.
    assert steepest(flat, np.s_[40:80, 40:60]) > 40 and steepest(flat, np.s_[40:80, 60:100]) > 30


@pytest.mark.parametrize("what", ["unknown", "another room"])
def test_what_may_be_another_background_stays_as_it_is(what):
    frame = WALL if what == "unknown" else np.random.default_rng(1).integers(0, 255, WALL.shape)
    nothing = np.zeros_like(LEARNED.certainty)
    background = LEARNED._replace(certainty=nothing) if what == "unknown" else LEARNED
    frame = frame.astype(np.uint8)
    grey = cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)
    np.testing.assert_array_equal(flat_frame(frame, background), grey)


def test_a_flattened_recording_has_its_frames_at_the_same_times():
    recording = small_recording()
    videos, _ = open_footage(recording)
    index = RecordingEvents.of(recording, videos, "own").timeline.frame_index
    pose = relaxed_pose(recording.skeleton)._replace(position=jnp.array([0.0, 0.0, 0.95]))
    poses = jax.tree.map(lambda part: np.tile(part, (len(index), 1)), pose)
    first = SimpleNamespace(poses=poses, frame_index=index)
    flat = flattened(recording, videos, first)  # type: ignore[arg-type]
    (before,), (after,) = videos, open_footage(flat)[0]
    np.testing.assert_array_equal(after.times, before.times)
    for (_, was), (_, now) in zip(before.frames(luma=True), after.frames(luma=True), strict=True):
        assert now.shape == was.shape and steepest(now, np.s_[:, :24]) < steepest(
            was, np.s_[:, :24]
        )
