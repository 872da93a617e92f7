"""A whole recording at once: every frame's pose given all markers and all that the cameras saw.

Frame by frame a hidden arm is a guess; over the whole recording what comes before and after decides
it, and a motion is as calm as bodies are. Markers, silhouettes, joint ranges and what people do at
ease are residuals; accelerations of the body's landmarks are the prior that joins the frames.

INPUTS: a start, markers, sights at some of the frames. OUTPUTS: poses, standard deviations.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from threadpoolctl import threadpool_limits

from jaxmocap.body.kinematics import Sites
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.compilation.batches import in_batches
from jaxmocap.evidence.residuals import Known, linearised_residuals
from jaxmocap.evidence.silhouettes import Sight, silhouette_fit, weighed
from jaxmocap.evidence.smoothness import Smoothness, smoothness
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.images.silhouette_grid import blurred
from jaxmocap.smoothing.levenberg_marquardt import DEFAULTS, Linearised, smooth
from jaxmocap.smoothing.levenberg_marquardt import Settings as Solve
from jaxmocap.smoothing.settings import SmoothingSettings
from jaxmocap.smoothing.trajectory import (
    TURN,
    Trajectory,
    all_turned,
    among_cameras,
    moved_by,
    shared_prior,
)
from jaxmocap.solvers.status import Status

# Frames and sights per call: shapes that every recording shares, so that they compile once.
FRAMES_A_CALL, SIGHTS_A_CALL = 64, 16


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
        known: (T, ...) of each frame besides its sights.
        sights: of all cameras.
    """

    skeleton: Skeleton
    cameras: Camera
    markers: Sites
    settings: SmoothingSettings
    times: np.ndarray
    known: Known
    sights: Sights


class SmoothedPoses(NamedTuple):
    """What a solve ended with.

    Attributes:
        trajectory: poses and what they share.
        cost: of all residuals and the prior.
        status: why the solve ended.
    """

    trajectory: Trajectory
    cost: float
    status: Status


def smooth_poses(
    problem: Problem,
    start: Trajectory,
    softness: tuple[float, ...],
    relative: float = DEFAULTS.relative,
    coarse: bool = False,
) -> SmoothedPoses:
    """Minimise all residuals from a start (T, ...), with silhouettes ever sharper.

    Args:
        problem: what is known.
        start: poses and what they share; the cameras turn where it brings turns.
        softness: of the silhouettes' borders, cells, one solve after the other.
        relative: a solve ends where the cost falls by no more than this share.
        coarse: draws on larger cells; only for where it is all still rough, since an arm may
            settle in another valley.
    """
    prior = landmark_prior(problem)
    solve = Solve(iterations=problem.settings.iterations, relative=relative)
    trajectory, ended = start, None
    with two_workers() as workers:
        for soft in softness:
            drawn = coarsely(problem, soft) if coarse else (softened(problem, soft), soft)
            linearise = partial(linearise_poses, *drawn, workers)
            ended = smooth(linearise, moved_by, trajectory, prior, solve)
            trajectory = ended.x
    assert ended is not None
    return SmoothedPoses(trajectory, ended.cost, ended.status)


@contextmanager
def two_workers() -> Iterator[ThreadPoolExecutor]:
    """Two threads over batches, and one alone in BLAS.

    Band matrices are narrow: BLAS's own threads would only wait for one another, for seconds.
    """
    one_thread = threadpool_limits(1, user_api="blas")
    with one_thread, ThreadPoolExecutor(2, thread_name_prefix="smooth") as workers:
        yield workers


def landmark_prior(problem: Problem) -> Smoothness:
    """What is known of the landmarks' motion before it is seen."""
    accelerations = np.full(3 * len(LANDMARKS), float(problem.settings.acceleration))
    return smoothness(problem.times, accelerations)


def softened(problem: Problem, softness: float) -> Problem:
    """The same, seen as softly as it is drawn, and counting as the settings say."""
    soft = problem.sights.sight.each_grid(lambda grid: blurred(grid, softness))
    counting = weighed(soft, problem.settings)
    return replace(problem, sights=problem.sights._replace(sight=counting))


def coarsely(problem: Problem, softness: float) -> tuple[Problem, float]:
    """The same, softened, on cells twice as large, a quarter of them; and the softness there."""
    seen = softened(problem, softness)
    sight = seen.sights.sight.halved()
    return replace(seen, sights=seen.sights._replace(sight=sight)), softness / 2


@jax.jit
def frames_fit(
    skeleton: Skeleton,
    proportions: Array,
    sites: Sites,
    settings: SmoothingSettings,
    poses: Pose,
    known: Known,
) -> tuple[Array, Array, Array, Array, Array]:
    """Costs, J^T J, J^T r, landmarks and their derivatives of a batch of frames.

    By pose and proportions, in this order: N = 6 + D + P.
    """

    def of_frame(pose: Pose, one: Known) -> tuple[Array, Array, Array, Array, Array]:
        r, J, at, by = linearised_residuals(skeleton, proportions, sites, settings, pose, one)
        hessian = jnp.matmul(J.T, J, precision=HIGHEST)
        return jnp.sum(r**2), hessian, jnp.matmul(r, J, precision=HIGHEST), at, by

    return jax.vmap(of_frame)(poses, known)


@jax.jit
def sights_fit(
    skeleton: Skeleton,
    proportions: Array,
    softness: Array,
    poses: Pose,
    cameras: Camera,
    sights: Sight,
) -> tuple[Array, Array, Array]:
    """Costs, J^T J and J^T r of a batch of sights, by pose, proportions and their camera's turn."""

    def of_sight(each: tuple[Pose, Camera, Sight]) -> tuple[Array, Array, Array]:
        return silhouette_fit(skeleton, proportions, *each, softness)

    # One after the other: a picture of the body fits the cache, a batch of them does not.
    return jax.lax.map(of_sight, (poses, cameras, sights))


def linearise_poses(
    problem: Problem, softness: float, workers: ThreadPoolExecutor, trajectory: Trajectory
) -> Linearised:
    """All frames about their poses, and what they share."""
    found = _over_frames(frames_fit, problem, workers, trajectory)
    cost, hessian, gradient, points, by = found
    cameras, n = len(trajectory.turns_cam), by.shape[2] - trajectory.proportions.size
    # Frames know nothing of cameras.
    wider = (0, TURN * cameras)
    hessian = np.pad(hessian, ((0, 0), wider, wider))
    gradient, by = np.pad(gradient, ((0, 0), wider)), np.pad(by, ((0, 0), (0, 0), wider))
    if len(problem.sights.frame):
        price, by_sight, pull = _over_sights(sights_fit, problem, softness, workers, trajectory)
        seen = price, *among_cameras(by_sight, pull, problem.sights.camera, cameras)
        for total, part in zip((cost, hessian, gradient), seen, strict=True):
            np.add.at(total, problem.sights.frame, part * sights_weight(problem))
    curvature, pull, price = shared_prior(problem.settings, problem.sights.camera, trajectory)
    return Linearised(
        cost + price, hessian[:, :n, :n], gradient[:, :n], points, by[:, :, :n],
        hessian[:, :n, n:], hessian[:, n:, n:] + curvature, gradient[:, n:] + pull, by[:, :, n:],
    )  # fmt: skip


def sights_weight(problem: Problem) -> float:
    """Of a squared difference between what was drawn and what was seen."""
    return 1 / float(problem.settings.silhouette) ** 2


def _over_frames(
    call: Callable, problem: Problem, workers: ThreadPoolExecutor, trajectory: Trajectory
) -> list[np.ndarray]:
    """A function of batches of frames over all of them, float64."""
    fixed = problem.skeleton, jnp.asarray(trajectory.proportions), problem.markers, problem.settings
    each = trajectory.poses, problem.known
    return in_batches(lambda *b: call(*fixed, *b), each, FRAMES_A_CALL, workers)


def _over_sights(
    call: Callable,
    problem: Problem,
    softness: float,
    workers: ThreadPoolExecutor,
    trajectory: Trajectory,
) -> list[np.ndarray]:
    """A function of batches of sights over all of them, float64."""
    sights = problem.sights
    cameras = all_turned(problem.cameras, trajectory.turns_cam)
    cameras = jax.tree.map(lambda part: np.asarray(part)[sights.camera], cameras)
    there = jax.tree.map(lambda part: np.asarray(part)[sights.frame], trajectory.poses)
    fixed = problem.skeleton, jnp.asarray(trajectory.proportions), jnp.asarray(softness, float)
    each = (there, cameras, sights.sight)
    return in_batches(lambda *b: call(*fixed, *b), each, SIGHTS_A_CALL, workers)
