"""A person's body and where markers sit on it, by the markers themselves; poses that meet them.

Each pose costs what its markers lie off their points, with long tails (two that are swapped do not
draw the body along), and what is unusual of a posture. Lengths and offsets are shared by all
samples and vary as they do among people: Gauss-Newton's equations have an arrow's shape, the poses
are eliminated, and the shared unknowns remain (a Schur complement).

INPUTS: a Model, positions of its markers in some samples. OUTPUTS: the fitted model; poses, and how
sure their landmarks are.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import (
    Frames,
    forward,
    jacobian,
    landmark_sites,
    site_positions,
)
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, beyond_limits, retract
from jaxmocap.body.proportions import LENGTHS, covariance_among_people, scaled
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.compilation.programs import Program
from jaxmocap.evidence.markers import are_present, off_targets
from jaxmocap.geometry.rotations import HIGHEST

# Standard deviation of a marker about its point: skin moves over bones, metres.
SKIN_M = 0.01
# By which a joint may exceed its range, radians: a raised arm's shoulder marker goes along with the
# skin as well, beyond the collar bone's range.
BEYOND_RAD = 0.4
# Standard deviation, each way, of where a set's marker sits on a person, metres.
PLACE_M = 0.02
# Degrees of freedom of Student's t, by which a marker lies off its point; far from the solution the
# tails begin so many times later.
TAILS = 25.0
FAR_TAILS = 400.0
STEPS, DAMPING, EASED, RAISED = 30, 1e-2, 0.2, 8.0
# A descent ends where a step brings less than this share of the cost.
RELATIVE = 1e-4


class MarkedPerson(NamedTuple):
    """What all samples share.

    Attributes:
        lengths: (P,) logarithms of factors on ``LENGTHS``.
        shifts: (M, 3) of the markers' offsets, in their bones' axes, metres.
    """

    lengths: Array
    shifts: Array


class PosesFit(NamedTuple):
    """Poses of K samples by their markers.

    Attributes:
        poses: (K, ...).
        cost: (K,) of each.
        distances: (K, M) of the markers from their points, metres; NaN where missing.
        variances: (K, L, 3) of the ``LANDMARKS``' coordinates, world, square metres.
    """

    poses: Pose
    cost: Array
    distances: Array
    variances: Array


class PersonFit(NamedTuple):
    """A person with markers, by K samples.

    Attributes:
        person: that was found.
        poses: (K, ...).
        cost: () of all.
    """

    person: MarkedPerson
    poses: Pose
    cost: Array


class _Linear(NamedTuple):
    """A sample about its pose.

    Attributes:
        off: (M, 3) markers from their targets, metres.
        weights: (M,) of their squares.
        J: (M, 3, N) their derivatives.
        frames: of the bones.
    """

    off: Array
    weights: Array
    J: Array
    frames: Frames


def fitted_model(model: Model, person: MarkedPerson) -> Model:
    """The model with a person's lengths and offsets."""
    sites = replace(model.markers, offsets=model.markers.offsets + person.shifts)
    return replace(model, skeleton=scaled(model.skeleton, person.lengths), markers=sites)


def unchanged(model: Model) -> MarkedPerson:
    """The person whom the model states."""
    markers = len(model.markers.bone_indices)
    return MarkedPerson(jnp.zeros(len(LENGTHS), model.dtype), jnp.zeros((markers, 3), model.dtype))


def fit_poses(model: Model, start: Pose, targets: Array, tails: Array | float) -> PosesFit:
    """The poses (K, ...) near a start that cost least.

    Args:
        model: of the person and M markers.
        start: (K, ...).
        targets: (K, M, 3) markers, world, metres; NaN where missing.
        tails: ``TAILS``, or more of them far from the solution.
    """

    def one(pose: Pose, own: Array) -> PosesFit:
        there, cost = _descend(
            partial(_cost, model, own, tails), partial(_step, model, own, tails), pose
        )
        off = jnp.sqrt(jnp.sum(_off(model, forward(model.skeleton, there), own) ** 2, -1))
        distances = jnp.where(are_present(own), off, jnp.nan)
        return PosesFit(there, cost, distances, _landmark_variances(model, own, tails, there))

    return jax.vmap(one)(start, targets)


def fit_person(model: Model, start: Pose, targets: Array) -> PersonFit:
    """Lengths, offsets and the poses of K samples, together.

    Args:
        model: of the person as stated, and M markers where they usually sit.
        start: (K, ...) poses.
        targets: (K, M, 3) markers, world, metres; NaN where missing.
    """
    first = unchanged(model), start
    (person, poses), cost = _descend(
        partial(_cost_of_all, model, targets),
        partial(_joint_step, model, targets),
        first,
    )
    return PersonFit(person, poses, cost)


FIT_POSES = Program(fit_poses, "fit_poses")
FIT_PERSON = Program(fit_person, "fit_person")


def _descend(cost_of: Callable, step_from: Callable, start: Any) -> tuple[Any, Array]:
    """Levenberg and Marquardt's descent: where it ends, and the cost there.

    Args:
        cost_of: of a place.
        step_from: a place and a damping, to the next place.
        start: the first place.
    """

    def unfinished(carry: tuple) -> Array:
        count, _, _, _, rests = carry
        return (count < STEPS) & ~rests

    def step(carry: tuple) -> tuple:
        count, here, cost, damping, _ = carry
        there = step_from(here, damping)
        price = cost_of(there)
        lower = price < cost
        here = jax.tree.map(lambda new, old: jnp.where(lower, new, old), there, here)
        rests = jnp.where(lower, cost - price < RELATIVE * cost, damping > 1.0)
        damping = damping * jnp.where(lower, EASED, RAISED)
        return count + 1, here, jnp.where(lower, price, cost), damping, rests

    cost = cost_of(start)
    damping = jnp.asarray(DAMPING, cost.dtype)
    first = (jnp.zeros((), jnp.int32), start, cost, damping, jnp.zeros((), bool))
    _, end, cost, _, _ = jax.lax.while_loop(unfinished, step, first)
    return end, cost


def _off(model: Model, frames: Frames, targets: Array) -> Array:
    return off_targets(site_positions(model.skeleton, frames, model.markers), targets)


def _cost(model: Model, targets: Array, tails: Array | float, pose: Pose) -> Array:
    """() of one sample: its markers, its posture."""
    skeleton = model.skeleton
    squares = jnp.sum(_off(model, forward(skeleton, pose), targets) ** 2, -1) / SKIN_M**2
    away = (pose.angles - skeleton.relaxed) / skeleton.usual_deviations
    beyond = beyond_limits(skeleton.limits, pose.angles) / BEYOND_RAD
    return jnp.sum(tails * jnp.log1p(squares / tails)) + jnp.sum(away**2) + jnp.sum(beyond**2)


def _linear(model: Model, targets: Array, tails: Array | float, pose: Pose) -> _Linear:
    frames = forward(model.skeleton, pose)
    off = _off(model, frames, targets)
    there = are_present(targets)
    weights = there.astype(off.dtype) / (SKIN_M**2 + jnp.sum(off**2, -1) / tails)
    points = off + jnp.where(there[:, None], targets, 0.0)
    return _Linear(
        off, weights, jacobian(model.skeleton, frames, model.markers.bones, points), frames
    )


def _equations(model: Model, linear: _Linear, pose: Pose) -> tuple[Array, Array]:
    """The Hessian (N, N) of half a sample's cost by its pose, and the gradient (N,)."""
    skeleton, angles = model.skeleton, pose.angles
    weighed = linear.weights[:, None, None] * linear.J
    hessian = jnp.einsum("mij,mik->jk", weighed, linear.J, precision=HIGHEST)
    gradient = jnp.einsum("mij,mi->j", weighed, linear.off, precision=HIGHEST)
    low, high = skeleton.limits.T
    beyond = jnp.where(angles < low, angles - low, jnp.where(angles > high, angles - high, 0.0))
    ease = 1 / skeleton.usual_deviations**2
    curvature = ease + jnp.where(beyond != 0, 1 / BEYOND_RAD**2, 0.0)
    pull = ease * (angles - skeleton.relaxed) + beyond / BEYOND_RAD**2
    still = jnp.full(ROOT_DOF, 1e-3, angles.dtype)
    hessian = hessian + jnp.diag(jnp.concatenate([still, curvature]))
    return hessian, gradient + jnp.pad(pull, (ROOT_DOF, 0))


def _damped(hessian: Array, damping: Array) -> Array:
    return hessian + damping * jnp.diag(jnp.diag(hessian))


def _step(model: Model, targets: Array, tails: Array | float, pose: Pose, damping: Array) -> Pose:
    hessian, gradient = _equations(model, _linear(model, targets, tails, pose), pose)
    return retract(pose, -_solve(_damped(hessian, damping), gradient))


def _solve(hessian: Array, right: Array) -> Array:
    return jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(hessian), right)


def _landmark_variances(model: Model, targets: Array, tails: Array | float, pose: Pose) -> Array:
    """(L, 3) given the person."""
    linear, skeleton = _linear(model, targets, tails, pose), model.skeleton
    hessian, _ = _equations(model, linear, pose)
    sites = landmark_sites(skeleton)
    points = site_positions(skeleton, linear.frames, sites)
    J = jacobian(skeleton, linear.frames, sites.bones, points).reshape(3 * len(LANDMARKS), -1)
    return jnp.sum(J.T * _solve(hessian, J.T), 0).reshape(-1, 3)


def _precision(model: Model) -> np.ndarray:
    """(P, P) of the lengths among people."""
    return np.linalg.inv(covariance_among_people(len(LENGTHS))).astype(model.dtype)


def _cost_of_all(model: Model, targets: Array, place: tuple[MarkedPerson, Pose]) -> Array:
    person, poses = place
    own = jax.vmap(partial(_cost, fitted_model(model, person)), (0, None, 0))(targets, TAILS, poses)
    shared = person.lengths @ _precision(model) @ person.lengths
    return jnp.sum(own) + shared + jnp.sum(person.shifts**2) / PLACE_M**2


def _joint_step(
    model: Model, targets: Array, place: tuple[MarkedPerson, Pose], damping: Array
) -> tuple[MarkedPerson, Pose]:
    """The next place: poses eliminated, what is shared solved for, poses found again."""
    person, poses = place
    there, count = fitted_model(model, person), len(LENGTHS)

    def of_sample(own: Array, pose: Pose) -> tuple[Array, ...]:
        linear = _linear(there, own, TAILS, pose)
        hessian, gradient = _equations(there, linear, pose)
        B = _by_person(model, person, linear, pose)
        weighed = linear.weights[:, None, None] * B
        pull = jnp.einsum("mis,mi->s", weighed, linear.off, precision=HIGHEST)
        cross = jnp.einsum("mij,mis->js", linear.J, weighed, precision=HIGHEST)
        square = jnp.einsum("mis,mit->st", weighed, B, precision=HIGHEST)
        eliminated = _solve(
            _damped(hessian, damping), jnp.concatenate([cross, gradient[:, None]], 1)
        )
        return eliminated, cross, square, pull

    eliminated, cross, square, pull = jax.vmap(of_sample)(targets, poses)
    shared = jnp.concatenate([person.lengths, person.shifts.ravel()])
    of_places = jnp.eye(person.shifts.size, dtype=model.dtype) / PLACE_M**2
    weights = jax.scipy.linalg.block_diag(_precision(model), of_places)
    left = _damped(jnp.sum(square, 0) + weights, damping)
    right = jnp.sum(pull, 0) + jnp.matmul(weights, shared, precision=HIGHEST)
    reduced = jnp.einsum("kis,kit->st", cross, eliminated, precision=HIGHEST)
    step = -_solve(left - reduced[:, :-1], right - reduced[:, -1])
    moves = -eliminated[..., -1] - jnp.einsum(
        "kis,s->ki", eliminated[..., :-1], step, precision=HIGHEST
    )
    lengths, shifts = step[:count], step[count:].reshape(-1, 3)
    moved = MarkedPerson(person.lengths + lengths, person.shifts + shifts)
    return moved, jax.vmap(retract)(poses, moves)


def _by_person(model: Model, person: MarkedPerson, linear: _Linear, pose: Pose) -> Array:
    """Derivatives (M, 3, P + 3 M) of the markers' points by what is shared."""

    def points(lengths: Array) -> Array:
        there = fitted_model(model, MarkedPerson(lengths, person.shifts))
        return site_positions(there.skeleton, forward(there.skeleton, pose), there.markers)

    by_length = jax.jacfwd(points)(person.lengths)
    markers = len(model.markers.bone_indices)
    R = linear.frames.R_world_bone[model.markers.bones]
    by_shift = jnp.eye(markers, dtype=R.dtype)[:, None, :, None] * R[:, :, None, :]
    return jnp.concatenate([by_length, by_shift.reshape(markers, 3, -1)], -1)
