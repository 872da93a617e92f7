"""The same work by the NumPy/SciPy reference: inverse kinematics, and a whole frame.

INPUTS: a clip. OUTPUTS: Metrics.
"""

from collections.abc import Iterator
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxmocap.hybrid.first_state import settled
from jaxmocap.hybrid.steps import Solved, State

from bench.clock import Span, ratio, timed
from bench.footage import Footage
from bench.metrics import Metric, stage_metrics
from jaxmocap.capture.video import open_video
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.hybrid import ik
from jaxmocap.hybrid.settings import RefineSettings, Settings
from jaxmocap.hybrid.tracker import HybridTracker
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
        yield from whole_frames(recording)


def inverse_kinematics(recording: Recording, solves: int) -> Iterator[Metric]:
    """Algorithm 1, jitted in float32 and in NumPy."""
    tracker = make_tracker(recording, Settings(refine="none"))

    @jax.jit
    def solve(skeleton, goals, settings, pose):
        # Which bones carry the goals is static.
        sites = goals.sites._replace(bones=tracker.held.sites.bones)
        return ik.reach(skeleton, goals._replace(sites=sites), settings, pose)

    state = settled(tracker, recording.positions_world[0])
    ours, theirs, farthest = [], [], 0.0
    for turn, markers in enumerate(recording.positions_world[1 : solves + 2]):
        problem = (tracker.skeleton, goals_at(tracker, state, markers), tracker.settings.ik)
        time, (pose, _) = timed(solve, *problem, state.pose)
        # As NumPy arrays: fetching each of its numbers from JAX would take most of its time.
        plain = jax.tree.map(np.asarray, (*problem, state.pose))
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
    yield Metric("inverse_kinematics_reference_over_ours", faster, "x", "higher")
    yield Metric("inverse kinematics, angles off the reference's", np.degrees(farthest), "°")


def goals_at(tracker: HybridTracker, state: State, markers: np.ndarray) -> ik.Goals:
    """Where a sample's markers and the feet are to go."""
    targets = jnp.asarray(markers, tracker.dtype)
    mask = jnp.all(jnp.isfinite(targets), -1)
    return ik.goals_of(
        tracker.skeleton, tracker.held, tracker.settings.ik, state.stance, targets, mask
    )


def whole_frames(recording: Recording) -> Iterator[Metric]:
    """The paper's own way, ours and the reference's; both get the same fields of the image."""
    polish = RefineSettings.create(iterations=STEPS)
    small = replace(Settings.paper(), region=REGION, polish=polish)
    tracker = make_tracker(recording, small)
    video = open_video(recording.videos[0])
    rows = np.searchsorted(recording.times, video.times)
    state, ours, theirs = settled(tracker, recording.positions_world[0]), [], []
    for i, (time, image) in enumerate(video.frames()):
        if i > FRAMES:
            break
        markers = np.asarray(recording.positions_world[rows[i]], tracker.dtype)
        spent, (after, _, _) = timed(tracker.step, state, time, markers, [image])
        seen_took, solved, views = look(tracker, state, markers, image)
        spent_there, _ = timed(by_reference, tracker, state, solved, markers, views)
        if i:  # The first of ours compiles.
            ours.append(spent)
            theirs.append(Span(*np.add(spent_there, seen_took)))
        state = after
    yield from stage_metrics("paper's way, small, whole frame", [span.wall for span in ours])
    yield from stage_metrics(
        "paper's way, small, whole frame, NumPy reference", [span.wall for span in theirs]
    )
    faster = ratio(np.array(theirs), np.array(ours))
    yield Metric("frame_reference_over_ours", faster, "x", "higher", 0.5)


def look(
    tracker: HybridTracker, state: State, markers: np.ndarray, image: np.ndarray | None
) -> tuple[Span, Solved, list[pipeline.ArmView | None]]:
    """How long the image chain took, the markers' pose, and both arms' fields."""
    shared = (tracker.skeleton, tracker.cameras, tracker.settings)
    solved = tracker.solve(*shared, state.pose, state.stance, markers)
    assert solved.region is not None
    spent, seen = timed(tracker.observer.observe, [image], solved.region)
    origin, scale = (np.asarray(part, float)[0] for part in solved.region)
    fields = np.asarray(seen.fields)[0, :, 0]
    return spent, solved, [
        pipeline.ArmView(*view) for view in zip(origin, scale, fields, strict=True)
    ]  # fmt: skip


def by_reference(
    tracker: HybridTracker,
    state: State,
    solved: Solved,
    markers: np.ndarray,
    views: list[pipeline.ArmView | None],
) -> tuple:
    """One frame by the reference from our last poses; regions and stance are the tracker's."""
    body, camera, grips = jax.tree.map(
        np.asarray, (tracker.skeleton, tracker.cameras, tracker.grips)
    )
    camera = jax.tree.map(lambda part: part[0], camera)
    goals = goals_at(tracker, state._replace(stance=solved.ik.stance), markers)
    goals = jax.tree.map(np.asarray, goals)
    alone, _ = reference_ik.reach(body, goals, tracker.settings.ik, state.pose)
    refined = pipeline.refine(
        body, camera, tracker.settings, np.asarray(tracker.factors), goals, alone,
        state.belief.pose, views, grips,
    )  # fmt: skip
    return alone, refined
