"""The batch smoother as a pure function of arrays: jit, vmap and derivatives go through it.

All poses of T events at once, where the terms of evidence and the smoothness of the landmarks'
motion cost least. The trajectory x is where the cost's slope vanishes; its derivatives are those of
that minimum (``solvers.optimum``), by the whole Hessian, which is block-banded in time: every term
belongs to one event, and of the prior that joins them only the landmarks' curvature is new.

INPUTS: a Model, settings, Events. OUTPUTS: SmoothMotion.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import landmarks
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, retract
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.compilation.arguments import check_kind, floating
from jaxmocap.evidence.shapes import checked_measurements, checked_pose
from jaxmocap.evidence.terms import Measurements, linearised, residuals
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.smoothing.settings import SmoothingSettings
from jaxmocap.solvers.block_bands import BlockBands, solve_block_banded

# An acceleration takes so many.
FEWEST_EVENTS = 3
# Steps of the descent, at most; the damping it begins with, and factors on it.
STEPS, DAMPING, EASED, RAISED = 60, 1e-3, 0.2, 10.0
# Newton steps after it, each of which squares the distance to the minimum.
NEWTON_STEPS = 3
# Curvature that every unknown has at least.
FLOOR = 1e-6


class Events(NamedTuple):
    """What was measured of T events, and where a first pass put the body.

    Attributes:
        times: (T,) seconds, ascending.
        measured: name -> (T, ...), as the terms ask for them: ``markers`` (T, M, 3), world, metres,
            NaN where missing; ``upright``, ``facing`` and ``ankles`` of the markers' poses;
            ``elbows`` (T, 2, 3), NaN where no image shows them.
        poses: (T, ...) to start from; nothing is differentiated by them.
    """

    times: Array
    measured: Measurements
    poses: Pose


def checked_events(model: Model, events: Any) -> Events:
    """Events in the model's precision.

    Raises:
        TypeError: no events, or no real numbers in them.
        ValueError: fewer than 3, or an array that has not a row for each.
    """
    check_kind("events", events, Events)
    times = np.shape(events.times)
    if len(times) == 1 and times[0] < FEWEST_EVENTS:
        raise ValueError(f"events: found {times[0]}, expected {FEWEST_EVENTS} or more")
    T = times[-1] if times else 0
    return Events(
        floating("events.times", events.times, (T,), model.dtype),
        checked_measurements("events.measured", model, events.measured, T),
        checked_pose("events.poses", model, events.poses, (T,)),
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


class _Slopes(NamedTuple):
    """The cost's gradient (T, N) and Hessian, or Gauss-Newton's."""

    gradient: Array
    hessian: BlockBands


def smooth_events(model: Model, settings: SmoothingSettings, events: Events) -> SmoothMotion:
    """The poses of all events at the minimum of the terms and of the landmarks' accelerations.

    Derivatives are by the model, the settings and what was measured. The bones are as the model has
    them: unlike ``track``, it estimates no proportions and no camera's turn.

    Args:
        model: of the person and the markers, as the events were made with.
        settings: of smoothing; their terms take part that find their measurements.
        events: T of them, 3 at least.
    """
    problem = _Problem(model, settings, events.times, events.measured)
    held, start = jax.lax.stop_gradient((problem, events.poses))
    poses = _descended(held, start)

    def newton(_: int, carry: tuple[Pose, BlockBands]) -> tuple[Pose, BlockBands]:
        poses = carry[0]
        slopes = _whole(held, poses)
        step = solve_block_banded(slopes.hessian, slopes.gradient)
        # Where it is no minimum of the whole cost, by Gauss-Newton's.
        rough = _raised(_gauss_newton(held, poses).hessian, jnp.zeros((), step.dtype))
        sound = jnp.all(jnp.isfinite(step))
        hessian = jax.tree.map(lambda a, b: jnp.where(sound, a, b), slopes.hessian, rough)
        moved = retract(poses, -jnp.where(sound, step, 0.0))
        return jax.tree.map(lambda a, b: jnp.where(sound, a, b), moved, poses), hessian

    blank = jnp.zeros((len(start.angles),) + 2 * (model.skeleton.costs.size,), start.angles.dtype)
    poses, hessian = jax.lax.fori_loop(0, NEWTON_STEPS, newton, (poses, BlockBands(*3 * (blank,))))
    gradient = _gradient(problem, poses)
    poses = retract(poses, -solve_block_banded(hessian, gradient))
    points = jax.vmap(partial(landmarks, model.skeleton))(poses)
    return SmoothMotion(events.times, poses, points)


def _cost(problem: _Problem, poses: Pose) -> Array:
    """() half the sum of all squares."""
    model, settings, times, measured = problem
    own = jax.vmap(lambda pose, each: residuals(settings.terms, model, pose, each))(poses, measured)
    points = jax.vmap(partial(landmarks, model.skeleton))(poses).reshape(len(times), -1)
    return (jnp.sum(own**2) + jnp.sum(_accelerations(problem, points) ** 2)) / 2


def _gradient(problem: _Problem, poses: Pose) -> Array:
    """(T, N) of the cost, by tangent vectors at the poses."""
    still = jnp.zeros((len(poses.angles), problem.model.skeleton.costs.size), poses.angles.dtype)
    return jax.grad(lambda step: _cost(problem, retract(poses, step)))(still)


def _stencil(problem: _Problem) -> Array:
    """(T - 2, 3) of three successive points, to their acceleration in its deviations."""
    steps = jnp.diff(problem.times)
    h1, h2 = steps[:-1], steps[1:]
    second = jnp.stack([1 / h1, -1 / h1 - 1 / h2, 1 / h2], 1) * jnp.sqrt(2 / (h1 + h2))[:, None]
    return second / problem.settings.acceleration


def _accelerations(problem: _Problem, points: Array) -> Array:
    """(T - 2, M) of points (T, M), in their deviations; see ``evidence.smoothness``."""
    c = _stencil(problem)
    each = [c[:, k, None] * points[k : len(points) - 2 + k] for k in range(3)]
    return each[0] + each[1] + each[2]


def _ties(problem: _Problem) -> list[Array]:
    """(T,) how each event's points are tied to themselves, to the next and to the second next."""
    c, count = _stencil(problem), len(problem.times)
    each = []
    for ahead in range(3):
        total = jnp.zeros(count, c.dtype)
        for k in range(3 - ahead):
            total = total.at[k : count - 2 + k].add(c[:, k] * c[:, k + ahead])
        each.append(total)
    return each


def _gauss_newton(problem: _Problem, poses: Pose) -> _Slopes:
    model, settings = problem.model, problem.settings
    none = jnp.zeros(0, poses.angles.dtype)
    linear = jax.vmap(lambda pose, own: linearised(settings.terms, model, none, pose, own))(
        poses, problem.measured
    )
    J, r = linear.jacobian, linear.residuals
    hessian = jnp.einsum("trn,trm->tnm", J, J, precision=HIGHEST)
    pull = _pull(problem, linear.points)
    gradient = jnp.einsum("trn,tr->tn", J, r, precision=HIGHEST)
    gradient += jnp.einsum("tpn,tp->tn", linear.points_jacobian, pull, precision=HIGHEST)
    return _Slopes(gradient, _with_prior(problem, hessian, linear.points_jacobian))


def _whole(problem: _Problem, poses: Pose) -> _Slopes:
    """With what Gauss-Newton leaves out: the curvature of residuals and of landmarks."""
    model, settings = problem.model, problem.settings
    points = jax.vmap(partial(landmarks, model.skeleton))(poses).reshape(len(problem.times), -1)
    pull = _pull(problem, points)
    still = jnp.zeros(model.skeleton.costs.size, poses.angles.dtype)

    def of_event(pose: Pose, own: Measurements, pull: Array) -> tuple[Array, Array, Array]:
        def cost(step: Array) -> tuple[Array, Array]:
            there = retract(pose, step)
            r = residuals(settings.terms, model, there, own)
            at = landmarks(model.skeleton, there).ravel()
            return jnp.sum(r**2) / 2 + jnp.sum(pull * at), at

        def uphill(step: Array) -> tuple[tuple[Array, Array], Array]:
            slope, at = jax.grad(cost, has_aux=True)(step)
            return (slope, at), slope

        (hessian, jacobian), gradient = jax.jacfwd(uphill, has_aux=True)(still)
        return gradient, hessian, jacobian

    gradient, hessian, jacobian = jax.vmap(of_event)(poses, problem.measured, pull)
    hessian = (hessian + hessian.swapaxes(1, 2)) / 2
    return _Slopes(gradient, _with_prior(problem, hessian, jacobian))


def _pull(problem: _Problem, points: Array) -> Array:
    """(T, M) the derivative of half the prior's squares by points (T, M)."""
    return jax.grad(lambda points: jnp.sum(_accelerations(problem, points) ** 2) / 2)(points)


def _with_prior(problem: _Problem, hessian: Array, jacobian: Array) -> BlockBands:
    """Events' own Hessians (T, N, N) and what the prior ties, by the points' (T, M, N)."""
    blocks = []
    for ahead, ties in enumerate(_ties(problem)):
        there = jnp.roll(jacobian, -ahead, 0)
        tied = jnp.einsum("tpn,tpm->tnm", jacobian, there, precision=HIGHEST)
        blocks.append(ties[:, None, None] * tied)
    return BlockBands(hessian + blocks[0], *blocks[1:])


def _raised(hessian: BlockBands, damping: Array) -> BlockBands:
    """With a share of its diagonal, and the floor, added to it."""
    diagonal = jnp.einsum("tnn->tn", hessian.own)
    more = (damping * diagonal + FLOOR)[..., None] * jnp.eye(
        diagonal.shape[1], dtype=diagonal.dtype
    )
    return hessian._replace(own=hessian.own + more)


def _descended(problem: _Problem, start: Pose) -> Pose:
    """Poses (T, ...) after Levenberg-Marquardt's steps."""
    tolerance = 10 * jnp.finfo(start.angles.dtype).eps

    def unfinished(carry: tuple[Array, Pose, Array, Array, Array]) -> Array:
        count, _, _, damping, moves = carry
        return (count < STEPS) & moves & (damping < 1e9)

    def step(carry: tuple[Array, Pose, Array, Array, Array]) -> tuple:
        count, poses, cost, damping, _ = carry
        slopes = _gauss_newton(problem, poses)
        move = -solve_block_banded(_raised(slopes.hessian, damping), slopes.gradient)
        there = retract(poses, move)
        price = _cost(problem, there)
        lower = price < cost
        poses = jax.tree.map(lambda new, old: jnp.where(lower, new, old), there, poses)
        gained = (cost - price > tolerance * cost) | ~lower
        damping = damping * jnp.where(lower, EASED, RAISED)
        return count + 1, poses, jnp.where(lower, price, cost), damping, gained

    damping = jnp.asarray(DAMPING, start.angles.dtype)
    first = (jnp.zeros((), jnp.int32), start, _cost(problem, start), damping, jnp.ones((), bool))
    return jax.lax.while_loop(unfinished, step, first)[1]
