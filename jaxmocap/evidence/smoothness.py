"""The prior of a motion: accelerations are white noise.

M coordinates of points over T frames at any times. The prior is a sum of squares, the integral of
(acceleration / deviation)^2 over time in its discrete form, so that it does not depend on how often
the motion was sampled: a point whose acceleration has the spectral density ``deviation``^2.

INPUTS: times, deviations, points over time. OUTPUTS: the prior's cost, precision, block rows; the
accelerations of points over time, as it counts them.
"""

from typing import NamedTuple

import numpy as np

from jaxmocap.compilation.arrays import Numbers, namespace

# An acceleration reaches two frames on.
REACH = 2
# Frames at a time.
FRAMES = 32


class Smoothness(NamedTuple):
    """A prior over the motion of M coordinates in T frames."""

    frames: int  # T
    coefficients: np.ndarray  # (T - 2, 3) of three successive points, to their acceleration
    weights: np.ndarray  # (M,) 1 / deviation; 0 where there is no prior

    def residuals(self, values: np.ndarray) -> np.ndarray:
        """Accelerations (T - 2, M, L), weighted, of each of L sets of (T, M, L) values."""
        count = len(self.coefficients)
        total = np.zeros((count, *values.shape[1:]))
        for k in range(REACH + 1):
            total += self.coefficients[:, k, None, None] * values[k : k + count]
        return total * self.weights[:, None]

    def cost(self, points: np.ndarray) -> float:
        """The sum of squares at (T, M) points."""
        return float(np.sum(self.residuals(points[..., None]) ** 2))

    def precision(self, values: np.ndarray) -> np.ndarray:
        """The prior's precision matrix times each of L sets of (T, M, L) values."""
        residuals, total = self.residuals(values), np.zeros(values.shape)
        for k in range(REACH + 1):
            total[k : k + len(residuals)] += self.coefficients[:, k, None, None] * residuals
        return total * self.weights[:, None]

    def ties(self, ahead: int) -> np.ndarray:
        """How strongly (T,), but for the weights, frames are tied to those ``ahead`` of them."""
        total = np.zeros(self.frames)
        for k in range(REACH + 1 - ahead):
            there = slice(k, k + len(self.coefficients))
            total[there] += self.coefficients[:, k] * self.coefficients[:, k + ahead]
        return total

    def block_rows(self, jacobian: np.ndarray) -> np.ndarray:
        """Its Hessian by the (T, M, N) derivative of the points, as ``banded`` keeps it."""
        size = jacobian.shape[2]
        rows = np.zeros((self.frames, size, (REACH + 1) * size))
        even = np.ptp(self.weights) == 0
        # Equal weights scale the products, which are smaller than the derivatives.
        weighed = jacobian if even else jacobian * self.weights[:, None]
        factor = self.weights[0] ** 2 if even else 1.0
        for ahead, block in enumerate(np.split(rows, REACH + 1, 2)):
            ties = factor * self.ties(ahead)[:, None, None]
            # As many at a time as the processor's cache holds.
            for first in range(0, self.frames - ahead, FRAMES):
                here = slice(first, min(first + FRAMES, self.frames - ahead))
                there = slice(here.start + ahead, here.stop + ahead)
                block[here] += weighed[here].swapaxes(1, 2) @ weighed[there] * ties[here]
        return rows


def smoothness(times: np.ndarray, accelerations: np.ndarray) -> Smoothness:
    """The prior that accelerations are white noise.

    Args:
        times: (T,) seconds, increasing, at any intervals.
        accelerations: (M,) deviations sigma, in units / s^2 * sqrt(s); infinite where there
            is no prior. The mean acceleration over h seconds deviates by sigma / sqrt(h).
    """
    times = np.asarray(times, float)
    if not (np.diff(times) > 0).all():
        raise ValueError("the times of a trajectory must increase")
    return Smoothness(len(times), second_differences(times), 1 / np.asarray(accelerations, float))


def second_differences(times: Numbers) -> Numbers:
    """(T - 2, 3) of three successive points at times (T,), seconds, increasing.

    They make of the points their mean acceleration over h seconds, times sqrt(h).
    """
    xp = namespace(times)
    steps = xp.diff(times)
    h1, h2 = steps[:-1], steps[1:]
    return xp.stack([1 / h1, -1 / h1 - 1 / h2, 1 / h2], 1) * xp.sqrt(2 / (h1 + h2))[:, None]


def accelerations_of(times: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Mean accelerations over h seconds times sqrt(h), (T - 2, M), of points (T, M).

    Their deviation is the sigma that ``smoothness`` asks for.
    """
    return smoothness(times, np.ones(points.shape[1])).residuals(points[..., None])[..., 0]
