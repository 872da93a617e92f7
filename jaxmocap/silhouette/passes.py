"""Passes over a recording: each tracks all frames, and learns what the next one begins with.

A first pass learns the backgrounds, frame by frame, where the person is not, and the person's
shape; the next ones begin with both, and with where the pass before them found each limb.

INPUTS: a tracker, a first pose, frames as often as they are asked for.
OUTPUTS: a PassResult; the poses that suit all frames together.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import NamedTuple

import jax
import numpy as np

from jaxmocap.body.pose import Pose
from jaxmocap.evidence.terms import Measurements
from jaxmocap.images.background_model import Background
from jaxmocap.images.regions import Region
from jaxmocap.silhouette.recovery.relocation import slim
from jaxmocap.silhouette.segmentation.background_models import BackgroundLearner, OnlineBackground
from jaxmocap.silhouette.smoothing import FrameInformation, smoothed_poses
from jaxmocap.silhouette.state import PoseEstimate, State, StepReport, TrackedBody, TrackerConstants
from jaxmocap.silhouette.surfaces.shape import ShapeEstimator
from jaxmocap.silhouette.tracker import SilhouetteTracker

# Level sets are kept as whole numbers of so many to a cell.
PHI_STEPS = 8
# What background models learn from: an image (H, W, 3) BGR uint8, a level set (S, S), where that
# lies, and pixels (N, 2) of points all over the body.
CameraFrame = tuple[np.ndarray, np.ndarray, Region, np.ndarray]


class FrameBundle(NamedTuple):
    """What all cameras bring for one instant."""

    time: float  # seconds
    # (H, W, 3) BGR uint8 of each of C cameras, None where there is none.
    images: Sequence[np.ndarray | None]
    measured: Measurements  # besides, see ``term_evidence``
    expected: Pose | None = None  # where key points have the person, where they do


@dataclass
class PassResult:
    """What a pass found in F frames."""

    body: TrackedBody  # as the pass had it
    times: list[float] = field(default_factory=list)  # (F,) seconds
    estimates: list[PoseEstimate] = field(default_factory=list)  # F of them
    reports: list[StepReport] = field(default_factory=list)  # F, without what is large
    # F times (C, S, S) int8, ``PHI_STEPS`` to a cell, positive within the person.
    level_sets: list[np.ndarray] = field(default_factory=list)
    milliseconds: list[float] = field(default_factory=list)  # F that the frames took
    is_expected: list[bool] = field(default_factory=list)  # F, whether key points had the person

    @property
    def is_anybody_visible(self) -> bool:
        """Whether any camera counted in any frame."""
        return any(report.used.any() for report in self.reports)

    def add(
        self, frame: FrameBundle, state: State, report: StepReport, milliseconds: float
    ) -> None:
        """One more frame."""
        self.times.append(frame.time)
        self.is_expected.append(frame.expected is not None)
        pose = jax.tree.map(np.asarray, state.pose)
        self.estimates.append(PoseEstimate(pose, state.velocity))
        revised = report.revised
        self.reports[len(self.reports) - len(revised) :] = revised
        self.reports.append(slim(report))
        phi = np.round(PHI_STEPS * np.asarray(report.outlines.segmentation.phi))
        self.level_sets.append(np.clip(phi, -127, 127).astype(np.int8))
        self.milliseconds.append(milliseconds)

    def poses(self) -> Pose:
        """(F, ...) as they were found."""
        return jax.tree.map(lambda *parts: np.stack(parts), *(each.pose for each in self.estimates))

    def smooth(self, constants: TrackerConstants) -> tuple[Pose, np.ndarray]:
        """(F, ...) as all frames together have them, and how sure (F, L, 3)."""
        information = FrameInformation(
            self.poses(),
            np.stack([report.information for report in self.reports]),
            np.stack([report.slope for report in self.reports]),
            np.array([report.spread for report in self.reports], float),
            np.array([report.used.sum() for report in self.reports]),
            self._place_deviations(constants),
        )
        return smoothed_poses(
            self.body.shape.skeleton, np.array(self.times), information,
            constants.rest_deviations, constants.settings.smoothing, constants.finder.morph,
        )  # fmt: skip

    def _place_deviations(self, constants: TrackerConstants) -> np.ndarray:
        """(F,) of the pelvis about its estimated place: one camera's is as key points have it."""
        by_points = np.array(self.is_expected) & (len(constants.cameras.size) == 1)
        return np.where(by_points, constants.settings.expected_place, np.inf)


class PassLearner:
    """Learns backgrounds and shape in one pass, for the next.

    Attributes:
        backgrounds: a learner for each camera.
        shape: of the person; passes share it.
    """

    def __init__(self, constants: TrackerConstants, frames: int, shape: ShapeEstimator):
        """Prepare for a recording of so many frames."""
        self._constants, self.shape = constants, shape
        self.backgrounds = [BackgroundLearner(frames) for _ in range(len(constants.cameras.size))]

    def add_frame(self, state: State, report: StepReport, cameras: dict[int, CameraFrame]) -> None:
        """A frame: the state after it, its report, and the cameras that counted, by number."""
        for number, frame in cameras.items():
            self.backgrounds[number].add_frame(*frame)
        # What hides a part draws the outlines of others along.
        if not report.hidden.any():
            skeleton, c = state.body.shape.skeleton, self._constants
            self.shape.add_frame(skeleton, c.cameras, state.pose, report.pairs, c.finder.morph)


def run_passes(
    tracker: SilhouetteTracker,
    start: Pose,
    frames: Callable[[], Iterable[FrameBundle]],
    count: int,
    backgrounds: Sequence[Background | None],
    passes: int = 3,
    shape_deviation: float = 1.0,
    lengths: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> PassResult:
    """What the last pass found; or the first in which no camera shows anybody.

    Args:
        tracker: of the person.
        start: pose in the first frame.
        frames: goes through the recording again whenever it is called.
        count: of frames.
        backgrounds: of each camera, where a picture shows it; None where passes are to learn it.
        passes: how many.
        shape_deviation: how far the surface may be off, by how far a generic one is.
        lengths: whether the bones' lengths are corrected as well.
        progress: called with the frames done and their total.
    """
    constants, body, models = tracker.constants, tracker.body, list(backgrounds)
    shape = ShapeEstimator(body.shape.surface, body.shape.skeleton, shape_deviation, lengths)
    result = None
    for number in range(passes):
        is_last = number + 1 == passes
        learner = None if is_last else PassLearner(constants, count, shape)
        earlier = None if result is None else result.estimates
        done = number * count
        result = run_pass(
            tracker, tracker.init(start, body, models), frames(), learner, earlier,
            lambda frame, done=done: progress(done + frame, passes * count),
        )  # fmt: skip
        if not result.is_anybody_visible:
            break
        if learner is not None:
            pictures = zip(backgrounds, learner.backgrounds, strict=True)
            models = [picture or learned.background() for picture, learned in pictures]
            body = tracker.reshape_person(body, *shape.estimate())
    assert result is not None, "expected one pass or several"
    return result


def run_pass(
    tracker: SilhouetteTracker,
    state: State,
    frames: Iterable[FrameBundle],
    learner: PassLearner | None = None,
    earlier: Sequence[PoseEstimate] | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> PassResult:
    """All frames from a state, in order of time; the first is tracked until its pose rests.

    ``earlier`` is what an earlier pass found, frame by frame; ``progress`` gets the frames done.
    """
    result = PassResult(state.body)
    online = {c: OnlineBackground() for c, each in enumerate(state.backgrounds) if each is None}
    for number, frame in enumerate(frames):
        if number == 0:
            for _ in range(tracker.constants.settings.settling_steps):
                first = tracker.step(state, *frame[:3], None, frame.expected)[0]
                state = first._replace(time=None, recent=())
        began = perf_counter()
        before = None if earlier is None else earlier[number]
        state, _, report = tracker.step(state, *frame[:3], before, frame.expected)
        result.add(frame, state, report, 1e3 * (perf_counter() - began))
        cameras = dict(_camera_frames(tracker, state, report, frame.images))
        if learner is not None:
            learner.add_frame(state, report, cameras)
        backgrounds = list(state.backgrounds)
        for camera in online.keys() & cameras.keys():
            backgrounds[camera] = online[camera].update(*cameras[camera])
        state = state._replace(backgrounds=tuple(backgrounds))
        progress(number + 1)
    return result


def _camera_frames(
    tracker: SilhouetteTracker,
    state: State,
    report: StepReport,
    images: Sequence[np.ndarray | None],
) -> Iterator[tuple[int, CameraFrame]]:
    """Those cameras that counted, by number."""
    phi, region = np.asarray(report.outlines.segmentation.phi), report.outlines.region
    pixels = tracker.body_pixels(state)
    for camera, image in enumerate(images):
        if image is not None and report.used[camera]:
            here = Region(*(part[camera] for part in region))
            yield camera, (image, phi[camera], here, pixels[camera])
