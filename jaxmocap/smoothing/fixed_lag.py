"""Smoothing while it happens: each pose waits for two more video frames, 0.1 s at most.

The same terms as over a whole recording, over the newest frames alone; earlier ones are condensed
into a marginal prior. Marker samples that follow closely lie between two poses of that window, and
near their markers. What changes behind a pose that was given out fades in, so that the track does
not jump (``fading``).

    tracker = HybridTracker(skeleton, [camera], settings, marker_names)
    state = tracker.init(markers)
    smoother = FixedLagSmoother(tracker.model, settings.smoothing)
    for time, markers, image in ...:  # NaN and None where there is nothing new
        report = None
        if not smoother.lies_between(time, [image], markers):
            state, _, report = tracker.solve(state, markers)
        for final in smoother.step(time, markers, [image], report):
            ...  # final.number, final.time, final.pose, final.deviations
    last = smoother.flush()

INPUTS: markers, images, a tracker's reports on them. OUTPUTS: smoothed poses, a little later.
"""

from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jax import Array
from threadpoolctl import ThreadpoolController

from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, unpack
from jaxmocap.body.skeleton import landmark_rows
from jaxmocap.evidence.appearance.running import MeasuredFrame, RunningAppearance
from jaxmocap.smoothing.facing import RunningFacing
from jaxmocap.smoothing.settings import SmoothingSettings
from jaxmocap.smoothing.uncertainty import landmark_deviations
from jaxmocap.smoothing.window.equations import WindowEquations
from jaxmocap.smoothing.window.events import (
    Images,
    ReportedStep,
    StepReported,
    WindowEvent,
    WindowFrame,
    any_image,
    expected_at,
    offsets,
)
from jaxmocap.smoothing.window.sliding import SOFTNESS, Window, stacked
from jaxmocap.smoothing.window.track import (
    FADED_M,
    Sample,
    TrackPose,
    at_event,
    between_events,
    track_poses,
    update_frames_markers,
)
from jaxmocap.solvers.fading import Fading

# A pose is given out once so many later video frames came,
DELAY_FRAMES = 2
# and so many seconds later at most; without video, where events wait for one another as well.
DELAY_S, DELAY_WITHOUT_VIDEO_S = 0.1, 0.05
# Video frames that stay in the window,
KEPT_FRAMES = 3
# for so many seconds at most.
KEPT_S = 0.2
# A marker sample is an event of the window so many seconds after the last one, and where no event
# of the window has an image; others lie between. A video's frames are events enough.
EVENT_S, EVENT_UNSEEN_S = 0.045, 0.015
# So is one with a marker that is farther away than this, metres, than in the last sample.
JUMP_M = 0.3
# Samples that frames between them take their markers from.
RECENT_SAMPLES = 40
# Events that wait for the next video frame before the window is solved without one, and where no
# event of the window has one: nothing more is to come.
MOST_WAITING, MOST_WAITING_UNSEEN = 3, 2
# Deviations are found at one video frame in so many, and hold until the next one.
SURE_EVERY = 5
# Silhouettes err alike from frame to frame. So deviations are so many times larger than by counting
# each frame for itself: by ten rendered clips and one real person; by six real people who walk.
ERRS_ALIKE, ERRS_ALIKE_WITHOUT_VIDEO = 1.4, 2.6
# What the search for arms moves: elbow, wrist and hand's tip of either side.
ARM_LANDMARKS = np.stack(
    [landmark_rows([f"{p}_{s}" for p in ("elbow", "wrist", "hand")]) for s in "lr"]
)
# Time constant with which corrections fade in, seconds.
FADE_S = 0.07
# Events farther apart are no motion, seconds.
LONGEST_GAP_S = 0.25


class SmoothedPose(NamedTuple):
    """A pose that stays as it is.

    Attributes:
        number: of its event, counted from 0.
        time: of its event, seconds.
        pose: smoothed.
        deviations: (L, 3) standard deviations of the landmarks' coordinates, world, metres; found
            every ``SURE_EVERY`` video frames, or solves without video.
        from_prior: (L,) 1 where markers and video leave a landmark almost as uncertain as it is
            without them, else 0.
    """

    number: int
    time: float
    pose: Pose
    deviations: np.ndarray
    from_prior: np.ndarray


class FixedLagSmoother:
    """Smooths one person's poses, at most ``DELAY_FRAMES`` video frames behind the tracker."""

    def __init__(self, model: Model, settings: SmoothingSettings):
        """Prepare; nothing of the room is learned yet.

        Args:
            model: of the person, the markers and the cameras, of which there may be none.
            settings: of the smoothing.
        """
        self.model, self.settings = model, settings
        self._person = replace(model, cameras=None)
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
        self._facing = RunningFacing()
        self._marker_pose: np.ndarray | None = None
        self._fading: Fading | None = None
        # Number and pose of the event given out last.
        self._last_given: tuple[int, Pose] | None = None
        self._waiting: list[ReportedStep] = []
        self._samples = deque[Sample](maxlen=RECENT_SAMPLES)
        # Samples between events that were not given out yet.
        self._between: list[Sample] = []
        self._frames_since_sure, self._sure = SURE_EVERY, None

    def step(
        self,
        time: float,
        markers_world: np.ndarray | Array,
        images: Images,
        report: StepReported | None,
    ) -> list[SmoothedPose]:
        """One step of the tracker.

        Args:
            time: as the tracker had it, later than the last one.
            markers_world: (M, 3) metres; NaN where missing. Markers that were only extrapolated to
                this time are left out: a frame without markers has them by the samples about it.
            images: a BGR (for colours to count) or grey uint8 frame per camera, None where there is
                no new one.
            report: of the tracker's ``solve`` of these markers; not asked for where it
                ``lies_between``.

        Returns:
            What is final now: of no event, or of some, in order.
        """
        final: list[SmoothedPose] = []
        sample = Sample(self._count, float(time), np.asarray(markers_world))
        self._count += 1
        is_placed = report is not None and bool(report.placed)
        if not is_placed and self.lies_between(time, images, sample.markers_world):
            self._samples.append(sample)
            self._between.append(sample)
            return final
        assert report is not None, "a step that does not lie between others has a report"
        last = self._last_time()
        if last is not None and (is_placed or time - last > LONGEST_GAP_S):
            final += self.flush()
        if np.isfinite(sample.markers_world).any():
            self._samples.append(sample)
        self._waiting.append(ReportedStep(*sample, images, report))
        most = MOST_WAITING if self._is_seen else MOST_WAITING_UNSEEN
        if len(self._waiting) < most and not self._waiting[-1].has_image:
            return final
        return final + self._settle(final=False)

    def lies_between(self, time: float, images: Images, markers_world: np.ndarray) -> bool:
        """Whether a step follows the last event closely, and its markers (M, 3) the last sample."""
        last, apart = self._last_time(), EVENT_S if self._is_seen else EVENT_UNSEEN_S
        if last is None or time - last >= apart or any_image(images):
            return False
        before = self._samples[-1].markers_world if self._samples else markers_world
        return not (np.abs(np.asarray(markers_world) - before) > JUMP_M).any()

    def flush(self) -> list[SmoothedPose]:
        """The poses that still wait, as they are; the next step begins a new motion."""
        given = self._settle(final=True) if self._last_time() is not None else []
        self._begin()
        return given

    def _last_time(self) -> float | None:
        """Of the last event of this motion, seconds."""
        steps = [*self._window.events[-1:], *self._waiting[-1:]]
        return steps[-1].time if steps else None

    @property
    def _is_seen(self) -> bool:
        """Whether a camera shows an event that can still change."""
        waiting = any(step.has_image for step in self._waiting)
        return waiting or any(event.frames for event in self._window.events)

    def _gather(self) -> None:
        """The steps that wait, with the poses that are expected there and what cameras saw."""
        if not self._waiting:
            return
        dtype, waiting, self._waiting = self.model.dtype, self._waiting, []
        alone = [stacked([step.report.marker_pose])[0].astype(dtype) for step in waiting]
        events, before = self._window.events, self._marker_pose
        last = np.concatenate(events[-1].pose).astype(dtype) if events else alone[0]
        before = alone[0] if before is None else before
        expected = expected_at(self.model.skeleton, last, before, alone)
        self._marker_pose = alone[-1]
        for step, there in zip(waiting, expected, strict=True):
            elapsed = step.time - events[-1].time if events else 0.0
            facing = self._facing.step(np.asarray(there.ahead), elapsed)
            measured = {
                "markers": np.asarray(step.markers_world, dtype),
                "upright": there.upright,
                "facing": facing.astype(dtype),
                "ankles": there.ankles,
                "elbows": self._no_goals,
            }
            frames = self._frames(step.images, there.pose)
            events.append(WindowEvent(step.number, step.time, measured, there.pose, frames))
        update_frames_markers(events, self._samples)

    def _frames(self, images: Images, pose: Pose) -> list[WindowFrame]:
        """Camera, what its image shows about a pose, width and height; of new images only."""
        return [
            (camera, self._measured(camera, image, pose), (image.shape[1], image.shape[0]))
            for camera, image in enumerate(images or ())
            if image is not None
        ]

    def _measured(self, camera: int, image: np.ndarray, pose: Pose) -> MeasuredFrame:
        """What a camera shows about a pose, weighted as in the settings."""
        frame = self._appearances[camera].measure(image, pose, SOFTNESS)
        return frame._replace(grids=self.settings.silhouettes.weighted(frame.grids))

    def _settle(self, final: bool) -> list[SmoothedPose]:
        """Solve the window, give out what has waited long enough, forget and learn."""
        self._gather()
        # Band matrices are narrow: BLAS's threads would only wait for one another.
        with self._blas.limit(limits=1, user_api="blas"):
            solved = self._window.solve()
            given = self._give(final)
            self._shorten(solved)
        self._learn()
        return given

    def _give(self, final: bool) -> list[SmoothedPose]:
        """What has waited long enough, and all of it in the end."""
        events = self._window.events
        ready = [i for i in self._due(final) if events[i].number >= self._given]
        if not ready:
            return []
        deviations, from_prior = self._deviations(ready[-1])
        self._correct()
        track: list[TrackPose] = []
        for i in ready:
            earlier = [each for each in self._between if each.number < events[i].number]
            track += [*between_events(events, i, earlier), at_event(events[i])]
            self._between = self._between[len(earlier) :]
        if final:
            track += between_events(events, len(events), self._between)
        poses = track_poses(self._person, [self._faded(each) for each in track])
        last = events[ready[-1]]
        self._last_given, self._given = (last.number, last.pose), last.number + 1
        return [
            SmoothedPose(each.number, each.time, unpack(pose), deviations, from_prior)
            for each, pose in zip(track, poses, strict=True)
        ]

    def _deviations(self, newest: int) -> tuple[np.ndarray, np.ndarray]:
        """Of what is given out with an event, found every few frames."""
        self._frames_since_sure += 1
        if self._sure is None or self._frames_since_sure >= SURE_EVERY:
            variances = self._window.variances([newest])
            each = landmark_deviations(*variances, float(self.settings.mismatch))
            self._sure, self._frames_since_sure = (each[0][0], each[1][0]), 0
        alike = ERRS_ALIKE if self.model.camera_count else ERRS_ALIKE_WITHOUT_VIDEO
        deviations = np.hypot(alike * self._sure[0], FADED_M)
        if self._is_seen:
            spread = self._window.arms_spread
            deviations[ARM_LANDMARKS] = np.hypot(deviations[ARM_LANDMARKS], spread)
        return deviations, self._sure[1]

    def _due(self, final: bool) -> list[int]:
        """Which events of the window have waited long enough."""
        events, later, due = self._window.events, 0, []
        longest = DELAY_S if self.model.camera_count else DELAY_WITHOUT_VIDEO_S
        final = final or bool(self.model.camera_count and not self._is_seen)
        for i in reversed(range(len(events))):
            waited = events[-1].time - events[i].time
            if final or later >= DELAY_FRAMES or waited >= longest:
                due.append(i)
            later += bool(events[i].frames)
        return due[::-1]

    def _correct(self) -> None:
        """Carry on what the track has moved by behind what was given out last."""
        now = {event.number: event.pose for event in self._window.events}
        if self._fading is None or self._last_given is None or self._last_given[0] not in now:
            return
        number, pose = self._last_given
        (offset,) = offsets(stacked([pose]), stacked([now[number]]))
        self._fading = self._fading.corrected(offset)

    def _faded(self, pose: TrackPose) -> TrackPose:
        """A pose with what is left of corrections."""
        nothing = np.zeros(pose.events.shape[1] - 1)
        fading = self._fading or Fading(nothing, nothing, pose.time)
        self._fading = fading.at(pose.time, FADE_S)
        return pose._replace(offset=self._fading.offset)

    def _shorten(self, solved: WindowEquations) -> None:
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
