"""Time and memory: clocks, the yardstick, and the silhouette tracker's stages.

A time is taken twice over: by the wall's clock, which users wait by, and by the processor's, which
stands still while the machine does something else. Ratios are of the latter, taken in turn: they
hold on a busy machine too. On one core, alone, the two clocks agree.

The yardstick is OpenCV's bare image chain on both arms' regions, one thread. Nothing that looks for
an arm's edges can do with less; so a tracker's step is reported as a multiple of it.

INPUTS: functions; frames, and where the elbows are in them; a tracker at work.
OUTPUTS: milliseconds, MiB; crops and their distance transforms; milliseconds of each stage.
"""

import gc
import resource
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from time import perf_counter, process_time
from typing import Any, NamedTuple
from unittest.mock import patch

import cv2
import jax
import jax.numpy as jnp
import numpy as np

from bench.figures import Metric
from jaxmocap.capture import footage
from jaxmocap.capture.markers import interpolate_markers
from jaxmocap.compilation.clock import Clock
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.geometry.cameras import Camera, project
from jaxmocap.images.regions import crop
from jaxmocap.silhouette import tracker
from jaxmocap.silhouette.fit import cycles
from jaxmocap.silhouette.segmentation import outlines
from jaxmocap.silhouette.surfaces import rim

# Samples along a side of a region, and Canny's thresholds: usual ones.
SIDE, LOW, HIGH = 200, 50, 150
ELBOWS = ("elbow_l", "elbow_r")
# Stage -> whose attributes do its work, in the order of a frame. ``decode`` is what a frame waits
# for the decoders, which work ahead on threads of their own.
STAGES: dict[str, tuple[tuple[object, str], ...]] = {
    "decode": ((footage.ForwardReader, "at"),),
    "predict": ((tracker, "predicted_pose"),),
    "rim": ((rim.RimFinder, "find"),),
    "canvases": ((outlines, "canvas"), (outlines, "silhouette_distance")),
    "segmentation": ((outlines, "segment"),),
    "sharpening": ((outlines, "_sharpen_contours"),),
    "contours": ((outlines, "contours"),),
    "matching": ((cycles, "match_pairs"),),
    "edges": ((cycles, "inner_edge_pairs"),),
    "fit": ((cycles, "fit"),),
    "hypotheses": ((tracker, "recover_limbs"),),
}
REST, WHOLE_FRAME = "the rest", "whole frame"


class Span(NamedTuple):
    """Milliseconds by the wall's clock, and by the processor's, all threads together."""

    wall: float
    busy: float


class Stopwatch:
    """Running since it was made."""

    def __init__(self):
        self._wall, self._busy = perf_counter(), process_time()

    def read(self) -> Span:
        """Since the start."""
        return Span(1e3 * (perf_counter() - self._wall), 1e3 * (process_time() - self._busy))


class BusyClock(Clock):
    """The tracker's clock for its stages, which keeps Spans as well.

    Attributes:
        spans: of the present step's stages.
    """

    def __init__(self):
        super().__init__()
        self.spans: dict[str, Span] = {}

    def time_stage(self, stage: str, function: Callable, *arguments: Any, among: int = 1) -> Any:
        """What a function returns, once it is there; its Span is kept, of each of so many."""
        span, result = timed(function, *arguments)
        self.spans[stage] = Span(span.wall / among, span.busy / among)
        self.milliseconds.setdefault(stage, []).append(span.wall / among)
        return result


def timed(function: Callable, *arguments) -> tuple[Span, Any]:
    """Until the result is there, and the result."""
    watch = Stopwatch()
    result = jax.block_until_ready(function(*arguments))
    return watch.read(), result


def interleaved(
    functions: Mapping[str, Callable[[], Any]], rounds: int, warm: int = 2
) -> dict[str, np.ndarray]:
    """Spans (rounds, 2) of each function, taken in turn."""
    spent: dict[str, list[Span]] = {name: [] for name in functions}
    for turn in range(warm + rounds):
        for name, function in functions.items():
            span, _ = timed(function)
            if turn >= warm:
                spent[name].append(span)
    return {name: np.array(spans) for name, spans in spent.items()}


def start_up(name: str, jitted: Any, *arguments) -> list[Metric]:
    """What a jitted function costs before it runs: trace, lower and compile, first call.

    Compiled programs that an earlier run has kept are read; tracing is never kept.
    """
    tracing, traced = timed(jitted.trace, *arguments)
    compiling, _ = timed(lambda: traced.lower().compile())
    calling, _ = timed(jitted, *arguments)
    parts = {"trace": tracing, "compile": compiling, "first call after it": calling}
    return [
        Metric(f"{name}, {part}", span.wall / 1e3, "s", tolerance=0.5)
        for part, span in parts.items()
    ]


def ratio(one: np.ndarray, other: np.ndarray) -> float:
    """Of Spans (N, 2) and (M, 2): median over median of the processor's time."""
    return float(np.median(one[:, 1]) / np.median(other[:, 1]))


def settle_garbage() -> None:
    """Collect what tracing left, and never look at it again: a pass over it takes milliseconds."""
    gc.collect()
    gc.freeze()


def peak_mib() -> float:
    """Most memory that the process has held so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def image_chain(regions_bgr: Sequence[np.ndarray]) -> list[np.ndarray]:
    """BGR to grey, 5 x 5 blur, equalise, Canny, L2 distance transform by a 3 x 3 mask."""
    fields = []
    for region in regions_bgr:
        grey = cv2.cvtColor(region, cv2.COLOR_BGR2GRAY)
        even = cv2.equalizeHist(cv2.GaussianBlur(grey, (5, 5), 0))
        edges = cv2.Canny(even, LOW, HIGH)
        fields.append(cv2.distanceTransform(cv2.bitwise_not(edges), cv2.DIST_L2, 3))
    return fields


def both_arms(
    recording: Recording, camera: Camera, times: np.ndarray, images: Sequence[np.ndarray]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Of each BGR frame the two crops about the true elbows, for what a region would be."""
    assert recording.path is not None
    truth = read_markers(recording.path.with_name("truth.trc"))
    points = np.stack([truth.points()[name] for name in ELBOWS], 1)
    elbows = interpolate_markers(truth.times, points, times)
    origins = np.round(np.asarray(project(camera, jnp.asarray(elbows, float)))) - SIDE / 2 - 0.5
    return [
        (crop(image, at[0], 1.0, SIDE), crop(image, at[1], 1.0, SIDE))
        for image, at in zip(images, origins, strict=True)
    ]


class StageClock:
    """Adds up what the stages of one frame take, frame after frame.

    A stage that calls another one does not count what that one takes.

    Attributes:
        frames: stage -> milliseconds, one dictionary a frame; the rest and the whole too.
    """

    def __init__(self):
        self.frames: list[dict[str, float]] = []
        self._now: dict[str, float] = {}

    def time_stage(self, stage: str, function: Callable) -> Callable:
        """The function, whose times count for a stage; it returns when its result is there."""

        def run(*arguments, **named):
            began, before = perf_counter(), sum(self._now.values())
            result = jax.block_until_ready(function(*arguments, **named))
            others = sum(self._now.values()) - before
            spent = 1e3 * (perf_counter() - began) - others
            self._now[stage] = self._now.get(stage, 0.0) + spent
            return result

        return run

    def step(self, function: Callable) -> Callable:
        """The tracker's step, whose end is the frame's."""

        def run(*arguments, **named):
            waited = self._now.get("decode", 0.0)
            began = perf_counter()
            result = function(*arguments, **named)
            spent = 1e3 * (perf_counter() - began)
            rest = spent - (sum(self._now.values()) - waited)
            self.frames.append({**self._now, REST: rest, WHOLE_FRAME: spent + waited})
            self._now = {}
            return result

        return run


@contextmanager
def stages_timed() -> Iterator[StageClock]:
    """Within, every silhouette tracker's stages are timed; waiting for them takes a little more."""
    clock = StageClock()
    with ExitStack() as patches:
        for stage, workers in STAGES.items():
            for owner, name in workers:
                timed = clock.time_stage(stage, getattr(owner, name))
                patches.enter_context(patch.object(owner, name, timed))
        step = clock.step(tracker.SilhouetteTracker.step)
        patches.enter_context(patch.object(tracker.SilhouetteTracker, "step", step))
        yield clock
