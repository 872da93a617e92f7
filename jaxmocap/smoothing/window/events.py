"""Events that can still change: what a window keeps of each.

INPUTS: what a step of a tracker measured and found. OUTPUTS: WindowEvents; their state in a solve.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jax import Array

from jaxmocap.body.kinematics import landmarks
from jaxmocap.body.pose import Pose, difference, retract, unpack
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.compilation.packing import packed, unpacked
from jaxmocap.compilation.programs import program
from jaxmocap.evidence.appearance.running import MeasuredFrame
from jaxmocap.evidence.ground import ANKLES
from jaxmocap.evidence.terms import Measurements
from jaxmocap.geometry.rotations import quaternion_to_matrix
from jaxmocap.smoothing.levenberg_marquardt import Linearised

# Of what an ``Expected`` holds beside the pose.
_EXPECTED_SHAPES = np.empty(2), np.empty(2), np.empty((2, 3))


class Expected(NamedTuple):
    """What is expected at an event before it is solved.

    Attributes:
        pose: the last one, moved as the markers' pose moved.
        ahead: (2,) horizontal part of the x axis of the markers' pelvis.
        upright: (2,) of its z axis.
        ankles: (2, 3) of the markers' pose, world, metres.
    """

    pose: Pose
    ahead: Array | np.ndarray
    upright: Array | np.ndarray
    ankles: Array | np.ndarray


def expected_at(skeleton: Skeleton, poses: np.ndarray) -> Expected:
    """The last pose moved as the markers' pose moved; where that faces and leans; its ankles.

    Args:
        skeleton: D degrees of freedom.
        poses: (3, 7 + D) packed: the last pose, the markers' pose there, and their pose now.
    """
    vector = np.asarray(_expected(skeleton, poses))
    return unpacked(vector, Expected(unpack(poses[0]), *_EXPECTED_SHAPES))


@program("quick")
def _expected(skeleton: Skeleton, poses: Array) -> Array:
    """``expected_at``, packed."""
    last, before, alone = (unpack(each) for each in poses)
    ankles = landmarks(skeleton, alone)[ANKLES]
    moved = retract(last, difference(alone, before))
    R = quaternion_to_matrix(alone.quaternion)
    return packed(Expected(moved, R[:2, 0], R[:2, 2], ankles))


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
