"""The paper's algorithms beside other programs of the same: its simplex, its inverse kinematics.

The downhill simplex stands beside SciPy's and optimistix': both arms, the same cost, the same first
simplices. The cost is of the tracker's kind and size: an arm of four hinges, some 150 points along
the outline of three limbs, looked up in a distance field, and how far the hand is from where it
belongs. It is written once, for NumPy and for JAX.

Inverse kinematics, and a whole frame, stand beside the NumPy/SciPy reference.

INPUTS: made-up fields; a clip for the reference. OUTPUTS: Metrics.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from scipy.optimize import minimize

from bench.clips import Footage
from bench.clock import Span, interleaved, ratio, timed
from bench.figures import OF_OTHERS, Metric, stage_metrics
from jaxmocap.capture.video import open_video
from jaxmocap.evidence.markers import Goals
from jaxmocap.evidence.terms import Measurements
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.hybrid.ik import goals_of
from jaxmocap.hybrid.observe import edge_fields
from jaxmocap.hybrid.paper import ik as paper_ik
from jaxmocap.hybrid.refine import Solved
from jaxmocap.hybrid.settings import Settings, SimplexSettings
from jaxmocap.hybrid.step import SOLVE
from jaxmocap.hybrid.tracker import HybridTracker, State
from jaxmocap.reference.hybrid import ik as reference_ik
from jaxmocap.reference.hybrid import pipeline
from jaxmocap.solvers.simplex import downhill_simplex, initial_simplex

SIDE, POINTS, ARMS, HINGES = 160, 25, 2, 4
FOCAL_PX, DEPTH_M = 260.0, 3.0
LENGTHS, RADII = (0.32, 0.26, 0.18), (0.05, 0.04, 0.04)
EDGE, STEPS, TOLERANCE = 0.2, 200, 1e-4
HOLD_PX = 200.0
ROUNDS = {True: 3, False: 20}
# What the arms' true hinges are, and where everybody begins.
TRUTH = np.array([[0.3, -0.2, 0.4, 0.9], [-0.4, 0.25, -0.3, 1.1]])
START = TRUTH + np.array([[0.25, -0.15, 0.2, -0.2], [-0.2, 0.2, 0.15, 0.25]])
# Solves by the reference, quickly and in full. Its raster goes pixel by pixel: minutes for a frame
# as users have it, so both get small regions and few steps of the simplex.
SOLVES, FRAMES, REGION, FEW_STEPS = {True: 30, False: 120}, 3, 32, 8


def turn(xp: Any, axis: int, angle: Any) -> Any:
    """(3, 3) about a coordinate axis."""
    c, s, zero, one = xp.cos(angle), xp.sin(angle), 0 * angle, 0 * angle + 1
    rows = [[c, -s, zero], [s, c, zero], [zero, zero, one]]
    order = [(i - axis - 1) % 3 for i in range(3)]
    return xp.stack([xp.stack([rows[i][j] for j in order]) for i in order])


def joints(xp: Any, hinges: Any) -> Any:
    """(4, 3) shoulder, elbow, wrist and fingertip before the camera, metres."""
    R_upper = turn(xp, 1, hinges[0]) @ turn(xp, 0, hinges[1]) @ turn(xp, 2, hinges[2])
    R_fore = R_upper @ turn(xp, 1, hinges[3])
    down = xp.asarray(np.array([0.0, 1.0, 0.0], np.float32))
    across = xp.asarray(np.array([1.0, 0.0, 0.0], np.float32))
    shoulder = xp.asarray(np.array([0.0, -0.3, DEPTH_M], np.float32))
    elbow = shoulder + LENGTHS[0] * (R_upper @ down)
    fore = R_fore @ (0.6 * down + 0.8 * across)
    return xp.stack([shoulder, elbow, elbow + LENGTHS[1] * fore, elbow + sum(LENGTHS[1:]) * fore])


def outline(xp: Any, hinges: Any) -> Any:
    """(3 * 2 * POINTS, 2) pixels along both sides of the limbs."""
    at = joints(xp, hinges)
    pixels = FOCAL_PX * at[:, :2] / at[:, 2:] + SIDE / 2
    along = pixels[1:] - pixels[:-1]
    normal = xp.stack([-along[:, 1], along[:, 0]], -1)
    normal = normal / xp.sqrt(xp.sum(normal**2, -1, keepdims=True) + 1e-6)
    share = xp.asarray(np.linspace(0.1, 0.9, POINTS, dtype=np.float32))[None, :, None]
    radii = xp.asarray(np.array(RADII, np.float32))[:, None, None] * FOCAL_PX / DEPTH_M
    middle = pixels[:-1, None] + share * along[:, None]
    sides = [middle + radii * normal[:, None], middle - radii * normal[:, None]]
    return xp.stack(sides).reshape(-1, 2)


def look_up(xp: Any, field: Any, pixels: Any) -> Any:
    """(K,) bilinear; the border goes on outside."""
    inside = xp.clip(pixels, 0.0, SIDE - 1.001)
    low = xp.floor(inside)
    part = inside - low
    x, y = low[:, 0].astype(np.int32), low[:, 1].astype(np.int32)
    u, v = part[:, 0], part[:, 1]
    above = (1 - u) * field[y, x] + u * field[y, x + 1]
    below = (1 - u) * field[y + 1, x] + u * field[y + 1, x + 1]
    return (1 - v) * above + v * below


def arm_cost(xp: Any, field: Any, grip: Any, hinges: Any) -> Any:
    """Mean distance of the outline to the edges, pixels, and of the wrist from its marker."""
    apart = joints(xp, hinges)[2] - grip
    return xp.mean(look_up(xp, field, outline(xp, hinges))) + HOLD_PX * xp.sqrt(
        xp.sum(apart**2) + 1e-12
    )


def scene() -> tuple[np.ndarray, np.ndarray]:
    """Distance fields (2, S, S) of the true outlines, and the wrists (2, 3), float32."""
    rows, columns = np.mgrid[:SIDE, :SIDE]
    grid = np.stack([columns, rows], -1)[:, :, None]
    fields = [
        np.linalg.norm(grid - outline(np, hinges), axis=-1).min(-1).clip(max=20.0)
        for hinges in TRUTH
    ]
    wrists = [joints(np, hinges)[2] for hinges in TRUTH]
    return np.asarray(fields, np.float32), np.asarray(wrists, np.float32)


def simplex(quick: bool) -> Iterator[Metric]:
    """Everybody in turn on both arms; the costs reached beside the times."""
    fields, grips = scene()
    ways = {
        "ours": ours(fields, grips),
        "scipy": by_scipy(fields, grips),
        "optimistix": by_optimistix(fields, grips),
    }
    spans = interleaved(ways, ROUNDS[quick], warm=1)
    for name, way in ways.items():
        yield from stage_metrics(f"simplex, both arms, {name}", spans[name][:, 0])
        worst = max(
            float(arm_cost(np, *problem)) for problem in zip(fields, grips, way(), strict=True)
        )
        yield Metric(f"simplex, worse arm's cost, {name}", worst, "px")
    for name in ("scipy", "optimistix"):
        faster = ratio(spans[name], spans["ours"])
        yield Metric(f"simplex_{name}_over_ours", faster, "x", "higher", OF_OTHERS)


def ours(fields: np.ndarray, grips: np.ndarray) -> Callable[[], np.ndarray]:
    """Both arms side by side."""

    @jax.jit
    def solve(fields, grips, start):
        cost = jax.vmap(lambda field, grip, hinges: arm_cost(jnp, field, grip, hinges))
        simplices = initial_simplex(start, EDGE * jnp.eye(HINGES))
        return downhill_simplex(
            lambda points: cost(fields, grips, points), simplices, STEPS, TOLERANCE, TOLERANCE
        ).points

    start = START.astype(np.float32)
    return lambda: np.asarray(solve(fields, grips, start))


def by_scipy(fields: np.ndarray, grips: np.ndarray) -> Callable[[], np.ndarray]:
    """``scipy.optimize.minimize``, one arm after the other, the cost in NumPy."""

    def one(field: np.ndarray, grip: np.ndarray, start: np.ndarray) -> np.ndarray:
        first = np.vstack([start, start + EDGE * np.eye(HINGES)])
        options = {
            "initial_simplex": first, "maxiter": STEPS, "xatol": TOLERANCE, "fatol": TOLERANCE
        }  # fmt: skip
        return minimize(
            lambda hinges: arm_cost(np, field, grip, hinges), start,
            method="Nelder-Mead", options=options,
        ).x  # fmt: skip

    return lambda: np.stack([one(*problem) for problem in zip(fields, grips, START, strict=True)])


def by_optimistix(fields: np.ndarray, grips: np.ndarray) -> Callable[[], np.ndarray]:
    """``optimistix.NelderMead`` on each hinge as a leaf (as one array it starts degenerate)."""
    solver = optimistix.NelderMead(rtol=TOLERANCE, atol=TOLERANCE)

    @jax.jit
    def solve(fields, grips, start):
        def one(field, grip, start):
            def cost(hinges, _):
                return arm_cost(jnp, field, grip, jnp.stack(hinges))

            solution = optimistix.minimise(
                cost, solver, tuple(start), max_steps=STEPS, throw=False
            ).value
            return jnp.stack(solution)

        return jax.vmap(one)(fields, grips, start)

    start = START.astype(np.float32)
    return lambda: np.asarray(solve(fields, grips, start))


def against_reference(footage: Footage, quick: bool) -> Iterator[Metric]:
    """Ours and the reference's, from the same start to the same goals."""
    recording = footage.recording
    yield from inverse_kinematics(recording, SOLVES[quick])
    if not quick:
        yield from full_frames(recording)


def inverse_kinematics(recording: Recording, solves: int) -> Iterator[Metric]:
    """Algorithm 1, jitted in float32 and in NumPy."""
    tracker = HybridTracker.from_recording(recording, Settings(refine="none"))
    model, settings = tracker.model, tracker.settings.ik
    # For one person: handing over a model's arrays takes as long as an iteration.
    solve = jax.jit(partial(paper_ik.reach, model, settings))
    state = tracker.init(recording.positions_world[0])
    ours, theirs, farthest = [], [], 0.0
    for turn, markers in enumerate(recording.positions_world[1 : solves + 2]):
        goals = goals_at(tracker, state, markers)
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


def goals_at(tracker: HybridTracker, state: State, markers: np.ndarray) -> Goals:
    """Where a sample's markers and the feet are to go."""
    targets = jnp.asarray(markers, tracker.model.dtype)
    return goals_of(tracker.model, tracker.settings.ik, state.feet, targets)


def full_frames(recording: Recording) -> Iterator[Metric]:
    """The paper's own way, ours and the reference's; both get the same fields of the image."""
    few = replace(SimplexSettings(), iterations=FEW_STEPS)
    small = replace(Settings.paper(), region=REGION, simplex=few)
    tracker = HybridTracker.from_recording(recording, small)
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
