"""Smoothing while it happens: each pose waits for two more video frames, or for 0.1 s.

The same terms as over a whole recording, over the newest frames alone; earlier ones are condensed
into a marginal prior. Marker samples that follow closely lie between two poses of that window, and
near their markers. What changes behind a pose that was given out fades in, so that the track does
not jump (``fading``).

    tracker = HybridTracker(skeleton, [camera], settings, marker_sites(skeleton, places))
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

import jax
import numpy as np
from jax import Array
from threadpoolctl import ThreadpoolController

from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, unpack
from jaxmocap.evidence.appearance.running import MeasuredFrame, RunningAppearance
from jaxmocap.evidence.keypoints import SightLines
from jaxmocap.evidence.markers import measured_noise
from jaxmocap.evidence.terms import Measurements
from jaxmocap.images.foreground import is_blank
from jaxmocap.smoothing.facing import RunningFacing
from jaxmocap.smoothing.settings import LONGEST_STEP_S, SmoothingSettings
from jaxmocap.smoothing.window.advance import Advanced, advance
from jaxmocap.smoothing.window.events import (
    Images,
    ReportedStep,
    StepReported,
    WindowEvent,
    WindowFrame,
    any_image,
    expect_poses,
    new_events,
)
from jaxmocap.smoothing.window.solving import SOFTNESS
from jaxmocap.smoothing.window.state import PLACES, EventArrays, WindowState, init
from jaxmocap.smoothing.window.track import (
    OFF_MARKERS_M,
    Sample,
    TrackPose,
    at_event,
    between_events,
    track_poses,
    update_frames_markers,
)
from jaxmocap.smoothing.window.unmarked import ARM_LANDMARKS, MarkerGaps, add_drift, are_missing
from jaxmocap.solvers.fading import Fading

# A marker sample is an event of the window so many seconds after the last one, and where no event
# of the window has an image; others lie between. A video's frames are events enough.
EVENT_S, EVENT_UNSEEN_S = 0.045, 0.015
# So is one with a marker that is farther away than this, metres, than in the last sample.
JUMP_M = 0.3
# Samples that frames between them take their markers from, and that the markers' noise is by,
RECENT_SAMPLES = 40
# each of which it counts for so many times.
NOISE_MEMORY = 4
# Events that wait for the next video frame before the window is solved without one, and where no
# event of the window has one: nothing more is to come.
MOST_WAITING, MOST_WAITING_UNSEEN = 3, 2
# Silhouettes err alike from frame to frame. So deviations are so many times larger than by counting
# each frame for itself: by ten rendered clips and one real person; by six real people who walk.
ERRS_ALIKE, ERRS_ALIKE_WITHOUT_VIDEO = 1.4, 2.6
# Time constant with which corrections fade in, seconds.
FADE_S = 0.07


class SmoothedPose(NamedTuple):
    """A pose that stays as it is."""

    number: int  # of its event, counted from 0
    time: float  # of its event, seconds
    pose: Pose  # smoothed
    # (L, 3) standard deviations of the landmarks' coordinates, world, metres; found every
    # ``SURE_EVERY`` video frames, or solves without video.
    deviations: np.ndarray
    # (L,) 1 where markers and video leave a landmark almost as uncertain as it is without them,
    # else 0.
    from_prior: np.ndarray
    # Cameras with a new image in which nothing of the person was recognised.
    unrecognised: tuple[int, ...] = ()


class FixedLagSmoother:
    """Smooths one person's poses, at most ``DELAY_FRAMES`` video frames behind the tracker."""

    def __init__(self, model: Model, settings: SmoothingSettings, keypoint_cameras: int = 0):
        """Prepare; nothing of the room is learned yet.

        Args:
            model: of the person, the markers and the cameras, of which there may be none.
            settings: of the smoothing.
            keypoint_cameras: how many of the cameras have key points.
        """
        self.model, self.settings = model, settings
        self._no_lines = SightLines.none(keypoint_cameras) if keypoint_cameras else None
        self._person = replace(model, cameras=None)
        self._advance = advance.after(model, settings)
        self._appearances = [
            RunningAppearance(model.skeleton, model.camera(index), model.no_foot_is_marked)
            for index in range(model.camera_count)
        ]
        # Several cameras tell how far away the person is.
        self._eye = np.asarray(model.camera(0).position_world) if model.camera_count == 1 else None
        self._no_goals = np.full((2, 3), np.nan, model.dtype)
        self._blas = ThreadpoolController()
        # Image pixels of a metre at the person while markers were measured, by camera.
        self._per_metre: dict[int, Array | np.ndarray] = {}
        self._gaps, self._seconds = MarkerGaps(model), deque[np.ndarray]()
        self._count = self._taken = 0
        self._noise_variance = 0.0
        self._begin()

    def _begin(self) -> None:
        """No events, no marginal prior; the learned room and the person's colours stay."""
        # What may still change; and as arrays, with what the events before tell.
        self._events: list[WindowEvent] = []
        self._state: WindowState | None = None
        self._news: EventArrays | None = None
        self._facing = RunningFacing()
        self._marker_pose: np.ndarray | None = None
        self._fading: Fading | None = None
        self._waiting: list[ReportedStep] = []
        self._samples = deque[Sample](maxlen=RECENT_SAMPLES)
        # Samples between events that were not given out yet.
        self._between: list[Sample] = []

    def step(
        self,
        time: float,
        markers_world: np.ndarray | Array,
        images: Images,
        report: StepReported | None,
        lines: SightLines | None = None,
    ) -> list[SmoothedPose]:
        """One step of the tracker.

        Args:
            time: as the tracker had it, later than the last one.
            markers_world: (M, 3) metres; NaN where missing. Markers that were only extrapolated to
                this time are left out: a frame without markers has them by the samples about it.
            images: a BGR (for colours to count) or grey uint8 frame per camera, None where there is
                no new one. One that is black, or of one brightness all over, counts as none.
            report: of the tracker's ``solve`` of these markers; not asked for where it
                ``lies_between``.
            lines: (K, ...) to the key points of the new images, of cameras that have any.

        Returns:
            What is final now: of no event, or of some, in order.
        """
        final: list[SmoothedPose] = []
        images = [None if each is None or is_blank(each) else each for each in images or ()]
        sample = Sample(self._count, float(time), np.asarray(markers_world))
        self._count += 1
        self._seconds.append(self._gaps.step(sample.time, sample.markers_world))
        is_placed = report is not None and bool(report.placed)
        if not is_placed and self.lies_between(time, images, sample.markers_world):
            self._take(sample)
            self._between.append(sample)
            return final
        assert report is not None, "a step that does not lie between others has a report"
        last = self._last_time()
        if last is not None and (is_placed or time - last > LONGEST_STEP_S):
            final += self.flush()
        if np.isfinite(sample.markers_world).any():
            self._take(sample)
        self._waiting.append(ReportedStep(*sample, images, report, lines or self._no_lines))
        most = MOST_WAITING if self._is_seen else MOST_WAITING_UNSEEN
        if len(self._waiting) < most and not self._waiting[-1].has_image:
            return final
        return final + self._settle(final=False)

    def _take(self, sample: Sample) -> None:
        """Take a sample, and from time to time the markers' noise from the newest ones."""
        self._samples.append(sample)
        self._taken += 1
        if self._taken % RECENT_SAMPLES:
            return
        times = np.array([each.time for each in self._samples])
        noise = measured_noise(times, np.stack([each.markers_world for each in self._samples]))
        share = 1 / min(self._taken // RECENT_SAMPLES, NOISE_MEMORY)
        self._noise_variance += share * (noise**2 - self._noise_variance)

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
        steps = [*self._events[-1:], *self._waiting[-1:]]
        return steps[-1].time if steps else None

    @property
    def _is_seen(self) -> bool:
        """Whether a camera shows an event that can still change."""
        waiting = any(step.has_image for step in self._waiting)
        return waiting or any(event.frames for event in self._events)

    def _gather(self) -> EventArrays:
        """The steps that wait, with the poses that are expected there and what cameras saw."""
        dtype, waiting, self._waiting = self.model.dtype, self._waiting, []
        events, measured, lines, since = self._events, [], [], []
        first = len(events)
        if waiting:
            alone = [np.concatenate(step.report.marker_pose).astype(dtype) for step in waiting]
            last = np.concatenate(events[-1].pose).astype(dtype) if events else alone[0]
            before = alone[0] if self._marker_pose is None else self._marker_pose
            expected = expect_poses(self.model.skeleton, last, before, alone)
            self._marker_pose = alone[-1]
            for step, there in zip(waiting, expected, strict=True):
                since.append(step.time - events[-1].time if events else LONGEST_STEP_S)
                facing = self._facing.step(np.asarray(there.ahead), since[-1] if events else 0.0)
                markers = np.asarray(step.markers_world, dtype)
                facing = facing.astype(dtype)
                measured.append(
                    Measurements(markers, there.upright, facing, there.ankles, self._no_goals)
                )
                if step.lines is not None:
                    lines.append(jax.tree.map(lambda part: np.asarray(part, dtype), step.lines))
                unmarked = bool(are_missing(self._seconds[step.number - self._count][2]))
                frames = self._frames(step.images, there.pose, unmarked)
                events.append(WindowEvent(step.number, step.time, markers, there.pose, frames))
            update_frames_markers(events, self._samples)
        self._news = new_events(self.model, events[first:], measured, lines, since, self._news)
        return self._news

    def _frames(self, images: Images, pose: Pose, unmarked: bool) -> list[WindowFrame]:
        """Camera, what its image shows about a pose, width and height; of new images only."""
        return [
            (each, self._measure_image(each, image, pose, unmarked), image.shape[1::-1])
            for each, image in enumerate(images or ())
            if image is not None
        ]

    def _measure_image(
        self, camera: int, image: np.ndarray, pose: Pose, unmarked: bool
    ) -> MeasuredFrame:
        """What a camera shows about a pose, weighted as in the settings."""
        frame = self._appearances[camera].measure(image, pose, SOFTNESS)
        if not unmarked:
            self._per_metre[camera] = frame.grids.per_metre
        metre = self._per_metre.get(camera, frame.grids.per_metre)
        grids = frame.grids._replace(per_metre=metre, unmarked=np.float32(unmarked))
        return frame._replace(grids=self.settings.silhouettes.weigh(grids))

    def _settle(self, final: bool) -> list[SmoothedPose]:
        """Solve the window, give out what has waited long enough, forget and learn."""
        news, events = self._gather(), self._events
        markers = np.full((PLACES, *events[0].markers_world.shape), np.nan, self.model.dtype)
        markers[: len(events)] = [event.markers_world for event in events]
        state = self._state or self._first_state(news)
        # Matrices are small: BLAS's threads would only wait for one another.
        with self._blas.limit(limits=1, user_api="blas"):
            self._state, found = self._advance(state, news, markers, np.bool_(final))
            found = Advanced(*(np.asarray(part) for part in found))
        for event, pose in zip(events, found.poses, strict=False):
            event.pose = unpack(pose)
        given = self._give(found, final)
        # Frames are learned from once their poses are final.
        for event in events[: found.given[1]]:
            self._learn_from(event)
        self._events = events[int(found.left) :]
        return given

    def _first_state(self, news: EventArrays) -> WindowState:
        """On the model's device as what follows will be: else all would compile twice."""
        (device,) = self.model.skeleton.lengths.devices()
        return jax.device_put(init(self.model, news), device)

    def _give(self, found: Advanced, final: bool) -> list[SmoothedPose]:
        """What has waited long enough, and all of it in the end."""
        events, ready = self._events, range(*found.given)
        if not ready and not (final and self._between):
            return []
        if self._fading is not None:
            # Later frames still correct the speed of the newest poses, later samples hardly.
            self._fading = self._fading.correct(*(found.correction * [[1.0], [not self._is_seen]]))
        track: list[TrackPose] = []
        for i in ready:
            earlier = [each for each in self._between if each.number < events[i].number]
            track += [*between_events(events, i, earlier), at_event(events[i])]
            self._between = self._between[len(earlier) :]
        if final:
            track += between_events(events, len(events), self._between)
        poses = track_poses(self._person, [self._fade(each) for each in track])
        deviations = self._deviations(found)
        unrecognised = {event.number: event.unrecognised for event in events}
        return [
            SmoothedPose(
                each.number, each.time, unpack(pose), self._with_drift(deviations, pose),
                found.from_prior, unrecognised.get(each.number, ()),
            )
            for each, pose in zip(track, poses, strict=True)
        ]  # fmt: skip

    def _deviations(self, found: Advanced) -> np.ndarray:
        """(L, 3) of what is given out, metres."""
        alike = ERRS_ALIKE if self._is_seen else ERRS_ALIKE_WITHOUT_VIDEO
        # Poses follow markers as if these were measured as precisely as is stated.
        noise = self._noise_variance**0.5
        off = noise if noise > self.settings.markers.deviation else OFF_MARKERS_M
        deviations = np.hypot(alike * found.deviations.astype(float), off)
        if self._is_seen:
            deviations[ARM_LANDMARKS] = np.hypot(deviations[ARM_LANDMARKS], found.arms_spread)
        return deviations

    def _with_drift(self, deviations: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """Deviations (L, 3) of the next packed pose that is given out; steps come out in order."""
        seconds = self._seconds.popleft()
        eye = self._eye
        return deviations if eye is None else add_drift(deviations, seconds, pose[:3], eye)

    def _fade(self, pose: TrackPose) -> TrackPose:
        """A pose with what is left of corrections."""
        nothing = np.zeros(pose.events.shape[1] - 1)
        fading = self._fading or Fading(nothing, nothing, pose.time)
        self._fading = fading.at(pose.time, FADE_S)
        return pose._replace(offset=self._fading.offset)

    def _learn_from(self, event: WindowEvent) -> None:
        if not event.learned:
            for camera, frame, size in event.frames:
                self._appearances[camera].learn(frame, size, event.pose)
        event.learned = True
