"""The equations of a window: a quadratic for each event, tied by the prior on the motion.

    event    terms and silhouettes about a pose -> LinearEvent
    window   LinearEvents + the marginal prior  -> WindowEquations, by a banded Cholesky factor:
             steps of all events;  variances of some;  the marginal prior of those that stay

Unknowns are tangent steps (T, N) from the poses about which the events were linearised. What leaves
the window is condensed straight from the factor: the columns of an event that was eliminated reach
the two events to which the motion prior ties it, and no farther.

INPUTS: linearised events. OUTPUTS: steps, costs, variances, a MarginalPrior.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxmocap.evidence.smoothness import REACH, Smoothness, smoothness
from jaxmocap.smoothing.levenberg_marquardt import PRIORS_SHARE
from jaxmocap.solvers import banded

# Curvature that every unknown has about its present value,
FLOOR = 1e-6
# times this where rounding has left less than nothing, and again, so many times.
RAISED, ATTEMPTS = 1000.0, 4


class SilhouetteQuadratic(NamedTuple):
    """What an event's silhouettes cost near a pose where they were drawn.

    Attributes:
        points: (M,) the landmarks there, world, metres.
        cost: () of it there.
        hessian: (N, N) of half the cost, by the pose's tangent vector.
        gradient: (N,) likewise.
        step: (N,) from the pose where the event's terms were linearised to that where it was drawn.
    """

    points: np.ndarray
    cost: float
    hessian: np.ndarray
    gradient: np.ndarray
    step: np.ndarray


@dataclass(eq=False)
class LinearEvent:
    """What one event costs, about a pose.

    Attributes:
        pose: (7 + D,) packed.
        cost: of its terms there, a sum of squares.
        hessian: (N, N) of half of it, by the pose's tangent vector.
        gradient: (N,) likewise.
        points: (M,) the landmarks there, world, metres.
        jacobian: (M, N) of the landmarks.
        silhouettes: where they were last drawn; None without.
    """

    pose: np.ndarray
    cost: float
    hessian: np.ndarray
    gradient: np.ndarray
    points: np.ndarray
    jacobian: np.ndarray
    silhouettes: SilhouetteQuadratic | None = None

    def points_at(self, step: np.ndarray) -> np.ndarray:
        """(M,) the landmarks a step (N,) on, as far as their derivative tells."""
        return self.points + self.jacobian @ step

    def cost_at(self, step: np.ndarray) -> float:
        """A step (N,) on, silhouettes included."""
        total = self.cost + _rise(self.hessian, self.gradient, step)
        if (drawn := self.silhouettes) is not None:
            total += drawn.cost + _rise(drawn.hessian, drawn.gradient, step - drawn.step)
        return total

    def silhouettes_about(self, step: np.ndarray) -> SilhouetteQuadratic | None:
        """The silhouettes, for terms that are linearised a step (N,) on."""
        drawn = self.silhouettes
        return drawn and drawn._replace(step=drawn.step - step)


class MarginalPrior(NamedTuple):
    """Evidence of the events before a window about its first two, as a quadratic of their steps.

    Attributes:
        hessian: (2 N, 2 N).
        gradient: (2 N,) half the cost's derivative at no step.
    """

    hessian: np.ndarray
    gradient: np.ndarray

    def cost(self, steps: np.ndarray) -> float:
        """At steps (2, N), but for a constant."""
        return _rise(self.hessian, self.gradient, steps.ravel())

    def about(self, steps: np.ndarray) -> "MarginalPrior":
        """The same by further steps from steps (2, N)."""
        return self._replace(gradient=self.gradient + self.hessian @ steps.ravel())


class WindowEquations(NamedTuple):
    """Normal equations of T events.

    Attributes:
        events: which.
        prior: on their landmarks' motion.
        marginal: of the events before; None at a beginning.
        rows: (T, N, 3 N) their Hessian, as ``banded`` keeps it.
        gradient: (T, N).
        scale: (N,) what damping holds each unknown back by.
    """

    events: Sequence[LinearEvent]
    prior: Smoothness
    marginal: MarginalPrior | None
    rows: np.ndarray
    gradient: np.ndarray
    scale: np.ndarray

    def steps(self, damping: float) -> np.ndarray:
        """(T, N) towards where all of it costs least; all the way without damping."""
        factor = _factorised(self.rows, damping * self.scale)
        return -banded.solve_factored(factor, self.gradient[..., None])[..., 0]

    def cost(self, steps: np.ndarray) -> float:
        """At steps (T, N), but for the marginal prior's."""
        pairs = list(zip(self.events, steps, strict=True))
        points = np.stack([event.points_at(step) for event, step in pairs])
        return sum(event.cost_at(step) for event, step in pairs) + self.prior.cost(points)

    def variances(self, chosen: Sequence[int]) -> np.ndarray:
        """(F, M) of the points of some events, given all."""
        J = np.stack([self.events[i].jacobian for i in chosen])
        covariances = banded.inverse_blocks(_factorised(self.rows), min(chosen))[list(chosen)]
        return np.maximum(np.sum(J @ covariances * J, 2), 0.0)

    def condensed(self, count: int) -> MarginalPrior:
        """What all this knows of the two events after the first so many, which leave.

        The evidence that stays in the window is left out.
        """
        size, kept = self.gradient.shape[1], self.events[count : count + REACH]
        leaving = slice(max(0, count - REACH) * size, count * size)
        some = count + REACH
        factor = _factorised(self.rows[:some])
        across = _below(factor.columns[leaving], REACH * size)
        solved = banded.forward_factored(factor, self.gradient[:some])[leaving]
        hessian, gradient = -across.T @ across, -across.T @ solved
        # The prior's ties that begin among those that leave.
        gone = self.prior.first(some)
        points = np.stack([event.points for event in self.events[:some]])
        pull = gone.precision(points[..., None])[count:, :, 0]
        for a, one in enumerate(kept):
            here = slice(a * size, (a + 1) * size)
            gradient[here] += pull[a] @ one.jacobian
            for b, other in list(enumerate(kept))[a:]:
                there = slice(b * size, (b + 1) * size)
                tie = gone.uniform_ties(b - a)[count + a]
                block = tie * one.jacobian.T @ other.jacobian
                hessian[here, there] += block
                if b > a:
                    hessian[there, here] += block.T
        # Of the marginal prior, what it says of an event that stays.
        if self.marginal is not None and count < REACH:
            here, rest = slice(0, (REACH - count) * size), slice(count * size, None)
            hessian[here, here] += self.marginal.hessian[rest, rest]
            gradient[here] += self.marginal.gradient[rest]
        return MarginalPrior(hessian, gradient)


def window_equations(
    events: Sequence[LinearEvent],
    times: np.ndarray,
    acceleration: float,
    marginal: MarginalPrior | None,
    share: float = 1.0,
) -> WindowEquations:
    """The equations of T events at (T,) seconds.

    Args:
        events: linearised.
        times: increasing.
        acceleration: deviation of the landmarks', see ``smoothness``.
        marginal: of the events before.
        share: of the silhouettes' evidence that counts, 0 to 1.
    """
    prior = smoothness(times, np.full(len(events[0].points), acceleration))
    size = len(events[0].gradient)
    jacobians = np.stack([event.jacobian for event in events])
    rows = prior.block_rows(jacobians)
    points = np.stack([event.points for event in events])
    stiffness = PRIORS_SHARE * np.einsum("tii->i", rows[:, :, :size]) / len(events)
    own = np.zeros(size)
    pull = prior.precision(points[..., None])[..., 0]
    gradient = (pull[:, None] @ jacobians)[:, 0]
    for i, event in enumerate(events):
        rows[i, :, :size] += event.hessian
        own += np.diag(event.hessian)
        gradient[i] += event.gradient
        if share and (drawn := event.silhouettes) is not None:
            rows[i, :, :size] += share * drawn.hessian
            gradient[i] += share * (drawn.gradient - drawn.hessian @ drawn.step)
    if marginal is not None:
        gradient[:REACH] += marginal.gradient.reshape(REACH, size)
        rows[0, :, : 2 * size] += marginal.hessian[:size]
        rows[1, :, :size] += marginal.hessian[size:, size:]
    return WindowEquations(events, prior, marginal, rows, gradient, own / len(events) + stiffness)


def _factorised(rows: np.ndarray, ridge: np.ndarray | float = 0.0) -> banded.Factor:
    """With a floor, and a higher one where that is not enough."""
    for attempt in range(ATTEMPTS):
        try:
            return banded.factorise(rows, ridge + FLOOR * RAISED**attempt)
        except banded.NotPositiveDefinite:
            continue
    raise banded.NotPositiveDefinite("the window's equations are not positive definite")


def _below(columns: np.ndarray, height: int) -> np.ndarray:
    """(C, height) what the last C columns of a factor's part have below that part."""
    count, width = columns.shape
    below = np.zeros((count, height))
    for i, column in enumerate(columns):
        inside = count - i
        reach = min(width - inside, height)
        if reach > 0:
            below[i, :reach] = column[inside : inside + reach]
    return below


def _rise(hessian: np.ndarray, gradient: np.ndarray, step: np.ndarray) -> float:
    """What a quadratic's cost rises by over a step."""
    return float(step @ (hessian @ step + 2 * gradient))
