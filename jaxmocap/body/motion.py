"""What tracking returns: poses over time, and a report on each of them.

Plain NumPy arrays and text: nothing here is traced.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import numpy as np

from jaxmocap.body.kinematics import landmarks
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import ELBOWS, LANDMARKS, Skeleton
from jaxmocap.compilation.arrays import on_device
from jaxmocap.compilation.batches import GatheredRows
from jaxmocap.compilation.programs import Program
from jaxmocap.geometry.origin import local_origin
from jaxmocap.geometry.rows import Index

# A report's arrays with a row for each sample.
SAMPLED = ("marker_errors", "arm_costs", "swivels", "landmarks_std", "from_prior")
# What files have of a ``Run`` by silhouettes, in this order.
BY_SILHOUETTES = (
    *("recording", "cameras", "markers", "deviations"),
    *("warnings", "tracker", "video_frames", "seconds"),
)
# A landmark whose standard deviation over the three axes is larger, metres, is stated as one that
# nothing determines.
UNDETERMINED_M = 0.15
# Poses in one call of a function over a motion, at least and at most.
FEWEST, MOST = 64, 16384


@dataclass(frozen=True)
class Run:
    """What was tracked, and how: the "settings" of report.json."""

    recording: str = ""  # its path, or its name
    mode: str | None = None  # of the video's frames, see ``track``; None by silhouettes
    cameras: tuple[str, ...] = ()  # their names
    markers: tuple[str, ...] = ()  # theirs
    warnings: tuple[str, ...] = ()
    filters: dict[str, Any] = field(default_factory=dict)  # which were on, what they changed
    tracker: dict[str, Any] = field(default_factory=dict)  # its settings
    camera_turns_deg: dict[str, list[float]] = field(default_factory=dict)  # in its own frame
    deviations_without_m: dict[str, dict[str, float]] = field(default_factory=dict)  # by landmark
    deviations: dict[str, str | None] = field(default_factory=dict)  # whom they were calibrated on
    latency: dict[str, float] = field(default_factory=dict)  # within which poses are given out
    video_frames: int = 0  # instants of the videos that were used
    seconds: dict[str, float] = field(default_factory=dict)  # of each pass
    fitted: str | None = None  # to markers that determine the body; None where they do not

    def as_dict(self) -> dict[str, Any]:
        """As report.json and motion.npz have it."""
        names = BY_SILHOUETTES if self.mode is None else vars(self)
        return {name: value for name in names if (value := getattr(self, name)) is not None}


@dataclass(frozen=True)
class Report:
    """How good each of T samples is.

    Attributes:
        markers: names of the M markers tracked.
        marker_errors: (T, M) distance of each marker to its point on the body, metres; NaN where
            the marker is missing.
        arm_costs: (T, 2) mean distance of the left and the right arm's outline to the nearest
            edge, pixels; NaN where no video frame was used.
        swivels: (T, 2) turn of the left and the right arm about shoulder and hand that video added
            to the markers' pose, radians.
        landmarks_std: (T, L, 3) standard deviations of the ``LANDMARKS``' coordinates, world,
            metres; NaN where they were not estimated.
        from_prior: (T, L) 1 where a landmark comes from the prior alone, neither marker nor video
            determining much of it, else 0; NaN where it was not estimated.
        statuses: T tuples of sentences; empty where there is no warning.
        milliseconds: stage -> times of its calls.
        run: what was tracked, and how.
    """

    markers: tuple[str, ...]
    marker_errors: np.ndarray
    arm_costs: np.ndarray
    swivels: np.ndarray
    landmarks_std: np.ndarray
    from_prior: np.ndarray
    statuses: tuple[tuple[str, ...], ...]
    milliseconds: dict[str, np.ndarray] = field(default_factory=dict)
    run: Run = field(default_factory=Run)

    @property
    def elbow_deviations(self) -> np.ndarray:
        """(T, 2) standard deviations of left and right elbow, over the three axes, metres."""
        return np.sqrt(np.sum(np.asarray(self.landmarks_std)[:, ELBOWS].astype(float) ** 2, -1))

    @property
    def deviations(self) -> np.ndarray:
        """(T, L) standard deviations of the ``LANDMARKS``, over the three axes, metres."""
        return np.linalg.norm(self.landmarks_std, axis=-1)

    @property
    def undetermined_shares(self) -> np.ndarray:
        """(L,) of samples with a deviation, in how many it is above ``UNDETERMINED_M``; or NaN."""
        counts = np.isfinite(self.deviations).sum(0)
        above = (self.deviations > UNDETERMINED_M).sum(0)
        return np.where(counts > 0, above / np.maximum(counts, 1), np.nan)


@dataclass(frozen=True)
class Motion:
    """Poses of one skeleton over T samples.

    Attributes:
        skeleton: whose poses these are.
        times: (T,) seconds, float64, marker time.
        poses: position (T, 3) seen from ``origin_world``, quaternion (T, 4), angles (T, D).
        report: on every sample, or None.
        origin_world: (3,) metres, float64; not zero where the world's own origin is far away, see
            ``geometry.origin``.
    """

    skeleton: Skeleton
    times: np.ndarray
    poses: Pose
    report: Report | None = None
    origin_world: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def __repr__(self) -> str:
        """In one line."""
        angles = np.asarray(self.poses.angles)
        missing = int(np.isnan(angles).any(-1).sum())
        span = f" from {self.times[0]:.2f} to {self.times[-1]:.2f} s" if len(self.times) else ""
        report = "no report" if self.report is None else "a report"
        joints = len(self.skeleton.tree.joints)
        return f"Motion({len(angles)} poses of {joints} joints{span}, {missing} missing, {report})"

    @property
    def positions_world(self) -> np.ndarray:
        """(T, 3) where the pelvis is, world, Z up, metres."""
        return _shift_points(np.asarray(self.poses.position), self.origin_world)

    def joints(self) -> dict[str, np.ndarray]:
        """Landmark name -> (T, 3) positions, world, Z up, metres."""
        points = self.joint_positions()
        return {name: points[:, i] for i, name in enumerate(LANDMARKS)}

    def joint_positions(self) -> np.ndarray:
        """Positions (T, L, 3) of the ``LANDMARKS``, world, Z up, metres."""
        return _shift_points(landmarks_over_time(self.skeleton, self.poses), self.origin_world)

    def deviations(self) -> dict[str, np.ndarray] | None:
        """Landmark name -> (T, 3) standard deviations, world, metres; None without a report."""
        if self.report is None:
            return None
        stated = np.asarray(self.report.landmarks_std)
        return {name: stated[:, i] for i, name in enumerate(LANDMARKS)}


def every_nth(motion: Motion, n: int) -> Motion:
    """One sample in n; a report's statuses are those of all n."""
    if n == 1:
        return motion
    report = motion.report
    if report is not None:
        starts = range(0, len(report.statuses), n)
        report = replace(
            report,
            **{name: np.asarray(getattr(report, name))[::n] for name in SAMPLED},
            statuses=tuple(
                tuple(dict.fromkeys(line for lines in report.statuses[i : i + n] for line in lines))
                for i in starts
            ),
            milliseconds={stage: spent[::n] for stage, spent in report.milliseconds.items()},
        )
    poses = Pose(*(np.asarray(part)[::n] for part in motion.poses))  # type: ignore[arg-type]
    return replace(motion, times=motion.times[::n], poses=poses, report=report)


def near_origin(motion: Motion) -> Motion:
    """A motion whose poses are in the world, seen from a local origin if that is far away."""
    origin = local_origin(motion.positions_world)
    if not origin.any():
        return motion
    position = motion.positions_world - origin
    return replace(motion, poses=motion.poses._replace(position=position), origin_world=origin)


def _shift_points(points: np.ndarray, origin_world: np.ndarray) -> np.ndarray:
    """Points (..., 3) seen from the world's origin; in double precision where it is elsewhere."""
    return points + np.asarray(origin_world, float) if np.any(origin_world) else points


def landmarks_over_time(skeleton: Skeleton, poses: Pose, rows: Index = slice(None)) -> np.ndarray:
    """Positions (T, L, 3), world, metres, of the ``LANDMARKS``, or some, at poses (T, ...)."""
    return in_blocks(lambda *each: np.asarray(_over_time(*each))[:, rows], skeleton, poses)


def in_blocks(function: Callable[[Skeleton, Pose], Any], skeleton: Skeleton, poses: Pose) -> Any:
    """What a function makes of poses (T, ...), called with some at a time: memory is bounded.

    Args:
        function: of a skeleton and poses (N, ...), to a tree of arrays (N, ...).
        skeleton: of the poses.
        poses: any number.
    """
    count = len(poses.angles)
    if not count:
        one = (np.zeros((1, *part.shape[1:]), part.dtype) for part in poses)
        rows = jax.eval_shape(function, skeleton, Pose(*map(on_device, one)))
        return jax.tree.map(lambda part: np.empty((0, *part.shape[1:]), part.dtype), rows)
    # Motions of many lengths share few compilations: the last pose fills up to a power of two.
    size = min(max(FEWEST, 1 << (count - 1).bit_length()), MOST)
    gathered = GatheredRows(count)
    for first in range(0, count, size):
        rows = np.minimum(np.arange(first, first + size), count - 1)
        filled = (on_device(np.asarray(part)[rows]) for part in poses)
        gathered.put(first, jax.tree.map(np.asarray, function(skeleton, Pose(*filled))))
    return gathered.tree


# Of the module, so that motions of one skeleton share them.
_over_time = Program(jax.vmap(landmarks, (None, 0)), "landmarks_over_time")
