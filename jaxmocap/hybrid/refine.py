"""Refinement of the markers' pose by the video (section 5).

    search    where each elbow is, by edges, with memory (ours)
    balance   the spine bows in a squat (5.3); by choice as the last step, as in the paper
    follow    the body follows the elbows by inverse kinematics, the markers held, so that a
              shoulder that three markers placed wrongly moves as well
    fit       a downhill simplex over each arm's four degrees of freedom brings the outlines to
              the edges (5.2: the arms are problems of their own, solved side by side), or least
              squares over the whole body (``gradient``)
    report    what came of it

INPUTS: a Model, what ``solve`` found, distance fields of edges, the belief about the elbows.
OUTPUTS: the refined pose, the belief, a report.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.body.arms import Arms, arm_dofs, arms_of, flesh, hang, swing, swivels, turn_between
from jaxmocap.body.kinematics import forward
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, beyond_limits
from jaxmocap.evidence.edges import EdgeFields
from jaxmocap.evidence.markers import Goals, are_present, off_targets
from jaxmocap.hybrid.balance import bow_on_feet
from jaxmocap.hybrid.elbow_search import (
    ElbowBelief,
    believed_elbows,
    search,
    without_image,
)
from jaxmocap.hybrid.gradient import Aims, refine_body
from jaxmocap.hybrid.ik import IKResult, goal_distances, goals_of, reach
from jaxmocap.hybrid.settings import Settings
from jaxmocap.images.regions import Region
from jaxmocap.solvers.optimum import curved_step
from jaxmocap.solvers.simplex import downhill_simplex, initial_simplex
from jaxmocap.solvers.status import Status


class Solved(NamedTuple):
    """What markers tell: their pose, whether the body was placed again, the arms' regions."""

    ik: IKResult
    placed: Array
    region: Region | None


class StepReport(NamedTuple):
    """What came of a step besides the pose.

    Attributes:
        marker_pose: of the markers alone.
        marker_errors: (M,) of the markers from their points on the refined body, metres; NaN where
            missing.
        outline_px: (2,) mean distance of each arm's outline to the edges, pixels; NaN without an
            image.
        swivels: (2,) turn of each elbow that the video added, radians.
        elbow_deviations: (2,) standard deviations of the elbows, metres.
        iterations: () of the inverse kinematics.
        planted: () whether the feet were planted again.
        placed: () whether the body was placed again.
        balanced: () whether balance bowed the spine.
        status: () int32 ``Status`` of the gradient refinement.
    """

    marker_pose: Pose
    marker_errors: Array
    outline_px: Array
    swivels: Array
    elbow_deviations: Array
    iterations: Array
    planted: Array
    placed: Array
    balanced: Array
    status: Array


def refine(
    model: Model,
    settings: Settings,
    bow_factors: Array,
    solved: Solved,
    targets: Array,
    fields: EdgeFields | None,
    belief: ElbowBelief,
    elapsed: Array,
) -> tuple[ElbowBelief, Pose, StepReport]:
    """The markers' pose and the edges to the refined pose and the new belief.

    Args:
        model: of the person, the markers and the cameras.
        settings: of the tracker.
        bow_factors: (S,) of the balance heuristic, by the S hinges of the spine.
        solved: what the markers tell.
        targets: (M, 3) markers, world, metres; NaN where missing.
        fields: distances to edges; None without cameras.
        belief: about the elbows, after the last step.
        elapsed: seconds since the last step.
    """
    belief = belief._replace(age=belief.age + elapsed)
    goals = goals_of(model, settings.ik, solved.ik.feet, targets)
    arms = _arms(model, solved.ik.pose)
    pose, elbows, status = solved.ik.pose, arms.elbow, _no_status()
    # All three are static: settled when this is traced.
    edges = None if settings.refine == "none" or model.cameras is None else fields
    if edges is not None and settings.search:
        pose = _last_unless_lost(model, settings, goals, belief, pose)
        belief, elbows = search_elbows(model, settings, arms, edges, belief)
    pose, centre, free, balanced = _balanced(model, settings, solved.ik.pose, pose, bow_factors)
    if edges is not None and settings.search:
        pose = follow_elbows(model, settings, goals, pose, free, elbows)
    elif settings.balance == "before":
        met = lambda: reach(model, settings.ik, {"goals": goals}, pose, free)[0]  # noqa: E731
        pose = jax.lax.cond(balanced, met, lambda: pose)
    if edges is not None:
        aims = Aims(goals, elbows, centre, free)
        pose, status = _fit(model, settings, edges, pose, aims, arms.grip)
        belief = updated_belief(belief, arms, _arms(model, pose), edges, pose)
    if settings.balance == "after":
        pose, _, balanced = bow_on_feet(model.skeleton, settings.ik, pose, bow_factors)
    refined = _arms(model, pose)
    outline_px = jnp.full(2, jnp.nan, targets.dtype)
    if edges is not None and model.cameras is not None:
        outline_px = settings.edges.outline_px(model.cameras, edges, refined)
    mask = are_present(targets)
    errors = goal_distances(model.skeleton, goals, pose)[: len(mask)]
    report = StepReport(
        solved.ik.pose, jnp.where(mask, errors, jnp.nan), outline_px, swivels(arms, refined),
        without_image(settings.elbow_search, belief)[1], solved.ik.iterations, solved.ik.planted,
        solved.placed, balanced, status,
    )  # fmt: skip
    return belief, pose, report


def _arms(model: Model, pose: Pose) -> Arms:
    return arms_of(model.skeleton, forward(model.skeleton, pose), model.grips)


def _no_status() -> Array:
    return jnp.asarray(int(Status.CONVERGED), jnp.int32)


def _last_unless_lost(
    model: Model, settings: Settings, goals: Goals, belief: ElbowBelief, pose: Pose
) -> Pose:
    """The last refined pose, so that the trunk that video has found stays found."""
    markers = len(model.markers.bone_indices)
    errors = goal_distances(model.skeleton, goals, belief.pose)[:markers]
    lost = jnp.max(errors) > settings.ik.lost
    return jax.tree.map(lambda new, old: jnp.where(lost, new, old), pose, belief.pose)


def search_elbows(
    model: Model, settings: Settings, arms: Arms, fields: EdgeFields, belief: ElbowBelief
) -> tuple[ElbowBelief, Array]:
    """The belief after the video and the (2, 3) elbows to follow.

    A new image is searched; without one the last belief is carried on.
    """
    assert model.cameras is not None
    cameras = model.cameras

    def by_image() -> tuple[ElbowBelief, Array]:
        new = search(settings, cameras, fields, arms, belief)
        return new, new.turn

    def without() -> tuple[ElbowBelief, Array]:
        return belief, without_image(settings.elbow_search, belief)[0]

    belief, turn = jax.lax.cond(jnp.any(jnp.asarray(fields.available)), by_image, without)
    return belief, believed_elbows(arms, turn)


def _balanced(
    model: Model, settings: Settings, alone: Pose, pose: Pose, bow_factors: Array
) -> tuple[Pose, Pose, Array, Array]:
    """Where the spine bows: the pose to go on from, the priors' centre, who may move, whether.

    From the markers' pose: one bow on another would pile up.
    """
    if settings.balance != "before":
        return pose, alone, jnp.ones(model.skeleton.costs.shape, bool), jnp.zeros((), bool)
    bowed, free, bows = bow_on_feet(model.skeleton, settings.ik, alone, bow_factors)
    pose, centre = (
        jax.tree.map(lambda new, old: jnp.where(bows, new, old), bowed, before)
        for before in (pose, alone)
    )
    return pose, centre, free, bows


def follow_elbows(
    model: Model, settings: Settings, goals: Goals, pose: Pose, free: Array, elbows: Array
) -> Pose:
    """The body with its elbows where the search has them, as far as the markers hold."""
    return reach(model, settings.ik, {"goals": goals, "elbows": elbows}, pose, free)[0]


def _fit(
    model: Model,
    settings: Settings,
    fields: EdgeFields,
    pose: Pose,
    aims: Aims,
    grip_targets: Array,
) -> tuple[Pose, Array]:
    """The pose whose outlines lie on edges, and how the descent ended."""
    if settings.refine == "search":
        return pose, _no_status()
    if settings.refine == "gradient":
        refined = refine_body(model, settings, fields, pose, aims)
        return refined.pose, refined.status
    return refine_arms(model, settings, fields, pose, grip_targets, aims.elbows), _no_status()


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
    costs = _arm_costs(model, settings, by_arm, grip_targets, elbows)

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
) -> Pose:
    """A pose that ``refine_arms`` found, with the derivatives of the minimum beside it.

    The pose is as it was given; the arguments are those of ``refine_arms``.
    """
    costs = _arm_costs(model, settings, fields.by_arm(), grip_targets, elbows)
    hung, dofs = hang(model.skeleton, pose, model.grips), arm_dofs(model.skeleton.tree)

    def slope(moves: Array) -> Array:
        def cost(moves: Array) -> Array:
            arms, angles = swing(hung, moves)
            return sum((jnp.sum(each(arms, angles)) for each in costs), start=jnp.zeros(()))

        return jax.grad(cost)(moves)

    step = jax.vmap(curved_step)(*_by_arm(slope, jnp.zeros_like(hung.angles)))
    has_image = jnp.any(jnp.asarray(fields.available), 0)[:, None]
    step = jnp.where(has_image, step - jax.lax.stop_gradient(step), 0.0)
    return pose._replace(angles=pose.angles.at[dofs].set(swing(hung, step)[1]))


def _by_arm(slope: Callable[[Array], Array], still: Array) -> tuple[Array, Array]:
    """Each arm's slope (2, 4) and its Hessian (2, 4, 4): arms do not depend on one another."""
    H = jax.jacfwd(slope)(still)
    return slope(still), jnp.stack([H[arm, :, arm] for arm in range(len(still))])


def _arm_costs(
    model: Model, settings: Settings, fields: EdgeFields, grip_targets: Array, elbows: Array
) -> tuple[ArmCost, ...]:
    """The terms of equation (14), and the searched elbow; fields with the arms' axis first."""
    own, limits = settings.simplex, model.skeleton.limits[arm_dofs(model.skeleton.tree)]
    of_arm = partial(settings.edges.arm_cost, model.cameras)

    def on_edges(arms: Arms, _: Array) -> Array:
        return jax.vmap(of_arm)(fields, flesh(arms))

    def held(arms: Arms, _: Array) -> Array:
        away = off_targets(arms.grip, grip_targets)
        return own.hold * jnp.sqrt(jnp.sum(away**2, -1) + 1e-12)

    def within_limits(_: Arms, angles: Array) -> Array:
        return own.limit * jnp.sum(beyond_limits(limits, angles), -1)

    def near_searched(arms: Arms, _: Array) -> Array:
        return jnp.sum((arms.elbow - elbows) ** 2, -1) / own.elbow**2 / 2

    costs = (on_edges, held, within_limits)
    return (*costs, near_searched) if settings.search else costs


def updated_belief(
    belief: ElbowBelief, arms: Arms, refined: Arms, fields: EdgeFields, pose: Pose
) -> ElbowBelief:
    """The belief with the turns from the markers' forearms to those refined by a new image."""
    has_image = jnp.any(jnp.asarray(fields.available))
    turn = jnp.where(has_image, turn_between(arms, refined), belief.turn)
    return belief._replace(turn=turn, pose=pose)
