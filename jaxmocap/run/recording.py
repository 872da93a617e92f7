"""The offline loop: a recording, event by event, to a motion.

    recording ── open_footage ── build_timeline ── tracker.step at every event ── Motion
                                                   (a marker sample, a video frame, or both)

INPUTS: a Recording. OUTPUTS: a Motion with one row per marker sample, and its Report.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.body.kinematics import Sites
from jaxmocap.body.motion import Motion, Report
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.capture.filters import Cleaning, cleaned
from jaxmocap.capture.markers import interpolate
from jaxmocap.capture.timeline import Mode, Timeline, build_timeline
from jaxmocap.capture.video import FrameSource
from jaxmocap.formats.recording import MarkerPlace, Recording
from jaxmocap.hybrid.fixed_lag import DELAY_FRAMES, DELAY_S, FixedLagSmoother, Given
from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.tracker import HybridTracker, State, StepReport
from jaxmocap.outputs.report import plain
from jaxmocap.run import statuses
from jaxmocap.run.judging import judge_steps
from jaxmocap.run.key_points import lines_at_events, open_all_keypoints
from jaxmocap.run.reading import ForwardReader, open_footage, reading
from jaxmocap.run.smoothing import FirstPass, Smoothed, gathered, smooth_recording
from jaxmocap.run.timing import Clock, Progress, progress_bar, timed_stages

# The first sample is solved again and again until the joints turn by less (radians).
SETTLED_RAD, MOST_SETTLING = 1e-3, 10


class Tracked(NamedTuple):
    """One run over a recording, seen twice.

    Attributes:
        motion: by markers and video.
        markers_only: the same steps before the video had its say.
    """

    motion: Motion
    markers_only: Motion


def track(
    recording: Recording,
    settings: Settings | None = None,
    *,
    mode: Mode = "own",
    progress: Progress | bool | None = None,
    tracker: HybridTracker | None = None,
) -> Motion:
    """Track a recording.

    Args:
        recording: markers, and any number of videos.
        settings: of the tracker; defaults to ``Settings()``.
        mode: ``own`` looks at each video frame at its own time, with the markers interpolated
            there; ``nearest`` looks at the frame nearest to each marker sample, as in the paper;
            ``causal`` is ``own`` without any later marker or frame than a live run would have:
            poses are smoothed by what came before and by at most two more video frames.
        progress: called with the events done and their total, then with the percent of the second
            pass done and 100; True shows a bar on stderr.
        tracker: of ``make_tracker`` for this recording, so that it compiles once for several
            runs; its settings hold.

    Returns:
        One pose per marker sample, NaN before the first sample with a marker, and a report: what
        was missing and how long each stage took (``milliseconds``: ``decode``, ``solve``,
        ``observe``, ``refine``, and ``frame`` for all of them, at the events with a video frame;
        ``carry`` for the second call and ``sample`` for all at those without one; ``first_call``
        for the first event and ``smooth`` for the second pass, compilation included, or
        causally for the smoothing at each event with a video frame).

    Raises:
        InputError: a video or key points that cannot be used with the recording.
    """
    return track_both(recording, settings, mode=mode, progress=progress, tracker=tracker).motion


def track_both(
    recording: Recording,
    settings: Settings | None = None,
    *,
    mode: Mode = "own",
    progress: Progress | bool | None = None,
    tracker: HybridTracker | None = None,
) -> Tracked:
    """Track a recording and keep the markers' own poses as well; see ``track``."""
    videos, warnings = open_footage(recording.marked())
    recording, cleaning = cleaned(recording, causal=mode == "causal")
    warnings += cleaning.remarks
    # Read first, so that what is wrong with them is said before anything takes its time.
    keypoints = open_all_keypoints(recording, videos)
    warnings += tuple(said for each in keypoints if each for said in each.warnings)
    tracker = tracker or make_tracker(recording, settings)
    used = [] if tracker.cameras is None else videos
    run = Run.plan(recording, used, mode, cleaning)
    smooth, causal = bool(used) and tracker.settings.smooth, mode == "causal"
    smoother = FixedLagSmoother(tracker) if smooth and causal else None
    in_colour = reading(used, colour=smoother is not None)
    with progress_bar("tracking", progress) as show, in_colour as readers:
        for done, total in run.events(tracker, readers, smoother):
            show(done, total)
    smoothed = gathered(tracker, run.given, run.first_pass()) if smoother else None
    if smooth and not causal:
        began, first = perf_counter(), run.first_pass()
        lines = lines_at_events(recording, keypoints, first.timeline, first.alone)
        first = first._replace(lines=lines)
        with progress_bar("smoothing", progress) as show:
            smoothed = smooth_recording(
                tracker, used, first, lambda share: show(round(100 * share), 100)
            )
        run.milliseconds["smooth"] = [1e3 * (perf_counter() - began)]
    told = {
        "recording": recording.path or recording.name,
        "mode": mode,
        "cameras": [source.camera_name for source in recording.videos],
        "markers": recording.marker_names,
        "warnings": warnings,
        "filters": cleaning.figures(),
        "tracker": tracker.settings,
        "camera_turns_deg": _turns_deg(recording, smoothed),
        "latency": {"video frames": DELAY_FRAMES, "seconds": DELAY_S} if smoother else {},
    }
    return run.tracked(tracker.skeleton, plain(told), smoothed)


def _turns_deg(recording: Recording, smoothed: Smoothed | None) -> dict[str, list[float]]:
    """Camera -> how it was found turned against its calibration, a vector in its frame, degrees."""
    turns = [] if smoothed is None else np.degrees(smoothed.turns_cam).tolist()
    return dict(zip((source.camera_name for source in recording.videos), turns, strict=False))


def make_tracker(recording: Recording, settings: Settings | None = None) -> HybridTracker:
    """The tracker for a recording's person, markers and cameras."""
    settings = settings or Settings()
    cameras = [source.camera for source in recording.videos] if settings.refine != "none" else None
    sites = marker_sites(recording.skeleton, recording.places)
    return HybridTracker(recording.skeleton, cameras, settings, sites)


def marker_sites(skeleton: Skeleton, places: Sequence[MarkerPlace]) -> Sites:
    """The markers' points on the bones."""
    bones = np.array([skeleton.tree.bone(place.bone) for place in places], np.int32)
    at = np.array([place.at for place in places], float)
    offsets = np.array([place.offset for place in places], float).reshape(-1, 3)
    return Sites(bones, jnp.asarray(at, float), jnp.asarray(offsets, float))


def choose_settings(
    refine: Literal["simplex", "gradient", "none"] = "simplex", paper: bool = False
) -> Settings:
    """The tracker's defaults, or the first paper's own way."""
    return replace(Settings.paper() if paper else Settings(), refine=refine)


@dataclass
class Run:
    """One way through a recording, and what it yields on the way.

    Attributes:
        recording: what is tracked.
        timeline: its events.
        markers_world: (E, M, 3) at the events; NaN where missing.
        unseen: C of (T,), whether no frame of a camera lies near each sample.
        start: the first event with a marker; the tracker is placed there.
        steps: pose and report of each event from there on.
        said: sentences of each of these samples.
        milliseconds: stage -> times.
        given: what a smoother behind the tracker gave out, event by event.
        cleaning: what filters did to the markers, or None.
    """

    recording: Recording
    timeline: Timeline
    markers_world: np.ndarray
    unseen: list[np.ndarray]
    start: int
    steps: list[tuple[Pose, StepReport]] = field(default_factory=list)
    said: list[tuple[str, ...]] = field(default_factory=list)
    milliseconds: dict[str, list[float]] = field(default_factory=dict)
    given: list[Given] = field(default_factory=list)
    cleaning: Cleaning | None = None

    @classmethod
    def plan(
        cls,
        recording: Recording,
        videos: Sequence[FrameSource],
        mode: Mode,
        cleaning: Cleaning | None = None,
    ) -> "Run":
        """The events, and the markers at them."""
        times, causal = recording.times, mode == "causal"
        timeline = build_timeline(times, [video.times for video in videos], mode)
        markers = interpolate(times, recording.positions_world, timeline.event_times, causal)
        first = int(np.isfinite(recording.positions_world).all(-1).any(-1).argmax())
        start = int(np.flatnonzero(timeline.sample_index == first)[0])
        unseen = [statuses.without_video(times, video.times, causal) for video in videos]
        return cls(recording, timeline, markers, unseen, start, cleaning=cleaning)

    def events(
        self,
        tracker: HybridTracker,
        readers: Sequence[ForwardReader],
        smoother: FixedLagSmoother | None = None,
    ) -> Iterator[tuple[int, int]]:
        """Step through the events from the first marker to the last sample.

        Args:
            tracker: that takes the steps.
            readers: of its cameras' videos.
            smoother: behind the tracker.

        Yields:
            How many are done, and how many there are.
        """
        clock, times = Clock(), self.timeline.event_times
        timed = timed_stages(tracker, clock)
        stop = int(np.flatnonzero(self.timeline.sample_index >= 0)[-1]) + 1
        sentences: list[str] = []
        began = perf_counter()
        state = settled(tracker, self.markers_world[self.start])
        for event in range(self.start, stop):
            began = perf_counter() if event > self.start else began
            frames = self.timeline.frame_index[event]
            images = [reader.at(i) for reader, i in zip(readers, frames, strict=True)]
            clock.spent = {"decode": 1e3 * (perf_counter() - began)}
            markers, time = self.markers_world[event], times[event] - times[self.start]
            state, pose, report = timed.step(state, time, markers, images)
            # A quarter of the time of jax.device_get, and the state stays where it is wanted next.
            pose, report = jax.tree.map(np.asarray, (pose, report))
            if smoother is not None:
                # Between the samples markers are extrapolated, which the smoother does better.
                there = markers if self.timeline.sample_index[event] >= 0 else np.nan * markers
                smooth = clock.timed("smooth", smoother.step)
                self.given += smooth(time, there, images, pose, report)
            sentences += [*statuses.of_step(report), *self._about_images(frames, images)]
            self._keep_times(clock.spent, 1e3 * (perf_counter() - began), images)
            self.steps.append((pose, report))
            if (sample := int(self.timeline.sample_index[event])) >= 0:
                sentences += self._about_sample(sample)
                # What happened since the sample before belongs to this one.
                self.said.append(tuple(dict.fromkeys(sentences)))
                sentences = []
            yield event + 1 - self.start, stop - self.start
        self.given += smoother.flush() if smoother else []

    def _about_images(
        self, frames: np.ndarray, images: Sequence[np.ndarray | None]
    ) -> Iterator[str]:
        names = [source.camera_name for source in self.recording.videos][: len(images)]
        yield from statuses.of_images(names, (frames >= 0).tolist(), images)

    def first_pass(self) -> FirstPass:
        """The events that were gone through, and their poses, float64."""
        events = slice(self.start, self.start + len(self.steps))
        parts = (self.timeline.event_times, self.timeline.sample_index, self.timeline.frame_index)
        found = [(report.pose, pose) for pose, report in self.steps]
        alone, refined = (
            jax.tree.map(lambda *values: np.stack(values), *each)
            for each in zip(*found, strict=True)
        )
        timeline = Timeline(*(part[events] for part in parts))
        return FirstPass(timeline, self.markers_world[events], alone, refined)

    def _about_sample(self, sample: int) -> Iterator[str]:
        positions = self.recording.positions_world[sample]
        yield from statuses.of_markers(self.recording.marker_names, positions)
        yield from self.cleaning.sentences(sample) if self.cleaning else ()
        for source, unseen in zip(self.recording.videos, self.unseen, strict=False):
            if unseen[sample]:
                yield f"{source.camera_name}: no video frame near this sample"

    def _keep_times(
        self, spent: dict[str, float], total: float, images: Sequence[np.ndarray | None]
    ) -> None:
        if not self.milliseconds:
            self.milliseconds["first_call"] = [total]
            return
        if any(image is not None for image in images):
            kept = spent | {"frame": total}
        else:
            kept = {"solve": spent["solve"], "carry": spent["refine"], "sample": total}
        for stage, time in kept.items():
            self.milliseconds.setdefault(stage, []).append(time)

    def tracked(self, skeleton: Skeleton, told: dict, smoothed: Smoothed | None) -> Tracked:
        """All samples as arrays, NaN before the first one with a marker."""
        before = len(self.recording.times) - len(self.said)
        first = self.first_pass()
        at_samples = np.flatnonzero(first.timeline.sample_index >= 0)

        def column(values: np.ndarray) -> np.ndarray:
            kept = np.asarray(values)[at_samples]
            return np.concatenate([np.full((before, *kept.shape[1:]), np.nan), kept])

        def motion(person: Skeleton, poses: Pose, report: Report | None) -> Motion:
            return Motion(person, self.recording.times, jax.tree.map(column, poses), report)

        reports = [report for _, report in self.steps]
        judged = judge_steps(reports) if smoothed is None else smoothed.judged
        report = Report(
            markers=self.recording.marker_names,
            marker_errors=column(judged.distances),
            arm_costs=column(np.stack([report.arm_costs for report in reports])),
            swivels=column(judged.swivels),
            confidence=column(judged.confidence),
            landmarks_std=column(judged.deviations),
            from_prior=column(judged.from_prior),
            statuses=self._sentences(before, column(judged.confidence)),
            milliseconds={stage: np.array(t) for stage, t in self.milliseconds.items()},
            settings=told,
        )
        person, poses = (skeleton, first.refined) if smoothed is None else smoothed[:2]
        return Tracked(motion(person, poses, report), motion(skeleton, first.alone, None))

    def _sentences(self, before: int, confidence: np.ndarray) -> tuple[tuple[str, ...], ...]:
        """What there is to say of each sample."""
        unsure = confidence[before:] if self.unseen else np.ones((len(self.said), 2))
        said = (
            (*sentences, *statuses.of_confidence(each))
            for sentences, each in zip(self.said, unsure, strict=True)
        )
        return (("no marker has been seen yet",),) * before + tuple(said)


def settled(tracker: HybridTracker, markers_world: np.ndarray) -> State:
    """The state at the first sample, where the body has come to rest on its (M, 3) markers."""
    state, targets = tracker.init(markers_world), jnp.asarray(markers_world, float)
    for _ in range(MOST_SETTLING):
        ik = tracker.solve(
            tracker.skeleton, tracker.cameras, tracker.settings, state.pose, state.stance, targets
        ).ik
        turned = np.abs(np.asarray(ik.pose.angles) - np.asarray(state.pose.angles)).max()
        state = state._replace(pose=ik.pose, stance=ik.stance)
        if turned < SETTLED_RAD:
            break
    return state
