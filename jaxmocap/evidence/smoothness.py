"""The prior of a motion: accelerations are white noise.

M coordinates of points over T frames at any times. The prior is a sum of squares, the integral of
(acceleration / deviation)^2 over time in its discrete form, so that it does not depend on how often
the motion was sampled: a point whose acceleration has the spectral density ``deviation``^2.

INPUTS: times, deviations, points over time. OUTPUTS: the prior's cost, precision, block rows; the
accelerations of points over time, as it counts them.
"""

from typing import NamedTuple

import numpy as np

# An acceleration reaches two frames on.
REACH = 2
# Frames at a time.
FRAMES = 32


class Stencil(NamedTuple):
    """Weighted differences of K successive groups of w frames.

    Attributes:
        coefficients: (K, w).
        weights: (M,) 1 / deviation; 0 where there is no prior.
    """

    coefficients: np.ndarray
    weights: np.ndarray

    def residuals(self, values: np.ndarray) -> np.ndarray:
        """Differences (K, M, L), weighted, of each of L sets of (T, M, L) values."""
        count, width = self.coefficients.shape
        total = np.zeros((count, *values.shape[1:]))
        for k in range(width):
            total += self.coefficients[:, k, None, None] * values[k : k + count]
        return total * self.weights[:, None]

    def spread(self, residuals: np.ndarray, frames: int) -> np.ndarray:
        """The transpose of ``residuals``: (K, M, L) to (T, M, L)."""
        count, width = self.coefficients.shape
        total = np.zeros((frames, *residuals.shape[1:]))
        for k in range(width):
            total[k : k + count] += self.coefficients[:, k, None, None] * residuals
        return total * self.weights[:, None]

    def couplings(self, ahead: int, frames: int) -> np.ndarray:
        """How strongly (T,), but for the weights, frames are tied to those ``ahead`` of them."""
        count, width = self.coefficients.shape
        total = np.zeros(frames)
        for k in range(width - ahead):
            total[k : k + count] += self.coefficients[:, k] * self.coefficients[:, k + ahead]
        return total


class Smoothness(NamedTuple):
    """A prior over the motion of M coordinates in T frames.

    Attributes:
        frames: T.
        stencils: of velocities and of accelerations.
    """

    frames: int
    stencils: tuple[Stencil, ...]

    def cost(self, points: np.ndarray) -> float:
        """The sum of squares at (T, M) points."""
        return sum(float(np.sum(each.residuals(points[..., None]) ** 2)) for each in self.stencils)

    def precision(self, values: np.ndarray) -> np.ndarray:
        """The prior's precision matrix times each of L sets of (T, M, L) values."""
        return sum(
            (each.spread(each.residuals(values), self.frames) for each in self.stencils),
            start=np.zeros(values.shape),
        )

    def first(self, frames: int) -> "Smoothness":
        """That of the first so many frames alone."""
        widths = (each.coefficients.shape[1] for each in self.stencils)
        pairs = zip(self.stencils, widths, strict=True)
        cut = (each._replace(coefficients=each.coefficients[: max(0, frames - width + 1)])
               for each, width in pairs)  # fmt: skip
        return Smoothness(frames, tuple(cut))

    def uniform_ties(self, ahead: int) -> np.ndarray:
        """How strongly (T,) any coordinate is tied, where all have the same deviations."""
        each = (own.couplings(ahead, self.frames) * own.weights[0] ** 2 for own in self.stencils)
        return sum(each, start=np.zeros(self.frames))

    def block_rows(self, jacobian: np.ndarray) -> np.ndarray:
        """Its Hessian by the (T, M, N) derivative of the points, as ``banded`` keeps it."""
        size = jacobian.shape[2]
        rows = np.zeros((self.frames, size, (REACH + 1) * size))
        for each in self.stencils:
            even = np.ptp(each.weights) == 0
            # Equal weights scale the products, which are smaller than the derivatives.
            weighed = jacobian if even else jacobian * each.weights[:, None]
            factor = each.weights[0] ** 2 if even else 1.0
            for ahead, block in enumerate(np.split(rows, REACH + 1, 2)):
                ties = factor * each.couplings(ahead, self.frames)[:, None, None]
                # As many at a time as the processor's cache holds.
                for first in range(0, self.frames - ahead, FRAMES):
                    here = slice(first, min(first + FRAMES, self.frames - ahead))
                    there = slice(here.start + ahead, here.stop + ahead)
                    block[here] += weighed[here].swapaxes(1, 2) @ weighed[there] * ties[here]
        return rows


def smoothness(
    times: np.ndarray,
    accelerations: np.ndarray,
    velocities: np.ndarray | float = np.inf,
) -> Smoothness:
    """The prior that accelerations, and velocities if asked for, are white noise.

    Args:
        times: (T,) seconds, increasing, at any intervals.
        accelerations: (M,) deviations sigma, in units / s^2 * sqrt(s); infinite where there
            is no prior. The mean acceleration over h seconds deviates by sigma / sqrt(h).
        velocities: (M,) or (), the same of velocities, in units / s * sqrt(s).
    """
    times, deviations = np.asarray(times, float), np.asarray(accelerations, float)
    steps = np.diff(times)
    if not (steps > 0).all():
        raise ValueError("the times of a trajectory must increase")
    h1, h2 = steps[:-1], steps[1:]
    second = np.stack([1 / h1, -1 / h1 - 1 / h2, 1 / h2], 1) * np.sqrt(2 / (h1 + h2))[:, None]
    first = np.stack([-1 / np.sqrt(steps), 1 / np.sqrt(steps)], 1)
    slow = np.broadcast_to(np.asarray(velocities, float), deviations.shape)
    stencils = Stencil(first, 1 / slow), Stencil(second, 1 / deviations)
    return Smoothness(len(times), tuple(each for each in stencils if each.weights.any()))


def accelerations_of(times: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Mean accelerations over h seconds times sqrt(h), (T - 2, M), of points (T, M).

    Their deviation is the sigma that ``smoothness`` asks for.
    """
    (stencil,) = smoothness(times, np.ones(points.shape[1])).stencils
    return stencil.residuals(points[..., None])[..., 0]
