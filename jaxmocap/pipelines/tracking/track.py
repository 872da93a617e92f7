"""A recording to a motion.

    Recording ── events ── first pass: scanned, or stepped as if live ── smoothing ── Motion
                 (a marker sample, a video frame, or both at every event)

Smoothing starts where the search has the elbows: from the markers' poses it ends farther off.

INPUTS: a Recording. OUTPUTS: a Motion with one row per marker sample, and its Report.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from time import perf_counter

import jax
import numpy as np

from jaxmocap.body.motion import Motion, Run
from jaxmocap.body.pose import Pose
from jaxmocap.capture.filters import check_cutoff
from jaxmocap.capture.footage import cached_frames, forward_readers
from jaxmocap.capture.timeline import Mode
from jaxmocap.compilation.clock import Clock
from jaxmocap.evidence.appearance.learned import ROWS
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.hybrid.settings import Settings, unused_setting
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.outputs.report import plain
from jaxmocap.pipelines.keypoints.lines import lines_at_events
from jaxmocap.pipelines.progress import Progress, progress_bar
from jaxmocap.pipelines.tracking.events import (
    Opened,
    RecordingEvents,
    open_recording,
    with_checked_clocks,
)
from jaxmocap.pipelines.tracking.first_pass import scan_events, step_events
from jaxmocap.pipelines.tracking.marked import MarkedPass, follow_markers, is_marked
from jaxmocap.pipelines.tracking.motions import (
    Tracked,
    join_outputs,
    low_pass_poses,
    motions,
    steps_as_trajectory,
)
from jaxmocap.smoothing.batch import smooth_recording
from jaxmocap.smoothing.fixed_lag import FixedLagSmoother
from jaxmocap.smoothing.markers_alone import smooth_markers
from jaxmocap.smoothing.problem import FirstPass, Trajectory
from jaxmocap.smoothing.settings import allow_for_noise
from jaxmocap.smoothing.uncertainty import deviations_without
from jaxmocap.smoothing.window.advance import DELAY_FRAMES, DELAY_S

# A camera that looks so far aside of what its calibration states was pushed, degrees. On a person
# of other lengths than stated those that were not seem to be by up to 1.3.
TURNED_DEG = 1.5
# Run -> the people on whose recordings the factors of its deviations were chosen.
CALIBRATED_ON = {
    "video": "rendered table-tennis players and fencers, and a real person before four cameras",
    "causal": "five rendered table-tennis players, five fencers, a real person before four cameras",
    "markers": "six real people who walk, by their joints in Plug-in Gait",
}


def track(
    recording: Recording,
    settings: Settings | None = None,
    *,
    mode: Mode = "own",
    progress: Progress | bool | None = None,
    tracker: HybridTracker | None = None,
) -> Motion:
    """Track a recording.

    Where it is smoothed over all its frames, a video whose image surely moves with the hands at
    another time than its offset states is taken at that time, and the report has a warning.

    Args:
        recording: markers, and any number of videos.
        settings: of the tracker; defaults to ``Settings()``.
        mode: ``own`` looks at each video frame at its own time, with the markers interpolated
            there; ``nearest`` looks at the frame nearest to each marker sample, as in the paper;
            ``causal`` is ``own`` without any later marker or frame than a live run would have:
            poses are smoothed by what came before and by at most two more video frames, or 0.1 s.
        progress: called with the events done and their total, then with the percent of the second
            pass done and 100; True shows a bar on stderr, None does so on a terminal.
        tracker: of this recording, so that it compiles once for several
            runs; its settings hold.

    Returns:
        One pose per marker sample, NaN before the first sample with a marker, and a report: what
        was missing and how long each stage took. ``milliseconds`` has ``decode`` and ``observe``
        of each event with a video frame, ``solve`` and ``refine`` of an event in each chunk of
        them, ``frame`` for all that a chunk took by each of its frames (``sample``: by each of its
        events, where there is none), ``first_call`` for what comes before the first event, and
        ``smooth`` for the second pass, compilation included. Causally they are the steps' own:
        ``observe`` and ``refine`` where nothing is smoothed, ``sample`` all at events without a
        frame, ``first_call`` has the first event, ``smooth`` is of each event
        with a frame. Without smoothing ``carry`` is the second call at events without a frame.

    Raises:
        InputError: a video or key points that cannot be used with the recording.
        ValueError: something was chosen that has no part in it, see ``unused_setting``.

    Example:
        >>> from jaxmocap import Recording, Settings, track
        >>> recording = Recording.load("recording.toml")
        >>> motion = track(recording, Settings(refine="none"))  # without the video
        >>> motion.joints()["elbow_r"].shape == (len(recording.times), 3)  # world, Z up, metres
        True
    """
    return track_both(recording, settings, mode=mode, progress=progress, tracker=tracker).motion


def track_both(
    recording: Recording,
    settings: Settings | None = None,
    *,
    mode: Mode = "own",
    progress: Progress | bool | None = None,
    tracker: HybridTracker | None = None,
    why: bool = False,
) -> Tracked:
    """Track a recording and keep the markers' own poses as well; see ``track``.

    With ``why`` the report has how sure landmarks would be without each part of the evidence.

    Raises:
        InputError: ``why``, and nothing is smoothed over the whole recording.
    """
    clock, causal, began = Clock(), mode == "causal", perf_counter()
    opened = open_recording(recording, mode)
    tracker = tracker or HybridTracker.from_recording(opened.recording, settings)
    has_video = bool(opened.videos) and tracker.model.camera_count > 0
    marked = not (causal and has_video) and is_marked(tracker)
    # Markers that determine the body need no smoothing but by the video.
    smooth = tracker.settings.smooth and (has_video or not marked)
    if problem := unused_setting(tracker.settings, smooth or marked, causal):
        raise ValueError(problem)
    if has_video and mode != "nearest" and not (marked or smooth or tracker.settings.search):
        problem = "found search = false (--paper), which takes no frame between two samples"
        expected = "no --causal, and" if causal else "the nearest frame:"
        raise recording.error(f"{problem}: expected {expected} --nearest")
    if why and (causal or not smooth):
        problem = "found --why, which is of poses that are smoothed over the whole recording"
        expected = "smoothing and neither --causal nor --paper"
        if marked and not has_video:
            expected = "a video, or fewer markers: these determine the body in each sample"
        raise recording.error(f"{problem}: expected {expected}")
    if cutoff := float(tracker.settings.low_pass):
        check_cutoff(opened.recording, cutoff, "low_pass")
    if has_video:
        opened = with_checked_clocks(opened, corrects=smooth and not causal)
    used = opened.videos if has_video else []
    events = RecordingEvents.of(opened.recording, used, mode, opened.cleaning)
    smoother = None
    if smooth and causal:
        have_points = sum(each is not None for each in opened.keypoints)
        smoother = FixedLagSmoother(tracker.model, tracker.settings.smoothing, have_points)
    by_markers: MarkedPass | None = None
    in_colour = forward_readers(used, colour=smoother is not None)
    with progress_bar("tracking", progress, "compiling") as show, in_colour as readers:
        if marked:
            by_markers = follow_markers(events, tracker, show, causal)
            tracker, first, final = by_markers.tracker, by_markers.first, []
            opened = opened._replace(recording=by_markers.recording(opened.recording))
        elif causal:
            first, final = step_events(
                events, tracker, readers, smoother, show, clock, opened.keypoints
            )
        else:
            first, final = scan_events(events, tracker, readers, show, clock), []
    trajectory, passed = join_outputs(final, len(used)) if smoother else None, perf_counter()
    if smooth and not causal:
        with progress_bar("smoothing", progress, "compiling") as show:
            trajectory = clock.time_stage(
                "smooth", _smooth_recording, opened, events, tracker, first,
                lambda share: show(round(100 * share), 100), why,
            )  # fmt: skip
    cameras = tuple(source.camera_name for source in recording.videos)
    # Each camera's estimated rotation against its calibration, a vector in its frame.
    turns = [] if trajectory is None else np.degrees(trajectory.turns_cam).tolist()
    warnings = opened.warnings + _turn_warnings(cameras, turns)
    if smooth and opened.noise > tracker.settings.smoothing.markers.deviation:
        shake = f"the markers shake by {1e3 * opened.noise:.0f} mm, a standard deviation of a"
        warnings += (f"{shake} coordinate; deviations allow for that",)
    left_out = trajectory and trajectory.left_out
    people = CALIBRATED_ON["markers" if not used else "causal" if causal else "video"]
    # Within which a smoothed causal pose is given out.
    latency = ({"video frames": DELAY_FRAMES} if used else {}) | {"seconds": DELAY_S}
    run = Run(
        recording=str(recording.path or recording.name),
        mode=mode,
        cameras=cameras,
        markers=recording.marker_names,
        warnings=warnings,
        filters=opened.cleaning.figures(),
        tracker=plain(tracker.settings),
        camera_turns_deg=dict(zip(cameras, turns, strict=False)),
        deviations_without_m=deviations_without(left_out or (), recording.marker_names, cameras),
        deviations={"calibrated_on": people if tracker.settings.smooth else None},
        latency=latency if smoother else {},
        video_frames=_frame_count(events.timeline.frame_index) if used else 0,
        seconds={"first pass": passed - began, "second pass": perf_counter() - passed},
        fitted=by_markers and by_markers.sentence,
    )
    trajectory = trajectory or (by_markers and by_markers.trajectory)
    ended = trajectory or steps_as_trajectory(first)
    if cutoff:
        ended = ended._replace(poses=_low_pass(events, ended.poses, tracker, cutoff))
    as_tracked = replace(recording, videos=opened.recording.videos)
    found = motions(tracker.model, events, first, ended, clock.milliseconds, run)
    return Tracked(*found, as_tracked)


def _turn_warnings(cameras: Sequence[str], turns_deg: Sequence[Sequence[float]]) -> tuple[str, ...]:
    """Which cameras do not look where their calibrations state, by their estimated turns."""
    aside = [float(np.hypot(x, y)) for x, y, _ in turns_deg]
    return tuple(
        f"{name}: turned by {size:.1f}° against its calibration, as its images fit the markers; "
        "calibrate it again"
        for name, size in zip(cameras, aside, strict=False)
        if size > TURNED_DEG
    )


def _frame_count(frame_index: np.ndarray) -> int:
    """How many instants of the videos events (E, C) look at; one may serve several of them."""
    return len(np.unique(frame_index[(frame_index >= 0).any(-1)], axis=0))


def with_sight_lines(opened: Opened, events: RecordingEvents, first: FirstPass) -> FirstPass:
    """A first pass with lines of sight to the tracked person's key points, chosen by its poses."""
    lines = lines_at_events(
        opened.recording, opened.keypoints, events.timeline, first.reports.marker_pose
    )
    return first._replace(sight_lines=lines)


def _smooth_recording(
    opened: Opened,
    events: RecordingEvents,
    tracker: HybridTracker,
    first: FirstPass,
    show: Callable[[float], None],
    why: bool,
) -> Trajectory | None:
    model, settings = tracker.model, allow_for_noise(tracker.settings.smoothing, opened.noise)
    if not model.camera_count or not (first.frame_index >= 0).any():
        return smooth_markers(model, settings, first, show, why)
    first = with_sight_lines(opened, events, first)
    videos = cached_frames(opened.videos, ROWS)
    found = smooth_recording(model, settings, first, videos, show, why)
    if found is None or found.unrecognised is None or first.sight_lines is not None:
        return found
    if not np.array_equal(found.unrecognised, first.frame_index >= 0):
        return found
    # In none of the frames is anything of the person.
    alone = smooth_markers(model, settings, first, show, why)
    return alone._replace(unrecognised=found.unrecognised)


def _low_pass(events: RecordingEvents, poses: Pose, tracker: HybridTracker, cutoff: float) -> Pose:
    """Poses of the events, of which those at the samples are filtered."""
    rows = np.flatnonzero(events.timeline.sample_index >= 0)
    times = events.recording.times[events.before :]
    at_samples = jax.tree.map(lambda part: np.asarray(part)[rows], poses)
    filtered = low_pass_poses(times, at_samples, tracker.model.skeleton, cutoff)
    poses = jax.tree.map(np.array, poses)
    for part, new in zip(poses, filtered, strict=True):
        part[rows] = new
    return poses
