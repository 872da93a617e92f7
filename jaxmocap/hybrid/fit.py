"""The body is fitted to the edges (section 5.2): outlines are brought onto them.

A downhill simplex over each arm's four degrees of freedom, as in the paper, or the whole body at
the minimum of its terms.

INPUTS: a Model, a pose, distance fields of edges. OUTPUTS: the fitted pose.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.arms import Arms, arm_dofs, arms_of, flesh, hang, swing
from jaxmocap.body.kinematics import forward
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, beyond_limits, difference, retract
from jaxmocap.evidence.edges import EdgeFields, WeightedEdges
from jaxmocap.evidence.expansion import expand_terms
from jaxmocap.evidence.markers import Goals, off_targets
from jaxmocap.evidence.terms import Measurements, Term, residuals
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.hybrid.minimum import pose_at_minimum
from jaxmocap.hybrid.settings import Settings
from jaxmocap.solvers.optimum import curved_step, following
from jaxmocap.solvers.simplex import downhill_simplex, initial_simplex
from jaxmocap.solvers.status import Status

# A degree of freedom that is held may move by this share of its prior.
HELD = 1e-3


class Aims(NamedTuple):
    """What the body is to meet beside the edges."""

    goals: Goals  # markers and unmarked feet
    elbows: Array  # (2, 3) of the search, world, metres
    centre: Pose  # the pose that the priors are about
    free: Array | None  # (6 + D,) degrees of freedom that may move; all where it is None


def no_status() -> Array:
    """Of a fit that had nothing to do."""
    return jnp.asarray(int(Status.CONVERGED), jnp.int32)


def refine_body(
    model: Model,
    settings: Settings,
    edges: WeightedEdges,
    start: Pose,
    aims: Aims,
    exact: bool = False,
) -> tuple[Pose, Array]:
    """The whole body where ``settings.gradient_terms`` cost least, and a ``Status``.

    Both arms together, and with them the trunk that carries the shoulders: three markers leave that
    uncertain too. Half the squared sum of the residuals means what the simplex's cost means, in
    nats. The start itself where no camera has an image: between two of them there is nothing to
    fit.

    Args:
        model: of the person, the markers and the cameras.
        settings: of the tracker.
        edges: of both arms, and how much each point of an outline counts.
        start: a pose.
        aims: what else is to be met.
        exact: go to the minimum itself, whose derivatives the pose then has; else optimistix ends
            where ``settings.gradient`` says.
    """
    return jax.lax.cond(
        jnp.any(jnp.asarray(edges.fields.available)),
        partial(_descend, model, settings, edges, start, aims, exact),
        lambda: (start, no_status()),
    )


def _descend(
    model: Model, settings: Settings, edges: WeightedEdges, start: Pose, aims: Aims, exact: bool
) -> tuple[Pose, Array]:
    # Here, since optimistix takes half a second to import, which the simplex does not need.
    from jaxmocap.solvers.least_squares import least_squares

    own, terms, (low, high) = settings.gradient, settings.gradient_terms, model.skeleton.limits.T
    elbows = aims.elbows if settings.search else None
    measured = Measurements(elbows=elbows, edges=edges, goals=aims.goals, centre=aims.centre)
    if exact:
        return pose_at_minimum(model, terms, measured, start, free=aims.free, bends=False)
    scale = own.near.deviations(model.skeleton)
    if aims.free is not None:
        scale = scale * jnp.where(aims.free, 1.0, HELD)
    about = jax.lax.stop_gradient(_FromStart(model, terms, measured, start, scale))
    found = least_squares(
        _whiten, jnp.zeros_like(scale), about, method=own.method, largest_steps=own.steps,
        tolerance=own.tolerance,
    )  # fmt: skip
    pose = about.pose(found.point)
    return pose._replace(angles=jnp.clip(pose.angles, low, high)), found.status


class _FromStart(NamedTuple):
    """What the residuals depend on, and poses by their way from the start."""

    model: Model
    terms: tuple[Term, ...]
    measured: Measurements
    start: Pose
    scale: Array  # (6 + D,) of the tangent vector whose entry of the descent's point is 1

    def pose(self, point: Array) -> Pose:
        """The pose at a point (6 + D,) of the descent."""
        return retract(self.start, self.scale * point)


@jax.custom_jvp
def _whiten(point: Array, about: _FromStart) -> Array:
    return residuals(about.terms, about.model, about.pose(point), about.measured)


@_whiten.defjvp
def _whiten_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    """By the formulas of the body's derivatives; nothing but the point moves."""
    (point, about), (change, _) = primals, tangents
    model, terms, measured, _, _ = about
    there = about.pose(point)
    r, J, _ = expand_terms(terms, model, there, measured, bends=False)
    step = jax.jvp(lambda point: difference(about.pose(point), there), (point,), (change,))[1]
    return r, jnp.matmul(J, step, precision=HIGHEST)


# Costs (2) of both arms, from arms and their (2, 4) joint angles.
ArmCost = Callable[[Arms, Array], Array]


def refine_arms(
    model: Model,
    settings: Settings,
    fields: EdgeFields,
    pose: Pose,
    grip_targets: Array,
    elbows: Array,
) -> Pose:
    """Minimise equation (14) over each arm's four degrees of freedom by the downhill simplex.

    An arm without an image stays as it is.

    Args:
        model: of the person, the markers and the cameras.
        settings: of the tracker.
        fields: of both arms.
        pose: to start from.
        grip_targets: (2, 3) t of equation (14), world, metres.
        elbows: (2, 3) of the search.
    """
    own, by_arm = settings.simplex, fields.by_arm()
    dofs = arm_dofs(model.skeleton.tree)
    limits = model.skeleton.limits[dofs]
    hung = hang(model.skeleton, pose, model.grips)
    costs = _arm_costs(model, settings, by_arm, pose, grip_targets, elbows)

    def cost(moves: Array) -> Array:
        arms, angles = swing(hung, moves)
        return sum((each(arms, angles) for each in costs), start=jnp.zeros(2, angles.dtype))

    still = jnp.zeros_like(hung.angles)
    has_image = jnp.any(by_arm.available, -1)[:, None]

    def fitted() -> Array:
        lengths = jnp.full(4, own.other_edge).at[0].set(own.swivel_edge)
        first = initial_simplex(still, jnp.diag(lengths))
        moves = downhill_simplex(cost, first, own.iterations).points
        angles = swing(hung, jnp.where(has_image, moves, still))[1]
        return jnp.where(has_image, jnp.clip(angles, limits[..., 0], limits[..., 1]), hung.angles)

    # Between two images there is nothing to fit.
    angles = jax.lax.cond(jnp.any(has_image), fitted, lambda: hung.angles)
    return pose._replace(angles=pose.angles.at[dofs].set(angles))


def arms_at_minimum(
    model: Model,
    settings: Settings,
    fields: EdgeFields,
    pose: Pose,
    grip_targets: Array,
    elbows: Array,
    found: Pose,
) -> Pose:
    """The pose that ``refine_arms`` found, with the derivatives of the minimum beside it.

    The other arguments are those of ``refine_arms``.
    """
    return following(_arms_moved, (model, settings, fields, pose, grip_targets, elbows), found)


def _arms_moved(parameters: tuple, pose: Pose) -> Pose:
    """Where arms at their minimum go as the parameters change."""
    model, settings, fields, *start = parameters
    costs = _arm_costs(model, settings, fields.by_arm(), *start)
    hung, dofs = hang(model.skeleton, pose, model.grips), arm_dofs(model.skeleton.tree)

    def cost(moves: Array) -> Array:
        arms, angles = swing(hung, moves)
        return sum((each(arms, angles) for each in costs), start=jnp.zeros(()))

    slope, H = _by_arm(lambda moves: _by_arm(cost, moves)[1], jnp.zeros_like(hung.angles))
    step = jax.vmap(curved_step)(slope, H)
    has_image = jnp.any(jnp.asarray(fields.available), 0)[:, None]
    step = jnp.where(has_image, step - jax.lax.stop_gradient(step), 0.0)
    return pose._replace(angles=pose.angles.at[dofs].set(swing(hung, step)[1]))


def _by_arm(function: Callable[[Array], Array], moves: Array) -> tuple[Array, Array]:
    """What (2, ...) each arm has of its own moves (2, 4) alone, and its derivative (2, ..., 4).

    Forwards: what goes twice through pictures backwards takes twice as long to compile.
    """
    # One way of both arms at once.
    ways = jnp.broadcast_to(np.eye(4, dtype=moves.dtype)[:, None], (4, *moves.shape))
    along = partial(jax.jvp, function, (moves,))
    return jax.vmap(lambda way: along((way,)), out_axes=(None, -1))(ways)


def _arm_costs(
    model: Model,
    settings: Settings,
    fields: EdgeFields,
    start: Pose,
    grip_targets: Array,
    elbows: Array,
) -> tuple[ArmCost, ...]:
    """The terms of equation (14), and the searched elbow; fields with the arms' axis first."""
    own, limits = settings.simplex, model.skeleton.limits[arm_dofs(model.skeleton.tree)]
    of_arm = partial(settings.edges.arm_cost, model.cameras)
    begun = flesh(arms_of(model.skeleton, forward(model.skeleton, start), model.grips))

    def on_edges(arms: Arms, _: Array) -> Array:
        return jax.vmap(of_arm)(fields, flesh(arms), begun)

    def held(arms: Arms, _: Array) -> Array:
        away = off_targets(arms.grip, grip_targets)
        return own.hold * jnp.sqrt(jnp.sum(away**2, -1) + 1e-12)

    def within_limits(_: Arms, angles: Array) -> Array:
        return own.limit * jnp.sum(beyond_limits(limits, angles), -1)

    def near_searched(arms: Arms, _: Array) -> Array:
        return jnp.sum((arms.elbow - elbows) ** 2, -1) / own.elbow**2 / 2

    costs = (on_edges, held, within_limits)
    return (*costs, near_searched) if settings.search else costs
