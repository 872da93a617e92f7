"""A whole recording at once: every frame's pose given all markers and all that the cameras saw.

Frame by frame a hidden arm is a guess; over the whole recording what comes before and after decides
it, and a motion is as calm as bodies are. Markers, silhouettes, joint ranges and what people do at
ease are residuals; accelerations of the body's landmarks are the prior that joins the frames.

INPUTS: a start, markers, sights at some of the frames. OUTPUTS: poses, standard deviations.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from threadpoolctl import threadpool_limits

from jaxmocap.body.kinematics import (
    Sites,
    forward,
    jacobian,
    landmark_sites,
    landmarks,
    site_positions,
)
from jaxmocap.body.pose import Pose, retract
from jaxmocap.body.skeleton import LANDMARKS, ROOT_DOF, Skeleton
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.rotations import HIGHEST, quaternion_to_matrix
from jaxmocap.hybrid.settings import SmoothingSettings
from jaxmocap.hybrid.silhouette import Sight, silhouette_cost, silhouette_fit
from jaxmocap.images.silhouette import blurred
from jaxmocap.solvers.smoothness import Smoothness, smoothness
from jaxmocap.solvers.status import Status
from jaxmocap.solvers.trajectory import Linearised, covariances, point_variances, smooth
from jaxmocap.solvers.trajectory import Settings as Solve

# Frames and sights per call: shapes that every recording shares, so that they compile once.
FRAMES_A_CALL, SIGHTS_A_CALL = 64, 16
# How far joints go from the relaxed pose, degrees (standard deviation), by how their names begin.
EASE = {
    "spine": 15, "neck": 25, "arm_flex": 60, "arm": 40, "elbow": 60,
    "hip_flexion": 40, "hip": 25, "knee": 60,
}  # fmt: skip
# A landmark is a guess where the video leaves more than this share of its variance, unless the
# markers alone already hold it this well (metres).
GUESSED, HELD_M = 0.7, 0.03
GROUND = ("ankle_l", "ankle_r")


class Frame(NamedTuple):
    """What is known of one frame besides its sights.

    Attributes:
        targets: (M, 3) markers, world, metres; NaN where missing.
        facing: (3,) unit and horizontal, where the markers' pose faces.
        ankles: (2, 3) of the markers' pose, world, metres.
        feet: () 1 where no marker holds the feet, so that the ground must, else 0.
    """

    targets: Array
    facing: Array
    ankles: Array
    feet: Array


class Sights(NamedTuple):
    """V looks of cameras at the person.

    Attributes:
        frame: (V,) host integers, which frame of the trajectory.
        camera: (V,) host integers, which camera.
        sight: what was seen, (V, ...) each.
    """

    frame: np.ndarray
    camera: np.ndarray
    sight: Sight


@dataclass(frozen=True)
class Problem:
    """A recording to be smoothed.

    Attributes:
        skeleton: of the person.
        cameras: C, stacked.
        markers: M points on bones.
        settings: of the smoothing.
        times: (T,) seconds.
        frames: (T, ...) each.
        sights: of all cameras.
    """

    skeleton: Skeleton
    cameras: Camera
    markers: Sites
    settings: SmoothingSettings
    times: np.ndarray
    frames: Frame
    sights: Sights


class SmoothedPoses(NamedTuple):
    """Poses of all frames.

    Attributes:
        poses: (T, ...).
        deviations: (T, L, 3) standard deviations of the landmarks' coordinates, world, metres.
        from_prior: (T, L) 1 where markers and video leave a landmark almost as uncertain as it is
            without them, else 0.
        cost: of all residuals and the prior.
        status: why the solve ended.
    """

    poses: Pose
    deviations: np.ndarray
    from_prior: np.ndarray
    cost: float
    status: Status


def smooth_poses(problem: Problem, start: Pose, softness: tuple[float, ...]) -> SmoothedPoses:
    """Minimise all residuals from a start (T, ...), with silhouettes ever sharper.

    Args:
        problem: what is known.
        start: poses.
        softness: of the silhouettes' borders, cells, one solve after the other.
    """
    settings = problem.settings
    accelerations = np.full(3 * len(LANDMARKS), float(settings.acceleration))
    prior = smoothness(problem.times, accelerations)
    poses, ended = start, None
    # Band matrices are narrow: BLAS's threads would only wait for one another, for seconds.
    one_thread = threadpool_limits(1, user_api="blas")
    with one_thread, ThreadPoolExecutor(2, thread_name_prefix="smooth") as workers:
        for soft in softness:
            seen = _softened(problem, soft)
            linearise = partial(_linearise, seen, soft, workers)
            evaluate = partial(_evaluate, seen, soft, workers)
            ended = smooth(
                linearise, evaluate, _move, poses, prior, Solve(iterations=settings.iterations)
            )
            poses = ended.x
        assert ended is not None
        linear = _linearise(seen, softness[-1], workers, poses)
        unseen = _linearise(_unseen(seen), softness[-1], workers, poses)
        told, guessed = (_variances(each, prior) for each in (linear, unseen))
    deviations = np.sqrt(told + float(settings.mismatch) ** 2)
    from_prior = told.sum(-1) > GUESSED * guessed.sum(-1)
    markers_hold = guessed.sum(-1) < HELD_M**2
    return SmoothedPoses(
        poses, deviations, (from_prior & ~markers_hold).astype(float), ended.cost, ended.status
    )


def _variances(linear: Linearised, prior: Smoothness) -> np.ndarray:
    """(T, L, 3) of the landmarks' coordinates."""
    found = point_variances(linear.jacobian, covariances(linear, prior))
    return found.reshape(-1, len(LANDMARKS), 3)


def _unseen(problem: Problem) -> Problem:
    """The same without what the cameras saw."""
    blind = jax.tree.map(lambda part: part[:0], problem.sights)
    return replace(problem, sights=blind)


def _softened(problem: Problem, softness: float) -> Problem:
    sight = problem.sights.sight
    soft = Sight(sight.region, blurred(sight.person, softness), blurred(sight.forearms, softness))
    return replace(problem, sights=problem.sights._replace(sight=soft))


def residuals(
    skeleton: Skeleton, markers: Sites, settings: SmoothingSettings, pose: Pose, frame: Frame
) -> Array:
    """All whitened residuals (R,) of one frame but its sights'."""
    bones = forward(skeleton, pose)
    seen = jnp.isfinite(frame.targets)
    off = site_positions(skeleton, bones, markers) - jnp.where(seen, frame.targets, 0.0)
    held = jnp.where(seen, off, 0.0) / settings.marker
    R = quaternion_to_matrix(pose.quaternion)
    turned = jnp.cross(R[:, 0], frame.facing)[2] / settings.facing
    low, high = skeleton.limits[:, 0], skeleton.limits[:, 1]
    beyond = jnp.maximum(low - pose.angles, 0.0) + jnp.maximum(pose.angles - high, 0.0)
    ankles = site_positions(skeleton, bones, landmark_sites(skeleton, GROUND))
    ground = jnp.stack([settings.footing, settings.footing, settings.ground])
    return jnp.concatenate(
        [
            held.ravel(),
            R[:2, 2] / settings.lean,
            turned[None],
            (pose.angles - skeleton.relaxed) / _ease(skeleton),
            beyond / settings.limit,
            (frame.feet * (ankles - frame.ankles) / ground).ravel(),
        ]
    )


def _ease(skeleton: Skeleton) -> Array:
    """Standard deviations (D,) of the joints about the relaxed pose, radians."""
    degrees = [
        next((ease for start, ease in EASE.items() if joint.startswith(start)), 40)
        for joint in skeleton.tree.joints
    ]
    return jnp.asarray(np.radians(degrees), skeleton.relaxed.dtype)


@jax.jit
def _frames_fit(
    skeleton: Skeleton, sites: Sites, settings: SmoothingSettings, poses: Pose, frames: Frame
) -> tuple[Array, Array, Array, Array, Array]:
    """Costs, J^T J, J^T r, landmarks and their derivatives of a batch of frames."""

    def of_frame(pose: Pose, frame: Frame) -> tuple[Array, Array, Array, Array, Array]:
        def moved(step: Array) -> Array:
            return residuals(skeleton, sites, settings, retract(pose, step), frame)

        still = jnp.zeros(ROOT_DOF + len(skeleton.tree.joints), pose.angles.dtype)
        r, J = moved(still), jax.jacfwd(moved)(still)
        bones, points = forward(skeleton, pose), landmark_sites(skeleton)
        at = site_positions(skeleton, bones, points)
        by_pose = jacobian(skeleton, bones, points.bones, at).reshape(-1, still.size)
        hessian = jnp.matmul(J.T, J, precision=HIGHEST)
        gradient = jnp.matmul(r, J, precision=HIGHEST)
        return jnp.sum(r**2), hessian, gradient, at.ravel(), by_pose

    return jax.vmap(of_frame)(poses, frames)


@jax.jit
def _frames_cost(
    skeleton: Skeleton, sites: Sites, settings: SmoothingSettings, poses: Pose, frames: Frame
) -> tuple[Array, Array]:
    """Costs and landmarks of a batch of frames."""

    def of_frame(pose: Pose, frame: Frame) -> tuple[Array, Array]:
        r = residuals(skeleton, sites, settings, pose, frame)
        return jnp.sum(r**2), landmarks(skeleton, pose).ravel()

    return jax.vmap(of_frame)(poses, frames)


@jax.jit
def _sights_fit(
    skeleton: Skeleton, softness: Array, poses: Pose, cameras: Camera, sights: Sight
) -> tuple[Array, Array, Array]:
    """Costs, J^T J and J^T r of a batch of sights."""

    def of_sight(each: tuple[Pose, Camera, Sight]) -> tuple[Array, Array, Array]:
        pose, camera, sight = each
        return silhouette_fit(skeleton, forward(skeleton, pose), camera, sight, softness)

    # One after the other: a picture of the body fits the cache, a batch of them does not.
    return jax.lax.map(of_sight, (poses, cameras, sights))


@jax.jit
def _sights_cost(
    skeleton: Skeleton, softness: Array, poses: Pose, cameras: Camera, sights: Sight
) -> Array:
    """Costs of a batch of sights."""

    def of_sight(each: tuple[Pose, Camera, Sight]) -> Array:
        pose, camera, sight = each
        return silhouette_cost(skeleton, forward(skeleton, pose), camera, sight, softness)

    return jax.lax.map(of_sight, (poses, cameras, sights))


_retract = jax.jit(jax.vmap(retract))


def _move(poses: Pose, steps: np.ndarray, _: np.ndarray) -> Pose:
    return jax.device_get(_retract(poses, jnp.asarray(steps, float)))


def _linearise(
    problem: Problem, softness: float, workers: ThreadPoolExecutor, poses: Pose
) -> Linearised:
    """All frames about their poses."""
    cost, hessian, gradient, points, by_pose = _over_frames(_frames_fit, problem, workers, poses)
    if not len(problem.sights.frame):
        return Linearised(cost, hessian, gradient, points, by_pose)
    seen = _over_sights(_sights_fit, problem, softness, workers, poses)
    for total, part in zip((cost, hessian, gradient), seen, strict=True):
        scaled = part / float(problem.settings.silhouette) ** 2
        np.add.at(total, problem.sights.frame, scaled)
    return Linearised(cost, hessian, gradient, points, by_pose)


def _evaluate(
    problem: Problem, softness: float, workers: ThreadPoolExecutor, poses: Pose
) -> tuple[np.ndarray, np.ndarray]:
    """Costs and landmarks of all frames."""
    cost, points = _over_frames(_frames_cost, problem, workers, poses)
    (seen,) = _over_sights(_sights_cost, problem, softness, workers, poses)
    np.add.at(cost, problem.sights.frame, seen / float(problem.settings.silhouette) ** 2)
    return cost, points


def _over_frames(
    call: Callable, problem: Problem, workers: ThreadPoolExecutor, poses: Pose
) -> list[np.ndarray]:
    """A function of batches of frames over all of them, float64."""
    fixed = problem.skeleton, problem.markers, problem.settings
    return _in_batches(lambda *b: call(*fixed, *b), (poses, problem.frames), FRAMES_A_CALL, workers)


def _over_sights(
    call: Callable, problem: Problem, softness: float, workers: ThreadPoolExecutor, poses: Pose
) -> list[np.ndarray]:
    """A function of batches of sights over all of them, float64."""
    sights = problem.sights
    cameras = jax.tree.map(lambda part: np.asarray(part)[sights.camera], problem.cameras)
    there = jax.tree.map(lambda part: np.asarray(part)[sights.frame], poses)
    fixed = problem.skeleton, jnp.asarray(softness, float)
    each = (there, cameras, sights.sight)
    return _in_batches(lambda *b: call(*fixed, *b), each, SIGHTS_A_CALL, workers)


def _in_batches(
    call: Callable, stacked: tuple[Any, ...], size: int, workers: ThreadPoolExecutor
) -> list[np.ndarray]:
    """``call`` over batches of one size, of which the last is filled up with its last entry."""
    count = len(jax.tree.leaves(stacked)[0])

    def of_batch(rows: np.ndarray) -> list[np.ndarray]:
        found = call(*jax.tree.map(lambda part: np.asarray(part)[rows], stacked))
        return [np.asarray(part, np.float64) for part in jax.tree.leaves(found)]

    parts = list(workers.map(of_batch, _batches(count, size)))
    return [np.concatenate(each)[:count] for each in zip(*parts, strict=True)]


def _batches(count: int, size: int) -> Iterator[np.ndarray]:
    for first in range(0, count, size):
        yield np.minimum(np.arange(first, first + size), count - 1)
