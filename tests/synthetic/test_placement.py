"""Cameras all around the synthetic person, and movement straight at them."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxmocap.formats.recordings.recording import load_recording
from jaxmocap.formats.time_series.trc import read_trc
from jaxmocap.geometry.cameras import on_host, project
from jaxmocap.synthetic import recording
from jaxmocap.synthetic.movements import motions
from jaxmocap.synthetic.people.meshes import QuadMesh
from jaxmocap.synthetic.renderer import RotatedMover, camera_at, render_frames

ARMS = ("shoulder_l", "shoulder_r", "elbow_l", "elbow_r", "wrist_l", "wrist_r")
MOTIONS = {
    "table tennis": lambda azimuth: motions.table_tennis(6.0, 3),
    "thrust": lambda azimuth: motions.thrust(6.0, 3, azimuth=azimuth),
    "reaching": lambda azimuth: motions.reaching(6.0, 3),
    "squat": lambda azimuth: motions.squat(6.0, 3),
}


class Dots:
    """Points that stand still, each a mesh's vertex without a face."""

    def __init__(self, points: np.ndarray):
        self.points, on_root, ones = points, np.zeros((len(points), 1), int), np.ones(len(points))
        nothing = np.zeros((0, 4), int)
        self.mesh = QuadMesh(points, nothing, np.zeros((0, 3)), on_root, ones[:, None])

    def vertices(self, times: np.ndarray) -> np.ndarray:
        return np.broadcast_to(self.points, (len(times), *self.points.shape))


@given(st.floats(-180, 180), st.integers(0, 1000))
def test_a_turned_person_looks_as_from_a_turned_camera(azimuth, seed):
    points = np.random.default_rng(seed).uniform((-0.8, -0.8, 0), (0.8, 0.8, 2), (20, 3))
    pixels = project(on_host(camera_at(azimuth)), points)
    turned = RotatedMover(Dots(points), azimuth).vertices(np.zeros(1))[0]
    np.testing.assert_allclose(pixels, project(on_host(camera_at(0.0)), turned), atol=5e-3)


def test_positive_azimuths_are_to_the_persons_left():
    left = on_host(camera_at(60.0)).position_world
    assert left[1] > 1 and left[0] > 1  # who faces +x has +y to the left
    assert on_host(camera_at(0.0)).position_world[1] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("azimuth", [-60.0, 0.0, 60.0])
def test_the_whole_person_is_in_view_from_every_side(motion, azimuth):
    scene = recording.scene(MOTIONS[motion](azimuth), 3, azimuth)
    pixels = project(on_host(scene.camera), scene.mover.vertices(np.arange(0, 6, 0.2)))
    assert pixels.min() > 0
    assert (pixels < np.array([639, 479])).all()


@pytest.mark.parametrize("azimuth", [-60.0, 30.0])
def test_the_arms_are_where_the_files_say_from_every_side(tmp_path, azimuth):
    path = recording.write_table_tennis(tmp_path, 0.1, 3, azimuth=azimuth)
    (source,) = load_recording(path).videos
    truth = read_trc(path.with_name("truth.trc")).points()
    scene = recording.scene(motions.table_tennis(0.1, 3), 3, azimuth)
    (frame,) = render_frames(scene, recording.video_times(0.1)[:1])
    away = cv2.absdiff(
        cv2.GaussianBlur(frame, (0, 0), 2), cv2.GaussianBlur(scene.background, (0, 0), 2)
    )
    person = away.max(-1) > 22
    hits = []
    for name in ARMS:
        x, y = np.rint(project(on_host(source.camera), truth[name][0])).astype(int)
        hits.append(person[y - 3 : y + 4, x - 3 : x + 4].any())
    assert np.mean(hits) > 0.8


@pytest.mark.parametrize("azimuth", [-60.0, 0.0, 45.0])
def test_thrusts_go_straight_at_the_camera_and_take_the_elbows_along(azimuth):
    times = np.arange(0, 6, 1 / 90)
    points = motions.thrust(6.0, 1, azimuth=azimuth).landmarks(times)
    camera = on_host(camera_at(azimuth)).position_world
    for name, share, depth in (("wrist", 0.95, 0.45), ("elbow", 0.6, 0.45)):
        for side in "lr":
            path = points[f"{name}_{side}"]
            line_of_sight = camera - path.mean(0)
            line_of_sight /= np.linalg.norm(line_of_sight)
            velocity = np.diff(path, axis=0)
            assert np.sum((velocity @ line_of_sight) ** 2) > share * np.sum(velocity**2)
            assert np.ptp(path @ line_of_sight) > depth


def test_without_an_azimuth_the_camera_is_the_webcam():
    performance = motions.table_tennis(0.1, 0)
    frontal, usual = (recording.scene(performance, 0, azimuth) for azimuth in (0.0, None))
    np.testing.assert_array_equal(usual.camera.T_cam_world, recording.webcam().T_cam_world)
    assert np.abs(np.asarray(frontal.camera.T_cam_world - usual.camera.T_cam_world)).max() > 0.1


def test_a_thrust_is_written_with_its_camera(tmp_path):
    performance = motions.thrust(0.1, azimuth=-30.0)
    path = recording.write_performance(tmp_path, performance, 0.1, azimuth=-30.0)
    (source,) = load_recording(path).videos
    np.testing.assert_allclose(
        source.camera.position_world, camera_at(-30.0).position_world, atol=1e-5
    )
