"""Gradient refinement: the whole body by least squares, as a rival to the simplex.

Both arms together, and with them the trunk that carries the shoulders: three markers leave that
uncertain too. Half the squared sum of the residuals means what the simplex's cost means, in nats.
The solution is differentiable by lengths, cameras and marker offsets (implicit differentiation);
how much each point of an outline counts is settled at the start.

INPUTS: a pose to start from, what it is to meet, distance fields of edges.
OUTPUTS: the refined pose.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, retract
from jaxmocap.evidence.edges import EdgeFields
from jaxmocap.evidence.markers import Goals
from jaxmocap.evidence.terms import residuals
from jaxmocap.hybrid.settings import Settings
from jaxmocap.solvers.status import Status

# A degree of freedom that is held may move by this share of its prior.
HELD = 1e-3


class Aims(NamedTuple):
    """What the body is to meet beside the edges.

    Attributes:
        goals: markers and unmarked feet.
        elbows: (2, 3) of the search, world, metres.
        centre: the pose that the priors are about.
        free: (6 + D,) degrees of freedom that may move.
    """

    goals: Goals
    elbows: Array
    centre: Pose
    free: Array


class Refined(NamedTuple):
    """How a refinement ended.

    Attributes:
        pose: refined.
        cost: () nats.
        steps: () made.
        status: () int32, a ``Status``.
    """

    pose: Pose
    cost: Array
    steps: Array
    status: Array


def refine_body(
    model: Model, settings: Settings, fields: EdgeFields, start: Pose, aims: Aims
) -> Refined:
    """The most likely pose near ``start``; the start itself where no camera has an image.

    Args:
        model: of the person, the markers and the cameras.
        settings: of the tracker.
        fields: of both arms.
        start: a pose; nothing is differentiated through it.
        aims: what else is to be met.
    """
    # Here, since optimistix takes half a second to import, which the simplex does not need.
    from jaxmocap.solvers.least_squares import least_squares

    own, terms = settings.gradient, settings.gradient_terms
    start, centre = jax.lax.stop_gradient((start, aims.centre))
    scale = own.near.deviations(model.skeleton) * jnp.where(aims.free, 1.0, HELD)
    edges = settings.edges.weighted(model, fields, start)
    measured = {"edges": edges, "goals": aims.goals, "centre": centre}
    if settings.search:
        measured["elbows"] = aims.elbows

    def whitened(point: Array, _: None) -> Array:
        return residuals(terms, model, retract(start, scale * point), measured)

    def solved() -> Refined:
        point, cost, steps, status = least_squares(
            whitened,
            jnp.zeros_like(scale),
            method=own.method,
            largest_steps=own.steps,
            relative=own.tolerance,
            absolute=own.tolerance,
        )
        pose = retract(start, scale * point)
        low, high = model.skeleton.limits.T
        return Refined(pose._replace(angles=jnp.clip(pose.angles, low, high)), cost, steps, status)

    def unsolved() -> Refined:
        none = jnp.zeros((), jnp.int32)
        return Refined(start, jnp.zeros((), scale.dtype), none, none + int(Status.CONVERGED))

    # Between two images there is nothing to fit.
    return jax.lax.cond(jnp.any(jnp.asarray(fields.available)), solved, unsolved)
