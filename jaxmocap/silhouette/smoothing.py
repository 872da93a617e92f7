"""All poses of a recording at once: by each frame's pairs, and because people move smoothly.

A frame's pairs tell some directions of a pose well and others hardly: an arm's turn about its own
axis shows only where the elbow is bent. What they leave open, prediction from the frames before
fills in, and drags behind; the frames before and after together know better. Each frame counts by
the quadratic that its pairs left about the pose found there, landmarks move with accelerations that
are white noise, and all of it is solved as one banded system. How large a landmark's accelerations
are the recording tells: a hand on the floor hardly moves, a jumper's does, and who is smoothed as
the other either shakes or lags.

INPUTS: poses, Hessians and slopes of all frames, a Morph where joints go along.
OUTPUTS: the poses that suit them all.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from threadpoolctl import threadpool_limits

from jaxmocap.body.kinematics import landmarks
from jaxmocap.body.pose import Pose, difference, retract
from jaxmocap.body.skeleton import LANDMARKS, ROOT_DOF, Skeleton
from jaxmocap.compilation.batches import in_batches
from jaxmocap.evidence.smoothness import REACH, accelerations_of, smoothness
from jaxmocap.silhouette.device_functions import landmark_jacobian
from jaxmocap.silhouette.surfaces.morph import Morph, without_followers
from jaxmocap.smoothing.levenberg_marquardt import Linearised, SolverSettings, minimise

# Frames that are linearised in one call: any recording's fill some, and compile once.
FRAMES_A_CALL = 32
# In each round. The frames' quadratics hold near the poses found only: more are not worth it.
STEPS = 3


class FrameInformation(NamedTuple):
    """What the pairs of T frames tell.

    Attributes:
        poses: (T, ...) that were found.
        information: (T, 6 + D, 6 + D) of ``PoseResult``; 0 where nothing was visible.
        slope: (T, 6 + D) likewise.
    """

    poses: Pose
    information: np.ndarray
    slope: np.ndarray


class PoseSmoothingSettings(NamedTuple):
    """What a user may tune.

    Attributes:
        acceleration: deviation of the landmarks' accelerations, m / s^2 * sqrt(s), see
            ``smoothness``, before the recording has shown how each moves, and at most.
        own_share: what counts from then on, as a share of each landmark's own. Pairs that err alike
            count as if they did not: less than 1 by as much.
        least_acceleration: of it all the same, m / s^2 * sqrt(s).
        rounds: times that accelerations are estimated.
        pose_deviation: of a pose about the one that was found, metres and radians: farther off
            the pairs would be others.
    """

    acceleration: float = 1.0
    own_share: float = 0.5
    least_acceleration: float = 0.1
    rounds: int = 3
    pose_deviation: float = 0.1


def smoothed_poses(
    skeleton: Skeleton,
    times: np.ndarray,
    information: FrameInformation,
    rest: np.ndarray,
    settings: PoseSmoothingSettings,
    morph: Morph | None = None,
) -> Pose:
    """The poses (T, ...) of a whole recording.

    Args:
        skeleton: of the person.
        times: (T,) seconds.
        information: frame by frame.
        rest: (D,) deviations of joints that are held about 0, radians; infinite for the others.
        settings: how smoothly.
        morph: what goes along with the joints' angles: such joints are held about where they go.
    """
    if len(times) <= REACH:
        return information.poses
    rest_precision = rest**-2.0
    slope = information.slope.astype(float)
    H = information.information + np.eye(slope.shape[-1]) / settings.pose_deviation**2

    def linearise(poses: Pose) -> Linearised:
        about = partial(_about, skeleton, morph)
        off, angles, bent, points, by = in_batches(about, (poses, information.poses), FRAMES_A_CALL)
        pulled = np.einsum("tij,tj->ti", H, off)
        cost = np.sum(off * (pulled + 2 * slope), 1) + angles**2 @ rest_precision
        firm = bent.swapaxes(1, 2) * rest_precision
        gradient = pulled + slope + np.einsum("tid,td->ti", firm, angles)
        return Linearised(cost, H + firm @ bent, gradient, points, by)

    def smoothly(poses: Pose, accelerations: np.ndarray) -> Pose:
        prior, move = smoothness(times, accelerations), partial(_moved, skeleton)
        # A band is narrow: BLAS's own threads would only wait for one another.
        with threadpool_limits(1, user_api="blas"):
            return minimise(linearise, move, poses, prior, SolverSettings(iterations=STEPS)).x

    poses = smoothly(information.poses, np.full(3 * len(LANDMARKS), settings.acceleration))
    for _ in range(settings.rounds):
        own = settings.own_share * _accelerations(skeleton, times, poses)
        # A limb that was lost and found again has large ones too: never looser than at first.
        own = np.clip(own, settings.least_acceleration, settings.acceleration)
        poses = smoothly(poses, np.repeat(own, 3))
    return poses


def _accelerations(skeleton: Skeleton, times: np.ndarray, poses: Pose) -> np.ndarray:
    """(L,) each landmark's, m / s^2 * sqrt(s), root mean square."""
    (places,) = in_batches(partial(_places, skeleton), (poses,), FRAMES_A_CALL)
    squares = accelerations_of(times, places) ** 2
    return np.sqrt(squares.reshape(len(squares), -1, 3).mean((0, 2)))


@jax.jit
def _places(skeleton: Skeleton, poses: Pose) -> Array:
    """(T, 3 L) landmarks."""
    places = jax.vmap(partial(landmarks, skeleton))(poses)
    return places.reshape(len(places), -1)


@jax.jit
def _about(
    skeleton: Skeleton, morph: Morph | None, poses: Pose, found: Pose
) -> tuple[Array, Array, Array, Array, Array]:
    """T poses: off those found (T, 6 + D); joints' own angles (T, D), landmarks (T, 3 L).

    Each of the two before its derivatives by the tangent vector of ``retract``.
    """

    def own(pose: Pose) -> Array:
        return (pose if morph is None else without_followers(morph, pose)).angles

    def bent(pose: Pose) -> Array:
        still = jnp.zeros(ROOT_DOF + pose.angles.size, pose.angles.dtype)
        return jax.jacfwd(lambda step: own(retract(pose, step)))(still)

    places = _places(skeleton, poses)
    by = jax.vmap(partial(landmark_jacobian, skeleton))(poses)
    angles, slopes = jax.vmap(own)(poses), jax.vmap(bent)(poses)
    return difference(poses, found), angles, slopes, places, by.reshape(*places.shape, -1)


def _moved(skeleton: Skeleton, poses: Pose, steps: np.ndarray, _: np.ndarray) -> Pose:
    """Poses moved by steps (T, 6 + D), within the joints' limits."""
    there = retract(poses, jnp.asarray(steps, poses.angles.dtype))
    low, high = skeleton.limits[:, 0], skeleton.limits[:, 1]
    there = there._replace(angles=jnp.clip(there.angles, low, high))
    return jax.tree.map(np.asarray, there)
