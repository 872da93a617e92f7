"""Refinement of the markers' pose by the video (section 5).

    search    where each elbow is, by edges, with memory (ours)
    balance   the spine bows in a squat (5.3)
    follow    the body follows the elbows by inverse kinematics, the markers held, so that a
              shoulder that three markers placed wrongly moves as well
    fit       a downhill simplex over each arm's four degrees of freedom brings the outlines to
              the edges (5.2: the arms are problems of their own, solved side by side), or least
              squares over the whole body (``gradient``)
    report    what came of it

The first paper's own order is ``paper.frame``.

INPUTS: a Model, what ``solve`` found, distance fields of edges, the belief about the elbows.
OUTPUTS: the refined pose, the belief, a report.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.body.arms import Arms, arms_of, swivels, turn_between
from jaxmocap.body.kinematics import forward
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose
from jaxmocap.evidence.edges import EdgeFields
from jaxmocap.evidence.markers import Goals, are_present
from jaxmocap.evidence.terms import Measurements
from jaxmocap.hybrid.balance import bow_on_feet
from jaxmocap.hybrid.elbow_search import ElbowBelief, expected_elbows, search, without_image
from jaxmocap.hybrid.fit import Aims, no_status, refine_arms, refine_body
from jaxmocap.hybrid.ik import IKResult, goal_distances, goals_of, reach
from jaxmocap.hybrid.settings import Settings
from jaxmocap.images.regions import Region


class Solved(NamedTuple):
    """What markers tell: their pose, the arms' regions."""

    ik: IKResult
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
    planted: Array
    placed: Array
    balanced: Array
    status: Array


def refine_event(
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
    pose, elbows, status = solved.ik.pose, arms.elbow, no_status()
    # Both are static: settled when this is traced.
    edges = None if settings.refine == "none" or model.cameras is None else fields
    if edges is not None:
        pose = _last_unless_lost(model, settings, goals, belief, pose)
        belief, elbows = search_elbows(model, settings, arms, edges, belief)
    pose, centre, free, balanced = _balance_pose(model, settings, solved.ik.pose, pose, bow_factors)
    if edges is not None:
        pose = follow_elbows(model, settings, goals, pose, free, elbows)
        aims = Aims(goals, elbows, centre, free)
        pose, status = fit(model, settings, edges, pose, aims, arms.grip)
        belief = _update_belief(belief, arms, _arms(model, pose), edges, pose)
    elif settings.balance:
        met = lambda: reach(model, settings.ik, Measurements(goals=goals), pose, free)  # noqa: E731
        pose = jax.lax.cond(balanced, met, lambda: pose)
    deviations = without_image(settings.elbow_search, belief)[1]
    report = report_of(model, settings, solved, targets, edges, pose)
    return (
        belief,
        pose,
        report._replace(elbow_deviations=deviations, balanced=balanced, status=status),
    )


def report_of(
    model: Model,
    settings: Settings,
    solved: Solved,
    targets: Array,
    edges: EdgeFields | None,
    pose: Pose,
) -> StepReport:
    """What the refined pose itself shows; the rest as of a step in which nothing happened."""
    frames = forward(model.skeleton, pose)
    refined = arms_of(model.skeleton, frames, model.grips)
    outline_px = jnp.full(2, jnp.nan, targets.dtype)
    if edges is not None and model.cameras is not None:
        outline_px = settings.edges.outline_px(model.cameras, edges, refined)
    mask, goals = are_present(targets), goals_of(model, settings.ik, solved.ik.feet, targets)
    errors = goal_distances(model.skeleton, goals, frames)[: len(mask)]
    prior = jnp.full(2, settings.elbow_search.elbow_prior)
    turns = swivels(_arms(model, solved.ik.pose), refined)
    return StepReport(
        solved.ik.pose, jnp.where(mask, errors, jnp.nan), outline_px, turns, prior,
        solved.ik.planted, solved.ik.placed, jnp.zeros((), bool), no_status(),
    )  # fmt: skip


def _arms(model: Model, pose: Pose) -> Arms:
    return arms_of(model.skeleton, forward(model.skeleton, pose), model.grips)


def _last_unless_lost(
    model: Model, settings: Settings, goals: Goals, belief: ElbowBelief, pose: Pose
) -> Pose:
    """The last refined pose, so that the trunk that video has found stays found."""
    markers = len(model.markers.bone_indices)
    frames = forward(model.skeleton, belief.pose)
    errors = goal_distances(model.skeleton, goals, frames)[:markers]
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
    return belief, expected_elbows(arms, turn)


def _balance_pose(
    model: Model, settings: Settings, alone: Pose, pose: Pose, bow_factors: Array
) -> tuple[Pose, Pose, Array, Array]:
    """Where the spine bows: the pose to go on from, the priors' centre, who may move, whether.

    From the markers' pose: one bow on another would pile up.
    """
    if not settings.balance:
        return pose, alone, jnp.ones(model.skeleton.costs.shape, bool), jnp.zeros((), bool)
    bowed, free, bows = bow_on_feet(model.skeleton, settings.ik, alone, bow_factors)
    pose, centre = (
        jax.tree.map(lambda new, old: jnp.where(bows, new, old), bowed, before)
        for before in (pose, alone)
    )
    return pose, centre, free, bows


def follow_elbows(
    model: Model, settings: Settings, goals: Goals, pose: Pose, free: Array | None, elbows: Array
) -> Pose:
    """The body with its elbows where the search has them, as far as the markers hold."""
    return reach(model, settings.ik, Measurements(goals=goals, elbows=elbows), pose, free)


def fit(
    model: Model,
    settings: Settings,
    fields: EdgeFields,
    pose: Pose,
    aims: Aims,
    grip_targets: Array,
) -> tuple[Pose, Array]:
    """The pose whose outlines lie on edges, and how the descent ended."""
    if settings.refine == "search":
        return pose, no_status()
    if settings.refine == "gradient":
        edges = settings.edges.weigh(model, fields, pose)
        return refine_body(model, settings, edges, pose, aims)
    return refine_arms(model, settings, fields, pose, grip_targets, aims.elbows), no_status()


def _update_belief(
    belief: ElbowBelief, arms: Arms, refined: Arms, fields: EdgeFields, pose: Pose
) -> ElbowBelief:
    """The belief with the turns from the markers' forearms to those refined by a new image."""
    has_image = jnp.any(jnp.asarray(fields.available))
    turn = jnp.where(has_image, turn_between(arms, refined), belief.turn)
    return belief._replace(turn=turn, pose=pose)
