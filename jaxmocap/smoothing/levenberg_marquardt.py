"""A whole trajectory at once: Levenberg-Marquardt whose Hessian is block-banded in time.

Minimises the frames' own costs f_t(x_t, p) plus a prior over how points of theirs move
(``smoothness``), over the states x_t of all frames and, if any, parameters p that all frames share.
The states live on any manifold: steps are taken in the tangent space. The frames' terms may come
from the device in float32; the sums over time are float64 on the host, since the squares of second
differences at 120 Hz weigh 1e7 times those of positions.

INPUTS: the frames' terms as functions of the trajectory, a start, the prior.
OUTPUTS: the trajectory, how the solve ended, covariances.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from jaxmocap.evidence.smoothness import Smoothness
from jaxmocap.solvers.arrow import BandedStep, Covariances, Equations
from jaxmocap.solvers.banded import NotPositiveDefinite
from jaxmocap.solvers.status import Status

# The derivative of anything, in any frame, by no shared parameters.
UNSHARED = np.zeros((1, 0))
# Damping is by the frames' own curvature: by the prior's, a million times as stiff from frame to
# frame, slow movements, in which the prior is soft, would hardly start. This share of the prior's
# still holds unknowns that no frame sees.
PRIORS_SHARE = 1e-4
LEAST_DAMPING = 1e-9
# With more of it, a small step or gain does not mean that the minimum is near.
LIGHT_DAMPING = 1.0
# A step that promises less than this part of what is small is not tried.
PROMISED = 0.5
# Most tries of one step, and the factor on the damping after the first that failed, doubled after
# each further one.
ATTEMPTS, GROWTH = 8, 2.0


class Linearised(NamedTuple):
    """T frames about their present states: N tangent directions each, M coordinates, P shared.

    Costs are sums of squares of whitened residuals r. All entries are finite; an absent frame has
    zeros (its points and their derivative aside), and the prior bridges it.
    """

    cost: ArrayLike  # (T,) r^T r
    hessian: ArrayLike  # (T, N, N) J^T J
    gradient: ArrayLike  # (T, N) J^T r, half the cost's derivative
    points: ArrayLike  # (T, M) the coordinates whose motion the prior weighs
    jacobian: ArrayLike  # (T, M, N) their derivative
    # (T, N, P) J^T J_p; without shared parameters this and the rest are left out.
    cross: ArrayLike = UNSHARED
    # (T, P, P) J_p^T J_p; a prior on p belongs to one frame, or a T-th to each.
    shared_hessian: ArrayLike = UNSHARED.T @ UNSHARED
    shared_gradient: ArrayLike = UNSHARED[0]  # (T, P) J_p^T r
    shared_jacobian: ArrayLike = UNSHARED  # (T, M, P) the points' derivative by p


class SolverSettings(NamedTuple):
    """How a trajectory is solved."""

    iterations: int = 20  # most steps
    damping: float = 1e-3  # the first, as a share of the frames' mean curvature
    relative: float = 1e-4  # converged when the cost falls by no more than this share, or would
    step: float = 1e-5  # likewise when no tangent component moves by more than this
    # Curvature that every unknown has about its present value, so that what nothing determines
    # stays where it is; it then has the variance 1 / floor.
    floor: float = 1e-6


DEFAULTS = SolverSettings()


class Solution(NamedTuple):
    """How a solve ended."""

    x: Any  # the trajectory
    linear: Linearised  # about it
    cost: float  # there, the priors' included
    iterations: int  # times that a step was solved for
    linearisations: int  # made
    damping: float  # to start with where the solve goes on
    status: Status  # why it ended


Linearise = Callable[[Any], Linearised]
Move = Callable[[Any, np.ndarray, np.ndarray], Any]


def minimise(
    linearise: Linearise,
    move: Move,
    start: Any,
    prior: Smoothness,
    settings: SolverSettings = DEFAULTS,
) -> Solution:
    """Minimise the frames' costs plus the priors over a whole trajectory.

    A stiff prior turns a far start into a narrow bent valley: there, solve with several times the
    prior's deviations first. Where a step led is linearised at once: mostly it was right, and the
    next one begins there.

    Args:
        linearise: trajectory to its ``Linearised``; a cost that is not finite refuses a step.
        move: trajectory, steps (T, N) and shared step (P,), float64 arrays both, to trajectory.
        start: a trajectory: anything that the two of them understand.
        prior: of the points' motion.
        settings: of the solve.
    """

    def place(x: Any) -> _Place:
        linear = linearise(x)
        cost = float(_double(linear.cost).sum()) + prior.cost(_double(linear.points))
        return _Place(x, linear, cost)

    def moved_by(x: Any, step: BandedStep) -> _Place:
        return place(move(x, step.frames, step.shared))

    here = place(start)
    state = Solution(start, here.linear, here.cost, 0, 1, settings.damping, Status.OUT_OF_STEPS)
    while state.status == Status.OUT_OF_STEPS and state.iterations < settings.iterations:
        equations = normal_equations(here.linear, prior)
        state = state._replace(iterations=state.iterations + 1)
        if not (np.isfinite(here.cost) and equations.finite()):
            begun = here if state.linearisations == 1 else place(start)
            state = state._replace(linear=begun.linear, cost=begun.cost)
            return state._replace(x=start, status=Status.BROKEN)
        here, state = _descend(moved_by, here, state, equations, settings)
        # That of the start would stay in memory until the end.
        state = state._replace(linear=here.linear)
        if state.status == Status.CONVERGED and not equations.is_determined():
            state = state._replace(status=Status.UNDETERMINED)
    return state._replace(x=here.x, linear=here.linear, cost=here.cost)


def covariances(
    linearised: Linearised, prior: Smoothness, settings: SolverSettings = DEFAULTS
) -> Covariances:
    """How uncertain the states about which ``linearised`` was taken are, given everything.

    Diagonal blocks of the inverse Hessian of half the cost: covariances, if the residuals have
    unit variance.
    """
    frames = positive(_double(linearised.hessian))
    equations = normal_equations(linearised._replace(hessian=frames), prior)
    return equations.covariances(settings.floor)


def point_variances(
    jacobian: ArrayLike, covariances_of: Covariances, shared_jacobian: ArrayLike = UNSHARED
) -> np.ndarray:
    """Variances (T, M) of coordinates, by their derivatives (T, M, N) and (T, M, P)."""
    own, common = _double(jacobian), _double(shared_jacobian)
    common = np.broadcast_to(common, (*own.shape[:2], common.shape[-1]))
    spread = own @ covariances_of.frames + common @ covariances_of.cross.swapaxes(1, 2)
    across = own @ covariances_of.cross + common @ covariances_of.shared
    return np.sum(spread * own, 2) + np.sum(across * common, 2)


def normal_equations(linearised: Linearised, prior: Smoothness) -> Equations:
    """The equations of all frames, the prior's terms included."""
    _, hessian, gradient, points, jacobian, *border = (_double(each) for each in linearised)
    cross, shared_hessian, shared_gradient, shared_jacobian = border
    (frames, size), width = gradient.shape, shared_gradient.shape[-1]
    common = np.broadcast_to(shared_jacobian, (*points.shape, width))
    shared = np.broadcast_to(shared_hessian, (frames, width, width)).sum(0)
    rows = prior.block_rows(jacobian)
    stiffness = np.einsum("tii->i", rows[:, :, :size]) / frames
    rows[:, :, :size] += hessian
    # The points and their leverage on the shared parameters pass through the prior together.
    pulled = prior.precision(np.concatenate([points[..., None], common], 2))
    own = jacobian.swapaxes(1, 2) @ pulled
    corner = np.einsum("tmp,tmq->pq", common, pulled)
    return Equations(
        rows,
        gradient + own[..., 0],
        cross + own[..., 1:],
        shared + corner[:, 1:],
        np.broadcast_to(shared_gradient, (frames, width)).sum(0) + corner[:, 0],
        np.einsum("tii->i", hessian) / frames + PRIORS_SHARE * stiffness,
        np.diag(shared) + PRIORS_SHARE * np.diag(corner[:, 1:]),
    )


class _Place(NamedTuple):
    """Where a solve is."""

    x: Any  # the trajectory
    linear: Linearised  # about it
    cost: float  # the prior's included


def _descend(
    moved_by: Callable[[Any, BandedStep], _Place],
    here: _Place,
    state: Solution,
    equations: Equations,
    settings: SolverSettings,
) -> tuple[_Place, Solution]:
    """One step downhill; the damping follows the gain as Nielsen (1999) has it."""
    damping, growth = state.damping, GROWTH
    enough = settings.relative * here.cost
    converged = state._replace(status=Status.CONVERGED)
    for _ in range(ATTEMPTS):
        try:
            step = equations.step(damping, settings.floor)
        except NotPositiveDefinite:
            damping, growth = damping * growth, 2 * growth
            continue
        light = damping <= LIGHT_DAMPING
        if light and step.decrease <= enough * PROMISED:
            return here, converged
        there = moved_by(here.x, step)
        state = state._replace(linearisations=state.linearisations + 1)
        converged = converged._replace(linearisations=state.linearisations)
        lower = there.cost < here.cost
        fall = here.cost - there.cost if lower else step.decrease
        small = light and (fall <= enough or step.largest() <= settings.step)
        if lower:
            gain = fall / step.decrease
            eased = max(damping * max(1 / 3, 1 - (2 * gain - 1) ** 3), LEAST_DAMPING)
            return there, (converged if small else state)._replace(damping=eased)
        if small:
            return here, converged
        damping, growth = damping * growth, 2 * growth
    return here, state._replace(status=Status.STALLED)


def positive(hessians: np.ndarray) -> np.ndarray:
    """The nearest (T, N, N) without the negative curvature that float32's rounding leaves."""
    values, vectors = np.linalg.eigh(hessians)
    return (vectors * np.maximum(values, 0)[:, None]) @ vectors.swapaxes(1, 2)


def _double(values: ArrayLike) -> np.ndarray:
    return np.asarray(values, float)
