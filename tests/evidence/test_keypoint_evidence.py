"""2-D key points as evidence: lines of sight that decide where nothing else is visible."""

from dataclasses import replace
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import complaint, on_device
from hypothesis import given
from hypothesis import strategies as st
from painted_motion import (
    CAMERAS,
    ELBOWS,
    MODEL,
    PERSON,
    SETTINGS,
    disturbed,
    elbow_errors,
    first_pass,
    measurements,
    points_of,
    problem,
    truth,
    views,
)
from small_recording import CAMERA, PLACES, small_recording

from jaxmocap.body.kinematics import Sites
from jaxmocap.body.model import Model
from jaxmocap.body.motion import landmarks_over_time
from jaxmocap.body.pose import Pose, relaxed_pose, retract
from jaxmocap.body.skeleton import LANDMARKS, landmark_rows
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.capture.timeline import build_timeline
from jaxmocap.capture.video import MemoryVideo
from jaxmocap.evidence.keypoints import (
    EstimatedDepths,
    SightLines,
    estimated_depths,
    line_residuals,
    lines_of_sight,
)
from jaxmocap.evidence.terms import Measurements, posed_body, residuals
from jaxmocap.formats.recordings.keypoints import Detections
from jaxmocap.geometry.cameras import Camera, project
from jaxmocap.pipelines.keypoints.lines import lines_at_events
from jaxmocap.pipelines.tracking.track import track
from jaxmocap.smoothing.batch import smooth_recording
from jaxmocap.smoothing.elbow_viterbi import elbow_path
from jaxmocap.smoothing.linearise import SmoothedPoses, smooth_poses
from jaxmocap.smoothing.problem import SmoothingProblem
from jaxmocap.smoothing.settings import SmoothingSettings
from jaxmocap.smoothing.uncertainty import with_deviations
from jaxmocap.solvers.robust import TAILS

COUNT, SOFTNESS, NOISE_PX = 17, (0.8,), 3.0
NAMES = tuple(name for name in LANDMARKS if name.rstrip("lr_") not in ("hand", "toe"))
SIGMA = float(SETTINGS.keypoints.deviation)
# With the camera of the only video.
FILMED = Model.create(PERSON, MODEL.markers, CAMERAS[0])


@cache
def at_ease() -> np.ndarray:
    """Landmarks (L, 3) of the relaxed pose, world, metres."""
    return points_of(jax.tree.map(lambda part: np.asarray(part)[None], relaxed_pose(PERSON)))[0]


@cache
def detected(camera: int = 0, wrong: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (T, P, 2) and confidences (T, P) of the true landmarks, a share of them wrong."""
    rng = np.random.default_rng(camera)
    points = points_of(truth(COUNT))[:, [LANDMARKS.index(name) for name in NAMES]]
    pixels = np.asarray(project(CAMERAS[camera], jnp.asarray(points)), float)
    pixels += rng.normal(0, NOISE_PX, pixels.shape)
    astray = rng.random(pixels.shape[:2]) < wrong
    pixels[astray] += rng.uniform(-150, 150, (astray.sum(), 2))
    return pixels, rng.uniform(0.6, 1.0, pixels.shape[:2])


def lines(camera: int = 0, wrong: float = 0.0) -> SightLines:
    return lines_of_sight(CAMERAS[camera], NAMES, *detected(camera, wrong))


def by_lines_alone(*cameras: SightLines) -> SmoothingProblem:
    """The motion by markers and lines; cameras that miss, of two, have detected nothing.

    So all problems have the same shapes, and one program.
    """
    blind = lines(1)
    blind = blind._replace(directions=np.nan * blind.directions, confidences=0 * blind.confidences)
    both = (*cameras, blind, blind)[:2]
    joined = jax.tree.map(lambda *parts: np.concatenate(parts, 1), *both)
    measured = measurements(COUNT)._replace(sight_lines=joined)
    return replace(problem(COUNT, views(1).none, measured), model=FILMED)


def smoothed(*cameras: SightLines) -> SmoothedPoses:
    """The disturbed motion, from markers and lines alone."""
    return smooth_poses(by_lines_alone(*cameras), disturbed(COUNT), SOFTNESS)


def errors(actual: SmoothedPoses) -> np.ndarray:
    return elbow_errors(actual.trajectory.poses)


# One line ----------------------------------------------------------------------------------------


LINE_RESIDUALS = jax.jit(line_residuals)


def one_line(confidence: float = 1.0) -> SightLines:
    """Of one camera at the origin that looks at one landmark along x."""
    way = np.array([[[1.0, 0.0, 0.0]]], np.float32)
    sure = np.full((1, 1), confidence, np.float32)
    return SightLines(np.zeros((1, 3), np.float32), way, sure, np.full_like(sure, np.nan))


def cost(off: float, confidence: float = 1.0, along: float = 3.0) -> float:
    point = np.array([[along, off, 0.0]], np.float32)
    return float(np.sum(np.asarray(LINE_RESIDUALS(point, one_line(confidence), SIGMA)) ** 2))


@given(st.floats(0.0, 30.0), st.floats(0.05, 1.0), st.floats(1.0, 8.0))
def test_a_landmark_off_its_line_costs_by_its_deviation_and_confidence(times, confidence, along):
    """Of long tails, and however far it is."""
    expected = TAILS * np.log1p((times * confidence) ** 2 / TAILS)
    assert cost(times * SIGMA, confidence, along) == pytest.approx(expected, rel=1e-3, abs=1e-5)
    assert cost(0.0, along=along) == 0.0


def test_a_landmark_costs_by_how_far_beyond_the_hips_it_is_against_the_detector():
    model, term = Model(PERSON, Sites.none(PERSON.lengths.dtype)), EstimatedDepths()
    pose, camera = relaxed_pose(PERSON), np.array([3.0, 1.0, 1.2], np.float32)
    points = at_ease()
    hips = points[landmark_rows(("hip_l", "hip_r"))].mean(0)
    beyond = (points - hips) @ (hips - camera) / np.linalg.norm(hips - camera)
    off = np.zeros(len(LANDMARKS))
    off[:3] = 0.5, -1.0, 20.0
    depths = beyond - off * float(term.deviation)
    depths[3] = np.nan
    none = np.zeros((1, len(LANDMARKS), 3), np.float32)
    sure = np.ones((1, len(LANDMARKS)), np.float32)
    sure[0, 4], depths[4] = 0.0, 5.0
    lines = SightLines(camera[None], none, sure, depths[None].astype(np.float32))
    body = jax.jit(posed_body)(model, pose)
    actual = jax.jit(term.residual)(model, body, Measurements(sight_lines=lines))[0]
    expected = np.sign(off) * np.sqrt(TAILS * np.log1p(off**2 / TAILS))
    np.testing.assert_allclose(actual, expected, atol=1e-4)
    assert not term.residual(model, body, Measurements()).size


def test_a_detector_s_person_gets_the_limbs_of_ours():
    """Of half their size, in a frame without one of them as well."""
    points = at_ease().astype(float)
    names = ("shoulder_l", "elbow_l", "wrist_l", "hip_l", "knee_l")
    joints = np.tile(0.5 * points[landmark_rows(names)], (3, 1, 1))
    joints[1, 2] = np.nan
    actual = estimated_depths(PERSON, names, joints)
    np.testing.assert_allclose(actual[[0, 2]], [points[landmark_rows(names), 2]] * 2, rtol=1e-5)
    np.testing.assert_allclose(actual[1, :2], points[landmark_rows(names[:2]), 2], rtol=1e-5)
    assert np.isnan(actual[1, 2])
    nobody = estimated_depths(PERSON, names, np.full((2, 5, 3), np.nan))
    assert np.isnan(nobody).all()


@pytest.mark.parametrize("lost", ["confidence", "direction"])
def test_what_was_not_detected_has_no_residual(lost):
    line = one_line()
    if lost == "confidence":
        line = line._replace(confidences=0 * line.confidences)
    else:
        line = line._replace(directions=np.nan * line.directions)
    point = jnp.asarray([[3.0, 0.5, 0.2]])

    def off(point):
        return line_residuals(point, line, jnp.asarray(SIGMA))

    curvature = jax.hessian(lambda point: jnp.sum(off(point) ** 2))
    for function in (off, jax.jacfwd(off), curvature):
        assert not np.asarray(jax.jit(function)(point)).any()


def test_lines_run_through_what_they_were_detected_of():
    points = points_of(truth(COUNT))
    pixels = np.asarray(project(CAMERAS[1], jnp.asarray(points)), float)
    pixels[3, 4] = np.nan
    actual = lines_of_sight(CAMERAS[1], LANDMARKS, pixels, np.ones(pixels.shape[:2]))
    off = np.asarray(LINE_RESIDUALS(points, actual, 1.0))
    assert np.abs(off).max() < 1e-3
    assert actual.confidences[3, 0, 4] == 0 and actual.confidences.sum() == pixels[..., 0].size - 1


# A frame -----------------------------------------------------------------------------------------


# The lines' residuals come last.
FRAME_TERMS = SETTINGS.terms
STILL = np.zeros(ROOT_DOF + len(PERSON.tree.joints), np.float32)


@jax.jit
def moved(step, pose, frame):
    return residuals(FRAME_TERMS, MODEL, retract(pose, step), frame)


def a_frame():
    pose = Pose(*(jnp.asarray(part[3], float) for part in disturbed(COUNT).poses))
    frames = measurements(COUNT)._replace(sight_lines=lines(wrong=0.2))
    return pose, on_device(jax.tree.map(lambda part: part[3], frames))


def test_there_is_no_ray_where_a_lens_folds():
    """OpenCV's iteration ends anywhere there, or in NaN with warnings on the terminal."""
    matrix = np.array([[850.0, 0, 960], [0, 850, 540], [0, 0, 1]])
    folding = Camera.create((1920, 1080), matrix, [-0.30, 0.09, 0.0005, -0.0004, -0.012])
    pixels = np.array([[[960.0, 540.0], [1200.0, 700.0], [1915.0, 1075.0], [1900.0, 1000.0]]])
    names = ("neck", "elbow_l", "elbow_r", "wrist_l")
    found = lines_of_sight(folding, names, pixels, np.ones((1, 4)))
    assert (found.confidences[0, 0, landmark_rows(names)] == [1, 1, 0, 0]).all()


def test_a_frame_without_any_point_costs_what_it_does_without_lines():
    pose, frame = a_frame()
    own, without = frame.sight_lines, frame._replace(sight_lines=None)
    nothing = frame._replace(sight_lines=own._replace(directions=np.nan * own.directions))
    costs = [float(jnp.sum(moved(STILL, pose, each) ** 2)) for each in (nothing, without)]
    assert costs[0] == pytest.approx(costs[1])


# A motion ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def by_lines() -> SmoothedPoses:
    return smoothed(lines())


def test_elbows_that_no_silhouette_shows_are_found_by_key_points(by_lines):
    assert errors(smoothed()).mean() > 0.05
    assert errors(by_lines).mean() < 0.025


def test_wrong_points_and_points_of_no_confidence_do_not_drag(by_lines):
    assert errors(smoothed(lines(wrong=0.05))).mean() < 1.5 * errors(by_lines).mean()
    assert errors(smoothed(lines(wrong=0.2))).mean() < 0.025
    right, astray = lines(), lines(wrong=1.0)
    unsure = np.random.default_rng(5).random(right.confidences.shape) < 0.3
    confidences = np.where(unsure, 0.0, right.confidences).astype(np.float32)
    directions = np.where(unsure[..., None], astray.directions, right.directions)
    mixed = right._replace(directions=directions, confidences=confidences)
    missing = right._replace(directions=np.where(unsure[..., None], np.nan, right.directions))
    np.testing.assert_allclose(errors(smoothed(mixed)), errors(smoothed(missing)), atol=1e-5)


def test_frames_without_points_are_bridged(by_lines):
    directions = lines().directions.copy()
    directions[6:9], directions[12] = np.nan, np.nan
    actual = errors(smoothed(lines()._replace(directions=directions)))
    assert np.isfinite(actual).all() and actual.max() < 0.05
    assert actual.mean() < 2 * errors(by_lines).mean()


def test_two_cameras_find_more_than_one(by_lines):
    assert errors(smoothed(lines(0), lines(1))).mean() < errors(by_lines).mean()


def test_key_points_make_elbows_sure(by_lines):
    sure, unsure = (
        with_deviations(by_lines_alone(*each), by_lines.trajectory, SOFTNESS[-1])
        for each in ([lines()], [])
    )
    assert (sure.deviations[:, ELBOWS] < unsure.deviations[:, ELBOWS]).all()
    assert not sure.from_prior[:, ELBOWS].any() and unsure.from_prior[:, ELBOWS].all()


def test_candidates_for_the_elbows_are_priced_by_key_points_too():
    start, expected = disturbed(COUNT, -25.0), points_of(truth(COUNT))[:, ELBOWS]
    # Candidates are for frames with silhouettes, whose cells have no weight here.
    empty = views(COUNT)
    grids = empty.grids.each_grid(lambda grid: grid._replace(weight=0 * grid.weight))

    def off(*cameras: SightLines) -> float:
        filmed = replace(by_lines_alone(*cameras), views=empty._replace(grids=grids))
        return np.linalg.norm(elbow_path(filmed, start).goals - expected, axis=-1).mean()

    without, with_points = off(), off(lines())
    assert with_points < 0.6 * without


# A recording -------------------------------------------------------------------------------------


def person_and_bystander(recording, frames: int) -> tuple[Detections, np.ndarray]:
    """Both in every frame, the bystander first; and the person's pixels (P, 2)."""
    names = tuple(landmark for _, landmark in PLACES.values())
    there = np.asarray(project(CAMERA, jnp.asarray(recording.positions_world[0], float)))
    both = np.stack([there + np.array([30, 0]), there])
    pixels = np.tile(both, (frames, 1, 1, 1))
    return Detections(np.arange(frames), names, pixels, np.full(pixels.shape[:3], 0.9)), there


def standing_poses(count: int) -> Pose:
    return jax.tree.map(lambda part: np.repeat(np.asarray(part), count, 0), disturbed(1).poses)


def test_the_persons_lines_are_those_of_the_events_frames():
    recording = small_recording()
    recording = replace(
        recording, positions_world=np.tile(recording.positions_world[0], (24, 1, 1))
    )
    timeline = build_timeline(recording.times, [np.arange(12) / 30])
    keypoints, there = person_and_bystander(recording, 12)
    keypoints.pixels_xy[5] = np.nan
    alone = standing_poses(len(timeline.event_times))
    actual = lines_at_events(recording, [keypoints], timeline, alone)
    assert actual is not None and actual.directions.shape == (24, 1, len(LANDMARKS), 3)
    has_frame = timeline.frame_index[:, 0] >= 0
    has_lines = np.asarray(np.isfinite(actual.directions).all(-1))[:, 0].any(-1)
    np.testing.assert_array_equal(has_lines, has_frame & (timeline.frame_index[:, 0] != 5))
    expected = lines_of_sight(CAMERA, keypoints.landmarks, there[None], np.full((1, 5), 0.9))
    np.testing.assert_allclose(actual.directions[0], expected.directions[0], atol=1e-5)
    np.testing.assert_allclose(actual.confidences[0], expected.confidences[0])
    assert lines_at_events(recording, [None], timeline, alone) is None


def test_where_no_marker_sits_on_a_landmark_the_person_is_found_by_the_poses():
    recording = small_recording()
    timeline = build_timeline(recording.times, [np.arange(12) / 30])
    poses = standing_poses(len(timeline.event_times))
    where = landmarks_over_time(recording.skeleton, poses)[0]
    pixels = np.asarray(project(CAMERA, jnp.asarray(where, float)))
    people = np.tile(np.stack([pixels + np.array([40, 0]), pixels]), (12, 1, 1, 1))
    keypoints = Detections(np.arange(12), LANDMARKS, people, np.ones(people.shape[:3]))
    places = tuple(replace(place, at=0.5) for place in recording.places)
    actual = lines_at_events(replace(recording, places=places), [keypoints], timeline, poses)
    assert actual is not None
    expected = lines_of_sight(CAMERA, keypoints.landmarks, pixels[None], np.ones((1, len(pixels))))
    np.testing.assert_allclose(actual.directions[0], expected.directions[0], atol=1e-5)


def test_key_points_count_where_the_frames_of_their_camera_cannot_be_read():
    times = np.arange(COUNT) / 30
    video = MemoryVideo(
        np.append(times, COUNT / 30), [*[None] * COUNT, np.zeros((90, 120, 3), np.uint8)]
    )
    markers, start = measurements(COUNT).markers, disturbed(COUNT).poses
    first = first_pass(
        build_timeline(times, [times]), markers, truth(COUNT), start,
        sight_lines=by_lines_alone(lines(wrong=0.05)).measured.sight_lines,
    )  # fmt: skip
    actual = smooth_recording(FILMED, SmoothingSettings(), first, [video], lambda share: None)
    assert actual is not None
    assert elbow_errors(start).mean() > 0.05 and elbow_errors(actual.poses).mean() < 0.03


def test_key_points_that_do_not_fit_the_video_are_refused_before_anything_is_tracked():
    recording = small_recording()
    wrong = Detections(np.arange(3, 40), ("elbow_l",), np.ones((37, 1, 1, 2)), np.ones((37, 1, 1)))
    source = replace(recording.videos[0], keypoints=wrong)
    assert "keypoints_first" in complaint(track, replace(recording, videos=(source,)), tracker=None)


def test_a_confidence_that_is_no_number_pulls_nowhere():
    points = np.random.default_rng(0).normal(size=(3, 3)).astype(np.float32)
    ways = np.tile(np.float32([0, 0, 1]), (1, 3, 1))
    confidences = np.float32([[1.0, np.nan, 0.5]])
    lines = SightLines(
        np.zeros((1, 3), np.float32), ways, confidences, np.zeros((1, 3), np.float32)
    )
    cost = lambda places: jnp.sum(line_residuals(places, lines, jnp.float32(0.02)) ** 2)  # noqa: E731
    slope = np.asarray(jax.jit(jax.grad(cost))(on_device(points)))
    assert np.isfinite(slope).all() and not slope[1].any() and slope[0].any()


def test_a_detectors_person_is_as_large_by_limbs_that_it_has():
    names = ("hip_l", "knee_l", "ankle_l", "hip_r", "knee_r", "ankle_r")
    rest = at_ease()[landmark_rows(names)]
    half = np.tile(0.5 * rest, (4, 1, 1))
    half[:, -1] = np.nan
    depths = estimated_depths(PERSON, names, half)
    np.testing.assert_allclose(depths[:, :-1], np.tile(rest[:-1, 2], (4, 1)), atol=1e-5)
