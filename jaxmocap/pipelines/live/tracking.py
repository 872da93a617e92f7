"""The tracker of a live run: samples and frames in, poses out.

    sample ── recent markers ── step ───────────────────────────── Output
    frame ─── recent markers, at the frame's own time ── step ──── (elbows of the next samples)

With smoothing both are stepped in the order of their times, and each Output comes two frames later,
or 0.1 s without cameras.

INPUTS: Samples, Frames. OUTPUTS: Outputs.
"""

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from copy import copy
from threading import Event
from time import sleep
from typing import NamedTuple

import jax
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import forward, site_positions
from jaxmocap.body.model import marker_sites
from jaxmocap.body.pose import Pose, relaxed_pose
from jaxmocap.body.skeleton import ELBOWS
from jaxmocap.capture.markers import RecentMarkers
from jaxmocap.capture.one_euro import filter_step, initial_state
from jaxmocap.capture.streams.inbox import LiveFrame
from jaxmocap.capture.streams.sample_assembly import MarkerSample
from jaxmocap.formats.recordings.marker_places import bone_points
from jaxmocap.hybrid.refine import StepReport
from jaxmocap.hybrid.settings import Settings, unused_setting
from jaxmocap.hybrid.tracker import HybridTracker, State
from jaxmocap.pipelines.live.setup import LiveSetup
from jaxmocap.smoothing.fixed_lag import FixedLagSmoother, SmoothedPose

# With smoothing a sample waits so many seconds for frames that are older than it, and for as long
# as the cameras' delay is stated to be.
REORDERING_S = 0.1
# Without a frame of any camera for so many seconds, poses are the markers' alone.
UNSEEN_S = 0.3
# Tracking begins at the first sample with all markers, or after so many with those there are.
MOST_INCOMPLETE_SAMPLES = 45


class Output(NamedTuple):
    """A pose to be sent."""

    time: float  # of its sample, seconds
    pose: Pose
    # (2,) standard deviations of the elbows, metres; NaN where unknown, and where no camera, of
    # some, brought a frame within ``UNSEEN_S``.
    deviations: np.ndarray
    arrived: float  # when its sample was received, seconds on the same clock


class LiveTracking:
    """One person, tracked live.

    Attributes:
        tracker: of the person.
        placements: how often the body was placed from scratch.
        late_events: samples and frames that arrived too late for the smoothing.
    """

    def __init__(
        self,
        setup: LiveSetup,
        settings: Settings,
        smooth: bool,
        tracker: HybridTracker | None = None,
    ):
        """Prepare; all compiles in a thread beside, what the markers' poses need first.

        Smoothed, poses come two frames late, and frames are to be BGR. A ``tracker`` that was
        compiled before is of this person, these markers and cameras.

        Raises:
            ValueError: something was chosen that has no part in it, see ``unused_setting``.
        """
        cameras = [v.camera for v in setup.videos] if settings.refine != "none" else []
        sites = marker_sites(setup.skeleton, bone_points(setup.skeleton, setup.places))
        self._cameras, self._smooth = len(cameras), smooth
        # A frame may come so much later than it was taken.
        offsets = [video.offset for video in setup.videos]
        self._delay = max(0.0, -min(offsets, default=0.0))
        self._longest_wait = REORDERING_S + self._delay
        if problem := unused_setting(settings, smooth, causal=True):
            raise ValueError(problem)
        if tracker is None:
            tracker = HybridTracker(setup.skeleton, cameras, settings, sites)
        self.tracker = tracker
        self._filter = setup.one_euro
        self._ended, self._can_solve = Event(), Event()
        self._compiling: Future[None] | None = None
        self._reset()
        self._warm_up()

    @property
    def has_markers_poses(self) -> bool:
        """Whether what the markers' poses need is compiled; until then there are none."""
        return self._can_solve.is_set() or self.is_ready

    @property
    def is_ready(self) -> bool:
        """Whether all is compiled; until then the poses are those of the markers alone.

        Raises what went wrong meanwhile.
        """
        if self._compiling is not None and self._compiling.done():
            self._compiling.result()
            self._compiling = None
        return self._compiling is None

    def wait_until_ready(self) -> None:
        """Wait until all is compiled."""
        while not self.is_ready:
            sleep(0.01)

    def close(self) -> None:
        """Compile no more than what is being compiled, which goes on beside."""
        self._ended.set()

    def _reset(self) -> None:
        """Forget who was tracked."""
        self.placements = self.late_events = 0
        self._state: State | None = None
        self._samples_waited, self._last = 0, -np.inf
        # When the newest frame that was used was taken, and when the newest one came.
        self._last_frame = self._last_frame_arrived = -np.inf
        # Camera -> when its newest frame was taken, and when it came.
        self._newest_frames: dict[int, tuple[float, float]] = {}
        self._newest_sample = -np.inf
        points = len(self.tracker.model.markers.bones)
        self._recent_markers = RecentMarkers(points, self._delay)
        self._filtered = None if self._filter is None else initial_state(points)
        model, settings = self.tracker.model, self.tracker.settings.smoothing
        self._smoother = FixedLagSmoother(model, settings) if self._smooth else None
        self._pending: list[MarkerSample | LiveFrame] = []
        # Of each event behind the smoother: its sample's arrival, or None.
        self._arrivals: deque[tuple[int, float | None]] = deque()
        self._events = 0

    def _warm_up(self) -> None:
        """Compile in a thread beside: what the markers' poses need, then the rest."""
        other = copy(self)
        other._reset()
        beside = ThreadPoolExecutor(1, "rehearse")
        self._compiling = beside.submit(other._rehearse)
        beside.shutdown(wait=False)

    def _rehearse(self) -> None:
        """Track somebody who stands still, by markers alone, then before a grey wall."""
        model = self.tracker.model
        frames = forward(model.skeleton, relaxed_pose(model.skeleton))
        points = np.asarray(site_positions(model.skeleton, frames, model.markers), float)
        jax.block_until_ready(self.tracker.solve(self.tracker.init(points), points))
        self._can_solve.set()
        sizes = [] if model.cameras is None else np.asarray(model.cameras.size, int)
        for i in range(12 if self._smooth else 2):
            time = i / 30
            if self._ended.is_set():
                return
            self.sample(MarkerSample(time, points, time))
            for camera, (width, height) in enumerate(sizes):
                wall = np.full((height, width, 3)[: 3 if self._smooth else 2], 128, np.uint8)
                self.frames([LiveFrame(camera, time + 0.01, wall, time + 0.01)])

    def sample(self, sample: MarkerSample) -> list[Output]:
        """Take a sample; the poses to be sent now."""
        if not self.has_markers_poses:
            return []
        if self._filter is not None and self._filtered is not None:
            points = sample.positions_world
            self._filtered, points = filter_step(self._filter, self._filtered, sample.time, points)
            sample = sample._replace(positions_world=points)
        self._recent_markers.add(sample.time, sample.positions_world)
        if self._state is None:
            is_visible = np.isfinite(sample.positions_world).all(-1)
            self._samples_waited += 1
            if not is_visible.all() and (
                self._samples_waited < MOST_INCOMPLETE_SAMPLES or not is_visible.any()
            ):
                return []
            self._state = self.tracker.init(sample.positions_world)
        if not self.is_ready:
            pose, _ = self._take_report(
                self.tracker.solve(self._state, self._with_gaps_filled(sample))
            )
            return [self._output(sample.time, pose, np.full(2, np.nan), sample.arrived)]
        if self._smoother is not None:
            self._newest_sample = max(self._newest_sample, sample.time)
            return self._in_order([sample])
        pose, report = self._step(sample.time, self._with_gaps_filled(sample), None)
        return [self._output(sample.time, pose, report.elbow_deviations, sample.arrived)]

    def frames(self, frames: Sequence[LiveFrame]) -> list[Output]:
        """Take frames, the newest of their cameras; the poses to be sent now."""
        if self._state is None or self.tracker.model.cameras is None or not self.is_ready:
            return []
        for frame in frames:
            self._last_frame_arrived = max(self._last_frame_arrived, frame.arrived)
            self._newest_frames[frame.camera] = frame.time, frame.arrived
        if self._smoother is not None:
            return self._in_order(frames)
        for frame in frames:
            self._last_frame = max(self._last_frame, frame.time)
            self._step(frame.time, self._recent_markers.at(frame.time), self._images(frame))
        return []

    def flush(self) -> list[Output]:
        """The poses that still wait."""
        if self._smoother is None:
            return []
        return [*self._release(np.inf), *self._outputs_of(self._smoother.flush())]

    def _with_gaps_filled(self, sample: MarkerSample) -> np.ndarray:
        """A sample's positions, those of missing markers extrapolated."""
        is_visible = np.isfinite(sample.positions_world).all(-1, keepdims=True)
        if is_visible.all():
            return sample.positions_world
        return np.where(is_visible, sample.positions_world, self._recent_markers.at(sample.time))

    def _images(self, frame: LiveFrame) -> list[np.ndarray | None]:
        images: list[np.ndarray | None] = [None] * self._cameras
        images[frame.camera] = frame.image
        return images

    def _step(
        self, time: float, markers_world: np.ndarray, images: list[np.ndarray | None] | None
    ) -> tuple[Pose, StepReport]:
        """One step of the tracker."""
        assert self._state is not None
        if self._smoother is None:
            return self._take_report(self.tracker.step(self._state, time, markers_world, images))
        return self._take_report(self.tracker.solve(self._state, markers_world))

    def _take_report(self, step: tuple[State, Pose, StepReport]) -> tuple[Pose, StepReport]:
        """What the tracker found; its state is kept, where the next step wants it."""
        self._state, *found = step
        pose, report = jax.tree.map(np.asarray, found)
        self.placements += bool(report.placed)
        return pose, report

    def _in_order(self, new: Sequence[MarkerSample | LiveFrame]) -> list[Output]:
        """Hold events until no older one is expected, then smooth them in order."""
        self._pending = sorted([*self._pending, *new], key=lambda event: event.time)
        newest = max(event.arrived for event in self._pending)
        # Cameras have as long to begin.
        if not np.isfinite(self._last_frame_arrived):
            self._last_frame_arrived = newest
        is_seen = self._cameras and newest - self._last_frame_arrived < UNSEEN_S
        # No camera's next frame is older than its last one, nor is the markers' next sample.
        each = self._newest_frames.values()
        newest_taken = [taken for taken, arrived in each if newest - arrived < UNSEEN_S]
        until = newest - (self._longest_wait if is_seen else 0.0)
        all_taken = min([*newest_taken, self._newest_sample]) if newest_taken else until
        return self._release(max(until, all_taken))

    def _release(self, until: float) -> list[Output]:
        outputs = []
        while self._pending and self._pending[0].time <= until:
            outputs += self._smooth_event(self._pending.pop(0))
        return outputs

    def _smooth_event(self, event: MarkerSample | LiveFrame) -> list[Output]:
        """One event through tracker and smoother."""
        assert self._smoother is not None
        if event.time <= self._last:
            self.late_events += 1
            return []
        self._last = event.time
        if isinstance(event, LiveFrame):
            self._last_frame = event.time
        if isinstance(event, MarkerSample):
            images, arrived = None, event.arrived
            filled, measured = self._with_gaps_filled(event), event.positions_world
        else:
            images, arrived = self._images(event), None
            filled = self._recent_markers.at(event.time)
            measured = np.full_like(filled, np.nan)
        report = None
        if not self._smoother.lies_between(event.time, images, measured):
            _, report = self._step(event.time, filled, images)
        self._arrivals.append((self._events, arrived))
        self._events += 1
        return self._outputs_of(self._smoother.step(event.time, measured, images, report))

    def _outputs_of(self, given: Sequence[SmoothedPose]) -> list[Output]:
        """The poses of samples among the smoothed events."""
        outputs = []
        for each in given:
            while self._arrivals and self._arrivals[0][0] < each.number:
                self._arrivals.popleft()
            arrived = self._arrivals.popleft()[1]
            if arrived is not None:
                spread = np.sqrt(np.sum(each.deviations[ELBOWS] ** 2, -1))
                outputs.append(self._output(each.time, each.pose, spread, arrived))
        return outputs

    def _output(
        self, time: float, pose: Pose, deviations: Array | np.ndarray, arrived: float
    ) -> Output:
        """An output, its deviations unknown where cameras have brought no frame of late."""
        alone = self._smooth and not self._cameras
        is_stated = alone or time - self._last_frame < UNSEEN_S + self._delay
        return Output(time, pose, np.where(is_stated, deviations, np.nan), arrived)
