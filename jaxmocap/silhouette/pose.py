"""Pose from points on rays (second paper, sections 3.1.3 and 3.2).

INPUTS: a Skeleton, a pose to start from, pairs of body points and rays of any number of cameras.
OUTPUTS: the pose that brings the points to their rays, what was taken for outliers, and how well
each degree of freedom is determined.

The system is linearised, solved and iterated (Gauss-Newton). Unknown are the twist of the whole
body, taken about the pelvis, and the joints' angles. Points far off in space, by the spread of all
of them, lose their weight (Tukey's biweight); a joint at its limit leaves the system, and what is
left is solved again.
"""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from threadpoolctl import ThreadpoolController

from jaxmocap.body.kinematics import forward
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, difference, retract, room
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.evidence.expansion import expand_terms
from jaxmocap.evidence.terms import Measurements, Term
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.silhouette.points import PointRays, linearised_rays
from jaxmocap.silhouette.surfaces.morph import (
    Morph,
    driver_jacobian,
    driver_values,
    followed_jacobian,
    moved_points,
    with_followers,
    without_followers,
)
from jaxmocap.solvers.limits import step_within
from jaxmocap.solvers.robust import robust_shares
from jaxmocap.solvers.status import Status

# A joint this near to its limit is at it, radians.
AT_LIMIT = 1e-4
# Most solves of a step that limits cut short.
ROUNDS = 3


class PoseSettings(NamedTuple):
    """What a user may tune; traced."""

    # Least standard deviation of a point about its ray, metres: rejection never takes a spread
    # smaller than this for the truth. While a pose is far off, let it be large: a limb that moved
    # fast is an outlier to the rest, and would be left behind.
    deviation: Array | float = 0.01
    # Points farther off than this many deviations are outliers (Tukey's constant).
    reach: Array | float = 4.685
    # Deviation of one step, radians and metres, where nothing else determines it.
    damping: Array | float = 1.0
    # No iteration turns or shifts anything farther, radians and metres.
    largest_step: Array | float = 0.3
    rest: Array | float = 1e-5  # a step smaller than this ends the iteration, radians and metres
    iterations: Array | int = 20  # at most


class Prior(NamedTuple):
    """What is expected beforehand of the 6 + D degrees of freedom.

    Deviations (6 + D,) are metres and radians; infinite where nothing is expected.
    """

    pose: Pose
    deviations: Array


class TermEvidence(NamedTuple):
    """What terms of evidence tell beside the rays, such as where markers were measured.

    They are believed however far they are: what is wrong with them is to be found before.
    """

    model: Model  # of the person and the markers
    terms: Sequence[Term]  # in any order
    measured: Measurements  # of this frame

    def equations(self, pose: Pose) -> tuple[Array, Array]:
        """Hessian (6 + D, 6 + D) and slope (6 + D,) of half the residuals' squares."""
        r, J, _ = expand_terms(self.terms, self.model, pose, self.measured, bends=False)
        return jnp.matmul(J.T, J, precision=HIGHEST), jnp.matmul(J.T, r, precision=HIGHEST)


class PoseResult(NamedTuple):
    """How a solve ended."""

    pose: Pose  # that was found
    distances: Array  # (N,) of the points from their rays, metres; 0 for pairs of no weight
    shares: Array  # (N,) from 0, an outlier, to 1: what robust weighting leaves of a pair's weight
    spread: Array  # () deviation of the points about their rays, metres
    # (6 + D, 6 + D) Hessian of half the weighted squares in deviations, without prior or damping:
    # its inverse is the covariance of what the rays tell.
    information: Array
    slope: Array  # (6 + D,) of the same half squares, by the tangent vector of ``retract``
    iterations: Array  # () made
    status: Array  # () a Status


class _Normal(NamedTuple):
    """Normal equations at a pose, and what they were made of."""

    information: Array
    slope: Array
    distances: Array
    shares: Array
    spread: Array


def solve_pose(
    skeleton: Skeleton,
    pose: Pose,
    pairs: PointRays,
    settings: PoseSettings,
    prior: Prior | None = None,
    free: Array | None = None,
    beside: TermEvidence | None = None,
    morph: Morph | None = None,
) -> PoseResult:
    """Iterate from ``pose`` until the points lie on their rays, or rest.

    Args:
        skeleton: D degrees of freedom.
        pose: to start from.
        pairs: N, padded; those of no weight count for nothing.
        settings: traced.
        prior: what is expected, beside the rays.
        free: (6 + D,) degrees of freedom that may move; all without it.
        beside: further evidence, where there is any.
        morph: what goes along with the angles. Steps, damping and the prior are then those of the
            free pose (``without_followers``); the pairs' moves are its drivers'.
    """
    moving = jnp.ones(skeleton.costs.shape, bool) if free is None else free

    def unfinished(carry: tuple[Array, Pose, Array]) -> Array:
        count, _, moved = carry
        return (count < settings.iterations) & (moved > settings.rest)

    def iterate(carry: tuple[Array, Pose, Array]) -> tuple[Array, Pose, Array]:
        count, pose, _ = carry
        normal = _normal_equations(skeleton, pose, pairs, settings, beside, morph)
        bounds = room(skeleton.limits, pose.angles)
        if morph is not None:
            normal = _by(followed_jacobian(morph, pose.angles), normal)
            pose = without_followers(morph, pose)
        step = _step(pose, bounds, normal, settings, prior, moving)
        there = retract(pose, step)
        if morph is not None:
            there = with_followers(morph, there, skeleton)
        return count + 1, there, jnp.max(jnp.abs(step))

    far = jnp.asarray(jnp.inf, pose.angles.dtype)
    count, last, moved = jax.lax.while_loop(
        unfinished, iterate, (jnp.zeros((), jnp.int32), pose, far)
    )
    measured = jnp.any(pairs.weights > 0)
    if beside is not None:
        measured = measured | jnp.any(jnp.diagonal(beside.equations(pose)[0]) > 0)
    broken = ~jnp.isfinite(moved) | ~measured
    last = jax.tree.map(lambda new, old: jnp.where(broken, old, new), last, pose)
    end = _normal_equations(skeleton, last, pairs, settings, beside, morph)
    status = jnp.where(moved > settings.rest, Status.OUT_OF_STEPS, Status.CONVERGED)
    status = jnp.where(broken, Status.BROKEN, status).astype(jnp.int32)
    kept = end.distances, end.shares, end.spread, end.information, end.slope
    return PoseResult(last, *kept, count, status)


def _normal_equations(
    skeleton: Skeleton,
    pose: Pose,
    pairs: PointRays,
    settings: PoseSettings,
    beside: TermEvidence | None,
    morph: Morph | None,
) -> _Normal:
    """Hessian and slope of half the squares of all pairs, in their robust deviations."""
    frames = forward(skeleton, pose)
    if morph is not None and pairs.moves is not None:
        gone = moved_points(pairs.points, pairs.moves, driver_values(morph, pose.angles))
        pairs = pairs._replace(points=gone)
    residuals, rows = linearised_rays(skeleton, frames, pairs)
    distances, shares, spread = robust_shares(
        jnp.sum(residuals**2, -1), pairs.weights > 0, settings.deviation, settings.reach
    )
    weights = jnp.where(pairs.weights > 0, shares * pairs.weights, 0.0) / spread**2
    # Rows and residuals side by side: one product, of a matrix with itself, has both sums.
    beside_rows = jnp.concatenate([rows, residuals[..., None]], -1)
    whitened = beside_rows * jnp.sqrt(weights)[:, None, None]
    whitened = whitened.reshape(-1, whitened.shape[-1])
    sums = jnp.matmul(whitened.T, whitened, precision=HIGHEST)
    normal = _Normal(sums[:-1, :-1], sums[:-1, -1], distances, shares, spread)
    if morph is not None and pairs.moves is not None:
        same = jnp.eye(len(skeleton.costs), dtype=sums.dtype)
        normal = _by(jnp.concatenate([same, driver_jacobian(morph, pose.angles)]), normal)
    if beside is not None:
        information, slope = beside.equations(pose)
        normal = normal._replace(
            information=normal.information + information, slope=normal.slope + slope
        )
    return normal


def _by(chain: Array, normal: _Normal) -> _Normal:
    """The equations for what the old unknowns are moved by: ``chain``, their derivatives."""
    information = jnp.matmul(normal.information, chain, precision=HIGHEST)
    information = jnp.matmul(chain.T, information, precision=HIGHEST)
    slope = jnp.matmul(chain.T, normal.slope, precision=HIGHEST)
    return normal._replace(information=information, slope=slope)


def _step(
    pose: Pose,
    bounds: tuple[Array, Array],
    normal: _Normal,
    settings: PoseSettings,
    prior: Prior | None,
    free: Array,
) -> Array:
    """The step (6 + D,) that solves the normal equations within the joints' room."""
    diagonal = jnp.full(free.shape, 1 / settings.damping**2, normal.slope.dtype)
    slope = normal.slope
    if prior is not None:
        precision = 1 / prior.deviations**2
        diagonal = diagonal + precision
        slope = slope + precision * difference(pose, prior.pose)
    H = normal.information + jnp.diag(diagonal)
    low, high = bounds

    def solved(stays: Array) -> Array:
        """-H^-1 slope among what stays, 0 elsewhere; of a unit diagonal for float32's sake."""
        scale = jnp.where(stays, jax.lax.rsqrt(jnp.diagonal(H)), 0.0)
        scaled = scale[:, None] * H * scale + jnp.diag(jnp.where(stays, 0.0, 1.0).astype(H.dtype))
        factor = jax.scipy.linalg.cho_factor(scaled)
        return -scale * jax.scipy.linalg.cho_solve(factor, scale * slope)

    step = step_within(solved, low, high, free, AT_LIMIT, ROUNDS)
    largest = jnp.max(jnp.abs(step))
    step = step * jnp.minimum(1.0, settings.largest_step / jnp.maximum(largest, 1e-12))
    return jnp.clip(step, low, high)


def standard_deviations(
    information: Array | np.ndarray, beforehand: np.ndarray | float = np.pi
) -> np.ndarray:
    """Of each degree of freedom (6 + D,), metres and radians, by the Hessian's inverse.

    In double precision on the host. What the rays leave open keeps the deviation from before.

    Args:
        information: (6 + D, 6 + D) of a ``PoseResult``.
        beforehand: (6 + D,) or one number: deviations before anything is measured.
    """
    H = np.asarray(information, float)
    H = (H + H.T) / 2
    prior = np.broadcast_to(1 / np.asarray(beforehand, float) ** 2, len(H))
    # So few rows: BLAS's threads would only wait for one another, for tens of milliseconds.
    with _blas().limit(limits=1, user_api="blas"):
        values, vectors = np.linalg.eigh(H / np.sqrt(np.outer(prior, prior)))
    # float32 sums cannot tell a small eigenvalue from none.
    values = np.where(values > 1e-6 * values.max(), values, 0.0)
    return np.sqrt(np.sum(vectors**2 / (1 + values), 1) / prior)


@cache
def _blas() -> ThreadpoolController:
    return ThreadpoolController()
