"""A smoothing problem, and the trajectory that solves it.

Frames share the person's proportions and how each camera is turned. A calibration errs by some
tenths of a degree, which at three metres is a centimetre or two: the error of an elbow by a
silhouette. All frames err by it alike, so that together they determine it.

INPUTS: a Model, settings, measurements over time. OUTPUTS: SmoothingProblem, Trajectory; those
moved; the prior on what frames share.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import numpy as np
from jax import Array
from scipy.linalg import block_diag

from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, retract
from jaxmocap.body.proportions import covariance_among_people, scale_skeleton
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.compilation.arrays import on_device
from jaxmocap.compilation.programs import Program
from jaxmocap.evidence.keypoints import SightLines
from jaxmocap.evidence.silhouettes import SilhouetteGrids
from jaxmocap.evidence.smoothness import Smoothness, smoothness
from jaxmocap.evidence.terms import Measurements
from jaxmocap.geometry.cameras import Camera, turn_camera
from jaxmocap.smoothing.settings import SmoothingSettings

# A turn is a rotation vector.
TURN = 3
# Most calibrations err by little, and some cameras were pushed since: Student's t with so many
# degrees of freedom.
TURN_TAILS = 1.0
# Where the cameras are held to be as calibrated.
UNTURNED = np.zeros((0, TURN), np.float32)


class FirstPass(NamedTuple):
    """What a tracker's steps went through, and what they found.

    Attributes:
        times: (E,) seconds.
        markers_world: (E, M, 3) metres; NaN where missing.
        frame_index: (E, C) which frame of each camera's video belongs to an event; -1 for none.
        poses: (E, ...) by markers and video, event by event.
        reports: (E, ...) of the steps; ``marker_pose`` among them, by the markers alone.
        warnings: sentences about each event.
        both_ways: (E, ...) by the markers alone, in fast turns halfway between steps in time and
            steps backwards: neither late nor early. None of a causal run.
        sight_lines: of the landmarks (E, ...), where the recording brings key points.
    """

    times: np.ndarray
    markers_world: np.ndarray
    frame_index: np.ndarray
    poses: Pose
    reports: Any
    warnings: Sequence[Sequence[str]]
    both_ways: Pose | None = None
    sight_lines: SightLines | None = None

    @property
    def marker_poses(self) -> Pose:
        """(E, ...) by the markers alone, without lag where the whole recording is there."""
        return self.reports.marker_pose if self.both_ways is None else self.both_ways


class Views(NamedTuple):
    """V silhouettes, each of one camera in one frame."""

    frame: np.ndarray  # (V,) host integers, which frame of the trajectory
    camera: np.ndarray  # (V,) host integers, which camera
    grids: SilhouetteGrids  # what it shows of the person, (V, ...) each

    @classmethod
    def no_cameras(cls) -> "Views":
        """Where nothing is drawn at all."""
        nothing = np.zeros(0, np.int32)
        return cls(nothing, nothing, None)  # type: ignore[arg-type]

    @property
    def none(self) -> "Views":
        """No view at all."""
        return jax.tree.map(lambda part: part[:0], self)


@dataclass(frozen=True)
class SmoothingProblem:
    """A recording to be smoothed.

    Attributes:
        model: of the person, the markers and the cameras.
        settings: with the terms of evidence: ``SmoothingSettings``, or what has ``terms`` only
            where nothing is shared and there are no views.
        times: (T,) seconds.
        measured: (T, ...) of each frame.
        views: of all cameras.
    """

    model: Model
    settings: Any
    times: np.ndarray
    measured: Measurements
    views: Views

    def with_measured(self, **more: Any) -> "SmoothingProblem":
        """The same with more measurements."""
        return replace(self, measured=self.measured._replace(**more))

    def motion_prior(self) -> Smoothness:
        """The prior on the landmarks' motion."""
        accelerations = np.full(3 * len(LANDMARKS), float(self.settings.acceleration))
        return smoothness(self.times, accelerations)


class LeftOut(NamedTuple):
    """How sure L landmarks would be without some of the evidence."""

    kind: str  # "nothing", "marker", "camera", "key points" or "prior"
    # Index of the marker or the camera; name of a prior's setting, or "motion".
    which: int | str | None
    # (L,) medians over time of standard deviations, over the three axes, metres.
    deviations: np.ndarray


class Trajectory(NamedTuple):
    """What is solved for, and how sure it is.

    Attributes:
        poses: (T, ...).
        proportions: (P,) of the person.
        turns_cam: (C, 3) rotation vectors, by which each camera is turned in its own frame against
            its calibration, radians; ``UNTURNED`` where the calibration holds.
        deviations: (T, L, 3) standard deviations of the landmarks' coordinates, world, metres; None
            until they are asked for.
        from_prior: (T, L) 1 where markers and video leave a landmark almost as uncertain as it is
            without them, else 0; None likewise.
        left_out: how sure it would be without each part of the evidence; None likewise.
        unrecognised: (T, C) whether a camera has a frame in which nothing of the person was
            recognised; None likewise.
    """

    poses: Pose
    proportions: Array | np.ndarray
    turns_cam: Array | np.ndarray = UNTURNED
    deviations: np.ndarray | None = None
    from_prior: np.ndarray | None = None
    left_out: tuple[LeftOut, ...] | None = None
    unrecognised: np.ndarray | None = None

    def person(self, skeleton: Skeleton) -> Skeleton:
        """The skeleton with the estimated proportions."""
        return scale_skeleton(skeleton, self.proportions)


_retract = Program(jax.vmap(retract), "retract")
_turned = Program(jax.vmap(turn_camera), "turned")


def move_trajectory(trajectory: Trajectory, steps: np.ndarray, shared: np.ndarray) -> Trajectory:
    """A trajectory moved by tangent vectors (T, 6 + D), what it shares by (P + 3 C,).

    Turns are so small that they add up.
    """
    poses = jax.device_get(_retract(trajectory.poses, on_device(steps)))
    lengths, turns = np.split(shared, [trajectory.proportions.size])
    moved = trajectory.proportions + lengths, trajectory.turns_cam + turns.reshape(-1, TURN)
    proportions, turns_cam = (np.asarray(part, poses.angles.dtype) for part in moved)
    return Trajectory(poses, proportions, turns_cam)


def all_turned(cameras: Camera | None, turns_cam: Array | np.ndarray) -> Camera:
    """C cameras, stacked, turned by (C, 3); as they are by ``UNTURNED``."""
    assert cameras is not None
    if not len(turns_cam):
        return cameras
    return _turned(cameras, on_device(turns_cam, cameras.T_cam_world.dtype))


def shared_prior(
    settings: SmoothingSettings, camera: np.ndarray, trajectory: Trajectory
) -> tuple[np.ndarray, np.ndarray, float]:
    """The prior on what is shared, its Hessian, gradient and cost, in each frame.

    It weighs like so many more views of each view: what silhouettes get wrong they get wrong in
    every frame, so that many frames are no more sure of a length, or of a turn, than few.

    Args:
        settings: of the smoothing; its ``camera`` is asked for where cameras may turn.
        camera: (V,) which camera each view is of.
        trajectory: of T frames, over which the prior is spread.
    """
    proportions, turns_cam = trajectory.proportions, trajectory.turns_cam
    if not proportions.size + turns_cam.size:
        return np.zeros((0, 0)), np.zeros(0), 0.0
    cameras, share = len(turns_cam), float(settings.proportions) / len(trajectory.poses.angles)
    lengths = np.ravel(proportions).astype(float)
    own = np.linalg.inv(covariance_among_people(proportions.size)) * max(len(camera), 1)
    cost, turns = float(lengths @ own @ lengths), np.zeros((0, 0))
    if cameras:
        views = np.maximum(np.bincount(camera, minlength=cameras)[:cameras], 1)
        squares = np.sum(np.square(turns_cam.astype(float) / float(settings.camera)), -1)
        far = 1 + squares / TURN_TAILS
        cost += float(np.sum(views * TURN_TAILS * np.log(far)))
        turns = np.diag(np.repeat(views / np.square(float(settings.camera)) / far, TURN))
    weights = np.asarray(block_diag(own, turns)) * share
    x = np.concatenate([lengths, np.ravel(turns_cam)])
    return weights, weights @ x, cost * share


def among_cameras(
    hessian: np.ndarray, gradient: np.ndarray, camera: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Views' terms (V, N + 3, ...), the last by their own camera's turn, by those of all cameras.

    Args:
        hessian: (V, N + 3, N + 3).
        gradient: (V, N + 3).
        camera: (V,) which it is.
        count: C cameras that may be turned; with none, the turns' terms are left out.

    Returns:
        Hessians (V, N + 3 C, N + 3 C) and gradients (V, N + 3 C).
    """
    own = gradient.shape[1] - TURN
    if not count:
        return hessian[:, :own, :own], gradient[:, :own]
    size = own + TURN * count
    wide, long = np.zeros((len(camera), size, size)), np.zeros((len(camera), size))
    for c in range(count):
        rows = np.flatnonzero(camera == c)
        columns = np.r_[:own, own + TURN * c : own + TURN * (c + 1)]
        wide[np.ix_(rows, columns, columns)] = hessian[rows]
        long[np.ix_(rows, columns)] = gradient[rows]
    return wide, long
