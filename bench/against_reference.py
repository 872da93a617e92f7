"""The same work by the NumPy/SciPy reference: inverse kinematics, and a whole frame.

INPUTS: a clip. OUTPUTS: Metrics.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from bench.clock import Span, ratio, timed
from bench.footage import Footage
from bench.metrics import OF_OTHERS, Metric, stage_metrics
from jaxmocap.capture.video import open_video
from jaxmocap.evidence.markers import Goals
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.hybrid.ik import goals_of
from jaxmocap.hybrid.observe import edge_fields
from jaxmocap.hybrid.paper import ik as paper_ik
from jaxmocap.hybrid.refine import Solved
from jaxmocap.hybrid.settings import Settings, SimplexSettings
from jaxmocap.hybrid.step import SOLVE
from jaxmocap.hybrid.tracker import HybridTracker, State
from jaxmocap.pipelines.tracking.track import make_tracker
from jaxmocap.reference.hybrid import ik as reference_ik
from jaxmocap.reference.hybrid import pipeline

# Solves by the reference, quickly and in full. Its raster goes pixel by pixel: minutes for a frame
# as users have it, so both get small regions and few steps of the simplex.
SOLVES, FRAMES, REGION, STEPS = {True: 30, False: 120}, 3, 32, 8


def measure(footage: Footage, quick: bool) -> Iterator[Metric]:
    """Ours and the reference's, from the same start to the same goals."""
    recording = footage.recording
    yield from inverse_kinematics(recording, SOLVES[quick])
    if not quick:
        yield from full_frames(recording)


def inverse_kinematics(recording: Recording, solves: int) -> Iterator[Metric]:
    """Algorithm 1, jitted in float32 and in NumPy."""
    tracker = make_tracker(recording, Settings(refine="none"))
    model, settings = tracker.model, tracker.settings.ik
    # For one person: handing over a model's arrays takes as long as an iteration.
    solve = jax.jit(partial(paper_ik.reach, model, settings))
    state = tracker.init(recording.positions_world[0])
    ours, theirs, farthest = [], [], 0.0
    for turn, markers in enumerate(recording.positions_world[1 : solves + 2]):
        goals = goals_at(tracker, state, markers)
        time, (pose, _) = timed(solve, {"goals": goals}, state.pose)
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


def goals_at(tracker: HybridTracker, state: State, markers: np.ndarray) -> Goals:
    """Where a sample's markers and the feet are to go."""
    targets = jnp.asarray(markers, tracker.model.dtype)
    return goals_of(tracker.model, tracker.settings.ik, state.feet, targets)


def full_frames(recording: Recording) -> Iterator[Metric]:
    """The paper's own way, ours and the reference's; both get the same fields of the image."""
    simplex = replace(SimplexSettings(), iterations=STEPS)
    small = replace(Settings.paper(), region=REGION, simplex=simplex)
    tracker = make_tracker(recording, small)
    video = open_video(recording.videos[0])
    rows = np.searchsorted(recording.times, video.times)
    state, ours, theirs = tracker.init(recording.positions_world[0]), [], []
    for i, (time, image) in enumerate(video.frames()):
        if i > FRAMES:
            break
        markers = np.asarray(recording.positions_world[rows[i]], tracker.model.dtype)
        spent, (after, _, _) = timed(tracker.step, state, time, markers, [image])
        observing, solved, views = observed(tracker, state, markers, image)
        spent_there, _ = timed(by_reference, tracker, state, solved, markers, views)
        if i:  # The first of ours compiles.
            ours.append(spent)
            theirs.append(Span(*np.add(spent_there, observing)))
        state = after
    yield from stage_metrics("paper's way, small, whole frame", [span.wall for span in ours])
    yield from stage_metrics(
        "paper's way, small, whole frame, NumPy reference", [span.wall for span in theirs]
    )
    faster = ratio(np.array(theirs), np.array(ours))
    yield Metric("frame_reference_over_ours", faster, "x", "higher", OF_OTHERS)


def observed(
    tracker: HybridTracker, state: State, markers: np.ndarray, image: np.ndarray | None
) -> tuple[Span, Solved, list[pipeline.ArmView | None]]:
    """How long the image chain took, the markers' pose, and both arms' fields."""
    model, settings = tracker.model, tracker.settings
    solved = SOLVE(model, settings, state.pose, state.feet, markers)
    assert solved.region is not None
    spent, (fields, _) = timed(edge_fields, settings, state.thresholds, [image], solved.region)
    origin, scale = (np.asarray(part, float)[0] for part in solved.region)
    distances, camera = np.asarray(fields.distances)[0, :, 0], model.camera(0)
    camera = jax.tree.map(np.asarray, camera)
    return spent, solved, [
        pipeline.ArmView(camera, *view) for view in zip(origin, scale, distances, strict=True)
    ]  # fmt: skip


def by_reference(
    tracker: HybridTracker,
    state: State,
    solved: Solved,
    markers: np.ndarray,
    views: list[pipeline.ArmView | None],
) -> tuple:
    """One frame by the reference from our last poses; regions and feet are the tracker's."""
    model = tracker.model
    body, grips = jax.tree.map(np.asarray, (model.skeleton, model.grips))
    goals = goals_at(tracker, state._replace(feet=solved.ik.feet), markers)
    goals = jax.tree.map(np.asarray, goals)
    alone, _ = reference_ik.reach(body, goals, tracker.settings.ik, state.pose)
    refined = pipeline.refine(
        body, tracker.settings, np.asarray(tracker.bow_factors), alone, views, grips,
    )  # fmt: skip
    return alone, refined
