"""The hybrid tracker: markers and one or several cameras to a pose, frame by frame.

A frame is two jitted calls of ``hybrid.step`` with OpenCV's image chain between them.
``HybridTracker.step`` takes one event, ``scan`` a whole recording chunk by chunk.

INPUTS: a Model, Settings; markers and images over time. OUTPUTS: states, poses, reports.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property
from typing import Any

import jax
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Sites
from jaxmocap.body.model import Model, Recorded, marker_sites, on_unmarked_feet
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.compilation.arguments import check_shape, is_traced
from jaxmocap.compilation.clock import Clock
from jaxmocap.compilation.programs import Program
from jaxmocap.evidence.edges import EdgeFields
from jaxmocap.geometry.cameras import Camera
from jaxmocap.hybrid.balance import spine_dofs
from jaxmocap.hybrid.elbow_search import ElbowBelief, no_belief
from jaxmocap.hybrid.observe import edge_fields, images_of, no_thresholds
from jaxmocap.hybrid.refine import Solved, StepReport
from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.step import (
    BALANCE,
    EVENTS,
    REFINE,
    REFINE_EVENTS,
    SEARCH,
    SOLVE,
    Chunk,
    ChunkedEvents,
    EventFields,
    Images,
    RefineInputs,
    State,
    nowhere,
    one_ahead,
)
from jaxmocap.solvers.status import Status


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
        # By name, what waits for a program that is compiled beside.
        self._programs: dict[str, Callable[[], Callable]] = {}

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

    def compile_ahead(self, scan: bool = False) -> None:
        """Begin to compile what ``init`` and ``step``, or ``scan``, need, in threads beside."""
        self._solving()
        (self._refining_events if scan else self._refining)()

    @cached_property
    def bow_factors(self) -> Array:
        """(S,) of the balance heuristic, for this person."""
        return self._balancing()()(self.model, self.settings)

    def init(self, markers_world: np.ndarray | Array) -> State:
        """The state before the first event, at rest on its (M, 3) markers; NaN where missing.

        Raises:
            TypeError: called while JAX traces.
            ValueError: other markers than the model's.
        """
        targets = self._targets("init", markers_world)
        ik = self._solving()()(self.model, self.settings, *nowhere(self.model), targets).ik
        belief = no_belief(self.settings.elbow_search, ik.pose)
        return State(ik.pose, ik.feet, belief, no_thresholds(self.model.camera_count), None)

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
            TypeError: called while JAX traces.
            ValueError: other markers or images than the model's.
        """
        model, settings, clock = self.model, self.settings, clock or Clock(False)
        # Without a camera there is nothing to look at.
        images = None if model.cameras is None else images_of(model.cameras, images)
        targets = self._targets("step", markers_world, state, time)
        solve = self._solving()()
        solved = clock.time_stage("solve", solve, model, settings, state.pose, state.feet, targets)
        fields, thresholds = None, state.thresholds
        if solved.region is not None:
            fields, thresholds = clock.time_stage(
                "observe", edge_fields, settings, thresholds, images, solved.region
            )
        elapsed = np.asarray(0.0 if state.time is None else time - state.time, model.dtype)
        belief, pose, report = clock.time_stage(
            "refine", self._refining()(), model, settings, self.bow_factors, solved, targets,
            fields, state.belief, elapsed,
        )  # fmt: skip
        after = State(solved.ik.pose, solved.ik.feet, belief, thresholds, float(time))
        return after, pose, report

    def solve(
        self, state: State, markers_world: np.ndarray | Array, clock: Clock | None = None
    ) -> tuple[State, Pose, StepReport]:
        """One event by its markers alone: what the video taught waits for the next ``step``.

        Args:
            state: after the last event.
            markers_world: (M, 3) metres; NaN where missing.
            clock: keeps how long the stage takes.

        Returns:
            The state, the markers' pose and a report whose elbows are of unknown deviation.

        Raises:
            TypeError: called while JAX traces.
            ValueError: other markers than the model's.
        """
        targets, clock = self._targets("solve", markers_world, state), clock or Clock(False)
        given = self.model, self.settings, state.pose, state.feet, targets
        solved = clock.time_stage("solve", self._solving()(), *given)
        after = state._replace(pose=solved.ik.pose, feet=solved.ik.feet)
        return after, solved.ik.pose, _report_unrefined(solved, targets)

    def _targets(self, asked: str, markers_world: np.ndarray | Array, *others: Any) -> np.ndarray:
        """(M, 3) on the host; what is traced is refused."""
        if is_traced((self.model.skeleton.lengths, markers_world, others)):
            raise TypeError(
                f"HybridTracker.{asked} works on the host and cannot be traced by jit, vmap, grad "
                "or scan; jaxmocap.solve, refine, landmarks and smooth can"
            )
        targets = np.asarray(markers_world, self.model.dtype)
        expected = len(self.model.markers.bone_indices), 3
        check_shape("markers_world", targets.shape, expected, self.model)
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
        scan = ChunkedEvents(
            self.model, self.settings, (state.pose, state.feet), state.thresholds,
            np.asarray(times, float), markers_world, images, clock,
        )  # fmt: skip
        solving, refining = self._solving(), self._refining_events()
        refine, belief = None, state.belief
        with ThreadPoolExecutor(1, "observe") as beside:
            for events, solved, observed in one_ahead(scan.solve_chunks(solving(), beside)):
                refine = refine or refining()
                fields, frames = observed.result()
                rows = scan.rows(events)
                inputs = RefineInputs(
                    solved, scan.markers(rows), fields, scan.elapsed_seconds(rows)
                )
                belief, result = clock.time_stage(
                    "refine", refine, self.model, self.settings, self.bow_factors, inputs,
                    belief, among=EVENTS,
                )  # fmt: skip
                keep = slice(len(events))
                poses, reports = jax.tree.map(lambda part, k=keep: np.asarray(part)[k], result)
                yield Chunk(events, poses, reports, frames)

    def _solving(self) -> Callable[[], Callable]:
        """What waits for ``solve``, which compiles beside from the first time on."""
        return self._beside("solve", lambda: (SOLVE, (*nowhere(self.model), self._like())))

    def _balancing(self) -> Callable[[], Callable]:
        """What waits for the factors of the balance heuristic, likewise."""
        return self._beside("balance", lambda: (BALANCE, ()))

    def _refining(self) -> Callable[[], Callable]:
        """What waits for ``refine`` of an event, likewise."""
        self._balancing()

        def asked() -> tuple[Program, tuple]:
            solved, belief = self._shapes()
            elapsed = np.zeros((), self.model.dtype)
            given = solved, self._like(), self._no_fields(solved), belief, elapsed
            return SEARCH if self.settings.refine == "search" else REFINE, (self._no_bow(), *given)

        return self._beside("refine", asked)

    def _refining_events(self) -> Callable[[], Callable]:
        """What waits for the scan's ``refine``, likewise."""
        self._balancing()

        def asked() -> tuple[Program, tuple]:
            one, belief = self._shapes()
            solved, nothing = jax.tree.map(_of_chunk, one), self._no_fields(one)
            fields = None if nothing is None else EventFields.of(nothing, [None] * EVENTS)
            elapsed = np.zeros(EVENTS, self.model.dtype)
            inputs = RefineInputs(solved, _of_chunk(self._like()), fields, elapsed)
            return REFINE_EVENTS, (self._no_bow(), inputs, belief)

        return self._beside("refine_events", asked)

    def _beside(
        self, name: str, asked: Callable[[], tuple[Program, tuple]]
    ) -> Callable[[], Callable]:
        """What waits for a program, which is compiled for arguments such as these."""
        if name not in self._programs:
            program, like = asked()
            self._programs[name] = program.beside(self.model, self.settings, *like)
        return self._programs[name]

    def _shapes(self) -> tuple[Solved, ElbowBelief]:
        """Of what an event's ``solve`` finds, and of a belief."""
        given = (*nowhere(self.model), self._like())
        solved = SOLVE.shapes(self.model, self.settings, *given)
        return solved, jax.eval_shape(no_belief, self.settings.elbow_search, solved.ik.pose)

    def _no_fields(self, solved: Solved) -> EdgeFields | None:
        """Of an event without images."""
        if solved.region is None:
            return None
        nowhere = jax.tree.map(lambda part: np.zeros(part.shape, part.dtype), solved.region)
        return edge_fields(self.settings, no_thresholds(self.model.camera_count), None, nowhere)[0]

    def _no_bow(self) -> np.ndarray:
        """(S,) factors of the balance heuristic that bow nothing."""
        return np.zeros(len(spine_dofs(self.model.skeleton)), self.model.dtype)

    def _like(self) -> jax.ShapeDtypeStruct:
        return jax.ShapeDtypeStruct((len(self.model.markers.bone_indices), 3), self.model.dtype)


def _of_chunk(one: Any) -> Any:
    """Of all events of a chunk."""
    return jax.ShapeDtypeStruct((EVENTS, *one.shape), one.dtype)


def _report_unrefined(solved: Solved, targets: np.ndarray) -> StepReport:
    """The report of an event that was solved by its markers (M, 3) only."""
    unknown, ik = np.full(2, np.nan, targets.dtype), solved.ik
    errors = np.full(len(targets), np.nan, targets.dtype)
    each: tuple[Any, ...] = (
        ik.pose, errors, unknown, np.zeros(2, targets.dtype), unknown, ik.planted, ik.placed,
        np.bool_(False), np.int32(Status.CONVERGED),
    )  # fmt: skip
    return StepReport(*each)
