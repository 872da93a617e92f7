"""Inverse kinematics as the first paper has it: section 4, algorithm 1.

End effectors are the residuals of terms: by default markers, and feet that carry none. Secondary
terms are approached as far as the first hold.

INPUTS: a Model, goals, a pose. OUTPUTS: the pose that meets the goals.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.body.kinematics import Frames, forward
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, retract, room
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.evidence.expansion import linearise_term
from jaxmocap.evidence.posture import effort_shares
from jaxmocap.evidence.terms import Measurements, Term
from jaxmocap.geometry.rotations import HIGHEST, cross, quaternion_to_matrix
from jaxmocap.hybrid.settings import IKSettings
from jaxmocap.solvers.limits import step_within
from jaxmocap.solvers.sdls import (
    clamp_lengths,
    clamp_max_abs,
    damped_step,
    project_secondary,
    sdls_step,
)

# A degree of freedom this near to its limit (weighted radians) is at it.
AT_LIMIT = 1e-3
# Most solves of a step that limits cut short.
ROUNDS = 2


class _Effectors(NamedTuple):
    """K end effectors about a pose: the residuals of some terms, in three-vectors."""

    J: Array  # (3K, 6 + D) their derivatives by the weighted degrees of freedom
    error: Array  # (3K,) what the residuals lack, clamped (4.1)
    missed: Array  # () the largest residual, metres; infinite where one is not a length


def secondary_task(skeleton: Skeleton, frames: Frames, pose: Pose, settings: IKSettings) -> Array:
    """The step (6 + D,), unweighted, towards the relaxed pose: equation (9), and to the upright.

    m_i h_i is normalised by its sum, so that the gain is below 1 in any units. The root has no
    relaxed angle; its lean from the vertical is turned back.
    """
    share = effort_shares(skeleton, frames, settings.augmented_body)
    relaxing = -2 * settings.relaxation * share * (pose.angles - skeleton.relaxed)
    up = quaternion_to_matrix(pose.quaternion)[:, 2]
    lean = cross(up, jnp.array([0.0, 0.0, 1.0], up.dtype))
    return jnp.concatenate([jnp.zeros(3, up.dtype), settings.uprightness * lean, relaxing])


def ik_step(
    model: Model,
    settings: IKSettings,
    measured: Measurements,
    pose: Pose,
    free: Array,
    gain: Array | float = 1.0,
) -> tuple[Pose, Array, Array]:
    """One iteration of algorithm 1.

    Returns the new pose, the largest weighted angle that it moved by, and by how much the old one
    missed its farthest goal, metres.

    Args:
        model: its skeleton has D degrees of freedom.
        settings: traced; its terms are what is reached for.
        measured: ``goals``, and ``elbows`` where there are secondary goals.
        pose: to start from.
        free: (6 + D,) degrees of freedom that may move.
        gain: factor on the secondary task and the secondary goals.
    """
    first = _effectors(model, settings.terms, measured, pose)
    return *_take_step(model, settings, measured, pose, free, first, gain), first.missed


def _take_step(
    model: Model,
    settings: IKSettings,
    measured: Measurements,
    pose: Pose,
    free: Array,
    first: _Effectors,
    gain: Array | float,
) -> tuple[Pose, Array]:
    """The pose after a step from where it was linearised, and the largest weighted angle of it."""
    skeleton = model.skeleton
    relaxing = secondary_task(skeleton, forward(skeleton, pose), pose, settings)
    wanted, (low, high) = gain * skeleton.costs * relaxing, _room(skeleton, pose)
    second = _effectors(model, settings.secondary_terms, measured, pose)

    def step(free: Array) -> Array:
        # Equation (1) in the weighted coordinates psi = mu * theta.
        solved = sdls_step(jnp.where(free, first.J, 0.0), first.error, settings.largest_step)
        beside = project_secondary(solved.row_space, jnp.where(free, wanted, 0.0))
        if second.error.size:
            A = project_secondary(solved.row_space, jnp.where(free, second.J, 0.0))
            rest = gain * second.error - jnp.matmul(A, beside, precision=HIGHEST)
            beside = beside + damped_step(A, rest, 1.0)
        return solved.primary + clamp_max_abs(beside, settings.largest_step)

    psi = step_within(step, low, high, free, AT_LIMIT, ROUNDS)
    psi = jnp.where(free, jnp.clip(psi, low, high), 0.0)
    return retract(pose, psi / skeleton.costs), jnp.max(jnp.abs(psi))


def _effectors(
    model: Model, terms: Sequence[Term], measured: Measurements, pose: Pose
) -> _Effectors:
    """The residuals of terms about a pose; lengths are clamped to a tenth of an arm (4.1)."""
    rows, errors, missed = [], [], [jnp.zeros((), pose.angles.dtype)]
    arm_length = jnp.sum(model.skeleton.lengths[model.skeleton.tree.bones_in("arm", side="l")])
    for term in terms:
        r, J = linearise_term(term, model, pose, measured)
        r, J = _three_vectors(r), _three_vectors(J, derivatives=True)
        if not r.size:
            continue
        if term.metres_per_deviation is None:
            missed.append(jnp.asarray(jnp.inf, r.dtype))
        else:
            missed.append(term.metres_per_deviation * jnp.sqrt(jnp.max(jnp.sum(r**2, -1))))
            r = clamp_lengths(r, 0.1 * arm_length / term.metres_per_deviation)
        rows.append(J.reshape(-1, J.shape[-1]) / model.skeleton.costs)
        errors.append(-r.ravel())
    if not errors:
        nothing = jnp.zeros(0, pose.angles.dtype)
        return _Effectors(jnp.zeros((0, model.skeleton.costs.size)), nothing, missed[0])
    largest = jnp.max(jnp.stack(missed))
    return _Effectors(jnp.concatenate(rows), jnp.concatenate(errors), largest)


def _three_vectors(values: Array, derivatives: bool = False) -> Array:
    """Residuals (..., 3), or any (...), as (K, 3); derivatives with their last axis kept."""
    inner = values.shape[:-1] if derivatives else values.shape
    last = values.shape[-1:] if derivatives else ()
    if inner and inner[-1] == 3:
        return values.reshape(-1, 3, *last)
    alone = values.reshape(-1, 1, *last)
    return jnp.pad(alone, [(0, 0), (0, 2), *([(0, 0)] if derivatives else [])])


def reach(
    model: Model,
    settings: IKSettings,
    measured: Measurements,
    pose: Pose,
    free: Array | None = None,
) -> tuple[Pose, Array]:
    """Algorithm 1: iterate from ``pose`` until the effectors are at their goals, or rest.

    Args:
        model: its skeleton has D degrees of freedom.
        settings: traced; its terms are what is reached for.
        measured: ``goals``. With ``elbows`` there are secondary goals, which are approached as far
            as the first hold; the last iterations leave them alone, so that the first hold in the
            end.
        pose: to start from.
        free: (6 + D,) degrees of freedom that may move; all without it.

    Returns:
        The pose and the number of iterations.
    """
    moving = jnp.ones(model.skeleton.costs.shape, bool) if free is None else free
    follows = measured.elbows is not None
    least = settings.following if follows else settings.settle

    def unfinished(carry: tuple[Array, Pose, Array, Array]) -> Array:
        count, _, moved, met = carry
        moves = (moved > settings.rest) & (count < settings.iterations)
        return (count < least) | (moves & ~met)

    def iterate(carry: tuple[Array, Pose, Array, Array]) -> tuple[Array, Pose, Array, Array]:
        # Whether a step has met the goals shows where the next one would begin.
        count, pose, moved, _ = carry
        first = _effectors(model, settings.terms, measured, pose)
        met = (count >= least) & (first.missed <= settings.tolerance)
        gain = jnp.where(count < settings.following, 1.0, 0.0) if follows else 1.0

        def step() -> tuple[Pose, Array]:
            return _take_step(model, settings, measured, pose, moving, first, gain)

        pose, moved = jax.lax.cond(met, lambda: (pose, moved), step)
        return count + jnp.where(met, 0, 1), pose, moved, met

    far = jnp.asarray(jnp.inf, pose.angles.dtype)
    start = (jnp.zeros((), jnp.int32), pose, far, jnp.zeros((), bool))
    count, pose, _, _ = jax.lax.while_loop(unfinished, iterate, start)
    return pose, count


def _room(skeleton: Skeleton, pose: Pose) -> tuple[Array, Array]:
    """How far each degree of freedom (6 + D,) may still turn down and up, weighted."""
    low, high = room(skeleton.limits, pose.angles)
    return low * skeleton.costs, high * skeleton.costs
