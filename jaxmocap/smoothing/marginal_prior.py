"""The marginal prior of a window: the measurements of frames that left it.

Frames that leave a window leave their measurements, as a quadratic of the two frames that the
motion prior ties them to. Nothing is forgotten, and the window stays as short as its frames need.

INPUTS: equations of a window's frames, the marginal prior before. OUTPUTS: the one after; variances
of what stays.
"""

from typing import NamedTuple

import numpy as np

from jaxmocap.evidence.smoothness import REACH
from jaxmocap.solvers import banded
from jaxmocap.solvers.arrow import Equations

# Curvature that every unknown has about its present value.
FLOOR = 1e-6


class MarginalPrior(NamedTuple):
    """Evidence of the frames before a window about its first two, as a quadratic of their offset.

    In tangent directions, from where the two stood when it was made.

    Attributes:
        hessian: (2 N, 2 N).
        gradient: (2 N,) half the cost's derivative at no offset.
    """

    hessian: np.ndarray
    gradient: np.ndarray

    def cost(self, offset: np.ndarray) -> float:
        """At an offset (2 N,), but for a constant."""
        return float(offset @ self.hessian @ offset + 2 * self.gradient @ offset)


def with_marginal(
    equations: Equations, marginal: MarginalPrior | None, offset: np.ndarray
) -> Equations:
    """A window's equations, and a marginal prior of its first two frames."""
    if marginal is None:
        return equations
    rows, gradient = equations.rows.copy(), equations.gradient.copy()
    size = rows.shape[1]
    pull = marginal.gradient + marginal.hessian @ offset
    gradient[:REACH] += pull.reshape(REACH, size)
    rows[0, :, : 2 * size] += marginal.hessian[:size]
    rows[1, :, :size] += marginal.hessian[size:, size:]
    return equations._replace(rows=rows, gradient=gradient)


def condensed(
    equations: Equations, marginal: MarginalPrior | None, offset: np.ndarray
) -> MarginalPrior:
    """A window's evidence without all but the last two of its frames, about where those stand.

    Args:
        equations: of three frames or more, the first of the window (``leaving``).
        marginal: of the window as it is.
        offset: (2 N,) of its first two frames from where that was made.
    """
    equations = with_marginal(equations, marginal, offset)
    frames, size = equations.gradient.shape
    dense = np.zeros((frames * size, (frames + REACH) * size))
    for row, block in enumerate(equations.rows):
        dense[row * size : (row + 1) * size, row * size : (row + REACH + 1) * size] = block
    dense = np.triu(dense[:, : frames * size])
    gone = (frames - REACH) * size
    left, pull = dense[gone:, gone:], equations.gradient.ravel()
    right = np.column_stack([dense[:gone, gone:], pull[:gone]])
    own = _mirrored(dense[:gone, :gone]) + FLOOR * np.eye(gone)
    tied = right[:, :-1].T @ np.linalg.solve(own, right)
    return MarginalPrior(
        _mirrored(left) - (tied[:, :-1] + tied[:, :-1].T) / 2, pull[gone:] - tied[:, -1]
    )


def weakened(equations: Equations, hessian: np.ndarray) -> Equations:
    """The same with the first frames' own terms less by (T, N, N) of their Hessians."""
    rows = equations.rows.copy()
    size = rows.shape[1]
    rows[: len(hessian), :, :size] -= hessian
    return equations._replace(rows=rows)


def _mirrored(upper: np.ndarray) -> np.ndarray:
    """A symmetric matrix by its upper triangle."""
    return upper + np.triu(upper, 1).T


def window_variances(
    equations: Equations,
    jacobian: np.ndarray,
    marginal: MarginalPrior | None,
    frames: np.ndarray,
) -> np.ndarray:
    """Variances (F, M) of the points of some of a window's frames, given window and marginal.

    Infinite where the equations do not determine them.

    Args:
        equations: of the window.
        jacobian: (T, M, N) of the points.
        marginal: of the window.
        frames: which.
    """
    chosen = np.asarray(jacobian, float)[frames]
    equations = with_marginal(equations, marginal, np.zeros(REACH * chosen.shape[2]))
    try:
        factor = banded.factorise(equations.rows, FLOOR)
    except banded.NotPositiveDefinite:
        return np.full(chosen.shape[:2], np.inf)
    covariances = banded.inverse_blocks(factor, int(np.min(frames)))[frames]
    return np.maximum(np.sum(chosen @ covariances * chosen, 2), 0.0)
