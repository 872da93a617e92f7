"""A person's body and where markers sit on it, by the markers themselves.

Lengths and offsets are shared by all samples and vary as they do among people: Gauss-Newton's
equations have an arrow's shape, the poses are eliminated, and the shared unknowns remain (a Schur
complement).

INPUTS: a Model, positions of its markers in some samples. OUTPUTS: the fitted model, and how
sure landmarks are.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.body.kinematics import forward, jacobian, landmark_sites, site_positions
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, retract
from jaxmocap.body.proportions import LENGTHS, covariance_among_people, scale_skeleton
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.calibration.fitting.marker_poses import (
    TAILS,
    LinearMarkers,
    damp_hessian,
    descend,
    linearise_sample,
    marker_cost,
    pose_equations,
    solve_definite,
)
from jaxmocap.compilation.programs import Program
from jaxmocap.geometry.rotations import HIGHEST

# Standard deviation, each way, of where a set's marker sits on a person, metres.
PLACE_M = 0.02
# Lengths by stature, as the body's file has them, are so many usual deviations from real people's:
# hips that are 0.19 of the stature apart there are 0.06 to 0.12 of it. Over six walking people hips
# are 2.9 cm off, in place of 5.8.
FREEDOM = 4.0


class MarkedPerson(NamedTuple):
    """What all samples share."""

    lengths: Array  # (P,) logarithms of factors on ``LENGTHS``
    shifts: Array  # (M, 3) of the markers' offsets, in their bones' axes, metres


class PersonFit(NamedTuple):
    """A person with markers, by K samples."""

    person: MarkedPerson
    poses: Pose  # (K, ...)
    covariance: Array  # (S, S) of what is shared, P lengths first, then the markers' shifts


def fitted_model(model: Model, person: MarkedPerson) -> Model:
    """The model with a person's lengths and offsets."""
    sites = replace(model.markers, offsets=model.markers.offsets + person.shifts)
    return replace(model, skeleton=scale_skeleton(model.skeleton, person.lengths), markers=sites)


def person_of_model(model: Model) -> MarkedPerson:
    """The person whom the model states."""
    markers = len(model.markers.bone_indices)
    return MarkedPerson(jnp.zeros(len(LENGTHS), model.dtype), jnp.zeros((markers, 3), model.dtype))


def fit_person(model: Model, start: Pose, targets: Array) -> PersonFit:
    """Lengths, offsets and the poses (K, ...) of K samples, from where markers usually sit.

    ``targets`` (K, M, 3) are markers, world, metres; NaN where missing.
    """

    def cost_of_all(place: tuple[MarkedPerson, Pose]) -> Array:
        person, poses = place
        cost = partial(marker_cost, fitted_model(model, person))
        own = jax.vmap(cost, (0, None, 0))(targets, TAILS, poses)
        shared = jnp.concatenate([person.lengths, person.shifts.ravel()])
        return jnp.sum(own) + jnp.sum(shared * solve_definite(usual_covariance(model), shared))

    def joint_step(place: tuple[MarkedPerson, Pose], damping: Array) -> tuple[MarkedPerson, Pose]:
        """The next place: poses eliminated, what is shared solved for, poses found again."""
        person, poses = place
        left, right, eliminated = _shared_equations(model, targets, person, poses, damping)
        step, count = -solve_definite(left, right), len(LENGTHS)
        follow, own = eliminated[..., :-1], eliminated[..., -1]
        moves = -own - jnp.einsum("kis,s->ki", follow, step, precision=HIGHEST)
        lengths, shifts = step[:count], step[count:].reshape(-1, 3)
        moved = MarkedPerson(person.lengths + lengths, person.shifts + shifts)
        return moved, jax.vmap(retract)(poses, moves)

    (person, poses), _ = descend(cost_of_all, joint_step, (person_of_model(model), start))
    undamped = jnp.zeros((), model.dtype)
    precision, _, _ = _shared_equations(model, targets, person, poses, undamped)
    unit = jnp.eye(len(precision), dtype=model.dtype)
    return PersonFit(person, poses, solve_definite(precision, unit))


def landmark_variances(model: Model, covariance: Array, poses: Pose, targets: Array) -> Array:
    """How sure landmarks (K, L, 3) are, square metres of world coordinates; see ``fit_person``.

    By the markers about their points, the posture, and what all samples share, whose covariance is
    (S, S): lengths and places that are a little wrong draw the pose along.
    """
    return jax.vmap(partial(_landmark_variances, model, covariance))(poses, targets)


FIT_PERSON = Program(fit_person, "fit_person")
LANDMARK_VARIANCES = Program(landmark_variances, "landmark_variances")


def _landmark_variances(model: Model, covariance: Array, pose: Pose, targets: Array) -> Array:
    linear, skeleton = linearise_sample(model, targets, TAILS, pose), model.skeleton
    hessian, _ = pose_equations(model, linear, pose)
    sites, person = landmark_sites(skeleton), person_of_model(model)
    points = site_positions(skeleton, linear.frames, sites)
    J = jacobian(skeleton, linear.frames, sites.bones, points).reshape(3 * len(LANDMARKS), -1)

    def scaled_points(lengths: Array) -> Array:
        longer = scale_skeleton(skeleton, lengths)
        return site_positions(longer, forward(longer, pose), sites).ravel()

    B = _by_person(model, person, linear, pose)
    weighed = linear.weights[:, None, None] * B
    cross = jnp.einsum("mij,mis->js", linear.J, weighed, precision=HIGHEST)
    follows = solve_definite(hessian, jnp.concatenate([J.T, cross], 1))
    alone, drawn = follows[:, : J.shape[0]], follows[:, J.shape[0] :]
    D = jnp.pad(jax.jacfwd(scaled_points)(person.lengths), ((0, 0), (0, person.shifts.size)))
    D = D - jnp.matmul(J, drawn, precision=HIGHEST)
    shared = jnp.sum(jnp.matmul(D, covariance, precision=HIGHEST) * D, 1)
    return (jnp.sum(J.T * alone, 0) + shared).reshape(-1, 3)


def usual_covariance(model: Model) -> Array:
    """(S, S) of lengths and markers' shifts among people."""
    among = FREEDOM**2 * covariance_among_people(len(LENGTHS))
    places = PLACE_M**2 * jnp.eye(3 * len(model.markers.bone_indices), dtype=model.dtype)
    return jax.scipy.linalg.block_diag(jnp.asarray(among, model.dtype), places)


def _shared_equations(
    model: Model, targets: Array, person: MarkedPerson, poses: Pose, damping: Array
) -> tuple[Array, Array, Array]:
    """Equations of what is shared, left (S, S) and right (S,), the poses eliminated.

    And (K, N, S + 1) how poses follow what is shared, and their own step.
    """
    there = fitted_model(model, person)

    def of_sample(own: Array, pose: Pose) -> tuple[Array, ...]:
        linear = linearise_sample(there, own, TAILS, pose)
        hessian, gradient = pose_equations(there, linear, pose)
        B = _by_person(model, person, linear, pose)
        weighed = linear.weights[:, None, None] * B
        pull = jnp.einsum("mis,mi->s", weighed, linear.off, precision=HIGHEST)
        cross = jnp.einsum("mij,mis->js", linear.J, weighed, precision=HIGHEST)
        square = jnp.einsum("mis,mit->st", weighed, B, precision=HIGHEST)
        eliminated = solve_definite(
            damp_hessian(hessian, damping), jnp.concatenate([cross, gradient[:, None]], 1)
        )
        return eliminated, cross, square, pull

    eliminated, cross, square, pull = jax.vmap(of_sample)(targets, poses)
    shared = jnp.concatenate([person.lengths, person.shifts.ravel()])
    weights = jnp.linalg.inv(usual_covariance(model))
    left = damp_hessian(jnp.sum(square, 0) + weights, damping)
    right = jnp.sum(pull, 0) + jnp.matmul(weights, shared, precision=HIGHEST)
    reduced = jnp.einsum("kis,kit->st", cross, eliminated, precision=HIGHEST)
    return left - reduced[:, :-1], right - reduced[:, -1], eliminated


def _by_person(model: Model, person: MarkedPerson, linear: LinearMarkers, pose: Pose) -> Array:
    """Derivatives (M, 3, P + 3 M) of the markers' points by what is shared."""

    def points(lengths: Array) -> Array:
        there = fitted_model(model, MarkedPerson(lengths, person.shifts))
        return site_positions(there.skeleton, forward(there.skeleton, pose), there.markers)

    by_length = jax.jacfwd(points)(person.lengths)
    markers = len(model.markers.bone_indices)
    R = linear.frames.R_world_bone[model.markers.bones]
    by_shift = jnp.eye(markers, dtype=R.dtype)[:, None, :, None] * R[:, :, None, :]
    return jnp.concatenate([by_length, by_shift.reshape(markers, 3, -1)], -1)
