"""A camera's height, pitch and roll by a person who walks before it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxmocap.body.kinematics import landmarks
from jaxmocap.body.pose import relaxed_pose
from jaxmocap.body.skeleton import Skeleton, landmark_rows
from jaxmocap.calibration.standing_person import ANKLE_M, StandingCamera, camera_by_person
from jaxmocap.calibration.vertical_lines import CameraTilt
from jaxmocap.geometry.cameras import Camera, project

NAMES = tuple(f"{joint}_{side}" for joint in ("shoulder", "hip", "knee", "ankle") for side in "lr")
SIZE, FOCAL = (720, 1280), 1100.0
LENS = Camera.create(SIZE, np.array([[FOCAL, 0, 359.5], [0, FOCAL, 639.5], [0, 0, 1]]))
PERSON = Skeleton.human(1.7)
PROJECT, POINTS = jax.jit(project), jax.jit(landmarks)


def walked(place: StandingCamera, count: int = 30, noise_px: float = 3.0):
    """Pixels (F, P, 2) of somebody upright who walks from 3 to 6 m away."""
    points = np.array(POINTS(PERSON, relaxed_pose(PERSON)))
    points[:, 2] += ANKLE_M - points[landmark_rows(("ankle_l",))[0], 2]
    away = np.linspace(3, 6, count)
    moved = points[landmark_rows(NAMES)] + np.stack([away, 0.2 * away, 0 * away], 1)[:, None]
    pixels = np.asarray(PROJECT(place.stand_camera(LENS), jnp.asarray(moved, float)))
    return pixels + np.random.default_rng(0).normal(0, noise_px, pixels.shape)


@pytest.mark.parametrize(
    ("height", "pitch_deg", "roll_deg"), [(1.5, 8.0, 0.0), (0.9, -4.0, 7.0), (2.2, 20.0, -15.0)]
)
def test_a_camera_is_placed_by_who_walks_before_it(height, pitch_deg, roll_deg):
    place = StandingCamera(height, np.radians(pitch_deg), np.radians(roll_deg), np.zeros(3))
    pixels = walked(place)
    found = camera_by_person(LENS, NAMES, pixels, np.ones(pixels.shape[:2]), PERSON)
    assert found is not None
    assert found.height == pytest.approx(height, abs=0.2)
    assert np.degrees(found.pitch) == pytest.approx(pitch_deg, abs=2.5)
    assert np.degrees(found.roll) == pytest.approx(roll_deg, abs=3.0)
    off = np.abs(np.subtract(found[:3], place[:3]))
    assert (off < 3 * found.deviations).all()


def test_a_tilt_that_lines_have_found_keeps_who_leans_from_turning_the_camera():
    """The person leans by 10 degrees all the time; the room's lines are vertical."""
    place = StandingCamera(1.5, np.radians(12.0), np.radians(6.0), np.zeros(3))
    pixels = walked(place._replace(roll=place.roll + np.radians(10.0)))
    sure = np.ones(pixels.shape[:2])
    tilt = CameraTilt(place.pitch, place.roll, np.radians([1.5, 1.0]))
    found = camera_by_person(LENS, NAMES, pixels, sure, PERSON, tilt=tilt)
    alone = camera_by_person(LENS, NAMES, pixels, sure, PERSON)
    assert found is not None and alone is not None
    assert np.degrees(abs(found.roll - place.roll)) < 2.0
    assert np.degrees(abs(found.pitch - place.pitch)) < 2.0
    assert np.degrees(alone.roll - place.roll) > 5.0


def test_who_bends_in_some_frames_hardly_matters():
    place = StandingCamera(1.5, np.radians(8.0), 0.0, np.zeros(3))
    pixels = walked(place)
    pixels[:6, :2, 1] += 120.0
    found = camera_by_person(LENS, NAMES, pixels, np.ones(pixels.shape[:2]), PERSON)
    assert found is not None and found.height == pytest.approx(1.5, abs=0.2)


@pytest.mark.parametrize("bent", ["knee", "hip"])
def test_frames_of_who_squats_or_bows_are_left_out_where_joints_tell(bent):
    """Most of them: by the pixels alone the camera would be elsewhere, and seem sure."""
    place = StandingCamera(1.3, np.radians(5.0), 0.0, np.zeros(3))
    body, rows = relaxed_pose(PERSON), landmark_rows(NAMES)
    angles, joints = np.array(body.angles), PERSON.tree.joints
    for side in "lr":
        angles[joints.index(f"hip_flexion_{side}")] = 1.2
        angles[joints.index(f"knee_flexion_{side}")] = {"knee": 1.8, "hip": 0.1}[bent]
    upright, low = (
        np.array(POINTS(PERSON, pose))[rows]
        for pose in (body, body._replace(angles=jnp.asarray(angles, body.angles.dtype)))
    )
    points = np.stack([upright, low, low, low, low])[np.arange(30) % 5]
    points[..., 2] += ANKLE_M - points[:, [NAMES.index("ankle_l")], 2]
    points[..., 0] += np.linspace(3, 6, 30)[:, None]
    camera = place.stand_camera(LENS)
    pixels, sure = np.asarray(PROJECT(camera, jnp.asarray(points))), np.ones(points.shape[:2])
    joints_cam = np.asarray(points @ np.asarray(camera.T_cam_world)[:3, :3].T, float)
    found = camera_by_person(LENS, NAMES, pixels, sure, PERSON, joints_cam)
    alone = camera_by_person(LENS, NAMES, pixels, sure, PERSON)
    assert found is not None and alone is not None
    assert found.height == pytest.approx(1.3, abs=0.1)
    assert np.degrees(found.pitch) == pytest.approx(5.0, abs=1.5)
    assert abs(alone.height - 1.3) > 0.3
    nobody = camera_by_person(LENS, NAMES, pixels[1:5], sure[1:5], PERSON, joints_cam[1:5])
    assert nobody is None


def test_who_is_hardly_seen_places_no_camera():
    pixels = walked(StandingCamera(1.5, 0.1, 0.0, np.zeros(3)))
    sure = np.ones(pixels.shape[:2])
    sure[2:, NAMES.index("ankle_l")] = 0.0
    assert camera_by_person(LENS, NAMES, pixels, sure, PERSON) is None
    assert camera_by_person(LENS, NAMES[:4], pixels[:, :4], sure[:, :4], PERSON) is None


def test_a_placed_camera_looks_along_x_from_its_height():
    camera = StandingCamera(1.5, np.radians(10), np.radians(20), np.zeros(3)).stand_camera(LENS)
    np.testing.assert_allclose(np.asarray(camera.position_world), [0, 0, 1.5], atol=1e-6)
    ahead = np.asarray(camera.T_cam_world)[2, :3]
    np.testing.assert_allclose(
        ahead, [np.cos(np.radians(10)), 0, -np.sin(np.radians(10))], atol=1e-6
    )
    # What is above the middle is to its right where the image is turned clockwise.
    above = np.asarray(PROJECT(camera, jnp.asarray([[3.0, 0.0, 1.7]])))[0] - LENS.matrix[:2, 2]
    assert np.degrees(np.arctan2(above[0], -above[1])) == pytest.approx(20.0, abs=1e-3)
