"""Synthetic recordings: hard for a tracker, true to their own figures, the same for a seed."""

from itertools import pairwise
from pathlib import Path

import av
import cv2
import ezc3d
import jax
import numpy as np
import pytest
from gait_person import BODY_MARKERS, mesh_person, write_person_recording
from gait_person import MARKERS as GAIT_MARKERS
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxmocap.body.kinematics import Frames
from jaxmocap.body.mass import centre_of_gravity
from jaxmocap.body.skeleton import WINTER, Skeleton
from jaxmocap.formats.recordings.recording import load_recording
from jaxmocap.formats.time_series.trc import read_trc
from jaxmocap.geometry.cameras import on_host, project
from jaxmocap.synthetic import recording, renderer
from jaxmocap.synthetic.movements import motions
from jaxmocap.synthetic.movements.splines import Spline
from jaxmocap.synthetic.people.clothed_person import MARKERS, clothed_actor
from jaxmocap.synthetic.people.figure import Posture
from jaxmocap.synthetic.people.meshes import QuadMesh
from jaxmocap.synthetic.renderer import RotatedMover, Scene, camera_at, render_frames

RECORDINGS = Path(__file__).parents[3] / "shared" / "recordings"

SECONDS = 6.0
TIMES = np.arange(0, SECONDS, 1 / 90)
BONES = (
    *(("shoulder", "elbow", "humerus"), ("elbow", "wrist", "radius"), ("wrist", "hand", "hand")),
    *(("hip", "knee", "femur"), ("knee", "ankle", "tibia"), ("ankle", "toe", "foot")),
)
PERFORMANCES = {
    "table tennis": lambda seed: motions.table_tennis(SECONDS, seed),
    "squat": lambda seed: motions.squat(SECONDS, seed),
    "reaching": lambda seed: motions.reaching(SECONDS, seed),
    "across": lambda seed: motions.across(SECONDS, seed),
    "raises": lambda seed: motions.raises(SECONDS, seed),
    "thrust": lambda seed: motions.thrust(SECONDS, seed, azimuth=40.0),
}


@pytest.fixture(scope="module", params=PERFORMANCES)
def performance(request):
    return PERFORMANCES[request.param](0)


@pytest.fixture(scope="module")
def scene():
    camera = recording.webcam()
    return Scene.in_room(camera, clothed_actor(motions.table_tennis(SECONDS, 0), 0), 0)


def test_bones_keep_their_lengths(performance):
    points = performance.landmarks(TIMES)
    for near, far, bone in BONES:
        for side in "lr":
            lengths = np.linalg.norm(points[f"{far}_{side}"] - points[f"{near}_{side}"], axis=1)
            np.testing.assert_allclose(
                lengths, performance.figure.length(f"{bone}_{side}"), atol=1e-9
            )


def test_frames_are_rotations_and_joints_hang_together(performance):
    joints, R = performance.bones(TIMES)
    np.testing.assert_allclose(
        R @ R.swapaxes(-1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-9
    )
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-9)
    far = joints + np.einsum("tbij,bj->tbi", R, performance.figure.reaches)
    for i, parent in enumerate(performance.figure.skeleton.tree.parents):
        if parent >= 0:
            np.testing.assert_allclose(joints[:, i], far[:, parent], atol=1e-9)


def test_feet_stay_planted(performance):
    points = performance.landmarks(TIMES)
    for name in ("ankle_l", "ankle_r", "toe_l", "toe_r"):
        assert np.ptp(points[name], axis=0).max() < 1e-9


def test_limbs_differ_from_the_tables_by_up_to_three_percent(performance):
    figure = performance.figure
    ratio = np.asarray(
        figure.skeleton.lengths / Skeleton.human(figure.height, proportions=WINTER).lengths
    )
    assert np.abs(ratio - 1).max() <= motions.LIMB_VARIATION + 1e-6
    assert np.ptp(ratio) > 0.02


def swivels_deg(performance, times: np.ndarray) -> np.ndarray:
    """(T, 2) of the left and the right elbow."""
    channels = Posture.split(performance.curves(times))
    return np.rad2deg(np.stack([channels.swivel_l, channels.swivel_r], -1))


@pytest.mark.parametrize("seed", range(4))
def test_elbows_swivel_by_forty_degrees_either_way_between_strokes(seed):
    performance = motions.table_tennis(SECONDS, seed)
    assert len(performance.starts) >= 4
    strikes = swivels_deg(performance, performance.starts[:4] + 0.8)
    for earlier, later in pairwise(strikes):
        assert (np.abs(later - earlier) >= 80).all()


def test_elbows_are_never_where_the_relaxed_pose_has_them(performance):
    # The relaxed pose's swivel is 0 by the definition of swivel.
    assert swivels_deg(performance, TIMES).min() > 8


def test_the_elbow_lies_at_its_swivel_about_the_arm():
    figure = motions.table_tennis(1.0).figure
    still = motions.Posture(reach_l=(0.0, 0.0, -0.8), reach_r=(0.0, 0.0, -0.8))
    for swivel, expected_l in ((0.0, (-1, 0)), (90.0, (0, 1)), (-90.0, (0, -1))):
        posture = motions.replace(still, swivel_l=swivel, swivel_r=swivel)
        curve = Spline(np.array([0.0, 1.0]), np.stack([posture.channels()] * 2))
        performance = motions.Performance(figure, curve, np.zeros(1))
        points, bones = performance.landmarks(np.zeros(1)), performance.bones(np.zeros(1))
        R_chest = bones.R_world_bone[0, figure.skeleton.tree.bone("spine3")]
        for side, mirror in (("l", 1), ("r", -1)):
            shoulder, elbow, wrist = (
                points[f"{n}_{side}"][0] for n in ("shoulder", "elbow", "wrist")
            )
            axis = (wrist - shoulder) / np.linalg.norm(wrist - shoulder)
            bend = elbow - shoulder - (elbow - shoulder) @ axis * axis
            bend = R_chest.T @ bend / np.linalg.norm(bend)
            np.testing.assert_allclose(bend[:2], np.multiply(expected_l, (1, mirror)), atol=0.06)


def test_strokes_are_as_fast_as_a_players():
    points = motions.table_tennis(SECONDS, 0).landmarks(TIMES)
    speeds = {
        name: np.linalg.norm(np.diff(points[name], axis=0), axis=1).max() * 90
        for name in ("wrist_r", "elbow_r")
    }
    assert 3.0 < speeds["wrist_r"] < 6.0
    assert 1.5 < speeds["elbow_r"] < 4.0


def test_the_squat_goes_down_by_thirty_centimetres_and_stays_over_the_feet():
    performance = motions.squat(SECONDS)
    points, bones = performance.landmarks(TIMES), performance.bones(TIMES)
    assert 0.28 < np.ptp(points["pelvis"][:, 2]) < 0.36
    skeleton = performance.figure.skeleton
    for i in range(0, len(TIMES), 45):
        frames = Frames(
            *(
                np.asarray(part, np.float32)
                for part in (points["pelvis"][i], bones.R_world_bone[i])
            ),
            np.asarray(bones.joints_world[i], np.float32),
            np.zeros((len(skeleton.tree.joints), 3), np.float32),
        )
        x = float(centre_of_gravity(skeleton, frames)[0])
        # Heels reach some 5 cm behind the ankles.
        assert points["ankle_r"][i, 0] - 0.05 < x < points["toe_l"][i, 0]


def test_an_unknown_stroke_is_refused_with_the_valid_ones():
    with pytest.raises(ValueError, match=r"smash.*forehand, backhand, serve"):
        motions.table_tennis(1.0, strokes=("smash",))


@given(st.lists(st.floats(-1, 1), min_size=3, max_size=8), st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_splines_pass_through_their_keys_and_are_twice_smooth(values, seed):
    steps = np.random.default_rng(seed).uniform(0.2, 1.0, len(values) - 1)
    times = np.concatenate([[0.0], np.cumsum(steps)])
    curve = Spline(times, np.array(values)[:, None])
    bend = 1 + np.abs(curve.derivative(2)(times)).max()
    np.testing.assert_allclose(curve(times)[:, 0], values, atol=1e-9)
    h = 1e-4
    for t in times[1:-1]:
        y = curve(t + h * np.arange(-2, 3))[:, 0]
        before, after = (y[0] - 2 * y[1] + y[2]) / h**2, (y[2] - 2 * y[3] + y[4]) / h**2
        assert abs(after - before) < 1e-2 * bend
    ends = np.array([times[0], times[0] + h, times[-1] - h, times[-1]])
    first, last = np.diff(curve(ends)[:, 0])[[0, 2]] / h
    assert max(abs(first), abs(last)) < 2 * h * bend


def test_the_lens_projects_as_opencv_and_the_package_do():
    camera = recording.webcam()
    lens = on_host(camera)
    points = np.random.default_rng(0).uniform((-1, -1.2, 0.3), (1, 1.2, 2.0), (50, 3))
    rotation = cv2.Rodrigues(lens.T_cam_world[:3, :3])[0]
    expected = cv2.projectPoints(
        points, rotation, lens.T_cam_world[:3, 3], lens.matrix, lens.distortion
    )[0]
    np.testing.assert_allclose(project(lens, points), expected[:, 0], atol=1e-3)
    np.testing.assert_allclose(
        project(lens, points), jax.jit(project)(camera, points.astype(np.float32)), atol=1e-2
    )


def test_marker_noise_stays_within_a_consumer_headsets():
    times = np.arange(0, 60, 1 / 90)
    error = recording.marker_noise(times, 3, np.random.default_rng(0))
    size = np.linalg.norm(error, axis=-1)
    assert size.max() <= recording.LARGEST_ERROR_M + 1e-12
    assert 0.003 < size.mean() < 0.007
    jitter = np.diff(error, axis=0).std() / np.sqrt(2)
    assert 0.0008 < jitter < 0.0013


def test_a_person_stands_where_the_truth_says(scene):
    times = np.linspace(0.2, 5.8, 12)
    lens = on_host(scene.camera)
    points = scene.mover.performance.landmarks(times)
    hits = []
    for i, frame in enumerate(render_frames(scene, times)):
        away = cv2.absdiff(
            cv2.GaussianBlur(frame, (0, 0), 2), cv2.GaussianBlur(scene.background, (0, 0), 2)
        )
        person = away.max(-1) > 22
        for name in ("wrist_l", "wrist_r", "elbow_l", "elbow_r", "shoulder_l", "shoulder_r"):
            x, y = np.rint(project(lens, points[name][i])).astype(int)
            # A few pixels of grace: arms are thin, and some are of the colour behind them.
            hits.append(person[max(y - 3, 0) : y + 4, max(x - 3, 0) : x + 4].any())
        assert 0.03 < person.mean() < 0.5
    assert np.mean(hits) > 0.9


def test_fast_hands_are_blurred_and_slow_ones_are_not(scene, monkeypatch):
    points = scene.mover.performance.landmarks(TIMES)["wrist_r"]
    speed = np.linalg.norm(np.gradient(points, 1 / 90, axis=0), axis=1)[20:-20]
    chosen = np.array([speed.argmax(), speed.argmin()]) + 20
    pixels = np.rint(project(on_host(scene.camera), points[chosen])).astype(int)
    blurred = list(render_frames(scene, TIMES[chosen]))
    monkeypatch.setattr(renderer, "EXPOSURE_S", 1e-6)
    sharp = list(render_frames(scene, TIMES[chosen]))
    fast, slow = (
        np.abs(cv2.absdiff(a, b)[y - 25 : y + 25, x - 25 : x + 25]).mean()
        for a, b, (x, y) in zip(blurred, sharp, pixels, strict=True)
    )
    assert fast > 3 * slow
    assert slow < 3


def test_the_same_seed_gives_the_same_frames_and_another_does_not():
    def frame(seed):
        mover = clothed_actor(motions.table_tennis(2.0, seed), seed)
        return next(render_frames(Scene.in_room(recording.webcam(), mover, seed), np.array([1.1])))

    first = frame(5)
    np.testing.assert_array_equal(first, frame(5))
    assert np.abs(first.astype(int) - frame(6)).mean() > 5


def test_a_recording_is_written_whole_and_read_like_any_other(tmp_path):
    done = []
    path = recording.write_table_tennis(
        tmp_path, seconds=0.4, seed=1, progress=lambda *counts: done.append(counts)
    )
    loaded = load_recording(path)
    assert done[-1] == (12, 12)
    assert loaded.marker_names == tuple(MARKERS)
    assert loaded.positions_world.shape == (36, 3, 3)
    assert loaded.videos[0].offset == recording.VIDEO_OFFSET_S
    with av.open(str(loaded.videos[0].path)) as container:
        frames = [frame.to_ndarray(format="bgr24") for frame in container.decode(video=0)]
    assert len(frames) == 12 and frames[0].shape == (480, 640, 3)
    performance = motions.table_tennis(0.4, 1)
    mover = clothed_actor(performance, 1)
    scene = Scene.in_room(recording.webcam(), mover, 1)
    (drawn,) = render_frames(scene, recording.video_times(0.4)[:1])
    assert np.abs(frames[0].astype(int) - drawn).mean() < 6


def test_the_files_truth_is_the_performers(tmp_path):
    path = recording.write_performance(tmp_path, motions.squat(0.2, 2), 0.2, seed=2)
    truth = read_trc(path.with_name("truth.trc"))
    points = motions.squat(0.2, 2).landmarks(truth.times)
    for i, name in enumerate(truth.names):
        np.testing.assert_allclose(truth.positions[:, i], points[name], atol=2e-6)
    measured = load_recording(path).positions_world
    figure, bones = motions.squat(0.2, 2).figure, motions.squat(0.2, 2).bones(truth.times)
    for i, on in enumerate(MARKERS.values()):
        error = np.linalg.norm(measured[:, i] - figure.points(bones, *on), axis=-1)
        assert 0 < error.max() <= recording.LARGEST_ERROR_M + 1e-5


@pytest.fixture(scope="module")
def server(recordings):
    """The rigged mesh, serving as the tennis player of the C3D file does."""
    file = ezc3d.c3d(str(recordings / "motions" / "tennis_serve.c3d"))
    labels = [name.split(":")[-1] for name in file["parameters"]["POINT"]["LABELS"]["value"]]
    positions = dict(zip(labels, file["data"]["points"][:3].transpose(1, 2, 0), strict=True))
    rate = float(file["header"]["points"]["frame_rate"])
    return positions, mesh_person(
        recordings / "person" / "person.npz", positions, rate, start=2.6, seconds=3.0
    )


def test_a_rigged_mesh_keeps_its_bones_and_follows_the_markers(server):
    positions, person = server
    times = np.arange(0, 2.9, 0.02)
    points = person.landmarks(times)
    for near, far, _ in BONES:
        for side in "lr":
            lengths = np.linalg.norm(points[f"{far}_{side}"] - points[f"{near}_{side}"], axis=1)
            assert np.ptp(lengths) < 1e-9
    at = GAIT_MARKERS.index
    markers = person.markers(times).reshape(len(times), -1, 3)
    for side, s in (("l", "L"), ("r", "R")):
        upper = points[f"elbow_{side}"] - points[f"shoulder_{side}"]
        measured = markers[:, at(s + "ELB")] - markers[:, at(s + "SHO")]
        cosine = np.sum(upper * measured, -1) / np.linalg.norm(upper, axis=-1)
        # Markers lie on the skin, centres some centimetres below it.
        assert np.rad2deg(np.arccos(cosine / np.linalg.norm(measured, axis=-1))).max() < 20
    hips = (points["hip_l"] + points["hip_r"]) / 2
    pelvis = markers[:, [at(n) for n in ("LASI", "RASI", "LPSI", "RPSI")]].mean(1)
    assert np.linalg.norm(hips - pelvis, axis=-1).max() < 0.15
    with pytest.raises(ValueError, match="unknown person 'nobody'"):
        mesh_person_of(positions, who="nobody")
    with pytest.raises(ValueError, match="the markers end"):
        mesh_person_of(positions, start=1e3)


def mesh_person_of(positions, **changed):
    return mesh_person(RECORDINGS / "person" / "person.npz", positions, 50.0, **changed)


def test_joints_of_a_rigged_mesh_lie_within_its_skin(server):
    _, person = server
    times = np.array([0.3, 1.2, 2.5])
    points, vertices = person.landmarks(times), person.vertices(times)
    directions = np.random.default_rng(0).normal(size=(60, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for name in ("elbow_l", "elbow_r", "wrist_l", "knee_r", "shoulder_l"):
        for i in range(len(times)):
            away = vertices[i] - points[name][i]
            near = away[np.linalg.norm(away, axis=-1) < 0.12]
            # Skin on every side, and none of it at the joint itself.
            assert (near @ directions.T).max(0).min() > 0.01
            assert np.linalg.norm(near, axis=-1).min() > 0.01


def test_a_recording_of_a_rigged_mesh_is_read_like_any_other(server, tmp_path):
    _, person = server
    loaded = load_recording(write_person_recording(tmp_path, person, 0.1))
    assert loaded.marker_names == tuple(BODY_MARKERS)
    tree = loaded.skeleton.tree
    points = person.landmarks(np.zeros(1))
    for near, far, bone in BONES[:2]:
        length = np.linalg.norm(points[f"{far}_l"] - points[f"{near}_l"])
        assert abs(float(loaded.skeleton.lengths[tree.bone(f"{bone}_l")]) - length) < 1e-3


# Cameras and floors -------------------------------------------------------------------------------


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
