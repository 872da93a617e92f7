"""Smooth curves through key values: clamped cubic splines, twice continuously differentiable.

INPUTS: increasing key times (K,), seconds, and values (K, C). OUTPUTS: values at any time.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Spline:
    """A curve at rest at both ends; before the first key and after the last it stands still.

    Attributes:
        times: (K,) key times, seconds, increasing.
        values: (K, C) at the keys.
        second_derivatives: (K, C) at the keys.
    """

    times: np.ndarray
    values: np.ndarray
    second_derivatives: np.ndarray

    @classmethod
    def through(cls, times: np.ndarray, values: np.ndarray) -> "Spline":
        """The spline through (K, C) values with zero velocity at both ends.

        Raises:
            ValueError: fewer than two keys, or times that do not increase.
        """
        times, values = np.asarray(times, float), np.asarray(values, float)
        steps = np.diff(times)
        if len(times) < 2 or not (steps > 0).all():
            raise ValueError(f"key times = {times.tolist()}: expected two or more, increasing")
        system = np.zeros((len(times), len(times)))
        interval = np.arange(len(steps))
        np.add.at(system, (interval, interval), steps / 3)
        np.add.at(system, (interval + 1, interval + 1), steps / 3)
        system[interval, interval + 1] = system[interval + 1, interval] = steps / 6
        slopes = np.diff(values, axis=0) / steps[:, None]
        resting = np.zeros((1, values.shape[1]))
        changes = np.diff(np.concatenate([resting, slopes, resting]), axis=0)
        return cls(times, values, np.linalg.solve(system, changes))

    def __call__(self, times: np.ndarray) -> np.ndarray:
        """Values (T, C) at (T,) times."""
        t = np.clip(np.asarray(times, float), self.times[0], self.times[-1])
        k = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, len(self.times) - 2)
        step = (self.times[k + 1] - self.times[k])[:, None]
        b = (t - self.times[k])[:, None] / step
        a = 1 - b
        straight = a * self.values[k] + b * self.values[k + 1]
        bend = (a**3 - a) * self.second_derivatives[k] + (b**3 - b) * self.second_derivatives[k + 1]
        return straight + step**2 / 6 * bend
