"""Exercises of a rigged mesh before four cameras: what moves, what stays, what is visible."""

import tracemalloc
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from bench.clips import displaced
from jaxmocap.formats.recordings.recording import load_recording
from jaxmocap.formats.time_series.trc import read_trc
from jaxmocap.geometry.cameras import on_host, project
from jaxmocap.synthetic.four_cameras import (
    cameras_around,
    flexion_angles,
    read_masks,
    write_four_cameras,
    write_truth,
)
from jaxmocap.synthetic.movements import motions
from jaxmocap.synthetic.movements.exercises import EXERCISES, PLANTED, exercise
from jaxmocap.synthetic.people.clothed_person import clothed_actor
from jaxmocap.synthetic.people.rigged_mesh import load_rig
from jaxmocap.synthetic.renderer import exposure

TIMES = np.linspace(0.0, 3.0, 61)
BONES = (("shoulder", "elbow"), ("elbow", "wrist"), ("hip", "knee"), ("knee", "ankle"))


@pytest.fixture(scope="module")
def rig(recordings):
    return load_rig(recordings / "person" / "person.npz")


def bent(rig, name):
    """Degrees by which elbows and knees are bent, over time."""
    angles = flexion_angles(exercise(rig, name).landmarks(TIMES))
    return {hinge: np.degrees(angle) for hinge, angle in angles.items()}


@pytest.mark.parametrize("name", EXERCISES)
def test_an_exercise_keeps_its_bones_moves_smoothly_and_touches_the_floor(rig, name):
    times = np.arange(0, 3, 0.01)
    person = exercise(rig, name)
    points = person.landmarks(times)
    for near, far in BONES:
        for side in "lr":
            lengths = np.linalg.norm(points[f"{far}_{side}"] - points[f"{near}_{side}"], axis=1)
            assert np.ptp(lengths) < 1e-9
    fastest = max(np.linalg.norm(np.diff(path, axis=0), axis=1).max() for path in points.values())
    assert 0.003 < fastest < 0.1
    lowest = np.array([person.vertices(TIMES[i : i + 1])[..., 2].min() for i in range(0, 61, 6)])
    highest = 0.25 if name == "jumping" else 0.05
    assert lowest.min() > -0.06 and lowest.max() < highest


def test_push_ups_bend_elbows_over_hands_that_stay(rig):
    points = exercise(rig, "push_ups").landmarks(TIMES)
    for side, place in zip("lr", PLANTED, strict=True):
        assert np.abs(points[f"wrist_{side}"] - place).max() < 0.01
    angles = bent(rig, "push_ups")
    assert angles["elbow_l"].max() > 90 and angles["elbow_l"].min() < 50
    assert angles["knee_l"].max() < 15


def test_sit_ups_bend_the_trunk_and_keep_the_knees_bent(rig):
    points, angles = exercise(rig, "sit_ups").landmarks(TIMES), bent(rig, "sit_ups")
    assert np.ptp(points["head"][:, 2]) > 0.3
    assert 80 < angles["knee_l"].min() < angles["knee_l"].max() < 115


def test_the_turn_is_half_a_turn_towards_the_first_camera(rig):
    points = exercise(rig, "turn").landmarks(TIMES)
    left = points["hip_l"] - points["hip_r"]
    assert left[0, 1] < 0 < left[-1, 1]
    assert points["pelvis"][-1, 0] - points["pelvis"][0, 0] > 0.8


def test_a_jump_leaves_the_floor_and_scissors_cross_the_legs(rig):
    toes = exercise(rig, "jumping").landmarks(TIMES)
    assert min(toes["toe_l"][:, 2].max(), toes["toe_r"][:, 2].max()) > 0.15
    legs = exercise(rig, "scissors").landmarks(TIMES)
    apart = legs["ankle_l"][:, 1] - legs["ankle_r"][:, 1]
    assert apart.max() > 0.5 and apart.min() < 0
    in_front = (legs["ankle_l"] - legs["ankle_r"])[apart < 0, 0]
    assert in_front.max() > 0.2 and in_front.min() < -0.2


def test_a_pose_that_is_off_is_off_by_so_much(rig):
    person = exercise(rig, "arm_raises")
    away = displaced(person, np.random.default_rng(0), degrees=5.0, metres=0.03)
    R, joints = person.rig(TIMES[:20])
    R_off, joints_off = away.rig(TIMES[:20])
    foot, elbow = (person.body.names.index(name) for name in ("LeftFoot", "LeftForeArm"))
    moved = np.linalg.norm(joints_off[:, elbow] - joints[:, elbow], axis=-1)
    assert 0.01 < moved.mean() < 0.2
    turned = np.einsum("tij,tij->t", R[:, foot], R_off[:, foot])
    assert 1.0 < np.degrees(np.arccos((turned - 1) / 2)).mean() < 25.0
    shifted = displaced(person, np.random.default_rng(0), degrees=0.0)
    shift = shifted.rig(TIMES)[1] - person.rig(TIMES)[1]
    np.testing.assert_allclose(np.linalg.norm(shift, axis=-1), 0.03, atol=1e-9)


def test_an_unknown_exercise_is_refused_with_the_valid_ones(rig):
    with pytest.raises(ValueError, match=r"planks.*push_ups, sit_ups"):
        exercise(rig, "planks")


def test_a_mask_is_where_the_person_changes_the_picture(rig):
    person, time = exercise(rig, "scissors"), 1.0
    view = cameras_around(person, 0.3)[1]
    scene = view.scene(person, 0)
    scene.background[:] = (0, 255, 0)
    image = exposure(scene, time)
    away = (image[..., 0] > 10) | (image[..., 2] > 10)
    mask = view.mask(person, time)
    assert (away & mask).sum() / (away | mask).sum() > 0.95
    # Away from the outline both agree wholly, but for what movement blurs.
    kernel = np.ones((9, 9), np.uint8)
    assert away[cv2.erode(mask.astype(np.uint8), kernel) > 0].mean() > 0.999
    assert not away[cv2.dilate(mask.astype(np.uint8), kernel) == 0].any()


def test_four_synchronous_videos_and_the_truth_are_written(rig, tmp_path):
    person, done = exercise(rig, "walking"), []
    path = write_four_cameras(tmp_path, person, 0.07, progress=lambda *counts: done.append(counts))
    recording, truth = load_recording(path), read_trc(tmp_path / "truth.trc")
    assert done == [(i, 8) for i in range(1, 9)]
    assert [video.offset for video in recording.videos] == [0.0] * 4
    points = person.landmarks(truth.times)
    knee = truth.positions[:, truth.names.index("knee_l")]
    np.testing.assert_allclose(knee, points["knee_l"], atol=2e-6)
    masks = read_masks(tmp_path / "truth_masks.npz")
    for video in recording.videos:
        mask = masks[video.camera_name]
        assert mask.shape == (2, 480, 640)
        # A pelvis is deep within the body, seen from anywhere.
        x, y = np.rint(project(on_host(video.camera), points["pelvis"][0])).astype(int)
        assert mask[0, y - 4 : y + 5, x - 4 : x + 5].all() and 0.02 < mask.mean() < 0.4
    with np.load(tmp_path / "truth_angles.npz") as angles:
        np.testing.assert_allclose(angles["knee_l"], flexion_angles(points)["knee_l"])


def test_true_masks_of_many_frames_are_in_memory_as_bits(tmp_path):
    """As bytes a minute of four cameras would be a gigabyte."""
    view = SimpleNamespace(name="cam", mask=lambda _, time: np.full((480, 640), time > 0.5))
    person, times = motions.squat(1.0), np.arange(120) / 120
    tracemalloc.start()
    write_truth(tmp_path, person, times, (view,))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 120 * 480 * 640 / 2
    masks = read_masks(tmp_path / "truth_masks.npz")["cam"]
    np.testing.assert_array_equal(masks.all((1, 2)), times > 0.5)


def test_whoever_moves_can_be_seen_by_four_cameras(tmp_path):
    actor = clothed_actor(motions.squat(1.0))
    path = write_four_cameras(tmp_path, actor, 0.04)
    assert len(load_recording(path).videos) == 4
    assert {"elbow_l", "knee_r"} < set(np.load(tmp_path / "truth_angles.npz"))
