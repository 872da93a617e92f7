"""The batch smoother as a pure function of arrays: jit, vmap and derivatives go through it.

All poses of T events at once, where the terms of evidence, the silhouettes and the smoothness of
the landmarks' motion cost least. The trajectory x is where the cost's slope vanishes; its
derivatives are those of that minimum (``solvers.optimum``), by the whole Hessian, which is
block-banded in time: every term belongs to one event, and of the prior that joins them only the
landmarks' curvature is new. Which limb reaches farthest over a cell of a silhouette, and what hides
a forearm, changes in jumps, which have no derivative.

INPUTS: a Model, settings, Events. OUTPUTS: SmoothMotion.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import (
    Frames,
    curvature,
    forward,
    jacobian,
    landmark_sites,
    landmarks,
    site_positions,
)
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, retract
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.compilation.arguments import check_kind, check_shape, floating, is_traced
from jaxmocap.evidence.expansion import expand_terms
from jaxmocap.evidence.shapes import check_measurements, check_pose, in_precision
from jaxmocap.evidence.silhouettes import SilhouetteGrids
from jaxmocap.evidence.smoothness import second_differences
from jaxmocap.evidence.terms import Measurements, residuals
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.smoothing.linearise import SilhouettesFit, silhouettes_fit
from jaxmocap.smoothing.settings import SmoothingSettings, weigh_by_time
from jaxmocap.smoothing.window.solving import LEAST_APART_S, SOFTNESS
from jaxmocap.smoothing.window.velocities import TiedEvents, solve_steps
from jaxmocap.solvers.descent import tree_where
from jaxmocap.solvers.optimum import LEAST_CURVATURE, following

# An acceleration takes so many.
FEWEST_EVENTS = 3
# Steps of the descent, at most; damping, nats per squared metre or radian, that it begins with, at
# least, at most, and factors on it.
STEPS, DAMPING, LEAST_DAMPING, LARGEST_DAMPING = 60, 1e-2, 1e-7, 1e9
EASED, RAISED = 0.1, 10.0
# The last step lowers the cost by less than so many precisions, nats, and by less than what
# rounding does to it; and its largest entry is less than so many roots of the precision.
LITTLE, SHORT = 100.0, 30.0


class Events(NamedTuple):
    """What was measured of T events, and where a first pass put the body.

    Attributes:
        times: (T,) seconds, ascending.
        measured: (T, ...), ``markers``, ``upright``, ``facing`` and ``ankles`` at least; ``elbows``
            are NaN where no image shows them.
        poses: (T, ...) to start from; nothing is differentiated by them.
        silhouettes: (T, C, ...) of the model's cameras, blurred over ``SOFTNESS`` cells; of weight
            0 where a camera has no frame. None without.
    """

    times: Array
    measured: Measurements
    poses: Pose
    silhouettes: SilhouetteGrids | None = None


def check_events(model: Model, events: Any) -> Events:
    """Events in the model's precision, their times from the first one on.

    Raises:
        TypeError: no events, or no real numbers in them.
        ValueError: fewer than 3, times that do not ascend, an array that has not a row for each, or
            silhouettes of other cameras than the model's.
    """
    check_kind("events", events, Events)
    times = np.shape(events.times)
    if len(times) == 1 and times[0] < FEWEST_EVENTS:
        raise ValueError(f"events: found {times[0]}, expected {FEWEST_EVENTS} or more")
    T = times[-1] if times else 0
    if events.silhouettes is not None:
        check_kind("events.silhouettes", events.silhouettes, SilhouetteGrids)
        each = (T, model.camera_count)
        for leaf in jax.tree.leaves(events.silhouettes):
            check_shape("events.silhouettes", np.shape(leaf)[:2], each, "one for each camera")
    seconds = floating("events.times", events.times, (T,), model.dtype)
    if not is_traced(events.times):
        # Single precision is too coarse for differences of the day's seconds.
        host = np.asarray(events.times, float)
        if not (np.diff(host) > 0).all():
            raise ValueError("events.times: expected seconds that ascend")
        seconds = jnp.asarray(host - host[0], seconds.dtype)
    return Events(
        seconds,
        check_measurements("events.measured", model, events.measured, T),
        check_pose("events.poses", model, events.poses, (T,)),
        in_precision(model, events.silhouettes),
    )


class SmoothMotion(NamedTuple):
    """Poses of T events.

    Attributes:
        times: (T,) seconds.
        poses: (T, ...).
        points: (T, L, 3) the ``LANDMARKS``, world, metres.
    """

    times: Array
    poses: Pose
    points: Array

    def joints(self) -> dict[str, Array]:
        """Landmark name -> (T, 3), world, metres."""
        return {name: self.points[:, i] for i, name in enumerate(LANDMARKS)}


class _Problem(NamedTuple):
    """All that the cost depends on but the poses."""

    model: Model
    settings: SmoothingSettings
    times: Array
    measured: Measurements
    silhouettes: SilhouetteGrids | None


class _Slopes(NamedTuple):
    """The cost about poses."""

    cost: Array  # () half the sum of squares
    gradient: Array  # (T, N) the cost's
    hessian: Array  # (T, N, N) Gauss-Newton's of the events' own terms
    bending: Array  # (T, N, N) what that leaves out, and what landmarks bend by
    jacobian: Array  # (T, M, N) of the landmarks, which the prior ties


def smooth_events(model: Model, settings: SmoothingSettings, events: Events) -> SmoothMotion:
    """The poses of all events at the minimum of the terms and of the landmarks' accelerations.

    Derivatives are by the model, the settings and what was measured. The bones are as the model has
    them: unlike ``track``, it estimates no proportions and no camera's turn.

    Args:
        model: of the person and the markers, as the events were made with.
        settings: of smoothing; their terms take part that find their measurements.
        events: T of them, 3 at least.
    """
    times = _apart(events.times)
    settings = weigh_by_time(settings, times)
    silhouettes = events.silhouettes and settings.silhouettes.weigh(events.silhouettes)
    problem = _Problem(model, settings, times, events.measured, silhouettes)
    constant, start = jax.lax.stop_gradient((problem, events.poses))
    poses = following(_move_minimum, problem, jax.lax.stop_gradient(_descend(constant, start)))
    points = jax.vmap(partial(landmarks, model.skeleton))(poses)
    return SmoothMotion(events.times, poses, points)


def _apart(times: Array) -> Array:
    """(T,) seconds, in single precision at least ``LEAST_APART_S`` apart."""
    if times.dtype == jnp.float64:
        return times
    steps = jnp.maximum(jnp.diff(times), LEAST_APART_S)
    return times[0] + jnp.concatenate([jnp.zeros_like(steps[:1]), jnp.cumsum(steps)])


def _move_minimum(problem: _Problem, poses: Pose) -> Pose:
    """Where poses at their minimum go as the problem changes."""
    slopes = _slopes(jax.lax.stop_gradient(problem), poses, exactly=True)
    # By tangent vectors (T, N) at the poses.
    still = jnp.zeros_like(slopes.gradient)
    gradient = jax.grad(lambda step: _cost(problem, retract(poses, step)))(still)
    if problem.silhouettes is not None:
        gradient += _draw_silhouettes(problem, poses).gradient
    change = gradient - jax.lax.stop_gradient(gradient)
    still, no_damping = jax.lax.stop_gradient(slopes), jnp.zeros((), change.dtype)
    # Where hardly any curvature is left, single precision cannot tell how much.
    less = still._replace(hessian=(1 - LEAST_CURVATURE) * still.hessian)
    is_curved = jnp.all(
        jnp.isfinite(solve_steps(_about(problem, less, no_damping + 1), no_damping))
    )
    evidence = _about(problem, still, is_curved.astype(change.dtype))
    evidence = jax.lax.stop_gradient(evidence)._replace(gradient=change)
    return retract(poses, solve_steps(evidence, no_damping))


def _cost(problem: _Problem, poses: Pose) -> Array:
    """() half the sum of all squares but the silhouettes'."""
    model, settings, times, measured, _ = problem
    own = jax.vmap(lambda pose, each: residuals(settings.terms, model, pose, each))(poses, measured)
    points = jax.vmap(partial(landmarks, model.skeleton))(poses).reshape(len(times), -1)
    return (jnp.sum(own**2) + jnp.sum(_accelerations(problem, points) ** 2)) / 2


def _stencil(problem: _Problem) -> Array:
    """(T - 2, 3) of three successive points, to their acceleration in its deviations."""
    return second_differences(problem.times) / problem.settings.acceleration


def _accelerations(problem: _Problem, points: Array) -> Array:
    """(T - 2, M) of points (T, M), in their deviations; see ``evidence.smoothness``."""
    c = _stencil(problem)
    each = [c[:, k, None] * points[k : len(points) - 2 + k] for k in range(3)]
    return each[0] + each[1] + each[2]


def _slopes(problem: _Problem, poses: Pose, exactly: bool = False) -> _Slopes:
    """Of the cost: Gauss-Newton leaves out the curvature of residuals and of landmarks.

    Silhouettes' curvature is worth its time where it must be exact.
    """
    skeleton, sites = problem.model.skeleton, landmark_sites(problem.model.skeleton)

    def landmarks_of(pose: Pose) -> tuple[Frames, Array]:
        frames = forward(skeleton, pose)
        return frames, site_positions(skeleton, frames, sites)

    frames, points = jax.vmap(landmarks_of)(poses)
    flat = points.reshape(len(points), -1)
    accelerations = _accelerations(problem, flat)
    # Of half the prior's squares, by the points.
    (pull,) = jax.vjp(partial(_accelerations, problem), flat)[1](accelerations)
    pull = pull.reshape(points.shape)

    def of_event(
        pose: Pose, own: Measurements, frames: Frames, points: Array, pull: Array
    ) -> tuple:
        r, J, S = expand_terms(problem.settings.terms, problem.model, pose, own)
        by_points = jacobian(skeleton, frames, sites.bones, points).reshape(-1, J.shape[1])
        slope = jnp.matmul(r, J, precision=HIGHEST)
        slope += jnp.matmul(pull.ravel(), by_points, precision=HIGHEST)
        S = S + curvature(skeleton, frames, sites.bones, points, pull)
        return jnp.sum(r**2), slope, jnp.matmul(J.T, J, precision=HIGHEST), S, by_points

    squares, slope, own, bending, by_points = jax.vmap(of_event)(
        poses, problem.measured, frames, points, pull
    )
    cost = (jnp.sum(squares) + jnp.sum(accelerations**2)) / 2
    slopes = _Slopes(cost, slope, own, bending, by_points)
    if problem.silhouettes is None:
        return slopes
    drawn = _draw_silhouettes(problem, poses, exactly)
    return slopes._replace(
        cost=cost + jnp.sum(drawn.cost) / 2,
        gradient=slope + drawn.gradient,
        hessian=own + drawn.hessian,
        bending=bending + drawn.bending,
    )


def _draw_silhouettes(problem: _Problem, poses: Pose, exactly: bool = False) -> SilhouettesFit:
    """Of the silhouettes (T, ...) at poses."""
    own, soft = problem.settings.silhouettes, jnp.asarray(SOFTNESS, poses.angles.dtype)

    def of_event(each: tuple[Pose, SilhouetteGrids]) -> SilhouettesFit:
        pose, grids = each
        shown = jnp.any(grids.person.weight > 0, (1, 2))
        return silhouettes_fit(problem.model, own, pose, shown, grids, soft, exactly)

    # One after the other: a picture of the body fits the cache, a batch of them does not.
    return jax.lax.map(of_event, (poses, problem.silhouettes))


def _about(problem: _Problem, slopes: _Slopes, curved: Array) -> TiedEvents:
    """What a step solves: Newton's equations, or with ``curved`` 0 Gauss-Newton's."""
    hessian, intervals = slopes.hessian + curved * slopes.bending, jnp.diff(problem.times)
    stencil = _stencil(problem)
    return TiedEvents(intervals, hessian, slopes.gradient, slopes.jacobian, stencil)


def _step(problem: _Problem, slopes: _Slopes, damping: Array) -> Array:
    """The damped step (T, N) by Newton's equations, or Gauss-Newton's.

    Where Newton's Hessian is not positive it is of no minimum.
    """

    def unsound(carry: tuple[Array, Array]) -> Array:
        curved, step = carry
        return (curved > 0) & ~jnp.all(jnp.isfinite(step))

    def solve(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        curved = carry[0] - 1
        return curved, solve_steps(_about(problem, slopes, curved), damping)

    first = jnp.full((), 2.0, damping.dtype), jnp.full_like(slopes.gradient, jnp.nan)
    return jax.lax.while_loop(unsound, solve, first)[1]


class _Steps(NamedTuple):
    """Between two steps: the best poses so far, and those that are tried next."""

    made: Array
    best: Pose
    slopes: _Slopes
    tried: Pose
    damping: Array
    short: Array


def _descend(problem: _Problem, start: Pose) -> Pose:
    """Poses (T, ...) where damped Newton steps end."""
    like = jax.eval_shape(_slopes, problem, start)
    precision = jnp.finfo(like.cost.dtype).eps

    def unfinished(now: _Steps) -> Array:
        return (now.made < STEPS) & ~now.short & (now.damping < LARGEST_DAMPING)

    def step(now: _Steps) -> _Steps:
        there, first = _slopes(problem, now.tried), now.made == 0
        # Where costs differ by rounding alone, the step still says where the minimum is.
        lower = first | (there.cost <= now.slopes.cost * (1 + 10 * precision))
        best, slopes = tree_where(lower, (now.tried, there), (now.best, now.slopes))
        damping = now.damping * jnp.where(first, 1.0, jnp.where(lower, EASED, RAISED))
        damping = jnp.maximum(damping, LEAST_DAMPING)
        move = _step(problem, slopes, damping)
        # Damping may be what makes it short.
        short = damping <= DAMPING
        short &= jnp.max(jnp.abs(move)) < SHORT * jnp.sqrt(precision)
        short &= jnp.abs(jnp.sum(slopes.gradient * move)) < precision * (LITTLE + slopes.cost)
        return _Steps(now.made + 1, best, slopes, retract(best, move), damping, short)

    unknown = jax.tree.map(lambda part: jnp.zeros(part.shape, part.dtype), like)
    damping, no = jnp.asarray(DAMPING, start.angles.dtype), jnp.zeros((), bool)
    begun = _Steps(jnp.zeros((), jnp.int32), start, unknown, start, damping, no)
    end = jax.lax.while_loop(unfinished, step, begun)
    return tree_where(end.short, end.tried, end.best)
