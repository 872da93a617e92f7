"""All poses of a recording at once: by each frame's pairs, and because people move smoothly.

A frame's pairs determine some directions of a pose well and others hardly: an arm's turn about its
own axis shows only where the elbow is bent. What they leave open, prediction from the frames before
fills in, and drags behind; the frames before and after together are better. Each frame counts by
the quadratic that its pairs left about its estimated pose, landmarks move with accelerations that
are white noise, and all of it is solved as one banded system. The recording determines how large a
landmark's accelerations are: a hand on the floor hardly moves, a jumper's does, and who is smoothed
as the other either shakes or lags.

It is the batch smoother of the smoothing room with two terms: what each frame estimated, and joints
at rest.

INPUTS: poses, Hessians and slopes of all frames, a Morph where joints go along.
OUTPUTS: the poses that suit them all, and how sure they are.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Sites
from jaxmocap.body.model import Model
from jaxmocap.body.motion import landmarks_over_time
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.compilation.settings import group, settings
from jaxmocap.evidence.posture import EstimatedPose, NearEstimate
from jaxmocap.evidence.smoothness import REACH, accelerations_of, smoothness
from jaxmocap.evidence.terms import Measurements, PosedBody, Term
from jaxmocap.silhouette.surfaces.morph import Morph, without_followers
from jaxmocap.smoothing.levenberg_marquardt import (
    SolverSettings,
    covariances,
    minimise,
    point_variances,
    positive,
)
from jaxmocap.smoothing.linearise import linearise_problem, two_workers
from jaxmocap.smoothing.problem import SmoothingProblem, Trajectory, Views, move_trajectory

# Steps in each round. The frames' quadratics hold near the estimates only: more are not worth it.
STEPS = 3
# Some hundred pairs of a frame err alike, where the person is not as the surface: deviations are so
# many times larger than by counting each of them.
PAIRS_ERR_ALIKE = 10.0
# By how many times the pairs' own scatter joints are misplaced that a surface is fitted round; by
# more with fewer cameras, since a wrong surface suits few. Four rendered people by their heights,
# by their bones, and a real one, two to four cameras (``bench.coverage``).
MISPLACED = 2.5
# Hips lie deep in the flesh, knees err with them, and feet are short: so many times more.
MISPLACED_MORE = {"hip": 1.4, "knee": 1.2, "toe": 2.0}
# Where one camera counts, key points leave it open how far off arms are: so many times more. The
# real person before each camera, and rendered people who squat, walk and raise their arms.
ALONE_MORE = {"shoulder": 1.2, "elbow": 1.4, "wrist": 1.5, "hand": 1.5}


@settings
class AtRest(Term):
    """Joints that outlines hardly determine, held about 0, or about where a morph takes them."""

    roots: Array = group(lambda: None, "(D,) inverse deviations, 1 / radians; 0 where none is held")
    morph: Any = group(lambda: None, "what goes along with the joints' angles")

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(D,)."""
        own = body.pose if self.morph is None else without_followers(self.morph, body.pose)
        return self.roots * own.angles


class _Terms(NamedTuple):
    """The settings of this smoother, as the smoothing room asks for them."""

    terms: tuple[Term, ...]


class FrameInformation(NamedTuple):
    """The evidence of the pairs of T frames."""

    poses: Pose  # (T, ...) as estimated
    information: np.ndarray  # (T, 6 + D, 6 + D) of ``PoseResult``; 0 where nothing was visible
    slope: np.ndarray  # (T, 6 + D) likewise
    spread: np.ndarray  # (T,) standard deviation of the pairs, metres
    cameras: np.ndarray  # (T,) how many counted
    # (T,) of the pelvis' place about the estimated one where key points have it, metres; infinite
    # elsewhere.
    place_deviations: np.ndarray


class PoseSmoothingSettings(NamedTuple):
    """What a user may tune."""

    # Deviation of the landmarks' accelerations, m / s^2 * sqrt(s), see ``smoothness``, before the
    # recording has shown how each moves, and at most.
    acceleration: float = 1.0
    # What counts from then on, as a share of each landmark's own. Pairs that err alike count as if
    # they did not: less than 1 by as much.
    own_share: float = 0.5
    least_acceleration: float = 0.1  # of it all the same, m / s^2 * sqrt(s)
    rounds: int = 3  # times that accelerations are estimated
    # Of a pose about the estimated one, metres and radians: farther off the pairs would be others.
    pose_deviation: float = 0.1


def smoothed_poses(
    skeleton: Skeleton,
    times: np.ndarray,
    information: FrameInformation,
    rest: np.ndarray,
    settings: PoseSmoothingSettings,
    morph: Morph | None = None,
) -> tuple[Pose, np.ndarray]:
    """The poses (T, ...) of a whole recording, and standard deviations (T, L, 3) of landmarks.

    ``rest`` (D,) are deviations of joints that are held about 0, or about where a morph takes them,
    radians; infinite for the others. Those returned are of the world's coordinates, metres; NaN of
    a recording of two frames.
    """
    if len(times) <= REACH:
        return information.poses, np.full((len(times), len(LANDMARKS), 3), np.nan)
    problem = _problem(skeleton, times, information, (rest, morph), settings.pose_deviation)
    no_lengths = np.zeros(0, skeleton.lengths.dtype)

    def smoothly(poses: Pose, accelerations: np.ndarray) -> Pose:
        start = Trajectory(poses, no_lengths)
        prior = smoothness(times, accelerations)
        with two_workers() as workers:
            linearise = partial(linearise_problem, problem, 0.0, workers)
            move = partial(_move_trajectory, skeleton)
            return minimise(linearise, move, start, prior, SolverSettings(iterations=STEPS)).x.poses

    own = np.full(len(LANDMARKS), settings.acceleration)
    poses = smoothly(information.poses, np.repeat(own, 3))
    for _ in range(settings.rounds):
        own = settings.own_share * _accelerations(skeleton, times, poses)
        # A limb that was lost and found again has large ones too: never looser than at first.
        own = np.clip(own, settings.least_acceleration, settings.acceleration)
        poses = smoothly(poses, np.repeat(own, 3))
    prior, trajectory = smoothness(times, np.repeat(own, 3)), Trajectory(poses, no_lengths)
    with two_workers() as workers:
        linear = linearise_problem(problem, 0.0, workers, trajectory)
    variances = point_variances(linear.jacobian, covariances(linear, prior))
    return poses, _deviations(variances.reshape(len(times), -1, 3), information)


def _deviations(variances: np.ndarray, information: FrameInformation) -> np.ndarray:
    """(T, L, 3) by variances that count each pair for itself, and by how the pairs scatter."""
    cameras = np.maximum(information.cameras, 1)
    misplaced = MISPLACED * np.sqrt(1 + 4 / cameras) * information.spread
    kinds = [name.split("_")[0] for name in LANDMARKS]
    more = np.array([MISPLACED_MORE.get(kind, 1.0) for kind in kinds])
    alone = np.array([ALONE_MORE.get(kind, 1.0) for kind in kinds])
    more = np.where(cameras[:, None] == 1, more * alone, more)
    return np.hypot(PAIRS_ERR_ALIKE * np.sqrt(variances), (misplaced[:, None] * more)[..., None])


def _problem(
    skeleton: Skeleton,
    times: np.ndarray,
    information: FrameInformation,
    at_rest: tuple[np.ndarray, Morph | None],
    pose_deviation: float,
) -> SmoothingProblem:
    """What the frames estimated, as a problem of two terms."""
    dtype, (rest, morph) = skeleton.lengths.dtype, at_rest
    slope = information.slope.astype(float)
    H = positive(information.information.astype(float))
    near = np.full(slope.shape, pose_deviation)
    near[:, :3] = np.minimum(near[:, :3], information.place_deviations[:, None])
    factors = np.linalg.cholesky(H + np.eye(slope.shape[-1]) / near[:, None] ** 2)
    offsets = np.linalg.solve(factors, slope[..., None])[..., 0]
    roots = factors.swapaxes(1, 2)
    estimate = EstimatedPose(information.poses, roots, offsets)
    estimate = jax.tree.map(lambda part: np.asarray(part, dtype), estimate)
    held = AtRest(jnp.asarray(1 / rest, dtype), morph)
    model, terms = Model(skeleton, Sites.none(dtype)), _Terms((NearEstimate(), held))
    measured = Measurements(estimate=estimate)
    return SmoothingProblem(model, terms, times, measured, Views.no_cameras())


def _accelerations(skeleton: Skeleton, times: np.ndarray, poses: Pose) -> np.ndarray:
    """(L,) each landmark's, m / s^2 * sqrt(s), root mean square."""
    places = landmarks_over_time(skeleton, poses).astype(float)
    squares = accelerations_of(times, places.reshape(len(times), -1)) ** 2
    return np.sqrt(squares.reshape(len(squares), -1, 3).mean((0, 2)))


def _move_trajectory(
    skeleton: Skeleton, trajectory: Trajectory, steps: np.ndarray, shared: np.ndarray
) -> Trajectory:
    """A trajectory moved by steps (T, 6 + D), within the joints' limits."""
    moved = move_trajectory(trajectory, steps, shared)
    angles = np.clip(moved.poses.angles, *np.asarray(skeleton.limits).T)
    return moved._replace(poses=moved.poses._replace(angles=angles))
