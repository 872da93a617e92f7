"""What an earlier pass found in a frame helps a later one that has lost a limb there."""

from types import SimpleNamespace

import numpy as np
import pytest
from test_lost_limbs import WRIST, in_known_rooms, lifted
from test_rim import BODY
from test_silhouette_tracker import painted

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import ROOT_DOF
from jaxmocap.pipelines.silhouettes import track
from jaxmocap.silhouette.first_pose import landmark_points
from jaxmocap.silhouette.state import PoseEstimate
from jaxmocap.silhouette.tracker import SilhouetteTracker

pytestmark = pytest.mark.usefixtures("plainly_compiled")
HANGING, UP, ELSEWHERE = lifted(10.0), lifted(150.0), lifted(80.0)
SPEEDS = np.linspace(-2, 2, len(BODY.costs)).astype(np.float32)
ARM = [BODY.tree.joint(name) for name in ("arm_flex_l", "arm_abduct_l", "elbow_flex_l")]


@pytest.fixture(scope="module")
def tracker() -> SilhouetteTracker:
    """That looks for no limb among hypotheses of its own."""
    made = in_known_rooms()
    made._doubter.propose = lambda doubts, *_: (None, doubts)  # type: ignore[method-assign]
    return made


def after_a_jump(tracker: SilhouetteTracker, earlier: Pose | None):
    """The step in which an arm that hung down is up, and how far off its wrist is, metres."""
    state = tracker.init(HANGING)
    for frame in range(2):
        state, _, _ = tracker.step(state, frame / 30, painted(tracker, HANGING))
    before = None if earlier is None else PoseEstimate(earlier, SPEEDS)
    state, pose, report = tracker.step(state, 2 / 30, painted(tracker, UP), None, before)
    found, true = (np.asarray(landmark_points(BODY, each)[WRIST]) for each in (pose, UP))
    return state, report, np.linalg.norm(found - true)


def test_a_lost_limb_is_where_an_earlier_pass_found_it_and_moves_on_as_it_did_there(tracker):
    state, report, off = after_a_jump(tracker, UP)
    assert off < 0.1 and report.relocated[ARM].all()
    np.testing.assert_array_equal(state.velocity[ROOT_DOF:][ARM], SPEEDS[ROOT_DOF:][ARM])
    legs = np.array(["knee" in joint or "hip" in joint for joint in BODY.tree.joints])
    assert not report.relocated[legs].any()
    assert (state.velocity[ROOT_DOF:][legs] != SPEEDS[ROOT_DOF:][legs]).all()


@pytest.mark.parametrize("earlier", [None, ELSEWHERE, HANGING])
def test_where_an_earlier_pass_was_lost_too_its_limbs_are_not_taken(tracker, earlier):
    state, report, off = after_a_jump(tracker, earlier)
    assert off > 0.4 and not report.relocated.any()
    assert (state.velocity[ROOT_DOF:][ARM] != SPEEDS[ROOT_DOF:][ARM]).all()


def test_an_arm_that_both_passes_have_in_place_is_left_alone(tracker):
    state = tracker.init(UP)
    for frame in range(2):
        shown = frame / 30, painted(tracker, UP), None, PoseEstimate(lifted(147.0), SPEEDS)
        state, _, report = tracker.step(state, *shown)
        assert not report.moved.any()


def test_each_pass_is_shown_what_the_one_before_it_found(monkeypatch):
    """Frame by frame; the first pass knows of none."""
    shown, made = [], []

    class Pass(SimpleNamespace):
        count, seen, learners = 2, True, ()

        def __init__(self, *_):
            super().__init__(found=[f"pass {len(made)} frame {i}" for i in range(2)])
            made.append(self)

        def through(self, start, show, earlier):
            shown.append(earlier)

        smoothed = masks = report = lambda self, *_: None

    person = SimpleNamespace(
        finder=SimpleNamespace(surface=None), skeleton=None, rooms=(), become=lambda *_: None,
        settings=None,
    )  # fmt: skip
    parts = {"path": "r", "name": "r", "videos": (), "marker_names": ()}
    recording = SimpleNamespace(**parts, origin_world=np.zeros(3))
    monkeypatch.setattr(track, "make_tracker", lambda *_: person)
    monkeypatch.setattr(track, "_open", lambda *_: (SimpleNamespace(times=[]), ()))
    monkeypatch.setattr(track, "_Pass", Pass)
    monkeypatch.setattr(
        track, "ShapeFinder", lambda *_: SimpleNamespace(fitted=lambda: (None, None))
    )
    track.follow(recording, HANGING, passes=3)  # type: ignore[arg-type]
    assert shown == [None, made[0].found, made[1].found]


def test_a_pass_shows_each_frame_to_the_tracker_with_what_was_found_in_it(monkeypatch):
    steps = []

    def step(state, time, images, markers, earlier):
        steps.append(earlier)
        return SimpleNamespace(velocity=time + np.zeros(1)), np.full(1, time), None

    person = SimpleNamespace(
        rooms=[], settings=SimpleNamespace(settling=0), init=lambda start: start, step=step
    )
    frames = SimpleNamespace(
        videos=[], times=np.array([0.0, 0.5]), indices=np.zeros((2, 0)),
        positions_world=np.zeros((2, 0, 3)),
    )  # fmt: skip
    monkeypatch.setattr(track._Pass, "_keep", lambda *_: None)
    monkeypatch.setattr(track, "Reports", lambda *_: SimpleNamespace(add=lambda *_: None))
    first, second = (track._Pass(person, frames) for _ in range(2))  # type: ignore[arg-type]
    first.through(HANGING, lambda done: None)
    second.through(HANGING, lambda done: None, first.found)
    assert steps == [None, None, *first.found]
    assert [float(each.pose[0]) for each in first.found] == [0.0, 0.5]
    assert [float(each.velocity[0]) for each in first.found] == [0.0, 0.5]
