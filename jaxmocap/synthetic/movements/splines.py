"""Smooth curves through key values, such as stances: clamped cubic splines.

INPUTS: increasing key times (K,), seconds, and values (K, C). OUTPUTS: values at any time, twice
continuously differentiable; a KeyStance of a whole body, and its channels for a spline.
"""

from dataclasses import dataclass, fields, replace
from typing import NamedTuple

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


class StanceChannels(NamedTuple):
    """A stance over time: the channels of ``KeyStance`` as (T, n), degrees and metres."""

    place: np.ndarray
    lift: np.ndarray
    turn: np.ndarray
    back: np.ndarray
    neck: np.ndarray
    arm_l: tuple[np.ndarray, np.ndarray]
    arm_r: tuple[np.ndarray, np.ndarray]
    leg_l: tuple[np.ndarray, np.ndarray, np.ndarray]
    leg_r: tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class KeyStance:
    """The stance of a body at one time: degrees, metres.

    Attributes:
        place: of the hips' middle on the floor, x (ahead) and y (left).
        lift: of the lowest part of the body above the floor.
        turn: of the hips: left about the vertical, then bowed, then towards the right.
        back: of the chest against the hips: bowed, towards the right, turned left.
        neck: bowed.
        arm_l: flexion, abduction and inward rotation of the upper arm, and of the elbow, flexion.
        arm_r: the same on the right.
        leg_l: flexion, abduction and inward rotation of the thigh, flexion of the knee, and of
            the ankle, how far the toes point down.
        leg_r: the same on the right.
    """

    place: tuple[float, float] = (0.0, 0.0)
    lift: float = 0.0
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    back: tuple[float, float, float] = (2.0, 0.0, 0.0)
    neck: float = 0.0
    arm_l: tuple[float, float, float, float] = (4.0, 9.0, 0.0, 14.0)
    arm_r: tuple[float, float, float, float] = (4.0, 9.0, 0.0, 14.0)
    leg_l: tuple[float, float, float, float, float] = (2.0, 4.0, -6.0, 4.0, 2.0)
    leg_r: tuple[float, float, float, float, float] = (2.0, 4.0, -6.0, 4.0, 2.0)

    def channels(self) -> np.ndarray:
        """(28,) all of it."""
        return np.concatenate([np.ravel(getattr(self, field.name)) for field in fields(self)])

    def mirrored(self) -> "KeyStance":
        """Left and right in each other's place."""
        (x, y), (yaw, pitch, roll), (bow, side, twist) = self.place, self.turn, self.back
        return replace(
            self,
            place=(x, -y),
            turn=(-yaw, pitch, -roll),
            back=(bow, -side, -twist),
            arm_l=self.arm_r,
            arm_r=self.arm_l,
            leg_l=self.leg_r,
            leg_r=self.leg_l,
        )

    @staticmethod
    def split(values: np.ndarray) -> StanceChannels:
        """Channels (T, 28) by their names."""
        v = values.T
        place, lift, turn, back, neck = (
            v[a:b].T for a, b in ((0, 2), (2, 3), (3, 6), (6, 9), (9, 10))
        )
        arm_l, arm_r = ((v[i : i + 3].T, v[i + 3 : i + 4].T) for i in (10, 14))
        leg_l, leg_r = ((v[i : i + 3].T, v[i + 3 : i + 4].T, v[i + 4 : i + 5].T) for i in (18, 23))
        return StanceChannels(place, lift, turn, back, neck, arm_l, arm_r, leg_l, leg_r)
