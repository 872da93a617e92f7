"""Inverse kinematics: markers to pose (section 4, algorithm 1).

INPUTS: a Skeleton, marker targets (world, metres) with a mask, the last pose and stance.
OUTPUTS: the pose that meets the markers, the stance, and how the solve ended.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Frames, Sites, forward, jacobian, site_positions
from jaxmocap.body.mass import augmented_bodies
from jaxmocap.body.pose import Pose, retract
from jaxmocap.body.skeleton import ROOT_DOF, Skeleton
from jaxmocap.geometry.rotations import HIGHEST, quaternion_to_matrix
from jaxmocap.hybrid.feet import SIDES, Effectors, Stance, replant
from jaxmocap.hybrid.settings import IKSettings
from jaxmocap.solvers.sdls import (
    clamp_lengths,
    clamp_max_abs,
    damped_step,
    project_secondary,
    sdls_step,
)

# A degree of freedom this near to its limit (weighted radians) is at it.
AT_LIMIT = 1e-3


class Goals(NamedTuple):
    """Where M points on bones are to go.

    Attributes:
        sites: the points.
        targets: (M, 3) world, metres.
        weights: (M,) of each in the least-squares sense; 0 where there is no target.
    """

    sites: Sites
    targets: Array
    weights: Array


class IKResult(NamedTuple):
    """How a solve ended.

    Attributes:
        pose: that meets the targets.
        stance: of the feet.
        distances: (M + F,) metres from effector to goal; 0 where there is none.
        iterations: () made.
        planted: () whether the feet were planted anew in this frame.
    """

    pose: Pose
    stance: Stance
    distances: Array
    iterations: Array
    planted: Array


class _Linear(NamedTuple):
    """M goals about a pose.

    Attributes:
        frames: at the pose.
        J: (3M, 6 + D) weighted Jacobian of their points.
        error: (3M,) clamped and weighted, metres.
        missed: () by how much the farthest is missed, metres.
    """

    frames: Frames
    J: Array
    error: Array
    missed: Array


def secondary_task(skeleton: Skeleton, frames: Frames, pose: Pose, settings: IKSettings) -> Array:
    """The step (6 + D,), unweighted, towards the relaxed pose: equation (9), and to the upright.

    m_i h_i is normalised by its sum, so that the gain is below 1 in any units. The root has no
    relaxed angle; its lean from the vertical is turned back.
    """
    bodies = augmented_bodies(skeleton, frames)
    effort = bodies.masses * bodies.arms
    share = effort / jnp.sum(effort)
    relaxing = -2 * settings.relaxation * share * (pose.angles - skeleton.relaxed)
    up = quaternion_to_matrix(pose.quaternion)[:, 2]
    lean = jnp.cross(up, jnp.array([0.0, 0.0, 1.0], up.dtype))
    return jnp.concatenate([jnp.zeros(3, up.dtype), settings.uprightness * lean, relaxing])


def ik_step(
    skeleton: Skeleton,
    goals: Goals,
    settings: IKSettings,
    pose: Pose,
    free: Array,
    wishes: Goals | None = None,
    ardour: Array | float = 1.0,
) -> tuple[Pose, Array, Array]:
    """One iteration of algorithm 1.

    Returns the new pose, the largest weighted angle that it moved by, and by how much the old one
    missed its farthest goal, metres.

    Args:
        skeleton: D degrees of freedom.
        goals: what is to be reached.
        settings: traced.
        pose: to start from.
        free: (6 + D,) degrees of freedom that may move.
        wishes: goals of a second rank: approached as far as the first hold.
        ardour: factor on all that is not of the first rank.
    """
    here = _linearised(skeleton, forward(skeleton, pose), goals)
    return *_stepped(skeleton, here, settings, pose, free, wishes, ardour), here.missed


def _stepped(
    skeleton: Skeleton,
    here: _Linear,
    settings: IKSettings,
    pose: Pose,
    free: Array,
    wishes: Goals | None,
    ardour: Array | float,
) -> tuple[Pose, Array]:
    """The pose after a step from where it was linearised, and the largest weighted angle of it."""
    frames, J, error, _ = here
    wanted = ardour * skeleton.costs * secondary_task(skeleton, frames, pose, settings)
    low, high = _room(skeleton, pose)

    def step(free: Array) -> Array:
        # Equation (1) in the weighted coordinates psi = mu * theta.
        solved = sdls_step(jnp.where(free, J, 0.0), error, settings.largest_step)
        secondary = project_secondary(solved.row_space, jnp.where(free, wanted, 0.0))
        if wishes is not None:
            wished = _linearised(skeleton, frames, wishes)
            A = project_secondary(solved.row_space, jnp.where(free, wished.J, 0.0))
            rest = ardour * wished.error - jnp.matmul(A, secondary, precision=HIGHEST)
            secondary = secondary + damped_step(A, rest, settings.wish_damping)
        return solved.primary + clamp_max_abs(secondary, settings.largest_step)

    # A degree of freedom at its limit that would go on leaves the problem, and the rest solve it.
    def blocked(psi: Array, free: Array) -> Array:
        onwards = ((psi < low) & (low > -AT_LIMIT)) | ((psi > high) & (high < AT_LIMIT))
        return onwards & free

    def unsolved(carry: tuple[Array, Array, Array]) -> Array:
        count, _, leaving = carry
        return (count == 0) | ((count < 2) & jnp.any(leaving))

    def solve(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        count, _, leaving = carry
        psi = step(free & ~leaving)
        return count + 1, psi, leaving | blocked(psi, free)

    start = (jnp.zeros((), jnp.int32), jnp.zeros_like(low), jnp.zeros(low.shape, bool))
    _, psi, _ = jax.lax.while_loop(unsolved, solve, start)
    psi = jnp.where(free, jnp.clip(psi, low, high), 0.0)
    return retract(pose, psi / skeleton.costs), jnp.max(jnp.abs(psi))


def _linearised(skeleton: Skeleton, frames: Frames, goals: Goals) -> _Linear:
    """The goals' points about a pose."""
    points = site_positions(skeleton, frames, goals.sites)
    weights = goals.weights[:, None]
    away = jnp.where(weights > 0, goals.targets - points, 0.0)
    error = weights * clamp_lengths(away, 0.1 * _arm_length(skeleton))
    J = jacobian(skeleton, frames, goals.sites.bones, points) / skeleton.costs
    J = (weights[..., None] * J).reshape(-1, J.shape[-1])
    return _Linear(frames, J, error.ravel(), jnp.sqrt(jnp.max(jnp.sum(away**2, -1))))


def reach(
    skeleton: Skeleton,
    goals: Goals,
    settings: IKSettings,
    pose: Pose,
    free: Array | None = None,
    wishes: Goals | None = None,
) -> tuple[Pose, Array]:
    """Algorithm 1: iterate from ``pose`` until the effectors are at their goals, or rest.

    Args:
        skeleton: D degrees of freedom.
        goals: what is to be reached.
        settings: traced.
        pose: to start from.
        free: (6 + D,) degrees of freedom that may move; all without it.
        wishes: goals of a second rank; the last iterations leave them alone, so that the first
            hold in the end.

    Returns:
        The pose and the number of iterations.
    """
    moving = jnp.ones(skeleton.costs.shape, bool) if free is None else free
    least = settings.settle if wishes is None else settings.following

    def unfinished(carry: tuple[Array, Pose, Array, Array]) -> Array:
        count, _, moved, met = carry
        moves = (moved > settings.rest) & (count < settings.iterations)
        return (count < least) | (moves & ~met)

    def iterate(carry: tuple[Array, Pose, Array, Array]) -> tuple[Array, Pose, Array, Array]:
        # Whether a step has met the goals is seen where the next one would begin.
        count, pose, moved, _ = carry
        here = _linearised(skeleton, forward(skeleton, pose), goals)
        met = (count >= least) & (here.missed <= settings.tolerance)
        ardour = 1.0 if wishes is None else jnp.where(count < settings.following, 1.0, 0.0)

        def step() -> tuple[Pose, Array]:
            return _stepped(skeleton, here, settings, pose, moving, wishes, ardour)

        pose, moved = jax.lax.cond(met, lambda: (pose, moved), step)
        return count + jnp.where(met, 0, 1), pose, moved, met

    far = jnp.asarray(jnp.inf, pose.angles.dtype)
    start = (jnp.zeros((), jnp.int32), pose, far, jnp.zeros((), bool))
    count, pose, _, _ = jax.lax.while_loop(unfinished, iterate, start)
    return pose, count


def goal_distances(skeleton: Skeleton, goals: Goals, pose: Pose) -> Array:
    """Distances (M,) of a pose from its goals, metres; 0 for those of no weight."""
    away = goals.targets - site_positions(skeleton, forward(skeleton, pose), goals.sites)
    wanted = goals.weights > 0
    away = jnp.where(wanted[:, None], away, 1.0)
    return jnp.where(wanted, jnp.sqrt(jnp.sum(away**2, -1)), 0.0)


def _room(skeleton: Skeleton, pose: Pose) -> tuple[Array, Array]:
    """How far each degree of freedom (6 + D,) may still turn down and up, weighted."""
    free = jnp.full(ROOT_DOF, jnp.inf, pose.angles.dtype)
    low = jnp.minimum(skeleton.limits[:, 0] - pose.angles, 0.0)
    high = jnp.maximum(skeleton.limits[:, 1] - pose.angles, 0.0)
    weights = skeleton.costs
    return jnp.concatenate([-free, low]) * weights, jnp.concatenate([free, high]) * weights


def _arm_length(skeleton: Skeleton) -> Array:
    return jnp.sum(skeleton.lengths[skeleton.tree.bones_in("arm", side="l")])


def goals_of(
    skeleton: Skeleton,
    held: Effectors,
    settings: IKSettings,
    stance: Stance,
    targets: Array,
    mask: Array,
) -> Goals:
    """Markers where they are seen, and the held feet where they stand.

    What is below the pelvis weighs less: where a leg is too short to reach, the feet give way
    before the head and the hands do.
    """
    low = np.isin(held.sites.bones, skeleton.tree.bones_in("hip", "leg"))
    weights = jnp.where(low, settings.leg_weight, 1.0)
    feet = np.array([SIDES.index(side) for side in held.held], np.int32)
    seen = jnp.concatenate([mask, jnp.ones(len(feet), bool)])
    targets = jnp.where(mask[:, None], targets, 0.0)
    return Goals(
        held.sites,
        jnp.concatenate([targets, stance.ankles[feet]]),
        jnp.where(seen, weights, 0.0),
    )


def solve_ik(
    skeleton: Skeleton,
    held: Effectors,
    settings: IKSettings,
    pose: Pose,
    stance: Stance,
    targets: Array,
    mask: Array,
) -> IKResult:
    """Markers to pose, from the last pose and stance.

    Args:
        skeleton: D degrees of freedom.
        held: M markers and F held feet.
        settings: traced.
        pose: to start from.
        stance: of the feet in the last frame.
        targets: (M, 3) marker positions, world, metres; anything where missing.
        mask: (M,) which markers are seen.
    """
    stance, planted = replant(skeleton, held, settings, pose, stance, targets, mask)
    goals = goals_of(skeleton, held, settings, stance, targets, mask)
    pose, count = reach(skeleton, goals, settings, pose)
    misses = goal_distances(skeleton, goals, pose)
    missed = jnp.max(misses[len(mask) :], initial=0.0) > settings.leg_overstretch
    return IKResult(pose, stance._replace(overstretched=missed), misses, count, planted)
