"""The pose at the minimum of its terms, within the joints' limits, with its derivatives.

INPUTS: a Model, terms, what was measured, a pose to start from. OUTPUTS: a pose.
"""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, retract
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.evidence.terms import Measurements, Term, residuals
from jaxmocap.solvers.limits import room
from jaxmocap.solvers.optimum import Costs, descend, newton_step

# Steps of the descent, at most.
STEPS = 100


def pose_at_minimum(
    model: Model, terms: Sequence[Term], measured: Measurements, start: Pose, scale: Array
) -> Pose:
    """The pose near ``start`` that costs least; differentiable by all but the start and the scale.

    Joints rest at their limits where terms push them outwards; then they follow the limits.

    Args:
        model: of the person, the markers and the cameras.
        terms: together they must determine every degree of freedom, a prior among them.
        measured: of this moment.
        start: to descend from.
        scale: (6 + D,) usual sizes of a change of each degree of freedom, metres and radians.
    """
    evidence = (model, terms, measured)
    held, start, scale = jax.lax.stop_gradient((evidence, start, scale))
    low, high = held[0].skeleton.limits.T
    start = start._replace(angles=jnp.clip(start.angles, low, high))
    costs = Costs(partial(_cost, held), partial(_slope, held), retract, partial(_room, held))
    pose, hessian, at_rest = descend(costs, start, scale, STEPS)
    side = jnp.where(at_rest, jnp.where(costs.room(pose)[0] >= 0, -1, 1), 0)[ROOT_DOF:]
    pose = _at_limits(model, pose, side)
    step = newton_step(_slope(evidence, pose, jnp.zeros_like(scale)), hessian, ~at_rest)
    # Where the cost has no second derivative to speak of, a step may lead anywhere.
    step = jnp.where(jnp.isfinite(step), step, 0.0)
    return retract(pose, step - jax.lax.stop_gradient(step))


def _cost(evidence: tuple, pose: Pose) -> Array:
    """() half the squares of all residuals."""
    model, terms, measured = evidence
    return jnp.sum(residuals(terms, model, pose, measured) ** 2) / 2


def _slope(evidence: tuple, pose: Pose, step: Array) -> Array:
    """(6 + D,) the cost's derivative where a step from the pose leads, by tangent vectors there."""
    there = retract(pose, step)
    return jax.grad(lambda further: _cost(evidence, retract(there, further)))(jnp.zeros_like(step))


def _room(evidence: tuple, pose: Pose) -> tuple[Array, Array]:
    """How far (6 + D,) each degree of freedom may go down and up."""
    low, high = room(evidence[0].skeleton.limits, pose.angles)
    endless = jnp.full(ROOT_DOF, jnp.inf, low.dtype)
    return jnp.concatenate([-endless, low]), jnp.concatenate([endless, high])


def _at_limits(model: Model, pose: Pose, side: Array) -> Pose:
    """The pose with the joints of a side at that limit."""
    low, high = model.skeleton.limits.T
    angles = jnp.where(side < 0, low, jnp.where(side > 0, high, pose.angles))
    return pose._replace(angles=angles)
