"""Poses that meet a full set of markers.

Each pose costs what its markers lie off their points, with long tails (two that are swapped do not
draw the body along), and what is unusual of a posture.

INPUTS: a Model, positions of its markers in some samples. OUTPUTS: poses, their linearisations.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.body.kinematics import Frames, forward, jacobian, site_positions
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, beyond_limits, retract
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.compilation.programs import Program
from jaxmocap.evidence.markers import are_present, off_targets
from jaxmocap.geometry.rotations import HIGHEST

# Standard deviation of a marker about its point: skin moves over bones, metres.
SKIN_M = 0.015
# By which a joint may exceed its range, radians: a raised arm's shoulder marker goes along with the
# skin as well, beyond the collar bone's range.
BEYOND_RAD = 0.4
# Degrees of freedom of Student's t, by which a marker lies off its point; far from the solution the
# tails begin so many times later.
TAILS = 25.0
FAR_TAILS = 400.0
STEPS, DAMPING, EASED, RAISED = 30, 1e-2, 0.2, 8.0
# A descent ends where a step brings less than this share of the cost.
RELATIVE = 1e-4


class PosesFit(NamedTuple):
    """Poses of K samples by their markers."""

    poses: Pose  # (K, ...)
    cost: Array  # (K,) of each
    distances: Array  # (K, M) of the markers from their points, metres; NaN where missing


class LinearMarkers(NamedTuple):
    """A sample about its pose."""

    off: Array  # (M, 3) markers from their targets, metres
    weights: Array  # (M,) of their squares
    J: Array  # (M, 3, N) their derivatives
    frames: Frames  # of the bones


def fit_poses(model: Model, start: Pose, targets: Array, tails: Array | float) -> PosesFit:
    """The poses (K, ...) near a start that cost least.

    ``targets`` (K, M, 3) are markers, world, metres; NaN where missing. ``tails`` are ``TAILS``, or
    more of them far from the solution.
    """

    def one(pose: Pose, own: Array) -> PosesFit:
        def step(pose: Pose, damping: Array) -> Pose:
            hessian, gradient = pose_equations(
                model, linearise_sample(model, own, tails, pose), pose
            )
            return retract(pose, -solve_definite(damp_hessian(hessian, damping), gradient))

        there, cost = descend(partial(marker_cost, model, own, tails), step, pose)
        off = jnp.sqrt(jnp.sum(_off(model, forward(model.skeleton, there), own) ** 2, -1))
        distances = jnp.where(are_present(own), off, jnp.nan)
        return PosesFit(there, cost, distances)

    return jax.vmap(one)(start, targets)


FIT_POSES = Program(fit_poses, "fit_poses")


def descend(cost_of: Callable, step_from: Callable, start: Any) -> tuple[Any, Array]:
    """Levenberg and Marquardt's descent: where it ends, and the cost there.

    ``step_from`` leads from a place and a damping to the next place.
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


def marker_cost(model: Model, targets: Array, tails: Array | float, pose: Pose) -> Array:
    """() of one sample: its markers, its posture."""
    skeleton = model.skeleton
    squares = jnp.sum(_off(model, forward(skeleton, pose), targets) ** 2, -1) / SKIN_M**2
    away = (pose.angles - skeleton.relaxed) / skeleton.usual_deviations
    beyond = beyond_limits(skeleton.limits, pose.angles) / BEYOND_RAD
    return jnp.sum(tails * jnp.log1p(squares / tails)) + jnp.sum(away**2) + jnp.sum(beyond**2)


def linearise_sample(
    model: Model, targets: Array, tails: Array | float, pose: Pose
) -> LinearMarkers:
    """A sample about its pose; see ``fit_poses``."""
    frames = forward(model.skeleton, pose)
    off = _off(model, frames, targets)
    there = are_present(targets)
    weights = there.astype(off.dtype) / (SKIN_M**2 + jnp.sum(off**2, -1) / tails)
    points = off + jnp.where(there[:, None], targets, 0.0)
    return LinearMarkers(
        off, weights, jacobian(model.skeleton, frames, model.markers.bones, points), frames
    )


def pose_equations(model: Model, linear: LinearMarkers, pose: Pose) -> tuple[Array, Array]:
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


def damp_hessian(hessian: Array, damping: Array) -> Array:
    """With its diagonal (N,) made larger by a share."""
    return hessian + damping * jnp.diag(jnp.diag(hessian))


def solve_definite(hessian: Array, right: Array) -> Array:
    """The solution (N, ...) of equations whose matrix (N, N) is positive definite."""
    return jax.scipy.linalg.cho_solve(jax.scipy.linalg.cho_factor(hessian), right)
