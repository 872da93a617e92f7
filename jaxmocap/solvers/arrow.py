"""Normal equations of a trajectory: banded in time, with a border for what all frames share.

    [ A   C ] [ s ]     [ g ]
    [ C'  B ] [ u ] = - [ b ]

A is the frames' block-banded part, B the shared parameters', C what ties the two. Solved by the
banded Cholesky factor of A and the Schur complement B - C' A^-1 C; without shared parameters the
border has no width.

INPUTS: the blocks. OUTPUTS: damped steps, covariances, whether everything is determined.
"""

from typing import NamedTuple

import numpy as np

from jaxmocap.solvers import banded

# A Cholesky pivot below this share of its diagonal entry is rounding: nothing determines it.
SMALLEST_PIVOT = 1e-13


class BandedStep(NamedTuple):
    """A step of T frames of N unknowns and P shared ones."""

    frames: np.ndarray  # (T, N)
    shared: np.ndarray  # (P,)
    decrease: float  # what a quadratic cost, the sum of squares, would fall by

    def largest(self) -> float:
        """The largest component."""
        return max(np.abs(self.frames).max(initial=0), np.abs(self.shared).max(initial=0))


class Covariances(NamedTuple):
    """What is left uncertain, in tangent directions."""

    frames: np.ndarray  # (T, N, N) of each frame's unknowns
    cross: np.ndarray  # (T, N, P) between those and the shared ones
    shared: np.ndarray  # (P, P) of the shared ones


class Equations(NamedTuple):
    """Normal equations J^T J step = -J^T r."""

    rows: np.ndarray  # (T, N, (reach + 1) N) A, its block rows as ``banded`` keeps them
    gradient: np.ndarray  # (T, N) g
    cross: np.ndarray  # (T, N, P) C
    shared: np.ndarray  # (P, P) B
    shared_gradient: np.ndarray  # (P,) b
    scale: np.ndarray  # (N,) what damping holds each frame's unknowns back by
    shared_scale: np.ndarray  # (P,) likewise

    def diagonal(self) -> np.ndarray:
        """(T, N) of A."""
        return np.einsum("tii->ti", self.rows[:, :, : self.rows.shape[1]])

    def finite(self) -> bool:
        """Whether every entry is."""
        return all(bool(np.isfinite(entries).all()) for entries in self)

    def step(self, damping: float, floor: float) -> BandedStep:
        """The step with ``damping`` times the scale, and ``floor``, added to the diagonal.

        Raises:
            NotPositiveDefinite: where the damping is too light.
        """
        ridge = damping * self.scale + floor
        shared_ridge = damping * self.shared_scale + floor
        factor = banded.factorise(self.rows, ridge)
        right = np.concatenate([self.gradient[..., None], self.cross], 2)
        solved = banded.solve_factored(factor, right)
        own, border = solved[..., 0], solved[..., 1:]
        schur = self._schur(border) + np.diag(shared_ridge)
        np.linalg.cholesky(schur)
        remaining = self.shared_gradient - np.einsum("tnp,tn->p", self.cross, own)
        shared = -np.linalg.solve(schur, remaining)
        frames = -(own + border @ shared)
        decrease = np.sum(frames * (ridge * frames - self.gradient))
        decrease += np.sum(shared * (shared_ridge * shared - self.shared_gradient))
        return BandedStep(frames, shared, float(decrease))

    def covariances(self, floor: float) -> Covariances:
        """Blocks of the inverse, with ``floor`` added to the diagonal.

        Raises:
            NotPositiveDefinite: where it has no inverse.
        """
        factor = banded.factorise(self.rows, floor)
        border = banded.solve_factored(factor, self.cross)
        schur = self._schur(border) + floor * np.eye(len(self.shared))
        np.linalg.cholesky(schur)
        shared = np.linalg.inv(schur)
        cross = -border @ shared
        frames = banded.inverse_blocks(factor) - cross @ border.swapaxes(1, 2)
        return Covariances(frames, cross, shared)

    def is_determined(self) -> bool:
        """Whether, undamped, every unknown has curvature beyond rounding."""
        try:
            factor = banded.factorise(self.rows)
            schur = self._schur(banded.solve_factored(factor, self.cross))
            corner = np.diag(np.linalg.cholesky(schur))
        except banded.NotPositiveDefinite:
            return False
        own = factor.columns[:, 0] ** 2 > SMALLEST_PIVOT * self.diagonal().ravel()
        return bool(own.all() and (corner**2 > SMALLEST_PIVOT * np.diag(self.shared)).all())

    def _schur(self, border: np.ndarray) -> np.ndarray:
        return self.shared - np.einsum("tnp,tnq->pq", self.cross, border)
