"""A recording gone through as a whole: the tracker's steps, a chunk of events at a time.

    solve_all    chunk 3                        (device)
    look                  chunk 2               (host, beside: every frame decoded and observed)
    refine_all                     chunk 1      (device)

INPUTS: a Plan, a tracker, readers of its videos. OUTPUTS: Passed.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from time import perf_counter
from typing import NamedTuple

import jax
import numpy as np

from jaxmocap.capture.footage import ForwardReader
from jaxmocap.hybrid.first_state import settled_at_once
from jaxmocap.hybrid.observe import Observation, Observer
from jaxmocap.hybrid.scan import EVENTS, Views
from jaxmocap.hybrid.steps import Solved, State
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.images.regions import Region
from jaxmocap.pipelines.progress import Tally
from jaxmocap.pipelines.tracking import warnings
from jaxmocap.pipelines.tracking.events import Plan
from jaxmocap.pipelines.tracking.first_pass import Passed


class Looked(NamedTuple):
    """What the cameras saw at the events of a chunk.

    Attributes:
        views: for ``refine_all``; None without cameras.
        said: sentences about each event's images.
        frames: how many events have an image.
    """

    views: Views | None
    said: list[list[str]]
    frames: int


class Chunk(NamedTuple):
    """``EVENTS`` events on their way; the last chunk is filled up with the last event.

    Attributes:
        events: those of the recording, at most ``EVENTS``.
        markers: (EVENTS, M, 3).
        times: (EVENTS,) seconds since the first event.
        solved: what the markers tell (EVENTS, ...).
        looked: what the cameras tell, once that is there.
    """

    events: range
    markers: np.ndarray
    times: np.ndarray
    solved: Solved
    looked: Future[Looked]


def scanned(
    plan: Plan,
    tracker: HybridTracker,
    readers: Sequence[ForwardReader],
    show: Callable[[int, int], None],
) -> Passed:
    """Scan through the events.

    Args:
        plan: the events.
        tracker: whose steps are taken.
        readers: of its cameras' videos.
        show: called with the events done and their total, chunk by chunk.
    """
    tally, began = Tally(), perf_counter()
    solving, refining = _compiling(tracker, plan)
    solve = solving()
    state = settled_at_once(tracker, solve, plan.markers_world[0])
    solve = tally.timed("solve", solve, EVENTS)
    look = partial(_look, plan, tracker.observer.fresh(), readers, tally)
    shared = tracker.skeleton, tracker.cameras, tracker.settings
    parts, said, belief = [], [], state.belief
    with ThreadPoolExecutor(1, "look") as beside:
        submit = partial(beside.submit, look)
        # The first is looked at while its refinement may still be compiling.
        chunks = _one_ahead(_chunks(plan, tracker, solve, state, submit))
        refine = tally.timed("refine", refining(), EVENTS)
        began = tally.keep("first_call", began)
        for chunk in chunks:
            looked, count = chunk.looked.result(), len(chunk.events)
            belief, found = refine(
                *shared, tracker.factors, chunk.solved, chunk.markers, looked.views, belief,
                chunk.times,
            )  # fmt: skip
            parts.append(jax.tree.map(lambda part, n=count: np.asarray(part)[:n], found))
            said += _sentences(parts[-1][1], looked)
            # All stages together, as far as they did not run beside one another.
            stage, among = ("frame", looked.frames) if looked.frames else ("sample", count)
            began = tally.keep(stage, began, among)
            show(len(said), len(plan.times))
    refined, reports = jax.tree.map(lambda *each: np.concatenate(each), *parts)
    return Passed(plan, refined, reports, said, tally.milliseconds)


def _compiling(
    tracker: HybridTracker, plan: Plan
) -> tuple[Callable[[], Callable], Callable[[], Callable]]:
    """What waits for either scan, for the shapes of the plan; the rest compiles beside as well."""
    shared = tracker.skeleton, tracker.cameras, tracker.settings
    count = plan.markers_world.shape[1]
    state = tracker.init_like(count)
    markers = np.zeros((EVENTS, *plan.markers_world.shape[1:]), tracker.dtype)
    times = np.zeros(EVENTS, tracker.dtype)

    def refine_like(solved: Solved) -> tuple:
        views = None
        if solved.region is not None:
            first = jax.tree.map(lambda part: np.zeros(part.shape[1:], part.dtype), solved.region)
            views = Views.of(tracker.observer.observe(None, first), [None] * EVENTS)
        # Not the factors themselves, which take a program of their own.
        factors = jax.ShapeDtypeStruct((3,), tracker.dtype)
        return *shared, factors, solved, markers, views, state.belief, times

    start = state.pose, state.stance
    compiling = tracker.scans.compiling((*shared, start, markers), refine_like)
    tracker.prepare(count)
    return compiling


def _chunks(
    plan: Plan,
    tracker: HybridTracker,
    solve: Callable,
    state: State,
    submit: Callable[[range, Region | None], Future[Looked]],
) -> Iterator[Chunk]:
    """All chunks in turn, each solved, and looked at beside."""
    shared = tracker.skeleton, tracker.cameras, tracker.settings
    last, total = (state.pose, state.stance), len(plan.times)
    for first in range(0, total, EVENTS):
        rows = np.minimum(np.arange(first, first + EVENTS), total - 1)
        markers = plan.markers_world[rows].astype(tracker.dtype)
        times = plan.times[rows].astype(tracker.dtype)
        last, solved = solve(*shared, last, markers)
        events = range(first, min(first + EVENTS, total))
        yield Chunk(events, markers, times, solved, submit(events, solved.region))


def _one_ahead(chunks: Iterator[Chunk]) -> Iterator[Chunk]:
    """The first is on its way at once, and is given out when the next one is too, and so on."""

    def given(waiting: Chunk) -> Iterator[Chunk]:
        for chunk in chunks:
            yield waiting
            waiting = chunk
        yield waiting

    return given(next(chunks))


def _look(
    plan: Plan,
    observer: Observer,
    readers: Sequence[ForwardReader],
    tally: Tally,
    events: range,
    regions: Region | None,
) -> Looked:
    """Decode and observe the frames of these events, in order: thresholds are remembered."""
    if regions is None or not readers:
        return Looked(None, [[] for _ in events], 0)
    host, said = jax.tree.map(np.asarray, regions), []
    found: list[Observation | None] = [None] * EVENTS
    for row, event in enumerate(events):
        began = perf_counter()
        frames = plan.timeline.frame_index[event]
        images = [reader.at(i) for reader, i in zip(readers, frames, strict=True)]
        if any(image is not None for image in images):
            began = tally.keep("decode", began)
            region = jax.tree.map(lambda part, i=row: part[i], host)
            found[row] = observer.observe(images, region)
            tally.keep("observe", began)
        said.append(plan.about_images(event, images))
    nothing = observer.observe(None, jax.tree.map(lambda part: part[0], host))
    return Looked(Views.of(nothing, found), said, sum(each is not None for each in found))


def _sentences(reports, looked: Looked) -> Iterator[list[str]]:
    """What is to be said of each event of a chunk: of its step, of its images."""
    for row, said in enumerate(looked.said):
        report = jax.tree.map(lambda part, i=row: part[i], reports)
        yield [*warnings.of_step(report), *said]
