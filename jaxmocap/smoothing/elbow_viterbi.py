"""Where the elbows may have been over a whole recording: many candidates, the cheapest path.

A solve that goes downhill leaves an elbow in the valley it began in, and a silhouette hardly tells
before the image plane from behind it. So every frame of every camera prices the whole grid of
candidates of the search, with the rest of the body where it is; dynamic programming over
time (Viterbi) then decides, so that clear frames decide for the ambiguous ones before and after.

INPUTS: a recording's problem and its trajectory so far. OUTPUTS: goals for the elbows, and poses
whose arms are turned there.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.arms import (
    AT_GRIPS,
    ELBOW,
    TURNS,
    Arms,
    arm_dofs,
    arms_of,
    flesh,
    hang,
    side_of,
    turn_arms,
    turn_pose,
    turned_angles,
    with_pivots,
)
from jaxmocap.body.kinematics import forward
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, beyond_limits
from jaxmocap.body.skeleton import ELBOWS
from jaxmocap.body.surfaces.cones import Cones, cones, project_cones
from jaxmocap.compilation.arrays import on_device
from jaxmocap.compilation.batches import in_batches
from jaxmocap.compilation.programs import Program, program
from jaxmocap.evidence.keypoints import SightLines, line_residuals
from jaxmocap.evidence.silhouettes import (
    SilhouetteGrids,
    nearest_surface,
    project_flesh,
    unhidden,
)
from jaxmocap.geometry.cameras import Camera, depth
from jaxmocap.geometry.outlines import Discs, Touch, depth_along, touch
from jaxmocap.images.regions import Region, discs_in_region
from jaxmocap.images.silhouette_grid import Grid, cells
from jaxmocap.smoothing.linearise import coarsely, rows_of, views_of
from jaxmocap.smoothing.problem import UNTURNED, SmoothingProblem, Trajectory, all_turned
from jaxmocap.smoothing.settings import ElbowPathSettings
from jaxmocap.solvers.viterbi import cheapest_path

# The candidate that leaves an arm where it is.
STAY = int(np.argmin(np.sum(TURNS**2, -1)))
# Cells over which silhouettes fade, so softly that larger ones do as well.
SOFTNESS = 1.5
# Views in one call.
VIEWS_A_CALL = 16
# Poses in one call.
POSES_A_CALL = 64


class ElbowPath(NamedTuple):
    """Where the cheapest path takes the elbows at T events."""

    goals: np.ndarray  # (T, 2, 3) world, metres; NaN without a view
    # (T, 2, 3) of the arms about their pivots, as of ``TURNS``, radians; without a view those of
    # the nearest event that has one.
    turns: np.ndarray
    pivots: np.ndarray  # (T, 2) int32


def elbow_path(
    problem: SmoothingProblem, trajectory: Trajectory, pivots: np.ndarray | None = None
) -> ElbowPath:
    """The cheapest path.

    First each arm for itself, the other one where it is. What one then claims may be the other's
    in truth; so of going there and staying, both arms decide together.

    Args:
        problem: the recording, with its views.
        trajectory: where the body is so far.
        pivots: (T, 2) about what arms are turned; all about their grips without it.
    """
    if pivots is None:
        pivots = np.tile(AT_GRIPS, (len(problem.times), 1))
    cameras = all_turned(problem.model.cameras, trajectory.turns_cam)
    skeleton = trajectory.person(problem.model.skeleton)
    problem = replace(problem, model=replace(problem.model, cameras=cameras, skeleton=skeleton))
    frames = np.unique(problem.views.frame)
    times, rows = problem.times[frames], np.arange(len(frames))[:, None]
    path_settings = problem.settings.elbow_path
    prices = float(path_settings.speed), float(path_settings.largest_price)
    with ThreadPoolExecutor(2, thread_name_prefix="price") as workers:
        there = rows_of(trajectory.poses, frames)
        call = partial(_elbows, problem.model, path_settings)
        at = np.asarray(pivots, np.int32)[frames]
        elbows, moving, own = in_batches(call, (there, at), VIEWS_A_CALL, workers)
        if problem.measured.sight_lines is not None:
            lines = rows_of(problem.measured.sight_lines, frames)
            deviation = problem.settings.keypoints.deviation
            own += np.asarray(price_off_lines(on_device(elbows), lines, deviation))
        price = partial(_pictures, *coarsely(problem, SOFTNESS), trajectory, workers)
        alone = own + own[:, ::-1, STAY, None] + price(_lone_costs, (at,))
        paths = [
            cheapest_path(alone[:, side], moving[:, side], times, *prices) for side in range(2)
        ]
        pairs = [np.stack([np.full_like(path, STAY), path], 1) for path in paths]
        costs = own[rows, 0, pairs[0]][:, :, None] + own[rows, 1, pairs[1]][:, None]
        costs = (costs + price(_pair_costs, (*pairs, at))).reshape(len(frames), -1)
    left, right = (moving[rows, side, pairs[side]] for side in range(2))
    both = np.concatenate([np.repeat(left, 2, 1), np.tile(right, (1, 2, 1))], 2)
    way, row = cheapest_path(costs, both, times, *prices), rows[:, 0]
    chosen = np.stack([pairs[0][row, way // 2], pairs[1][row, way % 2]], 1)
    goals = np.full((len(problem.times), 2, 3), np.nan, np.float32)
    goals[frames] = elbows[rows, np.arange(2), chosen]
    nearest = np.rint(np.interp(problem.times, times, row)).astype(int)
    return ElbowPath(goals, TURNS[chosen[nearest]], pivots)


def turn_arms_along(model: Model, trajectory: Trajectory, path: ElbowPath) -> Trajectory:
    """The same, its arms turned to where the path has them.

    A solve that only has a goal for an elbow may end in another valley.
    """
    call = partial(_turned, replace(model, skeleton=trajectory.person(model.skeleton)))
    turns, pivots = path.turns.astype(model.dtype), path.pivots.astype(np.int32)
    (angles,) = in_batches(call, (trajectory.poses, turns, pivots), POSES_A_CALL)
    poses = trajectory.poses._replace(angles=angles.astype(model.dtype))
    return trajectory._replace(poses=poses)


@program("quick")
def _turned(model: Model, poses: Pose, turns: Array, pivots: Array) -> Array:
    """Angles (B, D) of a batch of poses, their arms turned by (B, 2, 3) about pivots (B, 2)."""

    def of_pose(pose: Pose, turn: Array, at: Array) -> Array:
        return turn_pose(model.skeleton, pose, model.grips, turn, at).angles

    return jax.vmap(of_pose)(poses, turns, pivots)


def price_off_lines(elbows: Array, lines: SightLines, deviation: Array) -> Array:
    """Price (..., 2, K) of candidates (..., 2, K, 3) that lie off key points' lines, nats.

    Args:
        elbows: of both arms, world, metres.
        lines: (..., C, L) to the landmarks.
        deviation: of a point of full confidence, metres at the person.
    """
    of_elbows = SightLines(
        jnp.expand_dims(lines.origin, -3),
        jnp.expand_dims(jnp.asarray(lines.directions)[..., ELBOWS, :], -4),
        *(jnp.expand_dims(jnp.asarray(part)[..., ELBOWS], -3) for part in lines[2:]),
    )
    off = line_residuals(jnp.swapaxes(elbows, -3, -2), of_elbows, deviation)
    return jnp.swapaxes(jnp.sum(off**2, (-3, -1)) / 2, -1, -2)


def candidates(
    model: Model, settings: ElbowPathSettings, poses: Pose, pivots: Array, limited: bool = True
) -> tuple[Arms, Array]:
    """Arms (B, 2, K) of a batch of poses, and what they cost by themselves (B, 2, K), nats.

    ``pivots`` (B, 2) are what they are turned about; ``limited`` as in ``hang``.
    """
    skeleton = model.skeleton
    dofs = arm_dofs(skeleton.tree)
    ranges, usual = skeleton.limits[dofs], skeleton.usual_deviations[dofs]

    def of_pose(pose: Pose, at: Array) -> tuple[Arms, Array]:
        hung = hang(skeleton, pose, model.grips, at, limited)
        arms, slack = turn_arms(hung.arms)
        angles = turned_angles(hung, arms)
        away = (angles - skeleton.relaxed[dofs][:, None]) / usual[:, None]
        beyond = beyond_limits(ranges[:, None], angles) / settings.beyond_range
        slack = slack / settings.shoulder_slack
        return arms, (jnp.sum(away**2 + beyond**2, -1) + slack**2) / 2

    return jax.vmap(of_pose)(poses, pivots)


@program("quick")
def _elbows(
    model: Model, settings: ElbowPathSettings, poses: Pose, pivots: Array
) -> tuple[Array, Array, Array]:
    """Elbows (B, 2, K, 3) of ``candidates``; what moves, the wrist about an elbow; own costs."""
    arms, costs = candidates(model, settings, poses, pivots)
    about_elbow = (pivots == ELBOW)[..., None, None]
    return arms.elbow, jnp.where(about_elbow, arms.wrist, arms.elbow), costs


def _pictures(
    problem: SmoothingProblem,
    softness: float,
    trajectory: Trajectory,
    workers: ThreadPoolExecutor,
    cost: Program,
    chosen: tuple[np.ndarray, ...] = (),
) -> np.ndarray:
    """What the views' pictures cost (T, ...), nats.

    Args:
        problem: the recording, softened.
        softness: of what is drawn, cells.
        trajectory: where the body is.
        workers: threads.
        cost: of a batch of views, by a model, softness, poses, cameras, grids, what is chosen.
        chosen: of each of the T frames with views.
    """
    frames, row = np.unique(problem.views.frame, return_inverse=True)
    each = views_of(problem, trajectory._replace(turns_cam=UNTURNED))
    drawn = partial(cost, problem.model, on_device(softness))
    own = tuple(part[row].astype(np.int32) for part in chosen)
    (pictures,) = in_batches(drawn, (*each, *own), VIEWS_A_CALL, workers)
    costs = np.zeros((len(frames), *pictures.shape[1:]))
    np.add.at(costs, row, problem.settings.silhouettes.weight / 2 * pictures)
    return costs


@program("full")
def _pair_costs(model: Model, softness: Array, *views: Any) -> Array:
    """``view_costs`` of a batch of views, one after the other."""

    def of_view(each: tuple) -> Array:
        pose, camera, grids, left, right, at = each
        return view_costs(model, softness, pose, camera, grids, (left, right), at)

    return jax.lax.map(of_view, views)


@program("full")
def _lone_costs(model: Model, softness: Array, *views: Any) -> Array:
    """``lone_costs`` likewise."""
    return jax.lax.map(lambda view: lone_costs(model, softness, *view), views)


def view_costs(
    model: Model,
    softness: Array,
    pose: Pose,
    camera: Camera,
    grids: SilhouetteGrids,
    chosen: tuple[Array, Array],
    pivots: Array | np.ndarray = AT_GRIPS,
) -> Array:
    """Sums of squares (A, B) over both pictures with the arms moved, and all else as it is.

    Args:
        model: of the person and the markers.
        softness: cells.
        pose: of the person.
        camera: of the view.
        grids: of the view.
        chosen: candidates of the left arm (A,) and of the right one (B,).
        pivots: (2,) about what they are turned.
    """
    rest, arms = _draw_arms(model, softness, pose, camera, grids, jnp.stack(chosen), pivots)
    away = jnp.minimum(jnp.minimum(arms.away[0], rest)[:, None], arms.away[1])
    shown = jnp.maximum(arms.shown[0][:, None], arms.shown[1])
    return _squares(_coverage(away, softness), grids.person) + _squares(shown, grids.forearms)


def lone_costs(
    model: Model,
    softness: Array,
    pose: Pose,
    camera: Camera,
    grids: SilhouetteGrids,
    pivots: Array | np.ndarray = AT_GRIPS,
) -> Array:
    """The same (2, K) with one arm at each candidate, the other where it is."""
    every = jnp.tile(jnp.arange(len(TURNS)), (2, 1))
    rest, arms = _draw_arms(model, softness, pose, camera, grids, every, pivots)
    # Of each arm the other one.
    away, shown = (part[::-1, STAY, None] for part in arms)
    away = jnp.minimum(jnp.minimum(arms.away, rest), away)
    shown = jnp.maximum(arms.shown, shown)
    return _squares(_coverage(away, softness), grids.person) + _squares(shown, grids.forearms)


class _DrawnArms(NamedTuple):
    """Candidates of both arms: distances (2, N, C) to their outlines, cells; visible forearms."""

    away: Array
    shown: Array


def _draw_arms(
    model: Model,
    softness: Array,
    pose: Pose,
    camera: Camera,
    grids: SilhouetteGrids,
    chosen: Array,
    pivots: Array | np.ndarray,
) -> tuple[Array, _DrawnArms]:
    """Distances (C,) to the rest of the body, cells; candidates (2, N) of the arms."""
    skeleton = model.skeleton
    bones, frames = skeleton.tree.drawn, forward(skeleton, pose)
    kept = ~np.isin(bones, skeleton.tree.bones_in("arm"))
    body = Cones(*(part[kept] for part in cones(skeleton, frames, bones)))
    x, y = cells(grids.person.probability.shape[-1], pose.angles.dtype)
    outlines = project_flesh(skeleton.tree, camera, body, grids.per_metre, bones[kept])
    at = _nearest_limbs(grids.region, outlines, x, y)
    rest, surface = jnp.min(at.distance, 0), nearest_surface(camera, body, at.distance)
    moved, _ = turn_arms(with_pivots(arms_of(skeleton, frames, model.grips), pivots))

    def of_candidate(arm: Arms) -> _DrawnArms:
        limb = flesh(arm)
        at = _nearest_limbs(grids.region, project_cones(camera, limb), x, y)
        ends = (depth(camera, end)[:, None] for end in (limb.near, limb.far))
        _, radius, hand = depth_along(at, *ends)
        away = jnp.where(at.distance[1] < at.distance[2], radius, hand)
        visible = unhidden(surface, away)
        shown = _coverage(jnp.min(at.distance[1:], 0), softness) * visible
        return _DrawnArms(jnp.min(at.distance, 0), shown)

    def of_side(arms: Arms, indices: Array) -> _DrawnArms:
        return jax.vmap(of_candidate)(side_of(arms, indices))

    return rest, jax.vmap(of_side)(moved, chosen)


def _coverage(away: Array, softness: Array) -> Array:
    return jax.nn.sigmoid(-away / softness)


def _nearest_limbs(region: Region, discs: Discs, x: Array, y: Array) -> Touch:
    """Where (K, C) the outlines of K limbs, pixels, are nearest to C cells."""
    limbs = discs_in_region(region, discs)
    return touch(Discs(*(part[:, None] for part in limbs)), x, y)


def _squares(picture: Array, grid: Grid) -> Array:
    """Sums of squares (...) of pictures (..., C) against a grid of C cells."""
    probability, weight = (jnp.ravel(part) for part in grid)
    return jnp.sum((weight * (picture - probability)) ** 2, -1)
