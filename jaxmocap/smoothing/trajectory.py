"""The trajectory that a recording is smoothed to: all its poses, and what the frames share.

They share the person's proportions and how each camera is turned. A calibration errs by some tenths
of a degree, which at three metres is a centimetre or two: as far as a silhouette tells an elbow.
All frames err by it alike, so that together they can tell it.

INPUTS: poses, proportions, cameras' turns. OUTPUTS: those moved, the prior on what is shared.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.linalg import block_diag

from jaxmocap.body.pose import Pose, retract
from jaxmocap.body.proportions import covariance_among_people
from jaxmocap.geometry.cameras import Camera, turned
from jaxmocap.smoothing.settings import SmoothingSettings

# A turn is a rotation vector.
TURN = 3
# Where the cameras are held to be as calibrated.
UNTURNED = np.zeros((0, TURN), np.float32)


class Trajectory(NamedTuple):
    """What is solved for.

    Attributes:
        poses: (T, ...).
        proportions: (P,) of the person.
        turns_cam: (C, 3) rotation vectors, by which each camera is turned in its own frame against
            its calibration, radians; ``UNTURNED`` where the calibration holds.
    """

    poses: Pose
    proportions: Array | np.ndarray
    turns_cam: Array | np.ndarray = UNTURNED


_retract = jax.jit(jax.vmap(retract))


def moved_by(trajectory: Trajectory, steps: np.ndarray, shared: np.ndarray) -> Trajectory:
    """A trajectory moved by tangent vectors (T, 6 + D), what it shares by (P + 3 C,).

    Turns are so small that they add up.
    """
    poses = jax.device_get(_retract(trajectory.poses, jnp.asarray(steps, float)))
    lengths, turns = np.split(shared, [trajectory.proportions.size])
    moved = trajectory.proportions + lengths, trajectory.turns_cam + turns.reshape(-1, TURN)
    return Trajectory(poses, *(np.asarray(part, poses.angles.dtype) for part in moved))


def all_turned(cameras: Camera, turns_cam: Array | np.ndarray) -> Camera:
    """C cameras, stacked, turned by (C, 3); as they are by ``UNTURNED``."""
    if not len(turns_cam):
        return cameras
    cameras = jax.tree.map(jnp.asarray, cameras)
    return jax.vmap(turned)(cameras, jnp.asarray(turns_cam, cameras.T_cam_world.dtype))


def shared_prior(
    settings: SmoothingSettings, camera: np.ndarray, trajectory: Trajectory
) -> tuple[np.ndarray, np.ndarray, float]:
    """The prior on what is shared, its Hessian, gradient and cost, in each frame.

    It weighs like so many more sights of each sight: what silhouettes get wrong they get wrong in
    every frame, so that many frames are no more sure of a length, or of a turn, than few.

    Args:
        settings: of the smoothing.
        camera: (V,) which camera each sight is of.
        trajectory: of T frames, over which the prior is spread.
    """
    (_, proportions, turns_cam), cameras = trajectory, len(trajectory.turns_cam)
    own = np.linalg.inv(covariance_among_people(proportions.size)) * max(len(camera), 1)
    seen = np.maximum(np.bincount(camera, minlength=cameras)[:cameras], 1)
    turns = np.diag(np.repeat(seen, TURN)) / np.square(float(settings.camera))
    share = float(settings.proportions) / len(trajectory.poses.angles)
    weights = np.asarray(block_diag(own, turns)) * share
    x = np.concatenate([np.ravel(proportions), np.ravel(turns_cam)]).astype(float)
    return weights, weights @ x, float(x @ weights @ x)


def among_cameras(
    hessian: np.ndarray, gradient: np.ndarray, camera: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Sights' terms (V, N + 3, ...), the last by their own camera's turn, by those of all cameras.

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
