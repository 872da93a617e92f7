"""Events that can still change: what a window keeps of each.

INPUTS: what a step of a tracker measured and found. OUTPUTS: WindowEvents; what is expected there.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, Protocol

import jax
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import landmarks
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, difference, retract, unpack
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.compilation.arrays import pack_leaves, unpack_leaves
from jaxmocap.compilation.programs import program
from jaxmocap.evidence.appearance.running import NO_GRIDS, MeasuredFrame
from jaxmocap.evidence.ground import ANKLES
from jaxmocap.evidence.keypoints import SightLines
from jaxmocap.evidence.terms import Measurements
from jaxmocap.geometry.rotations import quaternion_to_matrix
from jaxmocap.smoothing.window.state import NEW, EventArrays

# A frame of each camera, None where there is no new one.
Images = Sequence[np.ndarray | None] | None
# Of what an ``Expected`` holds beside the pose.
_EXPECTED_SHAPES = np.empty(2), np.empty(2), np.empty((2, 3))


class StepReported(Protocol):
    """What a tracker's step reports of itself."""

    @property
    def marker_pose(self) -> Pose:
        """By the markers alone."""
        ...

    @property
    def placed(self) -> Array:
        """Whether the body was placed again."""
        ...


class ReportedStep(NamedTuple):
    """A step of the tracker that waits for the next video frame; steps are counted from 0."""

    number: int
    time: float
    markers_world: np.ndarray | Array
    images: Images
    report: StepReported
    lines: SightLines | None = None  # of cameras with key points, (K, ...)

    @property
    def has_image(self) -> bool:
        """Whether any camera has a new one."""
        return any_image(self.images)


def any_image(images: Images) -> bool:
    """Whether any camera has a new one."""
    return any(image is not None for image in images or ())


class Expected(NamedTuple):
    """What is expected at an event before it is solved."""

    pose: Pose  # the last one, moved as the markers' pose moved
    ahead: Array | np.ndarray  # (2,) horizontal part of the x axis of the markers' pelvis
    upright: Array | np.ndarray  # (2,) of its z axis
    ankles: Array | np.ndarray  # (2, 3) of the markers' pose, world, metres


def expect_poses(
    skeleton: Skeleton, last: np.ndarray, before: np.ndarray, alone: Sequence[np.ndarray]
) -> list[Expected]:
    """At some events in turn: the last pose moved as the markers' poses moved, and what those tell.

    Args:
        skeleton: D degrees of freedom.
        last: (7 + D,) packed, the last pose.
        before: the markers' pose there.
        alone: their pose at each event.
    """
    shapes, result = Expected(unpack(last), *_EXPECTED_SHAPES), []
    for now in alone:
        result.append(unpack_leaves(np.asarray(_expect_pose(skeleton, last, before, now)), shapes))
        last, before = np.concatenate(result[-1].pose), now
    return result


@program("quick")
def _expect_pose(skeleton: Skeleton, last: Array, before: Array, now: Array) -> Array:
    """Packed ``Expected``, of the last pose and of the markers' there and now, packed (7 + D,)."""
    there = unpack(now)
    moved = retract(unpack(last), difference(there, unpack(before)))
    R = quaternion_to_matrix(there.quaternion)
    ankles = landmarks(skeleton, there)[ANKLES]
    return pack_leaves(Expected(moved, R[:2, 0], R[:2, 2], ankles))


# A camera, what was measured in its frame, width and height of that.
WindowFrame = tuple[int, MeasuredFrame, tuple[int, int]]


@dataclass
class WindowEvent:
    """One step of the tracker, while it can still change."""

    number: int  # of it, counted from 0
    time: float  # seconds
    markers_world: np.ndarray  # (M, 3) metres; NaN where missing
    pose: Pose  # as it is now
    frames: list[WindowFrame]  # of the cameras that had a new one
    learned: bool = False  # whether the frames were learned from

    @property
    def unrecognised(self) -> tuple[int, ...]:
        """Cameras with a new frame of which nothing counts, for the person or against."""
        return tuple(camera for camera, frame, _ in self.frames if not frame.grids.recognised)


def new_events(
    model: Model,
    events: Sequence[WindowEvent],
    measured: Sequence[Measurements],
    lines: Sequence[SightLines],
    since: Sequence[float],
    before: EventArrays | None,
) -> EventArrays:
    """Events that come into a window, as arrays; ``NEW`` rows, of which the first are there.

    Args:
        model: of the person, the markers and the cameras.
        events: at most as many.
        measured: of each, besides silhouettes and key points.
        lines: (K, ...) of each; none where no camera has key points.
        since: seconds from the event before each.
        before: those that came last, which fill up; None at first.
    """
    dtype, cameras = model.dtype, model.camera_count
    if not events:
        assert before is not None
        return before._replace(filled=np.int32(0))
    rows = np.minimum(np.arange(NEW), len(events) - 1)
    shown = np.zeros((NEW, cameras), bool)
    grids = None
    if cameras:
        grids = jax.tree.map(lambda part: np.zeros((NEW, cameras, *part.shape), dtype), NO_GRIDS)
        for row, event in enumerate(events):
            for camera, frame, _ in event.frames:
                shown[row, camera] = True
                jax.tree.map(partial(_put, (row, camera)), grids, frame.grids)

    def stacked(each: Sequence[Any]) -> Any:
        return jax.tree.map(lambda *parts: np.stack(parts)[rows], *each)

    return EventArrays(
        np.int32(len(events)), np.asarray(since, dtype)[rows],
        np.stack([np.concatenate(event.pose) for event in events]).astype(dtype)[rows],
        stacked(measured), shown, grids, stacked(lines) if lines else None,
    )  # fmt: skip


def _put(where: tuple[int, int], every: np.ndarray, one: np.ndarray) -> None:
    every[where] = one
