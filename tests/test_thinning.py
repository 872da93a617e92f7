"""Some events stand for all: which, with what weight, and the motion in between."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from painted_motion import pose_at

from jaxmocap.body.pose import Pose
from jaxmocap.hybrid.smoothing_settings import SmoothingSettings
from jaxmocap.hybrid.trajectory import Trajectory
from jaxmocap.run.thinning import BRIDGING_S, SPARSE_S, at_all_events, some_events, standing_for_all


@given(st.integers(0, 10_000), st.integers(1, 3))
def test_some_events_have_all_cameras_both_ends_and_no_long_gap(seed, cameras):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.001, 0.04, 120))
    seen = rng.uniform(size=(120, cameras)) < rng.uniform(0, 0.5, cameras)
    rows = some_events(times, seen)
    assert rows[0] == 0 and rows[-1] == 119 and (np.diff(rows) > 0).all()
    assert np.diff(times[rows]).max() <= 2 * BRIDGING_S + 0.04
    for of_camera in seen.T:
        # No frame is farther from one that was chosen than frames may lie apart.
        chosen = times[rows[of_camera[rows]]]
        away = [np.abs(chosen - time).min() for time in times[of_camera]]
        assert max(away, default=0) <= SPARSE_S


def test_of_thirty_frames_a_second_every_other_is_looked_at():
    times = np.arange(240) / 120
    seen = (np.arange(240) % 4 == 0)[:, None]
    rows = some_events(times, seen)
    np.testing.assert_array_equal(rows[:-1], np.arange(0, 240, 8))


def test_some_events_weigh_against_calmness_and_each_other_as_all_do():
    every = SmoothingSettings.create()
    some = standing_for_all(every, 1 / 8, 1 / 2)
    # Each event stands for eight, each sight for two, as against one event for one sight.
    assert float((some.acceleration / every.acceleration) ** 2) == pytest.approx(8)
    for name in ("silhouette", "goal", "keypoints"):
        ratio = float(getattr(some, name) / getattr(every, name))
        assert ratio**2 == pytest.approx(4)
    assert float(every.proportions / some.proportions) == pytest.approx(4)
    same = standing_for_all(every, 1.0, 1.0)
    assert float(same.acceleration) == float(every.acceleration)


def test_the_motion_in_between_is_that_of_the_poses():
    times = np.arange(60) / 90
    truth = Pose._make(np.stack(part) for part in zip(*map(pose_at, times), strict=True))
    rows = some_events(times, (np.arange(60) % 3 == 0)[:, None])
    some = Pose._make(np.asarray(part)[rows].astype(np.float32) for part in truth)
    # Either sign of a quaternion is the same rotation.
    np.asarray(some.quaternion)[::2] *= -1
    found = at_all_events(times, rows, Trajectory(some, np.zeros(2, np.float32)))
    assert len(rows) < 25
    np.testing.assert_allclose(found.poses.position, truth.position, atol=2e-3)
    np.testing.assert_allclose(found.poses.angles, truth.angles, atol=0.02)
    same = np.abs(np.sum(found.poses.quaternion * truth.quaternion, 1))
    np.testing.assert_allclose(same, 1, atol=1e-4)
    assert found.poses.angles.dtype == np.float32
