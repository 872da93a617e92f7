"""How long a frame takes, stage by stage, at three sizes and in several ways of working.

INPUTS: a synthetic table-tennis clip, 30 Hz, markers at 90 Hz.
OUTPUTS: Metrics. Frames are decoded beforehand but where the name says otherwise.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from bench.clips import SIZES, Footage, at_size
from bench.clock import (
    BusyClock,
    Span,
    Stopwatch,
    both_arms,
    image_chain,
    peak_mib,
    ratio,
    settle_garbage,
    start_up,
    timed,
)
from bench.figures import OF_OTHERS, Metric, stage_metrics
from jaxmocap.capture.footage import forward_readers, open_footage
from jaxmocap.capture.markers import interpolate_markers
from jaxmocap.capture.timeline import build_timeline
from jaxmocap.capture.video import open_video
from jaxmocap.evidence.terms import Measurements
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.hybrid.ik import goals_of
from jaxmocap.hybrid.observe import edge_fields
from jaxmocap.hybrid.paper import ik as paper_ik
from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.step import REFINE, SOLVE
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.pipelines.tracking.track import track
from jaxmocap.reference.hybrid import ik as reference_ik
from jaxmocap.smoothing.fixed_lag import FixedLagSmoother

ImageAt = Callable[[int], np.ndarray | None]
# Stage -> what the table calls it.
STAGES = {
    "solve": "solve",
    "observe": "observe",
    "refine": "refine",
    "step": "tracker's step with a frame",
    "smooth": "fixed-lag smoothing",
    "frame": "causal step with a frame",
    "sample": "causal step without a frame",
}
# Solves by the NumPy/SciPy reference, quickly and in full.
SOLVES = {True: 30, False: 120}


@dataclass
class Pace:
    """How long the parts of a causal run took.

    Attributes:
        spans: stage -> times; "chain" is the yardstick, taken in turn with the frames.
        duration_s: of the recording.
    """

    spans: dict[str, list[Span]] = field(default_factory=dict)
    duration_s: float = 0.0

    def keep(self, stage: str, span: Span) -> None:
        """One more time of a stage."""
        self.spans.setdefault(stage, []).append(span)

    def of(self, stage: str) -> np.ndarray:
        """All times (N, 2) of a stage, by both clocks."""
        return np.array(self.spans[stage])

    def wall(self, stage: str) -> np.ndarray:
        """All times (N,) of a stage, by the wall's clock."""
        return self.of(stage)[:, 0]

    @property
    def core_share(self) -> float:
        """Of one core, at the recording's own pace, per cent."""
        busy = sum(self.of(stage)[:, 1].sum() for stage in ("frame", "sample"))
        return 100 * busy / 1e3 / self.duration_s


def causal(
    tracker: HybridTracker,
    footage: Footage,
    image_at: ImageAt,
    chain: Callable[[int], object] = lambda frame: None,
) -> Pace:
    """As a live run: every marker sample and every frame in turn, smoothed where that is set.

    Args:
        tracker: compiled already, or the first times tell of that.
        footage: whose markers and times count.
        image_at: the frame of that index.
        chain: the yardstick on that frame; run right after it.
    """
    recording, clock = footage.recording, BusyClock()
    model, settings = tracker.model, tracker.settings
    smoother = None
    if settings.smooth and model.camera_count:
        smoother = FixedLagSmoother(model, settings.smoothing)
    line = build_timeline(recording.times, [footage.times], "causal")
    markers = interpolate_markers(
        recording.times, recording.positions_world, line.event_times, True
    )
    state = tracker.init(recording.positions_world[0])
    pace = Pace(duration_s=float(line.event_times[-1] - line.event_times[0]))
    for event, time in enumerate(line.event_times):
        frame, total = int(line.frame_index[event, 0]), Stopwatch()
        images = [None if frame < 0 else image_at(frame)]
        step = Stopwatch()
        clock.spans, report = {}, None
        if smoother is None:
            state, *found = tracker.step(state, time, markers[event], images, clock)
            jax.tree.map(np.asarray, found)
        elif not smoother.lies_between(time, images, markers[event]):
            state, *found = tracker.solve(state, markers[event], clock)
            _, report = jax.tree.map(np.asarray, found)
        clock.spans["step"] = step.read()
        if smoother is not None:
            # Between the samples markers are extrapolated, which the smoother does better.
            there = markers[event] if line.sample_index[event] >= 0 else np.nan * markers[event]
            clock.time_stage("smooth", smoother.step, time, there, images, report)
        if frame < 0:
            pace.keep("sample", total.read())
            continue
        clock.spans["frame"] = total.read()
        for stage, span in clock.spans.items():
            pace.keep(stage, span)
        pace.keep("chain", timed(chain, frame)[0])
    return pace


def measure(footage: Footage, quick: bool) -> Iterator[Metric]:
    """All figures of this part.

    Args:
        footage: of 640 x 480 pixels.
        quick: this size and the default settings alone, and no second pass.
    """
    crops = both_arms(footage.recording, footage.camera, footage.times, footage.images)

    def chain(frame: int) -> object:
        return image_chain(crops[frame])

    tracker = HybridTracker.from_recording(footage.recording)
    yield from starting(tracker, footage)
    causal(tracker, footage, footage.images.__getitem__, chain)
    settle_garbage()
    pace = causal(tracker, footage, footage.images.__getitem__, chain)
    yield from at_one_size("640x480", pace)
    # The tracker's own loop refines at every frame; smoothed, it is asked at some of them.
    alone = HybridTracker.from_recording(footage.recording, replace(tracker.settings, smooth=False))
    causal(alone, footage, footage.images.__getitem__, chain)
    loop = causal(alone, footage, footage.images.__getitem__, chain)
    yield from over_chain(pace, loop)
    yield Metric("memory, most so far", peak_mib(), "MiB")
    yield from against_reference(footage.recording, SOLVES[quick])
    if not quick:
        yield from offline(tracker, footage, pace)
        yield from at_all_sizes(footage)
        yield from otherwise(footage)


def starting(tracker: HybridTracker, footage: Footage) -> Iterator[Metric]:
    """What a first step costs: solve and refine apart, then the smoother's first frames."""
    recording = footage.recording
    beginning, state = timed(tracker.init, recording.positions_world[0])
    model, settings = tracker.model, tracker.settings
    targets = np.asarray(recording.positions_world[0], model.dtype)
    solve = (model, settings, state.pose, state.feet, targets)
    yield Metric(
        "start: first placement, trace and compile", beginning.wall / 1e3, "s", tolerance=0.5
    )
    yield from start_up("start: solve", SOLVE, *solve)
    solved = SOLVE(*solve)
    fields, _ = edge_fields(settings, state.thresholds, [footage.images[0]], solved.region)
    elapsed = np.asarray(0.0, model.dtype)
    refine = (model, settings, tracker.bow_factors, solved, targets, fields, state.belief, elapsed)
    yield from start_up("start: refine", REFINE, *refine)


def at_one_size(size: str, pace: Pace) -> Iterator[Metric]:
    """The stages, the frame rate, and the share of a core."""
    for stage, name in STAGES.items():
        if stage in pace.spans:
            yield from stage_metrics(f"{size}, {name}", pace.wall(stage))
    rate = 1e3 / float(np.median(pace.wall("frame")))
    yield Metric(f"{size}, causal frames per second", rate, "1/s", "higher")
    yield Metric(f"{size}, causal, of one core at 30 Hz", pace.core_share, "%")


def over_chain(pace: Pace, loop: Pace) -> Iterator[Metric]:
    """Times as multiples of the bare image chain, taken in turn.

    Args:
        pace: of the smoothed run.
        loop: of the tracker alone, which refines at every frame.
    """
    yield from stage_metrics("bare image chain, two 200x200 regions", pace.wall("chain"))

    def over(run: Pace, stage: str) -> float:
        return ratio(run.of(stage), run.of("chain"))

    yield Metric("step_over_image_chain", over(pace, "frame"), "x", "lower", OF_OTHERS)
    yield Metric("tracker_step_over_image_chain", over(loop, "step"), "x", "lower", OF_OTHERS)
    for run, stage in ((loop, "solve"), (loop, "observe"), (loop, "refine"), (pace, "smooth")):
        yield Metric(f"{stage}_over_image_chain", over(run, stage), "x", "lower", OF_OTHERS)
    for run, stage, name in ((loop, "step", "tracker_step"), (pace, "frame", "step")):
        late = float(np.percentile(busy := run.of(stage)[:, 1], 99) / np.median(busy))
        yield Metric(f"{name}_p99_over_median", late, "x", "lower", OF_OTHERS)


def offline(tracker: HybridTracker, footage: Footage, pace: Pace) -> Iterator[Metric]:
    """The default: a first pass, and a second one over the whole recording."""
    before, _ = timed(lambda: track(footage.decoded, tracker=tracker))
    watch = Stopwatch()
    report = track(footage.decoded, tracker=tracker).report
    total, frames = watch.read(), len(footage.images)
    assert report is not None
    second_pass = float(report.milliseconds["smooth"][0])
    compiling = max(before.wall - total.wall, 0.0) / 1e3
    yield Metric("start: second pass, trace and compile", compiling, "s", tolerance=0.5)
    yield Metric("640x480, first pass, per frame", (total.wall - second_pass) / frames, "ms")
    yield Metric("640x480, second pass, per frame", second_pass / frames, "ms")
    chain = float(np.median(pace.of("chain")[:, 1]))
    yield Metric("offline_over_image_chain", total.busy / frames / chain, "x", "lower", OF_OTHERS)


def at_all_sizes(footage: Footage) -> Iterator[Metric]:
    """The causal loop at larger sizes, and decoding beside it at all of them."""
    for width, height in SIZES:
        size = f"{width}x{height}"
        larger = at_size(footage, width, height)
        tracker = HybridTracker.from_recording(larger.recording)
        # The smoother's grids are as large as the images: the first way through compiles.
        causal(tracker, larger, larger.images.__getitem__)
        if (width, height) != SIZES[0]:
            yield from at_one_size(size, causal(tracker, larger, larger.images.__getitem__))
        yield from decoding(size, tracker, larger)


def decoding(size: str, tracker: HybridTracker, footage: Footage) -> Iterator[Metric]:
    """Decoding by itself, to colour and to grey, and within the causal loop."""
    video = open_video(footage.recording.videos[0])
    for name, luma in (("BGR", False), ("grey", True)):
        watch = Stopwatch()
        count = sum(1 for _ in video.frames(luma=luma))
        spent = watch.read()
        yield Metric(f"{size}, decoding to {name}", spent.wall / count, "ms")
        of_core = 100 * spent.busy / 1e3 * video.fps / len(video)
        yield Metric(f"{size}, decoding to {name}, of one core at 30 Hz", of_core, "%")
    videos, _ = open_footage(footage.recording)
    with forward_readers(videos, colour=True) as (reader,):
        pace = causal(tracker, footage, reader.at)
    yield from stage_metrics(f"{size}, causal step with a frame and decoding", pace.wall("frame"))


def otherwise(footage: Footage) -> Iterator[Metric]:
    """Frame by frame without smoothing: markers only, and refined by gradients."""
    image_at = footage.images.__getitem__
    ways = {
        "markers only": Settings(refine="none", smooth=False),
        "gradient": Settings(refine="gradient", smooth=False),
    }
    for name, settings in ways.items():
        tracker = HybridTracker.from_recording(footage.recording, settings)
        causal(tracker, footage, image_at)
        pace = causal(tracker, footage, image_at)
        yield from stage_metrics(f"640x480, {name}, step", pace.wall("frame"))


def against_reference(recording: Recording, solves: int) -> Iterator[Metric]:
    """Algorithm 1, jitted in float32 and in NumPy, from the same start to the same goals."""
    tracker = HybridTracker.from_recording(recording, Settings(refine="none"))
    model, settings = tracker.model, tracker.settings.ik
    # For one person: handing over a model's arrays takes as long as an iteration.
    solve = jax.jit(partial(paper_ik.reach, model, settings))
    state = tracker.init(recording.positions_world[0])
    ours, theirs, farthest = [], [], 0.0
    for turn, markers in enumerate(recording.positions_world[1 : solves + 2]):
        targets = jnp.asarray(markers, model.dtype)
        goals = goals_of(model, settings, state.feet, targets)
        time, (pose, _) = timed(solve, Measurements(goals=goals), state.pose)
        # As NumPy arrays: fetching each of its numbers from JAX would take most of its time.
        plain = jax.tree.map(np.asarray, (model.skeleton, goals, settings, state.pose))
        theirs_took, (expected, _) = timed(reference_ik.reach, *plain)
        if turn:  # The first of ours compiles.
            ours.append(time)
            theirs.append(theirs_took)
        apart = np.asarray(pose.angles, float) - expected.angles
        farthest = max(farthest, float(np.abs(apart).max()))
        state = state._replace(pose=pose)
    yield from stage_metrics("inverse kinematics", [span.wall for span in ours])
    yield from stage_metrics("inverse kinematics, NumPy reference", [span.wall for span in theirs])
    faster = ratio(np.array(theirs), np.array(ours))
    yield Metric("inverse_kinematics_reference_over_ours", faster, "x", "higher", OF_OTHERS)
    yield Metric("inverse kinematics, angles off the reference's", np.degrees(farthest), "°")
