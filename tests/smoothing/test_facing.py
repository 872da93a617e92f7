"""Where somebody faces by the markers: in time, where the markers' own poses are late."""

import jax
import numpy as np
import pytest
from conftest import on_device
from painted_motion import MODEL, PERSON, SETTINGS, measurements, places_of, truth
from scipy.spatial.transform import Rotation

from jaxmocap.body.pose import Pose
from jaxmocap.evidence.terms import Measurements
from jaxmocap.smoothing.facing import average_over_time, facing_in_time, references

COUNT, LATE_S = 72, 0.5
TIMES = np.arange(COUNT) / 30


def turning(times: np.ndarray) -> np.ndarray:
    """To the left and to the right, radians."""
    return np.radians(25) * np.sin(2 * np.pi * times / 2.4)


def turned(angles: np.ndarray) -> Pose:
    """The motion (T, ...), by (T,) radians about the vertical through the pelvis."""
    poses = truth(COUNT)
    own = Rotation.from_quat(poses.quaternion, scalar_first=True)
    about_vertical = Rotation.from_rotvec(angles[:, None] * [0.0, 0.0, 1.0])
    quaternions = (about_vertical * own).as_quat(scalar_first=True)
    return Pose(poses.position, quaternions.astype(np.float32), poses.angles)


def aside(ahead: np.ndarray) -> np.ndarray:
    """Degrees (T,) from where the trunk faces."""
    found = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    return np.degrees(np.abs(found - turning(TIMES)))


@pytest.fixture(scope="module")
def late() -> tuple[Pose, Measurements]:
    """The markers' own poses, that follow late, and what is measured."""
    markers = np.asarray(places_of(on_device(turned(turning(TIMES)))))
    poses = turned(turning(TIMES - LATE_S))
    return poses, references(PERSON, TIMES, poses)._replace(
        markers=markers, elbows=measurements(COUNT).elbows
    )


def test_all_markers_at_once_face_where_the_shoulders_do_and_their_poses_did_before(late):
    _, measured = late
    assert aside(measured.facing).mean() > 10
    poses, measured = late
    ahead = facing_in_time(MODEL, SETTINGS, TIMES, measured, poses)
    np.testing.assert_allclose(np.linalg.norm(ahead, axis=-1), 1, atol=1e-5)
    assert (ahead[:, 2] == 0).all()
    assert aside(ahead).mean() < 0.6 * aside(measured.facing).mean()


def test_events_between_frames_face_between_them(late):
    every = np.arange(COUNT).repeat(3)
    times = np.arange(3 * COUNT) / 90
    poses, measured = (jax.tree.map(lambda part: np.asarray(part)[every], x) for x in late)
    ahead = facing_in_time(MODEL, SETTINGS, times, measured, poses)
    assert ahead.shape == (3 * COUNT, 3)
    assert np.abs(np.diff(np.arctan2(ahead[:, 1], ahead[:, 0]))).max() < np.radians(5)


@pytest.mark.parametrize("offset", [0.002, 0.016, 0.031])
def test_averages_are_over_seconds_wherever_frames_lie_between_samples(offset):
    samples = np.arange(300) / 30
    times = np.sort(np.concatenate([samples, samples + offset]))
    values = np.sin(times)[:, None]
    averaged = average_over_time(values, times, 0.5)
    # A Gaussian takes exp(-(deviation w)^2 / 2) off a wave.
    inner = (times > 2) & (times < 8)
    np.testing.assert_allclose(averaged[inner], np.exp(-0.125) * values[inner], atol=0.01)
