"""``python -m bench.refinement RECORDING.toml``: simplex against gradient, at the same frames.

Every rival starts where the search and the inverse kinematics have left the body and sees the same
image; so the table shows the refinement alone. Once each takes all the steps it wants, and once
only as many as fit into the same time.

INPUTS: a recording with video, and ``truth.trc`` beside it. OUTPUTS: a table.
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import NamedTuple
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from bench import command
from jaxmocap.body.arms import arms_of
from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import Pose
from jaxmocap.capture.footage import forward_readers, open_footage
from jaxmocap.capture.markers import interpolate_markers
from jaxmocap.evaluation.tables import align_columns
from jaxmocap.evidence.edges import EdgeEvidence, EdgeFields
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.markers import read_markers
from jaxmocap.hybrid import fit, refine
from jaxmocap.hybrid.elbow_search import ElbowBelief
from jaxmocap.hybrid.fit import Aims, refine_arms, refine_body
from jaxmocap.hybrid.ik import goals_of
from jaxmocap.hybrid.observe import edge_fields
from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.step import SOLVE
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.pipelines.tracking.events import RecordingEvents
from jaxmocap.solvers.status import Status

GRADIENTS = {
    "Levenberg-Marquardt": "levenberg-marquardt",
    "Gauss-Newton": "gauss-newton",
    "BFGS": "bfgs",
}
RIVALS = ("simplex", *GRADIENTS)
# Enough for every rival to come to rest; and what its pace is taken from.
PLENTY, FEW = {"simplex": 400, "BFGS": 300}, (2, 8)
# Quasi-Newton steps are short at first: what is rest to the others is only a slow start to it.
RESTING = {"Levenberg-Marquardt": 1e-2, "Gauss-Newton": 1e-2, "BFGS": 1e-4}
REPEATS = 3
# Where a recording names its elbows as Pose2Sim does, or as we do.
NAMES = (("LElbow", "RElbow"), ("elbow_l", "elbow_r"))
HEADINGS = [
    ["", "at convergence", "", "", "", "", "in the same time", "", "", ""],
    ["", "cm", "95 %", "evaluations", "rest, %", "ms", "cm", "95 %", "steps", "ms"],
]


class Frame(NamedTuple):
    """What a refinement is given at one video frame.

    Attributes:
        start: the pose where search and inverse kinematics have left the body.
        fields: distances to edges, of both arms.
        grip: (2, 3) points that the markers hold.
        aims: what else is to be met.
        elbows: (2, 3) the truth, world, metres.
    """

    start: Pose
    fields: EdgeFields
    grip: Array
    aims: Aims
    elbows: np.ndarray


class Ended(NamedTuple):
    """A refined pose's elbows (2, 3), and whether it had converged."""

    elbows: Array
    converged: Array


@dataclass(frozen=True)
class Row:
    """One rival over all frames.

    Attributes:
        errors: (F, 2) of the elbows, metres.
        milliseconds: median of a frame's.
        converged: share of the frames that came to rest.
        steps: most that it was allowed.
    """

    errors: np.ndarray
    milliseconds: float
    converged: float
    steps: int

    @property
    def cells(self) -> list[str]:
        """Mean and 95th percentile, centimetres."""
        return error_cells(self.errors)


def error_cells(errors: np.ndarray) -> list[str]:
    """Mean and 95th percentile, centimetres."""
    finite = errors[np.isfinite(errors)]
    return [f"{100 * value:.2f}" for value in (finite.mean(), np.percentile(finite, 95))]


def frames(recording: Recording, tracker: HybridTracker, truth: Path) -> Iterator[Frame]:
    """Track a recording with the simplex, and keep what each of its refinements was given."""
    videos, _ = open_footage(recording)
    model, settings, events = (
        tracker.model,
        tracker.settings,
        RecordingEvents.of(recording, videos, "own"),
    )
    line = events.timeline
    elbows = _true_elbows(truth, line.event_times)
    prepare = jax.jit(lambda *arguments: _prepare(tracker, *arguments))
    after = tracker.init(events.markers_world[0])
    with forward_readers(videos) as readers:
        for event, time in enumerate(events.times):
            each = zip(readers, line.frame_index[event], strict=True)
            images = [reader.at(int(index)) for reader, index in each]
            markers, before = events.markers_world[event].astype(model.dtype), after
            after, *_ = tracker.step(before, time, markers, images)
            solved = SOLVE(model, settings, before.pose, before.feet, markers)
            fields, _ = edge_fields(settings, before.thresholds, images, solved.region)
            if np.any(fields.available):
                elapsed = 0.0 if before.time is None else time - before.time
                belief = before.belief._replace(age=before.belief.age + elapsed)
                start, fields, grip, aims = prepare(solved, markers, fields, belief)
                yield Frame(start, fields, grip, aims, elbows[event])


def _prepare(
    tracker: HybridTracker,
    solved: refine.Solved,
    targets: Array,
    fields: EdgeFields,
    belief: ElbowBelief,
) -> tuple[Pose, EdgeFields, Array, Aims]:
    """The tracker's own way up to the refinement, balance left out."""
    model, settings = tracker.model, tracker.settings
    goals = goals_of(model, settings.ik, solved.ik.feet, targets)
    arms = arms_of(model.skeleton, forward(model.skeleton, solved.ik.pose), model.grips)
    _, elbows = refine.search_elbows(model, settings, arms, fields, belief)
    free = jnp.ones(model.skeleton.costs.shape, bool)
    start = refine.follow_elbows(model, settings, goals, belief.pose, free, elbows)
    return start, fields, arms.grip, Aims(goals, elbows, solved.ik.pose, free)


def _true_elbows(truth: Path, times: np.ndarray) -> np.ndarray:
    markers = read_markers(truth)
    points = markers.points()
    names = next(pair for pair in NAMES if pair[0] in points)
    return interpolate_markers(markers.times, np.stack([points[name] for name in names], 1), times)


def rival(tracker: HybridTracker, name: str, steps: int) -> Callable[[Frame], Ended]:
    """A refinement of at most so many steps, compiled."""
    model, settings = tracker.model, with_steps(tracker.settings, name, steps)

    def by_simplex(start: Pose, fields: EdgeFields, grip: Array, aims: Aims) -> Ended:
        pose = refine_arms(model, settings, fields, start, grip, aims.elbows)
        return Ended(_elbows(tracker, pose), jnp.asarray(True))

    def by_gradient(start: Pose, fields: EdgeFields, grip: Array, aims: Aims) -> Ended:
        edges = settings.edges.weigh(model, fields, start)
        pose, status = refine_body(model, settings, edges, start, aims)
        return Ended(_elbows(tracker, pose), status == int(Status.CONVERGED))

    chosen = jax.jit(by_simplex if name == "simplex" else by_gradient)
    return lambda frame: chosen(*frame[:4])


def _elbows(tracker: HybridTracker, pose: Pose) -> Array:
    model = tracker.model
    return arms_of(model.skeleton, forward(model.skeleton, pose), model.grips).elbow


def with_steps(settings: Settings, name: str, steps: int) -> Settings:
    """The settings with a rival's method and its most steps."""
    if name == "simplex":
        return replace(settings, simplex=replace(settings.simplex, iterations=steps))
    gradient = replace(
        settings.gradient, method=GRADIENTS[name], steps=steps, tolerance=RESTING[name]
    )
    return replace(settings, gradient=gradient)


def measure(tracker: HybridTracker, given: list[Frame], name: str, steps: int) -> Row:
    """Errors and time of a rival."""
    run = rival(tracker, name, steps)
    ended = jax.device_get([run(frame) for frame in given])
    times = []
    for frame in given * REPEATS:
        began = perf_counter()
        jax.block_until_ready(run(frame))
        times.append(1e3 * (perf_counter() - began))
    apart = np.stack([e.elbows - frame.elbows for e, frame in zip(ended, given, strict=True)])
    rested = float(np.mean([e.converged for e in ended]))
    return Row(np.linalg.norm(apart, axis=-1), float(np.median(times)), rested, steps)


def evaluations(tracker: HybridTracker, given: list[Frame], name: str, steps: int) -> float:
    """Mean number of evaluations of both arms' cost, or of the residuals."""
    count = [0]

    def counted(function: Callable) -> Callable:
        def run(*arguments):
            jax.debug.callback(lambda: count.__setitem__(0, count[0] + 1))
            return function(*arguments)

        return run

    at = (fit, "swing") if name == "simplex" else (EdgeEvidence, "residual")
    with mock.patch.object(*at, counted(getattr(*at))):
        run = rival(tracker, name, steps)
        for frame in given:
            jax.block_until_ready(run(frame))
        jax.effects_barrier()
    return count[0] / len(given)


def within(
    tracker: HybridTracker, given: list[Frame], name: str, budget: float, plenty: int
) -> Row:
    """The rival with about as many steps as fit into the budget (milliseconds)."""
    few, more = (measure(tracker, given, name, steps) for steps in FEW)
    pace = max((more.milliseconds - few.milliseconds) / (FEW[1] - FEW[0]), 1e-3)
    steps = FEW[0] + int((budget - few.milliseconds) / pace)
    return measure(tracker, given, name, min(max(steps, 1), plenty))


def compare(tracker: HybridTracker, given: list[Frame], budget: float) -> str:
    """The table of all rivals."""
    elbows_of = jax.jit(lambda pose: _elbows(tracker, pose))
    before = np.stack([np.asarray(elbows_of(frame.start)) - frame.elbows for frame in given])
    rows = [*HEADINGS, ["start", *error_cells(np.linalg.norm(before, axis=-1)), *[""] * 7]]
    for name in RIVALS:
        plenty = PLENTY.get(name, 100)
        full = measure(tracker, given, name, plenty)
        short = within(tracker, given, name, budget, plenty)
        counted = f"{evaluations(tracker, given, name, plenty):.0f}"
        rested = f"{100 * full.converged:.0f}"
        rows.append(
            [name, *full.cells, counted, rested, f"{full.milliseconds:.2f}",
             *short.cells, f"{short.steps}", f"{short.milliseconds:.2f}"]
        )  # fmt: skip
    return align_columns(rows)


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = command("bench.refinement", __doc__, metrics=False)
    result.add_argument("recordings", nargs="+", metavar="RECORDING.toml")
    result.add_argument("--every", type=int, default=1, help="one frame in so many")
    result.add_argument("--budget", type=float, default=1.5, help="milliseconds that each may take")
    return result


def main() -> None:
    options = parser().parse_args()
    keep_compiled()
    for path in map(Path, options.recordings):
        recording = Recording.load(path)
        tracker = HybridTracker.from_recording(recording)
        given = list(frames(recording, tracker, path.with_name("truth.trc")))[:: options.every]
        print(f"{path.parent.name}/{path.stem}, {len(given)} frames, elbows' distance, cm")
        print(compare(tracker, given, options.budget), flush=True)


if __name__ == "__main__":
    main()
