"""The markers' own poses in time and backwards: where somebody who turns fast faces."""

import numpy as np
import pytest
from painted_motion import PERSON, places_of
from scipy.spatial.transform import Rotation

from jaxmocap import Recording, Settings, first_pass
from jaxmocap.body.pose import Pose, halfway, relaxed_pose
from jaxmocap.formats.recordings.recording import write_recording
from jaxmocap.formats.time_series.csv import write_csv
from jaxmocap.smoothing.facing import without_hysteresis

RATE, SECONDS = 60, 3.0
TIMES = np.arange(0, SECONDS, 1 / RATE)
WRISTS = {"LWrist": "radius_l", "RWrist": "radius_r"}
PLACES = {"Head": "head"} | WRISTS


def turning(times: np.ndarray) -> np.ndarray:
    """Half a turn on the spot in a second and a half, radians."""
    share = np.clip((times - 0.75) / 1.5, 0, 1)
    return np.pi * share**2 * (3 - 2 * share)


def turned(angles: np.ndarray) -> Pose:
    """Somebody at ease (T, ...), by (T,) radians about the vertical."""
    at_ease = relaxed_pose(PERSON)
    quaternions = Rotation.from_rotvec(angles[:, None] * [0.0, 0.0, 1.0]).as_quat(scalar_first=True)
    count = len(angles)
    position = np.tile([0.0, 0.0, 0.92], (count, 1)).astype(np.float32)
    return Pose(position, quaternions.astype(np.float32), np.tile(at_ease.angles, (count, 1)))


@pytest.mark.parametrize("way", [1, -1])
def test_who_turns_fast_faces_where_the_hands_do(tmp_path, way):
    """By steps in time alone the trunk was 50 degrees late."""
    points = np.asarray(places_of(turned(way * turning(TIMES))))
    write_csv(
        tmp_path / "markers.csv", TIMES, dict(zip(PLACES, points.swapaxes(0, 1), strict=True))
    )
    places = {marker: {"bone": bone, "at": 1.0} for marker, bone in PLACES.items()}
    subject = {"height": 1.75, "proportions": "winter"}
    path = write_recording(tmp_path, "markers.csv", places, subject=subject)
    events = first_pass(Recording.load(path), Settings(refine="none"), progress=False)
    x, y, _ = np.asarray(events.measured.facing).T
    late = np.degrees(np.unwrap(np.arctan2(y, x)) - way * turning(TIMES))
    assert np.abs(late).max() < 45


def test_only_fast_turns_are_halfway_to_poses_backwards():
    times = np.arange(300) / 100
    own, other = turned(0 * times), turned(np.radians(np.where(np.abs(times - 1.5) < 0.1, 80, 20)))
    between = without_hysteresis(times, own, other)
    yaw = Rotation.from_quat(between.quaternion, scalar_first=True).as_euler("xyz", degrees=True)[
        :, 2
    ]
    np.testing.assert_allclose(yaw[np.abs(times - 1.5) < 0.09], 40, atol=1e-3)
    # And half a second around them.
    np.testing.assert_allclose(yaw[np.abs(times - 2.0) < 0.05], 10, atol=1e-3)
    np.testing.assert_allclose(yaw[np.abs(times - 1.5) > 0.65], 0, atol=1e-3)


def test_halfway_between_two_turns_is_the_shorter_way():
    one, other = turned(np.radians([170.0, 10.0])), turned(np.radians([-170.0, -30.0]))
    between = halfway(one, other)
    yaw = Rotation.from_quat(between.quaternion, scalar_first=True).as_euler("xyz", degrees=True)[
        :, 2
    ]
    np.testing.assert_allclose(np.abs(yaw[0]), 180, atol=1e-3)
    np.testing.assert_allclose(yaw[1], -10, atol=1e-3)
