"""Smooth curves through key values, such as stances: clamped cubic splines.

INPUTS: increasing key times (K,), seconds, and values (K, C). OUTPUTS: values at any time, twice
continuously differentiable; a KeyStance of a whole body, and its channels for a spline.
"""

from dataclasses import dataclass, fields, replace
from types import SimpleNamespace

import numpy as np
from scipy.interpolate import CubicSpline


class Spline(CubicSpline):
    """A curve through values (K, C) at times (K,), seconds, at rest at both ends.

    Before the first key and after the last it stands still.
    """

    def __init__(self, times: np.ndarray, values: np.ndarray):
        super().__init__(times, values, bc_type="clamped")

    def __call__(self, times: np.ndarray) -> np.ndarray:  # type: ignore[override]
        """Values (T, C) at (T,) times."""
        return super().__call__(np.clip(times, self.x[0], self.x[-1]))


class Channels(SimpleNamespace):
    """The attributes of a posture over T instants: (T,), or (T, n) where one has n numbers."""


@dataclass(frozen=True)
class KeyPosture:
    """What a body does at one time: attributes of one number or several."""

    def channels(self) -> np.ndarray:
        """(C,) all numbers, in the order of the attributes."""
        return np.concatenate([np.ravel(getattr(self, field.name)) for field in fields(self)])

    @classmethod
    def split(cls, values: np.ndarray) -> Channels:
        """Channels (T, C) by their names."""
        columns = iter(values.T)
        return Channels(**{
            field.name: np.stack([next(columns) for _ in field.default], 1)
            if isinstance(field.default, tuple)
            else next(columns)
            for field in fields(cls)
        })  # fmt: skip


@dataclass(frozen=True)
class KeyStance(KeyPosture):
    """The stance of a body at one time: degrees, metres."""

    # Of the hips' middle on the floor, x (ahead) and y (left).
    place: tuple[float, float] = (0.0, 0.0)
    lift: float = 0.0  # of the lowest part of the body above the floor
    # Of the hips: left about the vertical, then bowed, then towards the right.
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    # Of the chest against the hips: bowed, towards the right, turned left.
    back: tuple[float, float, float] = (2.0, 0.0, 0.0)
    neck: float = 0.0  # bowed
    # Flexion, abduction and inward rotation of the upper arm, and of the elbow, flexion.
    arm_l: tuple[float, float, float, float] = (4.0, 9.0, 0.0, 14.0)
    arm_r: tuple[float, float, float, float] = (4.0, 9.0, 0.0, 14.0)  # the same on the right
    # Flexion, abduction and inward rotation of the thigh, flexion of the knee, and of the ankle,
    # how far the toes point down.
    leg_l: tuple[float, float, float, float, float] = (2.0, 4.0, -6.0, 4.0, 2.0)
    # The same on the right.
    leg_r: tuple[float, float, float, float, float] = (2.0, 4.0, -6.0, 4.0, 2.0)

    def mirror(self) -> "KeyStance":
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
