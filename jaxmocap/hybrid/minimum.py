"""The pose at the minimum of its terms, within the joints' limits, with its derivatives.

INPUTS: a Model, terms, what was measured, a pose to start from. OUTPUTS: a pose.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, retract, room
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.evidence.expansion import expand_terms, residuals_and_pull
from jaxmocap.evidence.terms import Measurements, Term, residuals
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.solvers.descent import (
    FIRST_DAMPING,
    NEAR_DAMPING,
    Descent,
    Local,
    Problem,
    descend,
    rests,
    tree_where,
)
from jaxmocap.solvers.optimum import following, least_squares_step
from jaxmocap.solvers.status import Status

# Steps of the descent, at most.
STEPS = 100
# Points at which Newton's step is taken before a derivative, by a factorisation that single
# precision holds.
POLISHING = 5
# Times that one of them is made at most, as limits are met.
ROUNDS = 3


class Another(NamedTuple):
    """Where to descend from as well."""

    start: Pose  # another pose
    # () cost of the first descent's end above which it is tried; the better end is taken.
    above: Array


def pose_at_minimum(
    model: Model,
    terms: Sequence[Term],
    measured: Measurements,
    start: Pose,
    other: Another | None = None,
    free: Array | None = None,
    is_near: Array | bool = False,
    bends: bool = True,
) -> tuple[Pose, Array]:
    """The pose near ``start`` that costs least, and a ``Status``.

    It is differentiable by all but the starts.

    Joints rest at their limits where terms push them outwards; then they follow the limits.

    Args:
        model: of the person, the markers and the cameras.
        terms: together they must determine every degree of freedom, a prior among them.
        measured: of this moment.
        start: to descend from.
        other: another start.
        free: (6 + D,) degrees of freedom that may move; all without it.
        is_near: whether the minimum lies about the start.
        bends: whether the descent looks at second derivatives, which take long to compile for terms
            without formulas.
    """
    evidence = _Evidence(model, tuple(terms), measured, free)
    held = jax.lax.stop_gradient((evidence, start, other))
    problem = _PROBLEM if bends else _LINEAR
    pose, status = jax.lax.stop_gradient(_lowest(problem, *held, is_near))
    return following(_move_minimum, evidence, pose), status


class _Evidence(NamedTuple):
    """What the pose depends on; ``free`` is None where all may move."""

    model: Model
    terms: tuple[Term, ...]
    measured: Measurements
    free: Array | None


@partial(jax.jit, inline=True)
def _residuals(evidence: _Evidence, pose: Pose) -> Array:
    model, terms, measured, _ = evidence
    return residuals(terms, model, pose, measured)


@partial(jax.jit, inline=True)
def _local(evidence: _Evidence, pose: Pose) -> Local:
    model, terms, measured, _ = evidence
    return Local(*expand_terms(terms, model, pose, measured))


def _room(evidence: _Evidence, pose: Pose) -> tuple[Array, Array]:
    """How far (6 + D,) each degree of freedom may go down and up."""
    low, high = room(evidence.model.skeleton.limits, pose.angles)
    free = True if evidence.free is None else evidence.free
    return jnp.where(free, low, 0.0), jnp.where(free, high, 0.0)


@partial(jax.jit, inline=True)
def _straight(evidence: _Evidence, pose: Pose) -> Local:
    model, terms, measured, _ = evidence
    return Local(*expand_terms(terms, model, pose, measured, bends=False))


_PROBLEM = Problem(_residuals, _local, retract, _room)
_LINEAR = _PROBLEM._replace(about=_straight)


def _lowest(
    problem: Problem,
    evidence: _Evidence,
    start: Pose,
    other: Another | None,
    is_near: Array | bool,
) -> tuple[Pose, Array]:
    """The end of the descents, nothing differentiated."""
    low, high = evidence.model.skeleton.limits.T
    damping = jnp.where(is_near, NEAR_DAMPING, FIRST_DAMPING)

    def descended(start: Pose, steps: Array | int) -> Descent:
        within = start._replace(angles=jnp.clip(start.angles, low, high))
        return descend(problem, evidence, within, steps, damping)

    if other is None:
        end = descended(start, STEPS)
        return end.x, _status(end)

    def unsatisfied(carry: tuple[Array, Descent]) -> Array:
        attempts, best = carry
        return (attempts == 0) | ((attempts == 1) & ~(best.cost <= other.above))

    def attempt(carry: tuple[Array, Descent]) -> tuple[Array, Descent]:
        # Both through here, so that the descent compiles once; in a batch who is satisfied rests.
        attempts, best = carry
        end = descended(
            tree_where(attempts == 0, start, other.start), jnp.where(unsatisfied(carry), STEPS, 0)
        )
        return attempts + 1, tree_where(end.cost < best.cost, end, best)

    none = Descent(start, jnp.asarray(jnp.inf, start.angles.dtype), jnp.zeros((), bool))
    _, best = jax.lax.while_loop(unsatisfied, attempt, (jnp.zeros((), jnp.int32), none))
    return best.x, _status(best)


def _status(end: Descent) -> Array:
    found = jnp.where(end.rests, int(Status.CONVERGED), int(Status.OUT_OF_STEPS))
    return found.astype(jnp.int32)


class _About(NamedTuple):
    """Residuals about a pose, and which degrees of freedom (6 + D,) do not rest at a limit."""

    local: Local
    moves: Array

    def step(self, change: Array, pull: Array) -> Array:
        """The minimum's step (6 + D,) as the residuals and their pull change."""
        _, J, S = self.local
        return least_squares_step(J, S, self.moves, change, pull)

    def step_within(self, low: Array, high: Array) -> Array:
        """The step to the minimum; what would cross a limit ends there, the others follow."""
        r, J, S = self.local

        def unsettled(so_far: tuple) -> Array:
            count, *_, met = so_far
            return met & (count < ROUNDS)

        def limited(so_far: tuple) -> tuple:
            count, step, moves, _ = so_far
            fixed = jnp.where(moves, 0.0, step)
            change = r + jnp.matmul(J, fixed, precision=HIGHEST)
            pull = jnp.matmul(S, fixed, precision=HIGHEST)
            wanted = least_squares_step(J, S, moves, change, pull)
            step = jnp.clip(jnp.where(moves, wanted, step), low, high)
            within = moves & (wanted >= low) & (wanted <= high)
            return count + 1, step, within, jnp.any(moves & ~within)

        first = jnp.zeros((), jnp.int32), jnp.zeros_like(low), self.moves, jnp.ones((), bool)
        return jax.lax.while_loop(unsettled, limited, first)[1]


def _move_minimum(evidence: _Evidence, pose: Pose) -> Pose:
    """Where a pose at its minimum goes as the evidence changes."""
    there, about = jax.lax.stop_gradient(_polish_minimum(jax.lax.stop_gradient(evidence), pose))
    here = _at_limits(evidence, there, about.moves)
    model, terms, measured, _ = evidence
    changes = residuals_and_pull(terms, model, here, measured, about.local.residuals)
    step = about.step(*(part - jax.lax.stop_gradient(part) for part in changes))
    return retract(_at_limits(evidence, pose, about.moves), step)


def _polish_minimum(evidence: _Evidence, pose: Pose) -> tuple[Pose, _About]:
    """The minimum, as exactly as the precision allows, and the residuals there."""

    def polish(carry: tuple, _: None) -> tuple[tuple, None]:
        (pose, about), tried = carry
        there = _about(evidence, tried)
        # Where costs differ by rounding alone, the step still says where the minimum is.
        ends = there.local.cost <= about.local.cost + 1e-3 * (1e-3 + about.local.cost)
        pose, about = best = tree_where(ends, (tried, there), (pose, about))
        return (best, retract(pose, about.step_within(*_room(evidence, pose)))), None

    like = jax.eval_shape(partial(_about, evidence), pose)
    unknown = jax.tree.map(lambda part: jnp.full(part.shape, jnp.inf).astype(part.dtype), like)
    return jax.lax.scan(polish, ((pose, unknown), pose), None, POLISHING)[0][0]


def _about(evidence: _Evidence, pose: Pose) -> _About:
    local = _local(evidence, pose)
    return _About(local, ~rests(local.slope, *_room(evidence, pose)))


def _at_limits(evidence: _Evidence, pose: Pose, moves: Array) -> Pose:
    """The pose, whose joints that rest at a limit follow it."""
    low, high = evidence.model.skeleton.limits.T
    angles = pose.angles
    limit = jnp.where(angles - low <= high - angles, low, high)
    held = moves if evidence.free is None else moves | ~evidence.free
    return pose._replace(angles=jnp.where(held[ROOT_DOF:], angles, limit))
