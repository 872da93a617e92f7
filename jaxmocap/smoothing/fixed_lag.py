"""Smoothing while it happens: each pose waits for two more video frames, and no longer.

The same terms as over a whole recording, over the newest frames alone; earlier ones are condensed
into a marginal prior. What changes behind a pose that was given out fades in, so that the track
does not jump (``fading``).

    tracker = HybridTracker(skeleton, [camera], settings, marker_names)
    state = tracker.init(markers)
    smoother = FixedLagSmoother(tracker.model, settings.smoothing)
    for time, markers, image in ...:  # NaN and None where there is nothing new
        state, pose, report = tracker.step(state, time, markers, [image])
        for final in smoother.step(time, markers, [image], pose, report):
            ...  # final.number, final.time, final.pose, final.deviations
    last = smoother.flush()

INPUTS: a tracker's steps: markers, images, poses, reports. OUTPUTS: smoothed poses, a little later.
"""

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np
from jax import Array
from threadpoolctl import ThreadpoolController

from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, pack, retract, unpack
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.compilation.programs import program
from jaxmocap.evidence.appearance.running import MeasuredFrame, RunningAppearance
from jaxmocap.smoothing.facing import RunningFacing
from jaxmocap.smoothing.settings import SmoothingSettings
from jaxmocap.smoothing.uncertainty import landmark_deviations
from jaxmocap.smoothing.window.events import WindowEvent, expected_at
from jaxmocap.smoothing.window.sliding import SOFTNESS, SolvedWindow, Window, offsets, stacked
from jaxmocap.solvers.fading import Fading

# A pose is given out once so many later video frames came,
DELAY_FRAMES = 2
# and so many seconds later at most.
DELAY_S = 0.1
# Video frames that stay in the window,
KEPT_FRAMES = 3
# for so many seconds at most.
KEPT_S = 0.2
# Events that wait for the next video frame before the window is solved without one.
MOST_WAITING = 6
# Time constant with which corrections fade in, seconds.
FADE_S = 0.07
# Events farther apart are no motion, seconds.
LONGEST_GAP_S = 0.25
# Velocities are taken from events at least so far apart, seconds.
BASELINE_S = 0.005


class StepReported(Protocol):
    """What a tracker's step reports of itself."""

    @property
    def marker_pose(self) -> Pose:
        """By the markers alone."""
        ...

    @property
    def elbow_deviations(self) -> Array:
        """(2,) standard deviations of the elbows, metres."""
        ...

    @property
    def placed(self) -> Array:
        """Whether the body was placed again."""
        ...


class SmoothedPose(NamedTuple):
    """A pose that stays as it is.

    Attributes:
        number: of its event, counted from 0.
        time: of its event, seconds.
        pose: smoothed.
        deviations: (L, 3) standard deviations of the landmarks' coordinates, world, metres.
        from_prior: (L,) 1 where markers and video leave a landmark almost as uncertain as it is
            without them, else 0.
    """

    number: int
    time: float
    pose: Pose
    deviations: np.ndarray
    from_prior: np.ndarray


@program("quick")
def _retract(pose: Array, step: Array) -> Array:
    """A packed pose (7 + D,) moved by a tangent vector."""
    return pack(retract(unpack(pose), step))


class FixedLagSmoother:
    """Smooths one person's poses, at most ``DELAY_FRAMES`` video frames behind the tracker."""

    def __init__(self, model: Model, settings: SmoothingSettings):
        """Prepare for a model with cameras; nothing of the room is learned yet.

        Args:
            model: of the person, the markers and the cameras.
            settings: of the smoothing.
        """
        if not model.camera_count:
            raise ValueError("FixedLagSmoother needs a model with at least one camera")
        self.model, self.settings = model, settings
        self._window = Window(model, settings)
        self._appearances = [
            RunningAppearance(model.skeleton, camera, model.no_foot_is_marked)
            for camera in self._window.cameras
        ]
        self._no_goals = np.full((2, 3), np.nan, model.dtype)
        self._blas = ThreadpoolController()
        self._count = self._given = 0
        self._begin()

    def _begin(self) -> None:
        """No events, no marginal prior; the learned room and the person's colours stay."""
        self._window.begin()
        self._marker_pose: Pose | None = None
        self._facing = RunningFacing()
        self._fading: Fading | None = None
        # Number, time and pose of the event given out last, and of one beside it.
        self._last_given: list[tuple[int, float, Pose]] = []
        self._waiting = 0

    def step(
        self,
        time: float,
        markers_world: np.ndarray | Array,
        images: Sequence[np.ndarray | None] | None,
        pose: Pose,
        report: StepReported,
    ) -> list[SmoothedPose]:
        """One step of the tracker.

        Args:
            time: as the tracker had it, later than the last one.
            markers_world: (M, 3) metres; NaN where missing. Markers that were only extrapolated to
                this time are better left out.
            images: a BGR (for colours to count) or grey uint8 frame per camera, None where there is
                no new one.
            pose: of that step.
            report: of that step.

        Returns:
            What is final now: of no event, or of some, in order.
        """
        final: list[SmoothedPose] = []
        lost = bool(report.placed) or (
            bool(self._window.events) and time - self._window.events[-1].time > LONGEST_GAP_S
        )
        if self._window.events and lost:
            final += self.flush()
        self._window.events.append(self._event(time, markers_world, images, pose, report))
        self._waiting = 0 if self._window.events[-1].frames else self._waiting + 1
        if self._waiting in range(1, MOST_WAITING):
            return final
        self._waiting = 0
        return final + self._settle(final=False)

    def flush(self) -> list[SmoothedPose]:
        """The poses that still wait, as they are; the next step begins a new motion."""
        given = self._settle(final=True) if self._window.events else []
        self._begin()
        return given

    def _event(
        self,
        time: float,
        markers_world: np.ndarray | Array,
        images: Sequence[np.ndarray | None] | None,
        pose: Pose,
        report: StepReported,
    ) -> WindowEvent:
        """A step with the pose that is expected there, and what the cameras saw about it."""
        dtype = self.model.dtype
        both = (pose, report.marker_pose)
        first, alone = (Pose._make(np.asarray(p, dtype) for p in each) for each in both)
        last = self._window.events[-1] if self._window.events else None
        before = alone if last is None or self._marker_pose is None else self._marker_pose
        three = [np.concatenate(each) for each in (last.pose if last else first, before, alone)]
        expected = expected_at(self.model.skeleton, np.stack(three))
        self._marker_pose = alone
        facing = self._facing.step(
            np.asarray(expected.ahead), 0.0 if last is None else time - last.time
        )
        measured = {
            "markers": np.asarray(markers_world, dtype),
            "upright": expected.upright,
            "facing": facing.astype(dtype),
            "ankles": expected.ankles,
            "elbows": self._no_goals,
        }
        frames = self._frames(images, expected.pose)
        number, self._count = self._count, self._count + 1
        deviations = np.asarray(report.elbow_deviations, float)
        return WindowEvent(number, float(time), measured, expected.pose, first, deviations, frames)

    def _frames(
        self, images: Sequence[np.ndarray | None] | None, pose: Pose
    ) -> list[tuple[int, MeasuredFrame, tuple[int, int]]]:
        """Camera, what its image shows about a pose, width and height; of new images only."""
        pairs = enumerate(zip(self._appearances, images or (), strict=False))
        return [
            (camera, self._measured(appearance, image, pose), (image.shape[1], image.shape[0]))
            for camera, (appearance, image) in pairs
            if image is not None
        ]

    def _measured(
        self, appearance: RunningAppearance, image: np.ndarray, pose: Pose
    ) -> MeasuredFrame:
        """What a camera shows about a pose, weighted as in the settings."""
        frame = appearance.measure(image, pose, SOFTNESS)
        return frame._replace(grids=self.settings.silhouettes.weighted(frame.grids))

    def _settle(self, final: bool) -> list[SmoothedPose]:
        """Solve the window, give out what has waited long enough, forget and learn."""
        # Band matrices are narrow: BLAS's threads would only wait for one another.
        with self._blas.limit(limits=1, user_api="blas"):
            solved = self._window.solve()
            given = self._give(solved, final)
            self._shorten(solved)
        self._learn()
        return given

    def _give(self, solved: SolvedWindow, final: bool) -> list[SmoothedPose]:
        """What has waited long enough, and all of it in the end."""
        events = self._window.events
        ready = [i for i in self._due(final) if events[i].number >= self._given]
        if not ready:
            return []
        mismatch = float(self.settings.mismatch)
        sure = landmark_deviations(*self._window.variances(solved, ready), mismatch)
        self._correct()
        given = [
            SmoothedPose(event.number, event.time, self._faded(event), *each)
            for event, *each in zip([events[i] for i in ready], *sure, strict=True)
        ]
        self._keep_last(ready[-1])
        self._given = given[-1].number + 1
        return given

    def _due(self, final: bool) -> list[int]:
        """Which events of the window have waited long enough."""
        events, later, due = self._window.events, 0, []
        for i in reversed(range(len(events))):
            waited = events[-1].time - events[i].time
            if final or later >= DELAY_FRAMES or waited >= DELAY_S:
                due.append(i)
            later += bool(events[i].frames)
        return due[::-1]

    def _correct(self) -> None:
        """Carry on what the track has moved by behind what was given out last."""
        now = {event.number: event.pose for event in self._window.events}
        kept = [old for old in self._last_given if old[0] in now]
        if self._fading is None or len(kept) < 2:
            return
        (_, time, _), (_, beside, _) = kept
        ours = stacked(now[number] for number, *_ in kept)
        here, there = offsets(stacked(pose for *_, pose in kept), ours)
        self._fading = self._fading.corrected(here, (there - here) / (beside - time))

    def _faded(self, event: WindowEvent) -> Pose:
        """An event's pose, and what is left of corrections."""
        if self._fading is None:
            nothing = np.zeros(ROOT_DOF + len(event.pose.angles))
            self._fading = Fading(nothing, nothing, event.time)
        self._fading = self._fading.at(event.time, FADE_S)
        offset = self._fading.offset.astype(self.model.dtype)
        moved = np.asarray(_retract(np.concatenate(event.pose), offset))
        return unpack(moved)

    def _keep_last(self, last: int) -> None:
        """The event given out last and one beside it, as they are now."""
        events = self._window.events
        here = events[last]
        beside = [*events[last + 1 :], *reversed(events[:last])]
        far = [event for event in beside if abs(event.time - here.time) >= BASELINE_S]
        self._last_given = [(e.number, e.time, e.pose) for e in (here, *far[:1])]

    def _shorten(self, solved: SolvedWindow) -> None:
        """Condense the oldest events: the newest few video frames stay, and what still waits."""
        events, count = self._window.events, 0
        while len(events) - count > 3 and events[count].number < self._given - 1:
            frames = sum(bool(event.frames) for event in events[count:])
            if frames <= KEPT_FRAMES and events[-1].time - events[count].time < KEPT_S:
                break
            count += 1
        for event in self._window.drop(solved, count):
            self._learn_from(event)

    def _learn(self) -> None:
        """Learn from frames whose poses are final."""
        for event in self._window.events:
            if event.number < self._given:
                self._learn_from(event)

    def _learn_from(self, event: WindowEvent) -> None:
        if not event.learned:
            for camera, frame, size in event.frames:
                self._appearances[camera].learn(frame, size, event.pose)
        event.learned = True
