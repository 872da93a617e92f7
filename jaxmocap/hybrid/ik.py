"""Inverse kinematics: markers to pose (section 4).

The pose is the minimum of what is reached for and of the secondary task, about the last pose; or,
as in the paper, where algorithm 1 ends.

INPUTS: a Model, marker targets (world, metres; NaN where missing), the last pose, where the feet
stood. OUTPUTS: the pose that meets the markers, where the feet stand.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Frames, forward, site_positions
from jaxmocap.body.model import SIDES, Model
from jaxmocap.body.pose import Pose, relaxed_pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.evidence.markers import Goals, are_present
from jaxmocap.evidence.posture import EasyPosture, LastPose, effort_shares
from jaxmocap.evidence.shapes import in_precision
from jaxmocap.evidence.terms import Measurements
from jaxmocap.hybrid.feet import FootPlacement, faces_away, place, replant
from jaxmocap.hybrid.minimum import Another, pose_at_minimum
from jaxmocap.hybrid.paper import ik as paper_ik
from jaxmocap.hybrid.settings import IKSettings
from jaxmocap.solvers.descent import tree_where

# Where a pose misses a goal by more, metres, and its minimum costs more, nats, the placed body is
# another start.
FAR_OFF, WELL_MET = 0.1, 0.3


class IKResult(NamedTuple):
    """How a solve ended."""

    pose: Pose  # that meets the targets
    feet: FootPlacement  # where they stand
    distances: Array  # (M + F,) metres from effector to goal; 0 where there is none
    planted: Array  # () whether the feet were planted again in this frame
    placed: Array  # () whether the body was placed again


def solve_ik(
    model: Model, settings: IKSettings, pose: Pose, feet: FootPlacement, targets: Array
) -> IKResult:
    """Markers to pose, from the last pose.

    Where the last pose is lost (``settings.lost``) or ``faces_away``, the body is placed by its
    markers.

    Args:
        model: of the person and the markers.
        settings: traced.
        pose: the last one; NaN where there is none.
        feet: where they stood then.
        targets: (M, 3) markers, world, metres; NaN where missing.
    """
    skeleton = model.skeleton
    is_first = ~jnp.all(jnp.isfinite(pose.position))
    relaxed = relaxed_pose(skeleton)
    pose = tree_where(is_first, relaxed, pose)
    # Both at once, so that kinematics compile once.
    both = jax.tree.map(lambda *parts: jnp.stack(parts), pose, relaxed)
    both = jax.vmap(partial(forward, skeleton))(both)
    last, at_ease = (jax.tree.map(lambda part, i=i: part[i], both) for i in range(2))
    before = goal_distances(skeleton, goals_of(model, settings, feet, targets), last)
    missed = jnp.max(before[: len(targets)], initial=0.0)
    lost, far = (is_first | (missed > limit) for limit in (settings.lost, FAR_OFF))
    if settings.feet == "follow":
        lost |= faces_away(model, pose, targets)
    placed, placed_feet = place(model, settings, targets, at_ease)
    pose, feet = tree_where(lost, (placed, placed_feet), (pose, feet))
    feet, planted = replant(model, settings, pose, feet, targets)
    goals = goals_of(model, settings, feet, targets)
    # A last pose that is far off may lie in a valley of its own.
    other = Another(placed, jnp.where(far & ~lost, WELL_MET, jnp.inf))
    # Placing a body turns it about the vertical only, on which no effort depends.
    frames, measured = tree_where(lost, at_ease, last), Measurements(goals=goals)
    pose = reach(model, settings, measured, pose, remembered=~lost, other=other, frames=frames)
    misses = goal_distances(skeleton, goals, forward(skeleton, pose))
    stretched = jnp.max(misses[len(targets) :], initial=0.0) > settings.leg_overstretch
    return IKResult(pose, feet._replace(overstretched=stretched), misses, planted, lost)


def reach(
    model: Model,
    settings: IKSettings,
    measured: Measurements,
    pose: Pose,
    free: Array | None = None,
    remembered: Array | bool = True,
    other: Another | None = None,
    frames: Frames | None = None,
) -> Pose:
    """The pose that meets its goals, near another one; differentiable where it is a minimum.

    Args:
        model: its skeleton has D degrees of freedom.
        settings: traced; their terms are what is reached for.
        measured: ``goals``, and ``elbows`` where there are secondary goals.
        pose: to start from.
        free: (6 + D,) degrees of freedom that may move; all without it.
        remembered: whether what nothing determines stays near the start.
        other: another start.
        frames: of the bones at ``pose``, or with another heading; found without them.
    """
    if settings.solver == "sdls":
        return paper_ik.reach(model, settings, measured, pose, free)[0]
    skeleton = model.skeleton
    frames = frames or forward(skeleton, pose)
    effort = effort_shares(skeleton, frames, settings.augmented_body)
    ease = EasyPosture(settings.relaxation, settings.uprightness, settings.memory)
    terms = (*settings.terms, settings.knees, in_precision(model, ease))
    if measured.elbows is not None:
        terms = (*terms, *settings.secondary_terms)
    about = measured._replace(last=LastPose(pose, effort, remembered))
    return pose_at_minimum(model, terms, about, pose, other, free, is_near=remembered)[0]


def goal_distances(skeleton: Skeleton, goals: Goals, frames: Frames) -> Array:
    """Distances (M,) of a pose's bones from goals, metres; 0 for those of no weight."""
    away = goals.off(site_positions(skeleton, frames, goals.sites))
    squared = jnp.sum(away**2, -1)
    apart = squared > 0
    return jnp.where(apart, jnp.sqrt(jnp.where(apart, squared, 1.0)), 0.0)


def goals_of(model: Model, settings: IKSettings, feet: FootPlacement, targets: Array) -> Goals:
    """Markers where they are measured, and unmarked feet where they stand.

    What is below the pelvis weighs less: where a leg is too short to reach, the feet give way
    before the head and the hands do.
    """
    effectors = model.effectors
    low = np.isin(effectors.bones, model.skeleton.tree.bones_in("hip", "leg"))
    weights = jnp.where(low, settings.leg_weight, 1.0)
    sides = np.array([SIDES.index(side) for side in model.unmarked_feet], np.int32)
    mask = are_present(targets)
    held = jnp.concatenate([mask, jnp.ones(len(sides), bool)])
    present = jnp.where(mask[:, None], targets, 0.0)
    return Goals(
        effectors, jnp.concatenate([present, feet.ankles[sides]]), jnp.where(held, weights, 0.0)
    )
