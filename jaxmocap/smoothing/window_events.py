"""Events that can still change: what a window keeps of each.

INPUTS: what a step of a tracker measured and found. OUTPUTS: WindowEvents; their state in a solve.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxmocap.body.pose import Pose
from jaxmocap.evidence.appearance.running import MeasuredFrame
from jaxmocap.evidence.terms import Measurements
from jaxmocap.smoothing.levenberg_marquardt import Linearised


class SilhouetteQuadratic(NamedTuple):
    """What an event's silhouettes cost near a pose where they were drawn.

    Attributes:
        points: (3 L,) the landmarks there, world, metres.
        cost: () of it there.
        hessian: (N, N) of half the cost, by the pose's tangent vector.
        gradient: (N,) likewise.
        offset: (N,) of the present pose.
    """

    points: np.ndarray
    cost: float
    hessian: np.ndarray
    gradient: np.ndarray
    offset: np.ndarray

    def here(self) -> tuple[float, np.ndarray]:
        """Cost and gradient at the present pose."""
        turn = self.hessian @ self.offset
        rise = float(self.offset @ (2 * self.gradient + turn))
        return self.cost + rise, self.gradient + turn


@dataclass
class WindowEvent:
    """One step of the tracker, while it can still change.

    Attributes:
        number: of it, counted from 0.
        time: seconds.
        measured: of it besides its silhouettes.
        pose: as it is now.
        first: as the tracker found it.
        elbow_deviations: (2,) the tracker's, metres.
        frames: camera, what was measured in its frame, width and height of that.
        quadratic: of the silhouettes when they were last drawn; None before.
        learned: whether the frames were learned from.
    """

    number: int
    time: float
    measured: Measurements
    pose: Pose
    first: Pose
    elbow_deviations: np.ndarray
    frames: list[tuple[int, MeasuredFrame, tuple[int, int]]]
    quadratic: SilhouetteQuadratic | None = None
    learned: bool = False


@dataclass
class WindowState:
    """The window's events in certain poses.

    Attributes:
        poses: (T, 7 + D) packed, of which each is moved by
        steps: (T, N), until linearising has done so.
        quadratics: of each event's silhouettes, at poses near by.
        linear: the events there, once it was asked for.
    """

    poses: np.ndarray
    steps: np.ndarray
    quadratics: list[SilhouetteQuadratic | None]
    linear: Linearised | None = None

    def moved(self, steps: np.ndarray, _: np.ndarray | None = None) -> "WindowState":
        """The same events some steps (T, N) on; what was drawn stays where it was."""
        quadratics = [
            None if each is None else each._replace(offset=each.offset + step)
            for each, step in zip(self.quadratics, steps, strict=True)
        ]
        return WindowState(self.poses, steps, quadratics)
