"""What the frames of a pass told, so far as later ones do not deny it.

INPUTS: reports of a silhouette tracker's steps. OUTPUTS: them, without what is large.
"""

from typing import NamedTuple

import numpy as np

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import ROOT_DOF
from jaxmocap.silhouette.state import StepReport
from jaxmocap.silhouette.tracker import SilhouetteTracker

# Frames before a limb was found elsewhere, that told of it where it was not.
LOST = 3


class _Step(NamedTuple):
    """A frame's whole report, the pose found, the markers (M, 3) it was shown."""

    report: StepReport
    pose: Pose
    positions_world: np.ndarray


class Reports:
    """What a tracker tells, frame by frame.

    Attributes:
        kept: one report per frame so far, without level sets, contours and pairs.
    """

    def __init__(self, tracker: SilhouetteTracker):
        """Before the first frame."""
        self.kept: list[StepReport] = []
        self._tracker, self._latest = tracker, list[_Step]()

    def add(self, report: StepReport, pose: Pose, positions_world: np.ndarray) -> None:
        """One more frame, by ``SilhouetteTracker.step``."""
        if report.relocated.any():
            self._withdraw(report.relocated)
        self._latest = [*self._latest[1 - LOST :], _Step(report, pose, positions_world)]
        self.kept.append(_slim(report))

    def _withdraw(self, moved: np.ndarray) -> None:
        """Of joints (D,) that were found elsewhere the last frames told nothing."""
        self._latest = [self._without(moved, *step) for step in self._latest]
        before = len(self.kept) - len(self._latest)
        self.kept[before:] = [_slim(step.report) for step in self._latest]

    def _without(
        self, moved: np.ndarray, report: StepReport, pose: Pose, positions_world: np.ndarray
    ) -> _Step:
        """What a frame told, joints (D,) not being seen."""
        hidden, seen = report.hidden | moved, report.observed.copy()
        told = self._tracker.told_without(hidden, pose, report.pairs, positions_world)
        seen[ROOT_DOF:][moved] = False
        left = report._replace(
            hidden=hidden,
            seen=seen,
            information=np.asarray(told.information),
            slope=np.asarray(told.slope),
        )
        return _Step(left, pose, positions_world)


def _slim(report: StepReport) -> StepReport:
    """Without what is large: F frames are kept."""
    outlines = report.outlines._replace(segmented=None, contours=())  # type: ignore[arg-type]
    return report._replace(outlines=outlines, pairs=None)  # type: ignore[arg-type]
