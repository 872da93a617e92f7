"""Steps of the tracker that can still change: what a window keeps of each.

INPUTS: what a step found and saw. OUTPUTS: Events; where they stand in a solve.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxmocap.body.pose import Pose
from jaxmocap.evidence.appearance.running import Seen
from jaxmocap.evidence.residuals import Known
from jaxmocap.smoothing.levenberg_marquardt import Linearised


class Drawn(NamedTuple):
    """What an event's silhouettes tell, about a pose where they were drawn.

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
class Event:
    """One step of the tracker, while it can still change.

    Attributes:
        number: of it, counted from 0.
        time: seconds.
        known: what is known of it besides its sights.
        pose: as it is now.
        first: as the tracker found it.
        spread: (2,) the tracker's, of the elbows, metres.
        looks: camera, what it saw, width and height of its frame.
        drawn: what the looks told when they were last drawn; None before.
        learned: whether the looks were learned from.
    """

    number: int
    time: float
    known: Known
    pose: Pose
    first: Pose
    spread: np.ndarray
    looks: list[tuple[int, Seen, tuple[int, int]]]
    drawn: Drawn | None = None
    learned: bool = False


@dataclass
class Standing:
    """The window's events in certain poses.

    Attributes:
        poses: (T, 7 + D) packed, of which each is moved by
        steps: (T, N), until linearising has done so.
        drawn: of each event, at poses near by.
        linear: the events there, once it was asked for.
    """

    poses: np.ndarray
    steps: np.ndarray
    drawn: list[Drawn | None]
    linear: Linearised | None = None

    def moved(self, steps: np.ndarray) -> "Standing":
        """The same events some steps (T, N) on; what was drawn of them is left where it was."""
        drawn = [
            None if each is None else each._replace(offset=each.offset + step)
            for each, step in zip(self.drawn, steps, strict=True)
        ]
        return Standing(self.poses, steps, drawn)
