"""Poses by 2-D key points alone: one camera, the stature and the floor place a walker."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_rim import BODY

from jaxmocap.body.motion import landmarks_over_time
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS, landmark_rows
from jaxmocap.evidence.keypoints import lines_of_sight
from jaxmocap.geometry.cameras import project
from jaxmocap.silhouette.keypoint_poses import (
    INDEPENDENT,
    SPEED,
    KeypointPoseSettings,
    measurements,
    poses_of_lines,
    weigh_by_scatter,
)
from jaxmocap.solvers.viterbi import cheapest_path
from jaxmocap.synthetic.drawing_camera import look_at

NAMES = tuple(
    f"{joint}_{side}"
    for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    for side in "lr"
)
COUNT, NOISE_PX = 8, 2.0
TIMES = np.arange(COUNT) / 10
CAMERA = look_at((2.0, -3.5, 1.4), (0.0, 0.0, 0.9))


def walker() -> Pose:
    """Eight moments of somebody who walks across the image, ankles 7 cm above the floor."""
    joints = BODY.tree.joints
    angles = np.tile(np.asarray(BODY.relaxed), (COUNT, 1))
    swing = 0.35 * np.sin(2 * np.pi * TIMES)
    for side, sign in (("l", 1.0), ("r", -1.0)):
        angles[:, joints.index(f"hip_flexion_{side}")] = sign * swing
        angles[:, joints.index(f"arm_flex_{side}")] = -sign * swing
        angles[:, joints.index(f"knee_flexion_{side}")] = 0.15
    upright = np.tile([1.0, 0.0, 0.0, 0.0], (COUNT, 1))
    place = np.stack([0.3 * TIMES, 0.2 * TIMES, 0 * TIMES], 1)
    pose = Pose(place, upright, angles)
    lowest = landmarks_over_time(BODY, _as_arrays(pose))[
        :, landmark_rows(("ankle_l", "ankle_r")), 2
    ].min(1)
    place[:, 2] = 0.07 - lowest
    return _as_arrays(pose)


def _as_arrays(pose: Pose) -> Pose:
    return jax.tree.map(lambda part: jnp.asarray(part, BODY.lengths.dtype), pose)


@pytest.fixture(scope="module")
def truth() -> np.ndarray:
    """(T, L, 3) metres."""
    return landmarks_over_time(BODY, walker())


@pytest.fixture(scope="module")
def found(truth):
    """By one camera, one frame of which shows nobody and one elbow of which is far off once."""
    rows = landmark_rows(NAMES)
    pixels = np.asarray(project(CAMERA, jnp.asarray(truth[:, rows], float)))
    pixels = pixels + np.random.default_rng(0).normal(0, NOISE_PX, pixels.shape)
    sure = np.ones(pixels.shape[:2])
    pixels[3], sure[3] = np.nan, 0.0
    pixels[5, NAMES.index("elbow_l")] += 150.0
    lines = lines_of_sight(CAMERA, NAMES, pixels, sure)
    return poses_of_lines(BODY, TIMES, lines, KeypointPoseSettings())


def test_a_walker_before_one_camera_is_found_in_the_world(truth, found):
    points, rows = landmarks_over_time(found.skeleton, found.poses), landmark_rows(NAMES)
    off = np.linalg.norm(points - truth, axis=-1)[:, rows]
    hips = landmark_rows(("hip_l", "hip_r"))
    about = [each - each[:, hips].mean(1, keepdims=True) for each in (points, truth)]
    aligned = np.linalg.norm(about[0] - about[1], axis=-1)[:, rows]
    assert off.mean() < 0.10 and aligned.mean() < 0.07


def test_frames_in_which_left_is_taken_for_right_do_not_turn_the_person(truth):
    rows = landmark_rows(NAMES)
    pixels = np.array(project(CAMERA, jnp.asarray(truth[:, rows], float)))
    other = [NAMES.index(name[:-1] + {"l": "r", "r": "l"}[name[-1]]) for name in NAMES]
    pixels[5:] = pixels[5:, other]
    lines = lines_of_sight(CAMERA, NAMES, pixels, np.ones(pixels.shape[:2]))
    swapped = poses_of_lines(BODY, TIMES, lines, KeypointPoseSettings())
    points = landmarks_over_time(swapped.skeleton, swapped.poses)
    assert np.linalg.norm(points - truth, axis=-1)[:, rows].mean() < 0.10
    # Their lines are given back the right way round.
    left, right = landmark_rows(("hip_l", "hip_r"))
    np.testing.assert_array_equal(
        swapped.lines.directions[5:, 0, left], lines.directions[5:, 0, right]
    )
    np.testing.assert_array_equal(swapped.lines.directions[:5, 0], lines.directions[:5, 0])


def test_a_frame_without_key_points_lies_between_its_neighbours(found):
    places = np.asarray(found.poses.position)
    np.testing.assert_allclose(places[3], (places[2] + places[4]) / 2, atol=0.03)


def test_lengths_hardly_change_by_few_frames(found):
    change = np.log(np.asarray(found.skeleton.lengths) / np.asarray(BODY.lengths))
    assert np.abs(change).max() < 0.12


def test_the_path_takes_the_dearer_minimum_where_the_cheaper_one_is_a_jump():
    here, there = np.zeros((2, 3)), np.ones((2, 3))
    points = np.stack([np.stack([here, there])] * 3)
    costs = np.array([[0.0, 9.0], [1.0, 0.0], [0.0, 9.0]])
    flat, speed = points.reshape(3, 2, -1), SPEED * np.sqrt(2 / INDEPENDENT)
    assert cheapest_path(costs, flat, np.arange(3) / 10, speed).tolist() == [0, 0, 0]
    # Within a minute anybody goes so far.
    assert cheapest_path(costs, flat, 60.0 * np.arange(3), speed).tolist() == [0, 1, 0]


def test_a_landmark_that_scatters_counts_less(truth):
    """By as much as it lies off in the median; never more than the detector says itself."""
    pixels = np.asarray(project(CAMERA, jnp.asarray(truth[:, landmark_rows(NAMES)], float)))
    lines = lines_of_sight(CAMERA, NAMES, pixels, np.full(pixels.shape[:2], 0.8))
    moved = truth.copy()
    wrist = LANDMARKS.index("wrist_l")
    moved[:, wrist, 2] += 0.06
    after = np.asarray(weigh_by_scatter(moved, lines, 0.015).confidences)[:, 0]
    others = [row for row in landmark_rows(NAMES) if row != wrist]
    np.testing.assert_allclose(after[:, others], 0.8)
    assert 0.15 < after[0, wrist] < 0.35 and after[0, LANDMARKS.index("vertex")] == 0


def test_what_the_terms_ask_for_says_nothing_of_where_the_pelvis_faces():
    lines = lines_of_sight(CAMERA, NAMES, np.zeros((2, len(NAMES), 2)), np.ones((2, len(NAMES))))
    measured = measurements(lines)
    assert not measured.facing.any() and not measured.upright.any()
    assert len(LANDMARKS) == lines.directions.shape[2]
