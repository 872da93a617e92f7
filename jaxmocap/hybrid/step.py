"""A step of the tracker as pure functions of arrays, alone and over many events at once.

    solve_event    markers -> pose (section 4), and the regions where it puts the arms
    refine_one     pose, fields of edges -> search, balance (5.3), fit (5.2)
    scans          both over many events, without leaving the device in between

``solve_event`` reads its own last pose only, so regions are settled before any image is looked at.
What the video taught lives in the belief, and is carried to the samples between two video frames.

The model is an argument: another person needs no new program. Many recordings go side by side by
``jax.vmap`` over the scans, whatever differs between them along a new first axis.

INPUTS: a Model, Settings, markers, what was measured. OUTPUTS: poses, reports.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from time import perf_counter
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.arms import arms_of
from jaxmocap.body.kinematics import forward
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose
from jaxmocap.compilation.arrays import on_device
from jaxmocap.compilation.clock import Clock
from jaxmocap.compilation.programs import Program
from jaxmocap.evidence.edges import EdgeFields
from jaxmocap.hybrid.balance import bow_factors, spine_dofs
from jaxmocap.hybrid.elbow_search import ElbowBelief
from jaxmocap.hybrid.feet import FootPlacement, place
from jaxmocap.hybrid.ik import solve_ik
from jaxmocap.hybrid.observe import ArmThresholds, arm_regions, edge_fields
from jaxmocap.hybrid.paper.frame import refine_frame
from jaxmocap.hybrid.refine import Solved, StepReport, refine_event
from jaxmocap.hybrid.settings import Settings

# Events of a scan: few enough that their images take little memory, and that the next chunk can be
# solved while this one is looked at.
EVENTS = 32


class State(NamedTuple):
    """What an event leaves to the next: all of a tracker's memory.

    Attributes:
        pose: of the markers alone.
        feet: where they stand.
        belief: about the elbows, by the video.
        thresholds: of edges in the arms' regions.
        time: of the last event that was refined, seconds; None before the first.
    """

    pose: Pose
    feet: FootPlacement
    belief: ElbowBelief
    thresholds: ArmThresholds
    time: float | None


class EventFields(NamedTuple):
    """Fields of C cameras at some events, each kept once."""

    # (F + 1, C, 2, K, S, S) of F events with an image; the first is of no image.
    distances: Array | np.ndarray
    available: Array | np.ndarray  # (F + 1, C, 2) whether there is an image
    which: Array | np.ndarray  # (E,) which of them belongs to an event; 0 for none

    @classmethod
    def of(cls, nothing: EdgeFields, each: Sequence[EdgeFields | None]) -> "EventFields":
        """Of E events, with room for as many images, so that the shapes are always the same.

        Args:
            nothing: of an event without an image.
            each: of every event; None without an image.
        """
        distances = np.zeros((len(each) + 1, *np.shape(nothing.distances)), np.float32)
        available = np.zeros((len(each) + 1, *np.shape(nothing.available)), bool)
        distances[0], which, count = nothing.distances, np.zeros(len(each), np.int32), 0
        for event, fields in enumerate(each):
            if fields is not None:
                count += 1
                which[event] = count
                distances[count], available[count] = fields.distances, fields.available
        return cls(distances, available, which)


def bow_shares(model: Model, settings: Settings) -> Array:
    """(S,) p_i of the balance heuristic, of a person with S hinges of the spine; 0 without it."""
    if not settings.balance:
        return jnp.zeros(len(spine_dofs(model.skeleton)), model.dtype)
    return bow_factors(model.skeleton, settings.ik)


def nowhere(model: Model) -> tuple[Pose, FootPlacement]:
    """What a tracker knows of a body before its first markers: ``solve_event`` places it."""
    dtype = model.dtype
    unknown, upright = np.full(3, np.nan, dtype), np.array([1, 0, 0, 0], dtype)
    pose = Pose(on_device(unknown, dtype), on_device(upright, dtype), model.skeleton.relaxed)
    ankles = on_device(np.zeros((2, 3)), dtype)
    return pose, FootPlacement(ankles, on_device(False, bool))


def solve_event(
    model: Model, settings: Settings, pose: Pose, feet: FootPlacement, targets: Array
) -> Solved:
    """Markers (M, 3), NaN where missing, to pose and regions, from the last pose and its feet."""
    ik = solve_ik(model, settings.ik, pose, feet, targets)
    if model.cameras is None:
        return Solved(ik, None)
    arms = arms_of(model.skeleton, forward(model.skeleton, ik.pose), model.grips)
    region = arm_regions(model.cameras, arms, settings.samples, settings.margin, settings.spacing)
    return Solved(ik, region)


def solve_events(
    model: Model, settings: Settings, first: tuple[Pose, FootPlacement], markers: Array
) -> tuple[tuple[Pose, FootPlacement], Solved]:
    """``solve_event`` at all events: (E, M, 3) markers to the last pose and feet, and all results.

    Args:
        model: of the person, the markers and the cameras.
        settings: of the tracker.
        first: pose and feet before the first event.
        markers: (E, M, 3) world, metres; NaN where missing.
    """

    def one(
        last: tuple[Pose, FootPlacement], targets: Array
    ) -> tuple[tuple[Pose, FootPlacement], Solved]:
        solved = solve_event(model, settings, *last, targets)
        return (solved.ik.pose, solved.ik.feet), solved

    return jax.lax.scan(one, first, markers)


def refine_one(model: Model, settings: Settings, *rest: Any) -> tuple:
    """An event's ``refine_event``, or where nothing is searched the first paper's frame."""
    return (refine_event if settings.search else refine_frame)(model, settings, *rest)


class RefineInputs(NamedTuple):
    """What ``refine_event`` needs of E events."""

    solved: Solved  # (E, ...) of ``solve_events``
    markers: Array | np.ndarray  # (E, M, 3) as there
    fields: EventFields | None  # what the cameras measured; None without cameras
    elapsed: Array | np.ndarray  # (E,) seconds since the event before


def refine_events(
    model: Model, settings: Settings, bow_factors: Array, events: RefineInputs, belief: ElbowBelief
) -> tuple[ElbowBelief, tuple[Pose, StepReport]]:
    """``refine_event`` at all events: the last belief, and the refined poses and reports (E, ...).

    Args:
        model: of the person, the markers and the cameras.
        settings: of the tracker.
        bow_factors: (S,) of the balance heuristic, by the S hinges of the spine.
        events: in order of time.
        belief: before the first event.
    """

    def one(last: ElbowBelief, event: tuple) -> tuple[ElbowBelief, tuple[Pose, StepReport]]:
        solved, targets, which, elapsed = event
        fields = None
        if events.fields is not None:
            distances, available, _ = map(jnp.asarray, events.fields)
            fields = EdgeFields(solved.region, distances[which], available[which])
        last, pose, report = refine_one(
            model, settings, bow_factors, solved, targets, fields, last, elapsed
        )
        return last, (pose, report)

    which = None if events.fields is None else events.fields.which
    each = (events.solved, events.markers, which, events.elapsed)
    return jax.lax.scan(one, belief, each)


# What runs once is not optimised. Live, the tenth that an image's refinement would take longer
# counts; offline the first start.
PLACE = Program(place, "place", effort="once")
BALANCE = Program(bow_shares, "balance", effort="once")
SOLVE = Program(solve_event, "solve", effort="quick")
REFINE = Program(refine_one, "refine", effort="full")
SEARCH = Program(refine_one, "search", effort="quick")
REFINE_EVENTS = Program(refine_events, "refine_events", effort="quick")


# Images of each camera at one event; None where there is no new one.
Images = Sequence[np.ndarray | None]


class Chunk(NamedTuple):
    """Some events that ``scan`` went through."""

    events: range
    poses: Pose  # (E, ...) refined
    reports: StepReport  # (E, ...)
    frames: int  # how many of them have an image


class ChunkedEvents:
    """The events of a scan, in chunks; the last one is filled up with the last event."""

    def __init__(
        self,
        model: Model,
        settings: Settings,
        first: tuple[Pose, FootPlacement],
        thresholds: ArmThresholds,
        times: np.ndarray,
        markers_world: np.ndarray,
        images: Iterator[Images] | None,
        clock: Clock,
    ):
        self._model, self._settings, self._first = model, settings, first
        self._times, self._markers, self._images = times, markers_world, images
        self._thresholds, self._clock = thresholds, clock

    def rows(self, events: range) -> np.ndarray:
        """(EVENTS,) which events a chunk holds."""
        return np.minimum(events.start + np.arange(EVENTS), len(self._times) - 1)

    def markers(self, rows: np.ndarray) -> np.ndarray:
        """(EVENTS, M, 3)."""
        return self._markers[rows].astype(self._model.dtype)

    def elapsed_seconds(self, rows: np.ndarray) -> np.ndarray:
        """(EVENTS,) seconds since the event before."""
        before = self._times[np.maximum(rows - 1, 0)]
        return (self._times[rows] - before).astype(self._model.dtype)

    def solve_chunks(
        self, solve: Callable, beside: ThreadPoolExecutor
    ) -> Iterator[tuple[range, Solved, Future[tuple[EventFields | None, int]]]]:
        """All chunks in turn, each solved, and observed beside."""
        last, total = self._first, len(self._times)
        for first in range(0, total, EVENTS):
            events = range(first, min(first + EVENTS, total))
            markers = self.markers(self.rows(events))
            last, solved = self._clock.time_stage(
                "solve", self._each, solve, last, markers, among=EVENTS
            )
            yield events, solved, beside.submit(self._observe_images, events, solved)

    def _each(
        self, solve: Callable, last: tuple[Pose, FootPlacement], markers: np.ndarray
    ) -> tuple[tuple[Pose, FootPlacement], Solved]:
        """``solve_events`` one by one, so that they need no program of their own."""
        every = []
        for targets in markers:
            every.append(solve(self._model, self._settings, *last, targets))
            last = every[-1].ik.pose, every[-1].ik.feet
        return last, jax.tree.map(lambda *parts: np.stack(parts), *every)

    def _observe_images(self, events: range, solved: Solved) -> tuple[EventFields | None, int]:
        """Fields of a chunk's images, in order: thresholds are remembered; how many have one."""
        if solved.region is None:
            return None, 0
        region = jax.tree.map(np.asarray, solved.region)
        settings = self._settings
        fields: list[EdgeFields | None] = [None for _ in range(EVENTS)]
        for row, _ in enumerate(events):
            began = perf_counter()
            images = next(self._images) if self._images is not None else ()
            if any(image is not None for image in images):
                self._clock.keep("decode", began)
                own = jax.tree.map(lambda part, i=row: part[i], region)
                fields[row], self._thresholds = self._clock.time_stage(
                    "observe", edge_fields, settings, self._thresholds, images, own
                )
        nothing, _ = edge_fields(
            settings, self._thresholds, None, jax.tree.map(lambda part: part[0], region)
        )
        return EventFields.of(nothing, fields), sum(own is not None for own in fields)


def one_ahead(chunks: Iterator[Any]) -> Iterator[Any]:
    """The first is on its way at once, and is given out when the next one is too, and so on."""
    waiting = next(chunks)
    for chunk in chunks:
        yield waiting
        waiting = chunk
    yield waiting
