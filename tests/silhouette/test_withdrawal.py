"""Evidence of a pass's frames, which later ones may contradict."""

from types import SimpleNamespace

import numpy as np
import pytest

from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.silhouette.recovery import relocation
from jaxmocap.silhouette.recovery.relocation import (
    LOST_FRAMES,
    remember_frame,
    slim,
    withdraw_joints,
)
from jaxmocap.silhouette.segmentation.outlines import Outlines
from jaxmocap.silhouette.state import RecentFrame, StepReport

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
