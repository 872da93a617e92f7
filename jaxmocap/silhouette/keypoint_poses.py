"""Poses by 2-D key points alone: where a silhouette tracker begins, and looks for what it lost.

    start    from the body at some directions and postures, placed by the lines of sight
    descend  each to a minimum of its own: one camera leaves limbs that point to it or away alike
    decide   the cheapest path through all frames' minima
    smooth   all frames at once

The stature gives the distance, the floor and the camera's place do so once more.

INPUTS: a Skeleton, lines of sight to its landmarks, frame by frame. OUTPUTS: KeypointPoses.
"""

from dataclasses import fields, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Sites, landmarks
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, relaxed_pose, retract
from jaxmocap.body.proportions import LENGTHS
from jaxmocap.body.skeleton import LANDMARKS, Skeleton, other_side
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.compilation.batches import in_batches
from jaxmocap.compilation.programs import program
from jaxmocap.compilation.settings import group, settings, traced
from jaxmocap.evidence.balance import Balance
from jaxmocap.evidence.expansion import expand_terms
from jaxmocap.evidence.ground import FeetOnFloor
from jaxmocap.evidence.keypoints import EstimatedDepths, KeyPoints, SightLines
from jaxmocap.evidence.limits import JointLimits
from jaxmocap.evidence.posture import MostlyRelaxedPosture, Pelvis, RelaxedPosture
from jaxmocap.evidence.smoothness import REACH, smoothness
from jaxmocap.evidence.terms import Measurements, Term, residuals
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.smoothing.levenberg_marquardt import Solution, minimise
from jaxmocap.smoothing.linearise import linearise_problem, two_workers
from jaxmocap.smoothing.problem import SmoothingProblem, Trajectory, Views, move_trajectory
from jaxmocap.solvers.descent import tree_where
from jaxmocap.solvers.robust import MEDIAN_OF_LENGTHS
from jaxmocap.solvers.viterbi import cheapest_path

# A frame with fewer lines than this is bridged by the others.
LEAST_LINES = 4
# Directions that a start faces.
FACINGS = 8
# Frames in one call.
FRAMES_A_CALL = 8
# Minima of a frame that are kept; steps to tell which, and then; damping at first, factors on it.
MINIMA, ROUGH_STEPS, STEPS = 8, 8, 20
DAMPING, EASED, RAISED = 1.0, 0.2, 5.0
LARGEST_STEP = 0.5
# What a frame costs whose sides are swapped, nats.
SWAPPED = 0.05
# Speed of a landmark, metres a second, and what counts of the landmarks, which move together.
SPEED, INDEPENDENT = 1.0, 4.0


@settings
class KeypointPoseSettings:
    """What a user may tune of poses by key points; every field that is a ``Term`` takes part."""

    keypoints: KeyPoints = group(lambda: KeyPoints(deviation=0.015), "of key points")  # type: ignore[arg-type]
    depths: EstimatedDepths = group(EstimatedDepths, "of depths that the detector estimates")
    posture: RelaxedPosture = group(
        lambda: MostlyRelaxedPosture(ease=0.3, bearing=0.3),  # type: ignore[arg-type]
        "of most joints at ease",
    )
    range: RelaxedPosture = group(RelaxedPosture, "of all joints about ease")
    pelvis: Pelvis = group(lambda: Pelvis(lean=0.3), "of how upright the pelvis is")  # type: ignore[arg-type]
    limits: JointLimits = group(JointLimits, "of the joints' ranges")
    floor: FeetOnFloor = group(FeetOnFloor, "of feet on the floor")
    balance: Balance = group(lambda: Balance(deviation=0.15), "of standing in balance")  # type: ignore[arg-type]
    proportions: Array = traced(
        0.1,
        "weight of the prior on the person's lengths, in each frame: key points err alike in all",
    )
    acceleration: Array = traced(
        3.0, "spectral density of the landmarks' accelerations, m / s^2 * sqrt(s)"
    )

    @property
    def terms(self) -> tuple[Term, ...]:
        """The terms of a frame, in the order of the fields."""
        each = (getattr(self, field.name) for field in fields(self))
        return tuple(term for term in each if isinstance(term, Term))


class KeypointPoses(NamedTuple):
    """T frames by key points."""

    poses: Pose  # (T, ...)
    skeleton: Skeleton  # of the person, its lengths corrected
    lines: SightLines  # (T, ...) with confidences by how much each camera's landmarks scatter


def poses_of_lines(
    skeleton: Skeleton, times: np.ndarray, lines: SightLines, settings: KeypointPoseSettings
) -> KeypointPoses:
    """The poses (T, ...) at times (T,), seconds, that suit all frames' lines of sight (T, ...)."""
    model = Model(skeleton, Sites.none(skeleton.lengths.dtype))
    lines = jax.tree.map(lambda part: np.asarray(part, skeleton.lengths.dtype), lines)
    counted = (np.asarray(lines.confidences) > 0).sum((1, 2)) >= LEAST_LINES
    rows = np.flatnonzero(counted)
    found, lines = _cheapest_poses(settings, model, times, lines, rows)
    # No table of all pairs, which an hour's frames have no memory for.
    nearest = np.rint(np.interp(np.arange(len(times)), rows, np.arange(len(rows)))).astype(int)
    start = jax.tree.map(lambda part: part[nearest].astype(model.dtype), found)
    if len(times) <= REACH:
        return KeypointPoses(start, skeleton, lines)
    weighted = replace(settings, proportions=settings.proportions * len(times))
    problem = SmoothingProblem(model, weighted, times, measurements(lines), Views.no_cameras())
    prior = smoothness(times, np.full(3 * len(LANDMARKS), float(settings.acceleration)))

    def solve(problem: SmoothingProblem, begun: Trajectory) -> Solution:
        with two_workers() as workers:
            linearise = partial(linearise_problem, problem, 0.0, workers)
            return minimise(linearise, move_trajectory, begun, prior)

    solved = solve(problem, Trajectory(start, np.zeros(len(LENGTHS), model.dtype)))
    points = np.asarray(solved.linear.points).reshape(len(times), len(LANDMARKS), 3)
    lines = weigh_by_scatter(points, lines, float(settings.keypoints.deviation))
    solved = solve(problem.with_measured(sight_lines=lines), solved.x)
    person = solved.x.person(skeleton)
    return KeypointPoses(solved.x.poses, person, lines)


def _cheapest_poses(
    settings: KeypointPoseSettings,
    model: Model,
    times: np.ndarray,
    lines: SightLines,
    rows: np.ndarray,
) -> tuple[Pose, SightLines]:
    """Those of some of the frames' minima that make up the cheapest path.

    A detector takes left for right now and then, so that the person seems to face the other way:
    with one camera each frame's minima are also found with its sides swapped.

    Args:
        settings: of the terms.
        model: of the person.
        times: (T,) seconds.
        lines: (T, ...).
        rows: (R,) frames that have enough of them.

    Returns:
        Poses (R, ...), and the lines (T, ...) with sides swapped where they were.
    """
    tried = [lines] if lines.confidences.shape[1] > 1 else [lines, swap_sides(lines)]
    call, minima = partial(_minima, settings.terms, model), []
    for number, each in enumerate(tried):
        some = jax.tree.map(lambda part: part[rows], measurements(each))
        *parts, costs, points = in_batches(call, (some,), FRAMES_A_CALL)
        minima.append((*parts, costs + number * SWAPPED, points))
    *parts, costs, points = (np.concatenate(each, 1) for each in zip(*minima, strict=True))
    flat, speed = points.reshape(*costs.shape, -1), SPEED * np.sqrt(len(LANDMARKS) / INDEPENDENT)
    chosen = cheapest_path(np.where(np.isfinite(costs), costs, 1e9), flat, times[rows], speed)
    own = np.arange(len(rows))
    swapped = rows[chosen >= MINIMA]

    def with_swapped(part: np.ndarray, other: np.ndarray) -> np.ndarray:
        part = np.array(part)
        part[swapped] = other[swapped]
        return part

    lines = jax.tree.map(with_swapped, tried[0], tried[-1])
    poses = Pose(*(part[own, chosen] for part in parts))  # type: ignore[arg-type]
    return poses, lines


def swap_sides(lines: SightLines) -> SightLines:
    """Lines (T, ...) with left taken for right."""
    rows = other_side(LANDMARKS)
    directions, sure, depths = (np.asarray(part)[:, :, rows] for part in lines[1:])
    return SightLines(lines.origin, directions, sure, depths)


def weigh_by_scatter(points: np.ndarray, lines: SightLines, deviation: float) -> SightLines:
    """Lines (T, ...) whose confidences are smaller where a camera's landmark scatters by more.

    ``points`` (T, L, 3) are where all lines together have the landmarks, metres. ``deviation`` is
    of a point of full confidence, metres at the person; no scatter counts as less.
    """
    confidences, ways = np.asarray(lines.confidences), np.asarray(lines.directions)
    off = points[:, None] - np.asarray(lines.origin)[:, :, None]
    across = np.linalg.norm(np.cross(off, ways), axis=-1)
    across = np.where(confidences > 0, across, np.nan)
    is_detected = np.isfinite(across).any(0)
    middle = np.nanmedian(np.where(is_detected, across, 0.0), 0) / MEDIAN_OF_LENGTHS
    share = deviation / np.maximum(middle, deviation)
    return lines._replace(confidences=(confidences * share).astype(confidences.dtype))


def measurements(lines: SightLines) -> Measurements:
    """What the terms ask for, of T frames."""
    count, dtype = len(lines.confidences), np.asarray(lines.confidences).dtype
    # Nothing says where the pelvis faces.
    upright, facing = (np.zeros((count, axes), dtype) for axes in (2, 3))
    return Measurements(upright=upright, facing=facing, sight_lines=lines)


@program("full")
def _minima(
    terms: tuple[Term, ...], model: Model, measured: Measurements
) -> tuple[Array, Array, Array, Array, Array]:
    """Positions, quaternions, angles, costs and landmarks (B, N, ...) of each frame's minima."""
    starts = _starts(model.skeleton)

    def of_frame(own: Measurements) -> tuple:
        descend = jax.vmap(partial(_descend, terms, model, own), (0, None))
        poses = jax.vmap(partial(_place_pose, model.skeleton, own))(starts)
        poses, costs = descend(poses, ROUGH_STEPS)
        best = jax.lax.top_k(-costs, MINIMA)[1]
        poses, costs = descend(jax.tree.map(lambda part: part[best], poses), STEPS)
        return *poses, costs, jax.vmap(partial(landmarks, model.skeleton))(poses)

    return jax.lax.map(of_frame, measured)


def _starts(skeleton: Skeleton) -> Pose:
    """(N, ...) postures that descents begin from."""
    turns = 2 * np.pi * np.arange(FACINGS) / FACINGS
    relaxed = relaxed_pose(skeleton)
    facing = np.stack([np.cos(turns / 2), 0 * turns, 0 * turns, np.sin(turns / 2)], 1)
    rows = [(q, angles) for q in facing for angles in _postures(skeleton)]
    quaternions, angles = (
        jnp.stack([jnp.asarray(r[i], relaxed.angles.dtype) for r in rows]) for i in (0, 1)
    )
    return Pose(jnp.zeros((len(rows), 3), angles.dtype), quaternions, angles)


def _postures(skeleton: Skeleton) -> list[Array]:
    """(D,) each: at ease, crouched, and with arms and shanks drawn back."""
    joints = skeleton.tree.joints

    def bent(**degrees: float) -> Array:
        own = [degrees.get(joint.removesuffix("_l").removesuffix("_r"), np.nan) for joint in joints]
        angles = np.radians(np.array(own, float))
        return jnp.where(np.isnan(angles), skeleton.relaxed, angles.astype(skeleton.axes.dtype))

    return [
        skeleton.relaxed,
        bent(arm_flex=90.0, elbow_flex=60.0, hip_flexion=60.0, knee_flexion=80.0),
        bent(
            arm_flex=-30.0, arm_abduct=30.0, elbow_flex=60.0, hip_flexion=-10.0, knee_flexion=30.0
        ),
    ]


def _place_pose(skeleton: Skeleton, measured: Measurements, pose: Pose) -> Pose:
    """The pose moved to where its landmarks lie nearest to their lines."""
    lines = measured.sight_lines
    weights = jnp.where(jnp.isfinite(lines.directions).all(-1), lines.confidences, 0.0) ** 2
    way = jnp.nan_to_num(lines.directions)
    across = jnp.eye(3, dtype=way.dtype) - way[..., :, None] * way[..., None, :]
    across = across * weights[..., None, None]
    off = lines.origin[:, None] - landmarks(skeleton, pose)
    towards = jnp.einsum("clij,clj->i", across, off, precision=HIGHEST)
    total = jnp.sum(across, (0, 1)) + 1e-6 * jnp.eye(3, dtype=way.dtype)
    return pose._replace(position=jnp.linalg.solve(total, towards))


def _descend(
    terms: tuple[Term, ...], model: Model, measured: Measurements, start: Pose, steps: Any
) -> tuple[Pose, Array]:
    """Where a damped Gauss-Newton descent ends, and half the squares there.

    Infinite where that is behind the cameras, whose lines have two ends.
    """
    size = ROOT_DOF + start.angles.size

    def step(_: int, now: tuple) -> tuple:
        pose, damping = now
        r, J = expand_terms(terms, model, pose, measured, bends=False)[:2]
        cost = jnp.sum(r**2) / 2
        H = jnp.matmul(J.T, J, precision=HIGHEST) + damping * jnp.eye(size, dtype=r.dtype)
        move = -jnp.linalg.solve(H, jnp.matmul(r, J, precision=HIGHEST))
        move = move * jnp.minimum(1.0, LARGEST_STEP / jnp.maximum(jnp.max(jnp.abs(move)), 1e-9))
        there = retract(pose, move)
        there = there._replace(angles=jnp.clip(there.angles, *model.skeleton.limits.T))
        after = jnp.sum(residuals(terms, model, there, measured) ** 2) / 2
        lower = after < cost
        damping = damping * jnp.where(lower, EASED, RAISED)
        return tree_where(lower, there, pose), jnp.clip(damping, 1e-3, 1e6)

    pose, _ = jax.lax.fori_loop(0, steps, step, (start, jnp.asarray(DAMPING, start.angles.dtype)))
    lines = measured.sight_lines
    away = landmarks(model.skeleton, pose) - lines.origin[:, None]
    is_ahead = jnp.all(jnp.sum(away * jnp.nan_to_num(lines.directions), (1, 2)) >= 0)
    cost = jnp.sum(residuals(terms, model, pose, measured) ** 2) / 2
    return pose, jnp.where(is_ahead, cost, jnp.inf)
