"""Where cameras should stand: derivatives, what a camera adds, where the search ends."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import complaint, double
from scipy.optimize import approx_fprime

from jaxmocap.body.kinematics import Sites, joined_sites
from jaxmocap.body.skeleton import ELBOWS, LANDMARKS
from jaxmocap.calibration.fitting.camera_plan.expected import of_markers
from jaxmocap.calibration.fitting.camera_plan.placement import (
    Bounds,
    CameraPlace,
    Frame,
    Goal,
    Ring,
    best_place,
    camera_at,
    error_and_slope,
    error_at,
    frame_of,
    mean_deviation,
    penalty,
)
from jaxmocap.cli.setup import plan
from jaxmocap.geometry.cameras import Camera, camera_of_fov, project
from jaxmocap.geometry.lenses import BROWN_CONRADY, FISHEYE, LENSES
from jaxmocap.hybrid.settings import Settings
from jaxmocap.pipelines.planning.requirements import Requirements, fov_deg
from jaxmocap.pipelines.planning.results import in_words
from jaxmocap.pipelines.planning.subject import Subject, drawn_subject, movement_of, settings_for
from jaxmocap.synthetic.drawing_camera import look_at
from jaxmocap.synthetic.movements.motions import MOTIONS, table_tennis

AHEAD = CameraPlace(2.6, 0.0, 1.3, np.pi, -0.1, 0.0)
WALLS = Bounds(
    CameraPlace(-3.0, -3.0, 0.4, -6.3, -1.2, 0.0), CameraPlace(3.0, 3.0, 2.2, 6.3, 1.2, 0.0)
)


def lens() -> Camera:
    """In the precision of the test that asks."""
    return camera_of_fov((640, 480), 60.0)


def numbers(*place: float) -> CameraPlace:
    """As the search has them: weakly typed, they would be compiled once more."""
    return CameraPlace(*np.array(place, float))


@pytest.fixture(scope="module", autouse=True)
def doubled():
    """Differences need double precision."""
    with double():
        yield


@pytest.fixture(scope="module")
def subject(doubled) -> Subject:
    """Somebody who plays table tennis."""
    return drawn_subject(table_tennis(4.0, 0, height=1.75), 1.75)


def goal_of(subject: Subject) -> Goal:
    """The elbows of a part of the movement that is quickly computed."""
    moments = movement_of(subject)
    few = jax.tree.map(lambda part: part[:1, :4], (moments.poses, moments.measured))
    moments = moments._replace(times=moments.times[:4], poses=few[0], measured=few[1])
    settings = settings_for(subject.model, Settings().smoothing, moments)
    information = of_markers(subject.model, settings, moments)
    frame = frame_of(information, np.asarray(moments.measured.facing))
    weights = jnp.zeros(len(LANDMARKS)).at[ELBOWS].set(0.5)
    rate = jnp.asarray(30.0)
    return Goal(subject.model.skeleton, settings, information, frame, lens(), rate, weights)


@pytest.fixture(scope="module")
def goal(subject) -> Goal:
    return goal_of(subject)


def without_camera(goal: Goal) -> float:
    return float(mean_deviation(goal.settings, goal.information, goal.weights))


@pytest.mark.parametrize(
    "place", [(2.3, 0.9, 1.3, -2.8, -0.1, 0.1), (-1.2, -1.9, 0.7, 1.1, 0.2, 0)]
)
def test_derivatives_by_a_cameras_place_angles_and_lens_are_those_of_differences(goal, place):
    place = numbers(*place)
    _, slope = error_and_slope(goal, place)
    for name, step in zip(CameraPlace._fields, (1e-4,) * 6, strict=True):
        ends = [
            float(error_at(goal, place._replace(**{name: getattr(place, name) + sign * step})))
            for sign in (-1, 1)
        ]
        difference = (ends[1] - ends[0]) / (2 * step)
        assert abs(float(getattr(slope, name)) - difference) < 1e-4 + 0.002 * abs(difference), name


def test_a_camera_makes_the_elbows_surer_and_one_that_looks_away_does_not(goal):
    alone = without_camera(goal)
    assert float(error_at(goal, numbers(*AHEAD))) < 0.6 * alone
    away = AHEAD._replace(yaw=0.0)
    assert float(error_at(goal, numbers(*away))) == pytest.approx(alone, rel=0.01)


def test_twice_the_frames_are_worth_more(goal):
    place = numbers(*AHEAD)
    often = goal._replace(rate=2 * goal.rate)
    assert float(error_at(often, place)) < float(error_at(goal, place))


def test_trackers_on_the_elbows_leave_little_and_a_second_one_on_a_bone_is_none(subject):
    worn = subject.with_markers_at(("elbow_l", "elbow_r"))
    assert without_camera(goal_of(worn)) < 0.03
    assert worn.with_markers_at(("elbow_l",)) is None
    # An ankle is where the shank ends, and a wrist's marker leaves the elbow free.
    tree, model = subject.model.skeleton.tree, subject.model
    bones = np.array([tree.bone("tibia_l"), tree.bone("radius_l")], np.int32)
    ends = Sites(bones, jnp.ones(2, model.dtype), jnp.zeros((2, 3), model.dtype))
    measured = np.concatenate([subject.measured, np.ones((len(subject.measured), 2), bool)], 1)
    markers = joined_sites(model.markers, ends)
    wearing = subject._replace(model=replace(model, markers=markers), measured=measured)
    assert wearing.with_markers_at(("ankle_l", "ankle_r")) is None
    assert wearing.with_markers_at(("elbow_l", "elbow_r")) is not None


def test_a_marker_that_is_missing_is_worth_nothing(subject, goal):
    left = [
        i
        for i, bone in enumerate(subject.model.markers.bones)
        if bone == subject.model.skeleton.tree.bone("hand_l")
    ]
    measured = subject.measured.copy()
    measured[:, left] = False
    assert without_camera(goal_of(subject._replace(measured=measured))) > without_camera(goal)


def test_a_camera_stands_and_looks_as_the_person_has_it():
    frame = Frame(1.0, -2.0, np.radians(90.0))
    camera = camera_at(lens(), frame, numbers(2.0, 1.0, 1.5, np.pi, 0.0, np.log(2.0)))
    # Who faces +y has +y ahead and -x to the left.
    np.testing.assert_allclose(camera.position_world, [0.0, 0.0, 1.5], atol=1e-6)
    expected = look_at((0.0, 0.0, 1.5), (0.0, -5.0, 1.5))
    np.testing.assert_allclose(camera.T_cam_world, expected.T_cam_world, atol=1e-6)
    assert float(camera.matrix[0, 0]) == pytest.approx(2 * float(lens().matrix[0, 0]))


def test_the_descent_ends_between_the_walls_no_worse_than_it_began(goal):
    start = numbers(2.9, 0.6, 1.3, np.pi, -0.1, 0.0)
    before = float(error_at(goal, start))
    ring = Ring(jax.tree.map(lambda each: np.array([float(each)]), start), np.array([before]))
    found = best_place(goal, WALLS, ring, lambda share: None)
    assert found.error <= before
    place, low, high = (np.array(each, float) for each in (found.place, *WALLS))
    assert (place >= low - 1e-6).all() and (place <= high + 1e-6).all()
    assert found.place.distance > 1.5


@pytest.mark.parametrize("place", [(0.9, 0.4, 1.3, -2.3, 0, 0), (-2.0, 1.1, 1.3, 0.2, 0, 0)])
def test_being_too_near_and_looking_aside_cost_by_their_slope(place):
    value, slope = penalty(np.array(place))
    assert value > 0
    difference = approx_fprime(np.array(place), lambda at: penalty(at)[0], 1e-6)
    np.testing.assert_allclose(slope, difference, atol=1e-5)


@pytest.mark.parametrize(
    ("place", "words"),
    [
        (AHEAD, "2.6 m away, straight ahead, 1.3 m high, looks 6° down"),
        (
            CameraPlace(1.0, 1.0, 1.0, np.radians(-135.0), 0.0, 0.0),
            "1.4 m away, 45° to the left, 1.0 m high, looks level",
        ),
        (
            CameraPlace(-2.0, -0.0, 1.0, np.radians(10.0), 0.2, 0.0),
            "2.0 m away, straight behind, 1.0 m high, looks 11° up, the person 10° right of the "
            "image's middle",
        ),
        (
            AHEAD._replace(yaw=np.pi - 0.1, pitch=0.0),
            "2.6 m away, straight ahead, 1.3 m high, looks level, the person 6° left of the "
            "image's middle",
        ),
    ],
)
def test_a_place_in_words(place, words):
    assert in_words(place) == words
    if "middle" in words:
        camera = camera_at(lens(), Frame(0.0, 0.0, 0.0), numbers(*place))
        middle = (np.asarray(camera.size) - 1) / 2
        is_right = bool(project(camera, jnp.array([0.0, 0.0, 1.0]))[0] > middle[0])
        assert is_right == ("right of" in words)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (["--joints", "elbow"], "--joints: found 'elbow', expected elbows, wrists"),
        (["--room", "0.5,0.5,0.5,0.5"], "--room: leaves no place 1.6 m from the person"),
        (["--room", "-1,2,2,2"], "--room: found -1, expected distances from 0 on"),
        (["--heights", "2,1"], "--heights: found 2 and 1, expected the lower first"),
        (["--fov", "2"], "--fov: found 2, expected 5 to 150 degrees"),
        (["--rate", "1e9"], "--rate: found 1e+09, expected 1 to 10000 frames a second"),
        (["--cameras", "9"], "--cameras: found 9, expected 1 to 4"),
        (["--height", "17"], "--height: height = 17.0: expected metres between"),
        (["--out", "plan.txt"], "plan.txt: found '.txt', expected .png, .svg, .pdf"),
    ],
)
def test_what_cannot_be_planned_is_refused_in_a_sentence(
    options, sentence, refusal, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert sentence in refusal("plan", *options)


def test_the_command_names_all_movements():
    assert tuple(MOTIONS) == plan.MOVEMENTS


def test_pairs_of_joints_have_a_plural():
    required = replace(Requirements(), joints=("knees", "toe_l", "vertex"))
    assert required.landmarks() == ("knee_l", "knee_r", "toe_l", "vertex")
    assert "'spleens'" in complaint(replace(Requirements(), joints=("spleens",)).landmarks)


def test_a_zoom_lens_is_the_wider_one_with_room_to_zoom():
    wide, zoom = replace(Requirements(), fov_deg=(30.0, 90.0)).lens(())
    half = float(wide.size[0]) / 2 / float(wide.matrix[0, 0])
    assert np.degrees(2 * np.arctan(half)) == pytest.approx(90.0, abs=1e-3)
    assert np.degrees(2 * np.arctan(half / np.exp(zoom))) == pytest.approx(30.0, abs=1e-3)


def test_a_fisheye_s_field_of_view_is_its_own():
    size, matrix = (1200, 900), np.array([[350.0, 0, 600], [0, 350, 450], [0, 0, 1]])
    cameras = [
        Camera.create(size, matrix, (), np.eye(3), np.zeros(3), lens=lens) for lens in LENSES
    ]
    found = {camera.lens: fov_deg(camera, across=True) for camera in cameras}
    assert found[FISHEYE] == pytest.approx(np.degrees(1200 / 350))
    assert found[BROWN_CONRADY] == pytest.approx(np.degrees(2 * np.arctan(600 / 350)))
