"""The hybrid tracker: markers and one or several cameras to a pose, frame by frame.

A frame is two jitted calls with OpenCV's image chain between them: ``solve``, ``observe``,
``refine`` (``step``). ``step`` takes one event, ``scan`` a whole recording chunk by chunk.

INPUTS: a Model, Settings; markers and images over time. OUTPUTS: states, poses, reports.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from copy import copy
from dataclasses import replace
from time import perf_counter
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Sites
from jaxmocap.body.model import Model, Recorded, marker_sites, on_unmarked_feet
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.compilation.clock import Clock
from jaxmocap.evidence.edges import EdgeFields
from jaxmocap.geometry.cameras import Camera
from jaxmocap.hybrid.elbow_search import ElbowBelief
from jaxmocap.hybrid.feet import FootPlacement
from jaxmocap.hybrid.observe import ArmThresholds, no_thresholds, observe
from jaxmocap.hybrid.refine import Solved, StepReport
from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.step import (
    EVENTS,
    REFINE,
    REFINE_EVENTS,
    SOLVE,
    SOLVE_EVENTS,
    START,
    EventFields,
    RefineInputs,
)

# Images of each camera at one event; None where there is no new one.
Images = Sequence[np.ndarray | None]


class State(NamedTuple):
    """What an event leaves to the next: all of a tracker's memory.

    Attributes:
        pose: of the markers alone.
        feet: where they stand.
        belief: about the elbows, by the video.
        bow_factors: (3,) of the balance heuristic, for this person.
        thresholds: of edges in the arms' regions.
        time: of the event, seconds; None before the first.
    """

    pose: Pose
    feet: FootPlacement
    belief: ElbowBelief
    bow_factors: Array
    thresholds: ArmThresholds
    time: float | None


class Chunk(NamedTuple):
    """Some events that ``scan`` went through.

    Attributes:
        events: which.
        poses: (E, ...) refined.
        reports: (E, ...).
        frames: how many of them have an image.
    """

    events: range
    poses: Pose
    reports: StepReport
    frames: int


class HybridTracker:
    """Tracks one person. Its programs are traced once for a shape of input.

    Attributes:
        model: of the person, the markers and the cameras, as inverse kinematics takes it.
        settings: how to work.
    """

    def __init__(
        self,
        skeleton: Skeleton,
        cameras: Camera | Sequence[Camera] | None = None,
        settings: Settings | None = None,
        markers: Sites | None = None,
    ):
        """Prepare a tracker.

        Args:
            skeleton: of the person.
            cameras: one or several, or None for markers only.
            settings: defaults to ``Settings()``.
            markers: points on bones; defaults to the paper's: the vertex and both wrists.
        """
        chosen = settings or Settings()
        self.model = Model.create(skeleton, markers, cameras)
        if chosen.ik.feet == "follow":
            self.model = on_unmarked_feet(self.model)
        self.settings = chosen if self.model.camera_count else replace(chosen, refine="none")
        self._compiling: tuple[Callable, Callable] | None = None

    @classmethod
    def from_recording(
        cls, recording: Recorded, settings: Settings | None = None
    ) -> "HybridTracker":
        """The tracker of a recording's person, markers and cameras.

        Args:
            recording: its skeleton, where its markers sit, its cameras.
            settings: defaults to ``Settings()``; without refinement, cameras are left out.
        """
        settings = settings or Settings()
        cameras = [video.camera for video in recording.videos] if settings.refine != "none" else []
        sites = marker_sites(recording.skeleton, recording.places)
        return cls(recording.skeleton, cameras, settings, sites)

    def by_search(self) -> "HybridTracker":
        """The same, where nothing follows the search for the elbows."""
        other = copy(self)
        other._compiling = None
        if self.settings.refine != "none":
            other.settings = replace(self.settings, refine="search")
        return other

    def init(self, markers_world: np.ndarray | Array) -> State:
        """The state before the first event, at rest on its (M, 3) markers; NaN where missing.

        Raises:
            ValueError: other markers than the model's.
        """
        first = self.model, self.settings, self._targets(markers_world)
        begun = START.lowered(*first)()(*first)
        thresholds = no_thresholds(self.model.camera_count)
        return State(begun.pose, begun.feet, begun.belief, begun.bow_factors, thresholds, None)

    def step(
        self,
        state: State,
        time: float,
        markers_world: np.ndarray | Array,
        images: Images | None = None,
        clock: Clock | None = None,
    ) -> tuple[State, Pose, StepReport]:
        """One event: solve, observe, refine.

        Args:
            state: after the last event.
            time: of this one, seconds.
            markers_world: (M, 3) metres; NaN where missing.
            images: a BGR or grey uint8 frame per camera, None where there is no new one.
            clock: keeps how long the stages take.

        Returns:
            The state, the refined pose and a report.

        Raises:
            ValueError: other markers than the model's.
        """
        model, settings, clock = self.model, self.settings, clock or Clock(False)
        targets = self._targets(markers_world)
        solved = clock.timed("solve", SOLVE, model, settings, state.pose, state.feet, targets)
        fields, thresholds = None, state.thresholds
        if solved.region is not None:
            fields, thresholds = clock.timed(
                "observe", observe, settings, thresholds, images, solved.region
            )
        elapsed = np.asarray(0.0 if state.time is None else time - state.time, model.dtype)
        belief, pose, report = clock.timed(
            "refine", REFINE, model, settings, state.bow_factors, solved, targets, fields,
            state.belief, elapsed,
        )  # fmt: skip
        after = State(
            solved.ik.pose, solved.ik.feet, belief, state.bow_factors, thresholds, float(time)
        )
        return after, pose, report

    def _targets(self, markers_world: np.ndarray | Array) -> np.ndarray:
        targets = np.asarray(markers_world, self.model.dtype)
        expected = (len(self.model.markers.bone_indices), 3)
        if targets.shape != expected:
            raise ValueError(
                f"markers_world: found shape {targets.shape}, expected {expected}: {self.model}"
            )
        return targets

    def scan(
        self,
        state: State,
        times: np.ndarray,
        markers_world: np.ndarray,
        images: Iterator[Images] | None = None,
        clock: Clock | None = None,
    ) -> Iterator[Chunk]:
        """All events, a chunk at a time; the images of one are observed while another is refined.

            solve     chunk 3                        (device)
            observe            chunk 2               (host, in a thread beside)
            refine                      chunk 1      (device)

        Args:
            state: before the first event, of ``init``.
            times: (E,) seconds.
            markers_world: (E, M, 3) metres; NaN where missing.
            images: of each event, in order; asked for from one other thread.
            clock: keeps how long the stages take.
        """
        clock = clock or Clock(False)
        scan = _Scan(self, state, np.asarray(times, float), markers_world, images, clock)
        solving, refining = self._beside(markers_world.shape[1])
        refine, belief = None, state.belief
        with ThreadPoolExecutor(1, "observe") as beside:
            for events, solved, observed in _one_ahead(scan.solved(solving(), beside)):
                refine = refine or refining()
                fields, frames = observed.result()
                rows = scan.rows(events)
                inputs = RefineInputs(solved, scan.markers(rows), fields, scan.elapsed(rows))
                belief, result = clock.timed(
                    "refine", refine, self.model, self.settings, state.bow_factors, inputs,
                    belief, among=EVENTS,
                )  # fmt: skip
                keep = slice(len(events))
                poses, reports = jax.tree.map(lambda part, k=keep: np.asarray(part)[k], result)
                yield Chunk(events, poses, reports, frames)

    def _beside(self, count: int) -> tuple[Callable[[], Callable], Callable[[], Callable]]:
        """What waits for either scan by so many markers; they compile beside from the first on."""
        if self._compiling is None:
            model, settings = self.model, self.settings
            first = START.shapes(model, settings, self._like(count))
            markers = np.zeros((EVENTS, count, 3), model.dtype)
            like = model, settings, (first.pose, first.feet), markers
            # Only the compiler runs beside: what is traced belongs to this thread's precision.
            solving = SOLVE_EVENTS.beside(*like)
            _, solved = SOLVE_EVENTS.shapes(*like)
            events = RefineInputs(
                solved, markers, self._no_fields(solved), np.zeros(EVENTS, model.dtype)
            )
            refining = REFINE_EVENTS.beside(
                model, settings, first.bow_factors, events, first.belief
            )
            self._compiling = solving, refining
        return self._compiling

    def _no_fields(self, solved: Solved) -> EventFields | None:
        """Of a chunk without images."""
        if solved.region is None:
            return None
        first = jax.tree.map(lambda part: np.zeros(part.shape[1:], part.dtype), solved.region)
        thresholds = no_thresholds(self.model.camera_count)
        nothing, _ = observe(self.settings, thresholds, None, first)
        return EventFields.of(nothing, [None] * EVENTS)

    def _like(self, count: int) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct((count, 3), self.model.dtype)


class _Scan:
    """The events of ``HybridTracker.scan``; the last chunk is filled up with the last event."""

    def __init__(
        self,
        tracker: HybridTracker,
        state: State,
        times: np.ndarray,
        markers_world: np.ndarray,
        images: Iterator[Images] | None,
        clock: Clock,
    ):
        self._tracker, self._state, self._times = tracker, state, times
        self._markers, self._images, self._clock = markers_world, images, clock
        self._thresholds = state.thresholds

    def rows(self, events: range) -> np.ndarray:
        """(EVENTS,) which events a chunk holds."""
        return np.minimum(events.start + np.arange(EVENTS), len(self._times) - 1)

    def markers(self, rows: np.ndarray) -> np.ndarray:
        """(EVENTS, M, 3)."""
        return self._markers[rows].astype(self._tracker.model.dtype)

    def elapsed(self, rows: np.ndarray) -> np.ndarray:
        """(EVENTS,) seconds since the event before."""
        before = self._times[np.maximum(rows - 1, 0)]
        return (self._times[rows] - before).astype(self._tracker.model.dtype)

    def solved(
        self, solve: Callable, beside: ThreadPoolExecutor
    ) -> Iterator[tuple[range, Solved, Future[tuple[EventFields | None, int]]]]:
        """All chunks in turn, each solved, and observed beside."""
        model, settings = self._tracker.model, self._tracker.settings
        last, total = (self._state.pose, self._state.feet), len(self._times)
        for first in range(0, total, EVENTS):
            events = range(first, min(first + EVENTS, total))
            markers = self.markers(self.rows(events))
            last, solved = self._clock.timed(
                "solve", solve, model, settings, last, markers, among=EVENTS
            )
            yield events, solved, beside.submit(self._observed, events, solved)

    def _observed(self, events: range, solved: Solved) -> tuple[EventFields | None, int]:
        """Fields of a chunk's images, in order: thresholds are remembered; how many have one."""
        if solved.region is None:
            return None, 0
        region = jax.tree.map(np.asarray, solved.region)
        settings = self._tracker.settings
        fields: list[EdgeFields | None] = [None for _ in range(EVENTS)]
        for row, _ in enumerate(events):
            began = perf_counter()
            images = next(self._images) if self._images is not None else ()
            if any(image is not None for image in images):
                self._clock.keep("decode", began)
                own = jax.tree.map(lambda part, i=row: part[i], region)
                fields[row], self._thresholds = self._clock.timed(
                    "observe", observe, settings, self._thresholds, images, own
                )
        nothing, _ = observe(
            settings, self._thresholds, None, jax.tree.map(lambda part: part[0], region)
        )
        return EventFields.of(nothing, fields), sum(own is not None for own in fields)


def _one_ahead(chunks: Iterator[Any]) -> Iterator[Any]:
    """The first is on its way at once, and is given out when the next one is too, and so on."""
    waiting = next(chunks)
    for chunk in chunks:
        yield waiting
        waiting = chunk
    yield waiting
