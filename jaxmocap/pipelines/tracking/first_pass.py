"""The first pass over a recording: the tracker's steps at all events.

Offline a chunk of events at a time; causally one by one, as they would come in live, and a smoother
behind gives out what is some frames old.

INPUTS: RecordingEvents, a tracker, readers of its videos; or a Recording.
OUTPUTS: FirstPass; smoothed poses; Events, arrays for the pure functions.
"""

from collections.abc import Callable, Iterator, Sequence
from time import perf_counter

import jax
import numpy as np

from jaxmocap.body.motion import landmarks_over_time
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import ELBOWS
from jaxmocap.capture.footage import ForwardReader, cached_frames, forward_readers
from jaxmocap.capture.timeline import Timeline
from jaxmocap.compilation.arrays import on_device
from jaxmocap.compilation.batches import GatheredRows
from jaxmocap.compilation.clock import Clock
from jaxmocap.evidence.appearance.learned import ROWS
from jaxmocap.evidence.keypoints import SightLines
from jaxmocap.formats.recordings.keypoints import Detections
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.resampling import bridge_poses
from jaxmocap.hybrid.refine import StepReport
from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.step import State
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.pipelines.keypoints.lines import lines_at_events
from jaxmocap.pipelines.progress import Progress, progress_bar
from jaxmocap.pipelines.tracking.events import RecordingEvents, open_recording, step_warnings
from jaxmocap.smoothing.batch import measurements_of, silhouettes_of
from jaxmocap.smoothing.facing import without_hysteresis
from jaxmocap.smoothing.fixed_lag import FixedLagSmoother, SmoothedPose
from jaxmocap.smoothing.functions import Events
from jaxmocap.smoothing.problem import FirstPass


def scan_events(
    events: RecordingEvents,
    tracker: HybridTracker,
    readers: Sequence[ForwardReader],
    show: Progress,
    clock: Clock,
) -> FirstPass:
    """Scan through the events, chunk by chunk."""
    began = perf_counter()
    about_images: list[tuple[str, ...]] = []

    def images_of_events() -> Iterator[list[np.ndarray | None]]:
        for event, frames in enumerate(events.timeline.frame_index):
            images = _images_at(frames, readers)
            about_images.append(tuple(events.image_warnings(event, images)))
            yield images

    images = images_of_events() if readers else None
    tracker.compile_ahead(scan=True)
    state = tracker.init(events.markers_world[0])
    times, about = events.timeline.event_times, list[tuple[str, ...]]()
    backwards = tracker.settings.smooth
    total = len(times) * (2 if backwards else 1)
    gathered = GatheredRows(len(times))
    for chunk in tracker.scan(state, times, events.markers_world, images, clock):
        if not about:
            began = clock.keep("first_call", began)
        gathered.put(len(about), (chunk.poses, chunk.reports))
        rows = range(len(chunk.events))
        steps = [jax.tree.map(lambda part, row=row: part[row], chunk.reports) for row in rows]
        about += [tuple(step_warnings(step)) for step in steps]
        # All stages together, as far as they did not run beside one another.
        stage, among = ("frame", chunk.frames) if chunk.frames else ("sample", len(rows))
        began = clock.keep(stage, began, among)
        show(len(about), total)
    poses, reports = gathered.tree
    both_ways = None
    if backwards:
        others = _poses_backwards(
            tracker,
            state,
            reports.marker_pose,
            events.markers_world,
            lambda done: show(len(times) + done, total),
        )
        both_ways = without_hysteresis(times, reports.marker_pose, others)
        # A pose that is held while nothing is measured is no start for what goes on meanwhile.
        is_measured = np.isfinite(events.markers_world).all(-1).sum(1) > 0
        poses, marker_pose, both_ways = (
            bridge_poses(times, each, is_measured)
            for each in (poses, reports.marker_pose, both_ways)
        )
        reports = reports._replace(marker_pose=marker_pose)
    if about_images:
        about = [own + images for own, images in zip(about, about_images, strict=True)]
    return _first_pass(events, poses, reports, about)._replace(both_ways=both_ways)


def _poses_backwards(
    tracker: HybridTracker,
    state: State,
    in_time: Pose,
    markers_world: np.ndarray,
    show: Callable[[int], None],
) -> Pose:
    """Poses (E, ...) by the markers alone, each from the one after it, the last from its own."""
    # The reports do not say where the feet stood: they are planted below the head.
    feet = state.feet._replace(overstretched=np.True_)
    state = state._replace(pose=jax.tree.map(lambda part: part[-1], in_time), feet=feet)
    poses = list[Pose]()
    for markers in markers_world[::-1]:
        state, pose, _ = tracker.solve(state, markers)
        poses.append(jax.tree.map(np.asarray, pose))
        show(len(poses))
    return jax.tree.map(lambda *parts: np.stack(parts), *poses[::-1])


def step_events(
    events: RecordingEvents,
    tracker: HybridTracker,
    readers: Sequence[ForwardReader],
    smoother: FixedLagSmoother | None,
    show: Progress,
    clock: Clock,
    keypoints: Sequence[Detections | None] = (),
) -> tuple[FirstPass, list[SmoothedPose]]:
    """Step through the events, one by one; the smoother sees the videos' key points, if any."""
    if smoother is None:
        tracker.compile_ahead()
    state, line = tracker.init(events.markers_world[0]), events.timeline
    final: list[SmoothedPose] = []
    steps, about = [], []
    began = perf_counter()
    for event, time in enumerate(events.times):
        began = perf_counter() if event else began
        own, markers = Clock(), events.markers_world[event]
        images = own.time_stage("decode", _images_at, line.frame_index[event], readers)
        if smoother is None:
            state, pose, report = tracker.step(state, time, markers, images, own)
        else:
            state, pose, report = tracker.solve(state, markers, own)
        # A quarter of the time of jax.device_get, and the state stays where it is wanted next.
        pose, report = jax.tree.map(np.asarray, (pose, report))
        if smoother is not None:
            # Between the samples markers are extrapolated, which the smoother does better.
            there = markers if line.sample_index[event] >= 0 else np.nan * markers
            lines = own.time_stage("lines", _lines_at, events, event, keypoints, report.marker_pose)
            final += own.time_stage("smooth", smoother.step, time, there, images, report, lines)
        _keep_stages(clock, own, 1e3 * (perf_counter() - began), not event, images)
        steps.append((pose, report))
        about.append((*step_warnings(report), *events.image_warnings(event, images)))
        show(event + 1, len(events.times))
    final += smoother.flush() if smoother else []
    poses, reports = jax.tree.map(lambda *parts: np.stack(parts), *steps)
    return _first_pass(events, poses, reports, about), final


def _first_pass(
    events: RecordingEvents, poses: Pose, reports: StepReport, about: Sequence[tuple[str, ...]]
) -> FirstPass:
    line = events.timeline
    return FirstPass(
        line.event_times, events.markers_world, line.frame_index, poses, reports, about
    )


def _lines_at(
    events: RecordingEvents, event: int, keypoints: Sequence[Detections | None], pose: Pose
) -> SightLines | None:
    """(K, ...) of the cameras with key points; None where no frame comes."""
    now, line = slice(event, event + 1), events.timeline
    if not any(keypoints) or (line.frame_index[event] < 0).all():
        return None
    own = Timeline(line.event_times[now], line.sample_index[now], line.frame_index[now])
    there = jax.tree.map(lambda part: part[None], pose)
    lines = lines_at_events(events.recording, keypoints, own, there)
    return jax.tree.map(lambda part: part[0], lines)


def _images_at(frames: np.ndarray, readers: Sequence[ForwardReader]) -> list[np.ndarray | None]:
    return [reader.at(int(index)) for reader, index in zip(readers, frames, strict=True)]


def _keep_stages(
    clock: Clock, own: Clock, total: float, first: bool, images: Sequence[np.ndarray | None]
) -> None:
    """Keep an event's times as the stages that they belong to."""
    spent = {stage: times[0] for stage, times in own.milliseconds.items()}
    if first:
        spent = {"first_call": total}
    elif any(image is not None for image in images):
        spent = spent | {"frame": total}
    else:
        carried = {"carry": spent["refine"]} if "refine" in spent else {}
        spent = {"solve": spent["solve"], **carried, "sample": total}
    for stage, taken in spent.items():
        clock.milliseconds.setdefault(stage, []).append(taken)


def first_pass(
    recording: Recording,
    settings: Settings | None = None,
    *,
    progress: Progress | bool | None = None,
    tracker: HybridTracker | None = None,
) -> Events:
    """The events of a recording, and where the tracker puts the body event by event.

    Elbows count as measured at events with a video frame, where the first pass had them. So do the
    silhouettes there, learned as in the second pass of ``track``.

    Args:
        recording: markers, and any number of videos.
        settings: of the tracker; ``refine="none"`` leaves the videos out.
        progress: called with the events done and their total; True shows a bar
            on stderr; None does so on a terminal.
        tracker: of this recording; its settings hold.

    Raises:
        InputError: a video or key points that cannot be used with the recording.

    Returns:
        T events in the model's dtype: times from the first one on, seconds; world, metres.

    Example:
        >>> from jaxmocap import Recording, Settings, first_pass
        >>> recording = Recording.load("recording.toml")
        >>> events = first_pass(recording, Settings(refine="none"))
        >>> events.measured.markers.shape == recording.positions_world.shape
        True
    """
    opened = open_recording(recording)
    tracker = tracker or HybridTracker.from_recording(opened.recording, settings)
    used = opened.videos if tracker.model.camera_count else []
    events = RecordingEvents.of(opened.recording, used, "own", opened.cleaning)
    with progress_bar("tracking", progress) as show, forward_readers(used) as readers:
        found = scan_events(events, tracker, readers, show, Clock())
    measured = measurements_of(tracker.model, found)
    points = landmarks_over_time(tracker.model.skeleton, found.poses)
    filmed = np.any(found.frame_index >= 0, -1, keepdims=True)[..., None]
    measured = measured._replace(elbows=np.where(filmed, points[:, ELBOWS], np.nan))
    grids = silhouettes_of(tracker.model, found, cached_frames(used, ROWS)) if used else None
    parts = (found.times - found.times[0], measured, found.poses, grids)
    dtype = tracker.model.dtype
    return Events(*jax.tree.map(lambda part: on_device(part, dtype), parts))
