"""Where the markers' own pose faces and leans, and where it has the ankles: for pelvis and ground.

The facing is averaged, since a person turns more slowly than it errs: over the time around where
all of it is there, over the time before where it is not.

The markers' own poses go on from one another, and so turn late: with the trunk turned to the left
they still face right. Over a whole recording a smoothing of the markers turns in time. It starts
halfway to poses that go on backwards, where these face elsewhere.

INPUTS: poses of the markers alone. OUTPUTS: measurements.
"""

from dataclasses import replace

import jax
import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from jaxmocap.body.model import Model
from jaxmocap.body.motion import landmarks_over_time
from jaxmocap.body.pose import Pose, halfway
from jaxmocap.body.proportions import PROPORTIONS
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.compilation.arrays import on_device
from jaxmocap.compilation.programs import Program
from jaxmocap.evidence.ground import ANKLES
from jaxmocap.evidence.posture import UNMARKED_FACING
from jaxmocap.evidence.terms import Measurements
from jaxmocap.geometry.rotations import quaternion_to_matrix
from jaxmocap.smoothing.linearise import smooth_poses
from jaxmocap.smoothing.problem import UNTURNED, SmoothingProblem, Trajectory, Views
from jaxmocap.smoothing.settings import SmoothingSettings, weigh_by_time

# Standard deviation of the average over the time around, seconds.
AROUND_S = 0.5
# Time constant of the average over the time before, seconds.
BEFORE_S = 0.35

# Who faces elsewhere backwards than in time, by more than this, radians, turns by a hysteresis. Six
# people who turn differ by up to 2.7, strokes by 0.5; 0.5 to 1.0 end alike.
HYSTERESIS_RAD = 0.8
# By how much a smoothing of the markers turns from where their own poses face, radians (standard
# deviation). With 1.0 thrusting arms turn the trunk, with 0.3 it is late.
TURNED_RAD = 0.5
# So many events a second are enough for it.
EVENTS_HZ = 30.0
# Longer steps are pauses, seconds.
LONGEST_STEP_S = 0.1

# As one program: step by step each step would compile for every number of events.
_matrices = Program(jax.vmap(quaternion_to_matrix), "matrices")


def references(skeleton: Skeleton, times: np.ndarray, poses: Pose) -> Measurements:
    """Measured ``upright``, ``facing`` and ``ankles`` (T, ...) of poses by the markers alone."""
    R = np.asarray(_matrices(on_device(poses.quaternion)))
    ankles = landmarks_over_time(skeleton, poses, ANKLES)
    facing = _level(average_over_time(R[:, :2, 0], times))
    # Copies: what is a part of a larger array would keep that one.
    upright, facing, ankles = (
        np.array(part, skeleton.lengths.dtype) for part in (R[:, :2, 2], facing, ankles)
    )
    return Measurements(upright=upright, facing=facing, ankles=ankles)


def without_hysteresis(times: np.ndarray, poses: Pose, backwards: Pose) -> Pose:
    """Poses (T, ...) by the markers alone, halfway to those backwards around a fast turn.

    A trunk follows its hands late in time, and as much too early backwards.

    Args:
        times: (T,) seconds.
        poses: (T, ...), each from the one before.
        backwards: (T, ...), each from the one after.
    """
    each = (
        np.asarray(_matrices(on_device(one.quaternion)))[:, :2, 0] for one in (poses, backwards)
    )
    alike = np.sum(np.prod([unit(ahead) for ahead in each], 0), -1)
    around = 2 * round(AROUND_S / _mean_step(times)) + 1
    turns = maximum_filter1d(alike < np.cos(HYSTERESIS_RAD), around, mode="nearest")
    both = zip(poses, halfway(poses, backwards), strict=True)
    return Pose(*(np.where(turns[:, None], other, own) for own, other in both))  # type: ignore[arg-type]


def facing_in_time(
    model: Model,
    settings: SmoothingSettings,
    times: np.ndarray,
    measured: Measurements,
    poses: Pose,
) -> np.ndarray:
    """Where somebody faces (T, 3) whose feet have no marker, by all markers at once.

    Args:
        model: of the person, the markers and the cameras, which take no part.
        settings: of the smoothing.
        times: (T,) seconds.
        measured: with the ``references`` of the poses.
        poses: (T, ...) by the markers alone.
    """
    stride = max(1, int(1 / (EVENTS_HZ * _mean_step(times)) + 1e-3))
    rows = np.arange(0, len(times), stride)
    pelvis = replace(settings.pelvis, facing=on_device(TURNED_RAD / UNMARKED_FACING))
    # Markers alone tell little of lengths: they count as if each event were a view.
    lengths = settings.proportions * len(rows)
    problem = SmoothingProblem(
        model,
        weigh_by_time(replace(settings, pelvis=pelvis, proportions=lengths), times[rows]),
        times[rows],
        jax.tree.map(lambda part: part[rows], measured),
        Views.no_cameras(),
    )
    some = jax.tree.map(lambda part: np.asarray(part)[rows], poses)
    start = Trajectory(some, np.zeros(len(PROPORTIONS), model.dtype), UNTURNED)
    found = smooth_poses(problem, start, (1.0,)).trajectory.poses
    ahead = np.asarray(_matrices(on_device(found.quaternion)))[:, :2, 0]
    every = np.stack([np.interp(times, times[rows], column) for column in ahead.T], -1)
    return _level(every).astype(model.dtype)


def _mean_step(times: np.ndarray) -> float:
    """Seconds from event to event, whose steps alternate where samples and frames do."""
    return float(np.minimum(np.diff(times), LONGEST_STEP_S).mean()) if len(times) > 1 else 1.0


def average_over_time(
    values: np.ndarray, times: np.ndarray, around_s: float = AROUND_S
) -> np.ndarray:
    """Values (T, N) over the time around: a Gaussian of so many seconds, of even samples."""
    return gaussian_filter1d(values, around_s / _mean_step(times), axis=0, mode="nearest")


class RunningFacing:
    """The same facing of one pose after the other."""

    def __init__(self) -> None:
        self._ahead: np.ndarray | None = None

    def step(self, ahead: np.ndarray, elapsed: float) -> np.ndarray:
        """(3,) unit and horizontal, from (2,) of the newest pose, seconds after the last."""
        average = np.asarray(ahead, float) if self._ahead is None else self._ahead
        average = average + (1 - np.exp(-elapsed / BEFORE_S)) * (ahead - average)
        self._ahead = average
        return _level(average)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 2) of length 1; shorter where they have none."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)


def _level(ahead: np.ndarray) -> np.ndarray:
    """Unit and horizontal (..., 3) of (..., 2)."""
    return np.concatenate([unit(ahead), np.zeros_like(ahead[..., :1])], -1)
