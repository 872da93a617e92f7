"""What an earlier pass found in a frame helps a later one that has lost a limb there."""

from types import SimpleNamespace

import numpy as np
import pytest
from test_lost_limbs import WRIST, begun, four_cameras, lifted
from test_rim import BODY
from test_silhouette_tracker import painted

from jaxmocap.body.pose import Pose
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.evidence.terms import Measurements
from jaxmocap.silhouette import passes
from jaxmocap.silhouette.first_pose import landmark_points
from jaxmocap.silhouette.passes import FrameBundle, run_passes
from jaxmocap.silhouette.segmentation.outlines import Outlines
from jaxmocap.silhouette.state import PoseEstimate
from jaxmocap.silhouette.tracker import SilhouetteTracker

HANGING, UP, ELSEWHERE = lifted(10.0), lifted(150.0), lifted(80.0)
SPEEDS = np.linspace(-2, 2, len(BODY.costs)).astype(np.float32)
ARM = [BODY.tree.joint(name) for name in ("arm_flex_l", "arm_abduct_l", "elbow_flex_l")]


@pytest.fixture(scope="module")
def tracker() -> SilhouetteTracker:
    """That looks for no limb among hypotheses of its own."""
    made = four_cameras()
    made.body.recovery.propose = lambda memory, *_: (None, memory)  # type: ignore[method-assign]
    return made


def after_a_jump(tracker: SilhouetteTracker, earlier: Pose | None = None, expected=None):
    """The step in which an arm that hung down is up, and how far off its wrist is, metres."""
    state = begun(tracker, HANGING)
    for frame in range(2):
        state, _, _ = tracker.step(state, frame / 30, painted(tracker, HANGING))
    before = None if earlier is None else PoseEstimate(earlier, SPEEDS)
    state, pose, report = tracker.step(state, 2 / 30, painted(tracker, UP), None, before, expected)
    actual, true = (np.asarray(landmark_points(BODY, each)[WRIST]) for each in (pose, UP))
    return state, report, np.linalg.norm(actual - true)


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


def test_a_lost_limb_is_where_key_points_have_it(tracker):
    """In the very next frame, without an earlier pass or a search."""
    _, report, off = after_a_jump(tracker, expected=UP)
    assert off < 0.1 and not report.relocated.any()


def test_an_arm_that_both_passes_have_in_place_is_left_alone(tracker):
    state = begun(tracker, UP)
    for frame in range(2):
        shown = frame / 30, painted(tracker, UP), None, PoseEstimate(lifted(147.0), SPEEDS)
        state, _, report = tracker.step(state, *shown)
        assert not report.relocated.any()


def track_by(step, shape=None):
    """A tracker that steps so, of one camera that shows somebody in every frame."""
    shape = SimpleNamespace(surface=None, skeleton=BODY) if shape is None else shape
    constants = SimpleNamespace(
        settings=SimpleNamespace(settling_steps=0), cameras=SimpleNamespace(size=[0])
    )
    return SimpleNamespace(
        constants=constants, body=SimpleNamespace(shape=shape), step=step,
        init=lambda pose, body=None, backgrounds=(): SimpleNamespace(
            body=body, backgrounds=tuple(backgrounds), _replace=lambda **_: None
        ),
        body_pixels=lambda state: np.zeros((1, 1, 2)), reshape_person=lambda body, *_: body,
    )  # fmt: skip


def test_each_pass_steps_each_frame_with_what_the_one_before_it_found(monkeypatch):
    """Frame by frame; the first pass has none."""
    steps, region = [], SimpleNamespace(origin=np.zeros((1, 2)), scale=np.zeros(1))

    class Report(SimpleNamespace):
        used, hidden, revised = np.ones(1, bool), np.zeros(1, bool), ()
        outlines = Outlines((), SimpleNamespace(phi=np.zeros((1, 8, 8))), region)  # type: ignore[arg-type]
        pairs = None

        def _replace(self, **_):
            return self

    class After(SimpleNamespace):
        body, backgrounds = None, (None,)

        def _replace(self, **_):
            return self

    def step(state, time, images, measured, earlier, expected):
        steps.append(earlier)
        pose = np.full(1, float(len(steps)))
        return After(pose=pose, velocity=time + np.zeros(1)), pose, Report()

    estimator = SimpleNamespace(estimate=lambda: (None, None))
    monkeypatch.setattr(passes, "ShapeEstimator", lambda *_: estimator)
    frames, done = [FrameBundle(t, [None], Measurements()) for t in (0.0, 0.5)], []
    monkeypatch.setattr(passes.PassLearner, "add_frame", lambda *_: None)
    result = run_passes(
        track_by(step), HANGING, lambda: iter(frames), 2, [None],
        progress=lambda *counts: done.append(counts),
    )  # type: ignore[arg-type]  # fmt: skip
    assert steps[:2] == [None, None] and len(steps) == 6
    assert [float(each.pose[0]) for each in steps[2:]] == [1, 2, 3, 4]
    assert [float(each.velocity[0]) for each in steps[2:]] == [0.0, 0.5, 0.0, 0.5]
    assert [float(each.pose[0]) for each in result.estimates] == [5, 6]
    assert done == [(count, 6) for count in range(1, 7)]
