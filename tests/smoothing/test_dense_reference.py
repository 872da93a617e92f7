"""About a second of a motion, smoothed, against all residuals stacked and solved densely."""

from dataclasses import replace
from functools import cache

import jax
import numpy as np
import pytest
from conftest import double, in_double
from painted_motion import CAMERAS, MODEL, PERSON, pose_at, views
from references import smoothing as reference

import jaxmocap
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.evidence.keypoints import SightLines
from jaxmocap.evidence.terms import Measurements
from jaxmocap.hybrid.settings import Settings
from jaxmocap.reference import kinematics
from jaxmocap.smoothing.functions import Events
from jaxmocap.smoothing.linearise import smooth_poses
from jaxmocap.smoothing.problem import SmoothingProblem, Trajectory
from jaxmocap.smoothing.settings import LASTING_HZ, SmoothingSettings
from jaxmocap.smoothing.uncertainty import with_deviations
from jaxmocap.solvers.status import Status

# Of the deviations, what the solve alone leaves uncertain.
SETTINGS = SmoothingSettings(iterations=60, mismatch=0.0)
TIMES = np.array([0.0, 0.12, 0.25, 0.36, 0.52, 0.63, 0.8])
ROUNDS = 16


def crouching(time: float) -> Pose:
    """Both arms move, one of them bent beyond its range; bent legs stay clear of theirs."""
    pose = pose_at(time)
    angles = pose.angles.copy()
    bent = {"hip_flexion": 15, "knee_flexion": 30}
    for name, degrees in bent.items():
        for side in "lr":
            angles[PERSON.tree.joint(f"{name}_{side}")] = np.radians(degrees)
    angles[PERSON.tree.joint("elbow_flex_r")] = np.radians(153)
    return pose._replace(angles=angles)


@cache
def problem() -> reference.Problem:
    """Three noisy markers, key points of a camera, two elbows; some of each are missing."""
    rng = np.random.default_rng(0)
    body = jax.tree.map(np.asarray, MODEL)
    poses = [crouching(time) for time in TIMES]
    frames = [kinematics.forward(body.skeleton, pose) for pose in poses]
    points = np.array([kinematics.landmark_positions(body.skeleton, each) for each in frames])
    markers = [kinematics.site_positions(body.skeleton, each, body.markers) for each in frames]
    markers = np.array(markers) + 0.002 * rng.normal(size=(len(TIMES), 3, 3))
    markers[2, 1] = markers[5] = np.nan
    elbows = points[:, [LANDMARKS.index(f"elbow_{side}") for side in "lr"]]
    elbows = elbows + 0.01 * rng.normal(size=elbows.shape)
    elbows[:6] = np.nan
    origin = np.tile(np.asarray(CAMERAS[0].position_world, float), (len(TIMES), 1, 1))
    ways = points[:, None] + 0.005 * rng.normal(size=points[:, None].shape) - origin[:, :, None]
    ways = ways / np.linalg.norm(ways, axis=-1, keepdims=True)
    sure = rng.uniform(0.2, 1, ways.shape[:-1])
    sure[:, :, ::3] = 0.0
    ways[:, :, ::3] = np.nan
    measured = {
        "markers": markers,
        "upright": np.zeros((len(TIMES), 2)),
        "facing": np.tile([1.0, 0.0, 0.0], (len(TIMES), 1)),
        "ankles": points[:, [LANDMARKS.index(f"ankle_{side}") for side in "lr"]],
        "elbows": elbows,
        "sight_lines": SightLines(origin, ways, sure, np.full_like(sure, np.nan)),
    }
    start = Pose(*(np.stack(part) for part in zip(*poses, strict=True)))
    start = start._replace(angles=start.angles + 0.02 * rng.normal(size=start.angles.shape))
    return reference.Problem(body, SETTINGS, TIMES, measured, start)


def points_of(dense: reference.Problem, x: np.ndarray) -> np.ndarray:
    """Landmarks (T, 3 L)."""
    count = 3 * len(LANDMARKS)
    return np.array([reference.frame_values(dense, x, t)[-count:] for t in range(len(TIMES))])


def test_the_public_smoothers_poses_are_at_the_dense_minimum():
    """There Gauss and Newton's step, and so the gradient, vanishes; nowhere near is it cheaper."""
    with double():
        events = in_double(Events(TIMES, Measurements(**problem().measured), problem().start))
        model, settings = in_double((MODEL, Settings(smoothing=SETTINGS)))
        actual = jax.jit(jaxmocap.smooth)(model, settings, events)
    there = problem()._replace(
        start=Pose(*(np.asarray(part) for part in actual.poses)),
        persistence=1 / (np.mean(np.diff(TIMES)) * LASTING_HZ),
    )
    still = np.zeros(actual.poses.angles.size + 6 * len(TIMES))
    np.testing.assert_allclose(
        actual.points.reshape(len(TIMES), -1), points_of(there, still), atol=1e-9
    )
    assert np.abs(reference.step(there, still)).max() < 1e-6
    least, rng = np.sum(reference.residuals(there, still) ** 2), np.random.default_rng(0)
    for _ in range(5):
        aside = rng.normal(0, 1e-3, still.shape)
        assert np.sum(reference.residuals(there, aside) ** 2) > least


@pytest.fixture
def double_in_all_threads():
    """Batches of frames go through two of them."""
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


@pytest.mark.usefixtures("double_in_all_threads")
def test_a_recordings_minimum_and_its_deviations_are_the_dense_ones():
    """With two proportions that all frames share."""
    dense = problem()._replace(shared=2)
    model, settings = in_double((MODEL, SETTINGS))
    given = SmoothingProblem(model, settings, TIMES, Measurements(**dense.measured), views(1).none)
    start = Trajectory(dense.start, np.zeros(dense.shared))
    # A solve ends with a step of a hundredth of a millimetre; another goes on from there.
    begun = smooth_poses(given, start, (0.8,), 1e-14)
    ended = smooth_poses(given, begun.trajectory, (0.8,), 1e-14)
    actual = with_deviations(given, ended.trajectory, 0.8)
    assert ended.status == Status.CONVERGED
    expected = reference.minimum(dense, ROUNDS)
    there = dense._replace(start=actual.poses)
    still = np.append(0 * expected[: -dense.shared], actual.proportions)
    assert ended.cost == pytest.approx(np.sum(reference.residuals(there, still) ** 2), rel=1e-9)
    assert ended.cost == pytest.approx(np.sum(reference.residuals(dense, expected) ** 2), rel=1e-9)
    np.testing.assert_allclose(points_of(there, still), points_of(dense, expected), atol=1e-6)
    np.testing.assert_allclose(actual.proportions, expected[-dense.shared :], atol=1e-6)
    # Of habits that last, and of key points whose errors are alike, many count once.
    lasting, keypoints = float(SETTINGS.persistence) * LASTING_HZ, SETTINGS.keypoints
    lines = np.sqrt(keypoints.redundancy) * keypoints.deviation
    once = replace(SETTINGS, keypoints=replace(keypoints, deviation=lines))
    sure = reference.deviations(there._replace(persistence=lasting, settings=once), still)
    np.testing.assert_allclose(actual.deviations, sure, rtol=1e-4)
