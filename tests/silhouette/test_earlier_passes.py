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
from jaxmocap.silhouette.recovery import relocation
from jaxmocap.silhouette.recovery.relocation import (
    LOST_FRAMES,
    remember_frame,
    slim,
    withdraw_joints,
)
from jaxmocap.silhouette.segmentation.outlines import Outlines
from jaxmocap.silhouette.state import PoseEstimate, RecentFrame, StepReport
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


# What later frames withdraw -----------------------------------------------------------------------


JOINTS = 3
NONE = np.zeros(JOINTS, bool)


def only(joint: int) -> np.ndarray:
    return np.arange(JOINTS) == joint


def step(moved: np.ndarray = NONE, hidden: np.ndarray = NONE) -> StepReport:
    """A frame that tells of all joints that are not hidden, of each as much as 1."""
    information, is_free = 1.0 * ~hidden, np.append(np.ones(ROOT_DOF, bool), ~hidden)
    nothing, outlines = np.zeros(0), Outlines(("contour",), "level sets", None)  # type: ignore[arg-type]
    return StepReport(
        nothing, nothing, 0.0, nothing, is_free, np.diag(information), information,
        outlines, moved, hidden, "pairs",
    )  # type: ignore[arg-type]  # fmt: skip


def information_without(constants, body, hidden, pose, pairs, measured):
    """What is left of a frame: of its whole pairs, given the frame's pose and markers."""
    assert pairs == "pairs" and pose == measured
    return SimpleNamespace(information=np.diag(1.0 * ~hidden), slope=1.0 * ~hidden)


@pytest.fixture
def kept(monkeypatch):
    """What a pass keeps of some steps."""
    monkeypatch.setattr(relocation, "information_without", information_without)

    def run(*steps: StepReport) -> list[StepReport]:
        reports, recent = [], ()
        for number, each in enumerate(steps):
            if each.relocated.any():
                recent = withdraw_joints(None, None, recent, each.relocated)  # type: ignore[arg-type]
                reports[len(reports) - len(recent) :] = [slim(frame.report) for frame in recent]
            recent = remember_frame(recent, RecentFrame(each, number, number))  # type: ignore[arg-type]
            reports.append(slim(each))
        return reports

    return run


def determined(reports: list[StepReport]) -> list[list[bool]]:
    """Of which joints each frame tells; the same by all that says so."""
    for each in reports:
        np.testing.assert_array_equal(np.diag(each.information), each.slope)
        np.testing.assert_array_equal(each.observed[ROOT_DOF:], each.slope > 0)
        np.testing.assert_array_equal(each.hidden, each.slope == 0)
        assert each.observed[:ROOT_DOF].all()
    return [list(each.slope > 0) for each in reports]


def test_what_frames_told_of_a_limb_just_before_it_was_found_elsewhere_is_withdrawn(kept):
    before = [step(hidden=only(2)) for _ in range(LOST_FRAMES + 2)]
    expected = [[True, True, False]] * 2 + [[False, True, False]] * LOST_FRAMES + [[True] * 3]
    assert determined(kept(*before, step(moved=only(0)))) == expected


@pytest.mark.parametrize("between", range(LOST_FRAMES + 2))
def test_two_limbs_that_are_found_one_after_the_other_are_both_withdrawn(kept, between):
    frames = [step()] * 5 + [step(moved=only(0))] + [step()] * between + [step(moved=only(1))]
    expected = np.ones((len(frames), JOINTS), bool)
    expected[5 - LOST_FRAMES : 5, 0] = False
    expected[len(frames) - 1 - LOST_FRAMES : -1, 1] = False
    assert determined(kept(*frames)) == expected.tolist()


def test_frames_that_were_told_stay_as_they_are_without_a_move_and_small(kept):
    first, second = kept(step(), step())
    assert determined([first, second]) == [[True] * 3] * 2
    for each in (first, second):
        assert (
            each.outlines.segmentation is None and each.pairs is None and not each.outlines.contours
        )


def test_a_limb_found_in_the_first_frames_withdraws_those_there_are(kept):
    assert determined(kept(step(moved=only(0)), step(moved=only(1)))) == [
        [True, False, True],
        [True] * 3,
    ]
