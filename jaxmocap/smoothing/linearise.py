"""A smoothing problem about a trajectory: costs, Gauss-Newton terms and landmarks of all frames.

Frames and views go through programs in batches of one size, which every recording shares.

INPUTS: a SmoothingProblem, a Trajectory. OUTPUTS: Linearised; the trajectory that costs least.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from threadpoolctl import threadpool_limits

from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.compilation.arrays import Numbers, on_device
from jaxmocap.compilation.batches import in_batches
from jaxmocap.compilation.programs import program
from jaxmocap.evidence.expansion import linearise_terms
from jaxmocap.evidence.silhouettes import (
    SilhouetteGrids,
    Silhouettes,
    silhouette_fit,
    silhouette_hessian,
)
from jaxmocap.evidence.terms import Measurements, Term
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.images.silhouette_grid import blur_grid
from jaxmocap.smoothing.levenberg_marquardt import DEFAULTS, Linearised, SolverSettings, minimise
from jaxmocap.smoothing.problem import (
    TURN,
    SmoothingProblem,
    Trajectory,
    all_turned,
    among_cameras,
    move_trajectory,
    shared_prior,
)
from jaxmocap.solvers.status import Status

# Frames in one call.
FRAMES_A_CALL = 64
# Views in one call.
VIEWS_A_CALL = 16


class SmoothedPoses(NamedTuple):
    """What a solve ended with."""

    trajectory: Trajectory  # poses and what they share
    cost: float  # of all residuals and the prior
    status: Status  # why the solve ended
    costs: np.ndarray  # (T,) of each event's residuals
    points: np.ndarray  # (T, 3 L) landmarks, world, metres


def smooth_poses(
    problem: SmoothingProblem,
    start: Trajectory,
    softness: tuple[float, ...],
    relative: float = DEFAULTS.relative,
    coarse: bool = False,
) -> SmoothedPoses:
    """Minimise all residuals from a start (T, ...), with silhouettes ever sharper.

    Args:
        problem: the recording.
        start: poses and what they share; the cameras turn where it brings turns.
        softness: of the silhouettes' borders, cells, one solve after the other.
        relative: a solve ends where the cost falls by no more than this share.
        coarse: draws on larger cells; only for where it is all still rough, since an arm may
            settle in another valley.
    """
    prior = problem.motion_prior()
    solver = SolverSettings(iterations=problem.settings.iterations, relative=relative)
    trajectory, ended = start, None
    with two_workers() as workers:
        for soft in softness:
            drawn = coarsely(problem, soft) if coarse else (soften_grids(problem, soft), soft)
            linearise = partial(linearise_problem, *drawn, workers)
            ended = minimise(linearise, move_trajectory, trajectory, prior, solver)
            trajectory = ended.x
    assert ended is not None
    each, points = (np.asarray(part) for part in (ended.linear.cost, ended.linear.points))
    return SmoothedPoses(trajectory, ended.cost, ended.status, each, points)


@contextmanager
def two_workers() -> Iterator[ThreadPoolExecutor]:
    """Two threads over batches, and one alone in BLAS.

    Band matrices are narrow: BLAS's own threads would only wait for one another, for seconds.
    """
    one_thread = threadpool_limits(1, user_api="blas")
    with one_thread, ThreadPoolExecutor(2, thread_name_prefix="smooth") as workers:
        yield workers


def soften_grids(problem: SmoothingProblem, softness: float) -> SmoothingProblem:
    """The same, its grids as soft as what is drawn, and weighted as in the settings."""
    if not len(problem.views.frame):
        return problem
    soft = problem.views.grids.each_grid(lambda grid: blur_grid(grid, softness))
    grids = problem.settings.silhouettes.weigh(soft)
    return replace(problem, views=problem.views._replace(grids=grids))


def coarsely(problem: SmoothingProblem, softness: float) -> tuple[SmoothingProblem, float]:
    """The same, softened, on cells twice as large, a quarter of them; and the softness there."""
    soft = soften_grids(problem, softness)
    grids = soft.views.grids.halve()
    return replace(soft, views=soft.views._replace(grids=grids)), softness / 2


class FramesFit(NamedTuple):
    """Batches of frames about their poses; N = 6 + D + P, by pose and proportions."""

    cost: Numbers  # (B,) of their terms
    hessian: Numbers  # (B, N, N) J^T J
    gradient: Numbers  # (B, N) J^T r
    points: Numbers  # (B, 3 L) landmarks, world, metres
    jacobian: Numbers  # (B, 3 L, N) of the landmarks


@program("quick")
def frames_fit(
    terms: Sequence[Term], model: Model, proportions: Array, poses: Pose, measured: Measurements
) -> FramesFit:
    """Gauss-Newton terms of a batch of frames."""

    def of_frame(pose: Pose, own: Measurements) -> FramesFit:
        r, J, points, points_J = linearise_terms(terms, model, proportions, pose, own)
        hessian = jnp.matmul(J.T, J, precision=HIGHEST)
        pull = jnp.matmul(r, J, precision=HIGHEST)
        return FramesFit(jnp.sum(r**2), hessian, pull, points, points_J)

    return jax.vmap(of_frame)(poses, measured)


@program("full")
def views_fit(
    skeleton: Skeleton,
    proportions: Array,
    softness: Array,
    poses: Pose,
    cameras: Camera,
    grids: SilhouetteGrids,
) -> tuple[Array, Array, Array]:
    """Costs, J^T J and J^T r of a batch of views, by pose, proportions and their camera's turn."""

    def of_view(each: tuple[Pose, Camera, SilhouetteGrids]) -> tuple[Array, Array, Array]:
        return silhouette_fit(skeleton, proportions, *each, softness)

    # One after the other: a picture of the body fits the cache, a batch of them does not.
    return jax.lax.map(of_view, (poses, cameras, grids))


class SilhouettesFit(NamedTuple):
    """What all cameras' silhouettes of a person cost at a pose; N = 6 + D."""

    cost: Array  # ()
    hessian: Array  # (N, N) J^T J
    gradient: Array  # (N,) J^T r, half the cost's
    bending: Array  # (N, N) what J^T J leaves out of half the cost's Hessian; 0 where nobody asks


def silhouettes_fit(
    model: Model,
    settings: Silhouettes,
    pose: Pose,
    shown: Array,
    grids: SilhouetteGrids,
    softness: Array,
    exactly: bool = False,
) -> SilhouettesFit:
    """All cameras' silhouettes at one time, cameras as calibrated.

    Args:
        model: of the person and C cameras.
        settings: their deviation counts.
        pose: of the person.
        shown: (C,) which cameras have a frame.
        grids: (C, ...) weighted, as soft as what is drawn.
        softness: () cells.
        exactly: whether ``bending`` is found, for several times the time.
    """
    size, dtype = ROOT_DOF + pose.angles.size, pose.angles.dtype

    def of_view(camera: Camera, own: SilhouetteGrids) -> SilhouettesFit:
        view = camera, own, softness
        fit = silhouette_fit(model.skeleton, None, pose, *view)
        bending = jnp.zeros_like(fit[1])
        if exactly:
            bending = silhouette_hessian(model.skeleton, pose, *view) - fit[1]
        weighed = jax.tree.map(lambda part: part / settings.deviation**2, (*fit, bending))
        return SilhouettesFit(*weighed)

    def with_camera(total: SilhouettesFit, each: tuple) -> tuple[SilhouettesFit, None]:
        is_shown, *view = each

        def added() -> SilhouettesFit:
            return jax.tree.map(jnp.add, total, of_view(*view))

        return jax.lax.cond(is_shown, added, lambda: total), None

    square = jnp.zeros((size, size), dtype)
    nothing = SilhouettesFit(square[0, 0], square, square[0], square)
    return jax.lax.scan(with_camera, nothing, (shown, model.cameras, grids))[0]


def linearise_problem(
    problem: SmoothingProblem,
    softness: float,
    workers: ThreadPoolExecutor,
    trajectory: Trajectory,
) -> Linearised:
    """All frames about their poses, and what they share."""
    fixed = problem.settings.terms, problem.model, trajectory.proportions
    frames = trajectory.poses, problem.measured
    fit = FramesFit(*in_batches(partial(frames_fit, *fixed), frames, FRAMES_A_CALL, workers))
    cameras, size = len(trajectory.turns_cam), fit.jacobian.shape[2]
    n = size - trajectory.proportions.size
    # Frames do not depend on cameras.
    if cameras:
        wider = (0, TURN * cameras)
        fit = fit._replace(
            hessian=np.pad(fit.hessian, ((0, 0), wider, wider)),
            gradient=np.pad(fit.gradient, ((0, 0), wider)),
            jacobian=np.pad(fit.jacobian, ((0, 0), (0, 0), wider)),
        )
    cost, hessian, gradient, jacobian = (
        np.asarray(part) for part in (fit.cost, fit.hessian, fit.gradient, fit.jacobian)
    )
    views = problem.views
    if len(views.frame):
        drawn = problem.model.skeleton, trajectory.proportions, on_device(softness)
        each = views_of(problem, trajectory)
        price, by_view, pull = in_batches(partial(views_fit, *drawn), each, VIEWS_A_CALL, workers)
        parts = price, *among_cameras(by_view, pull, views.camera, cameras)
        for total, part in zip((cost, hessian, gradient), parts, strict=True):
            np.add.at(total, views.frame, part * problem.settings.silhouettes.weight)
    curvature, pull, price = shared_prior(problem.settings, views.camera, trajectory)
    return Linearised(
        cost + price, hessian[:, :n, :n], gradient[:, :n], fit.points, jacobian[:, :, :n],
        hessian[:, :n, n:], hessian[:, n:, n:] + curvature, gradient[:, n:] + pull,
        jacobian[:, :, n:],
    )  # fmt: skip


def views_of(
    problem: SmoothingProblem, trajectory: Trajectory
) -> tuple[Pose, Camera, SilhouetteGrids]:
    """The pose, the camera as it is turned, and the grids of each view."""
    views = problem.views
    cameras = all_turned(problem.model.cameras, trajectory.turns_cam)
    return rows_of(trajectory.poses, views.frame), rows_of(cameras, views.camera), views.grids


def rows_of(stacked: Any, rows: np.ndarray | int) -> Any:
    """Some entries of each array of a pytree, on the host."""
    return jax.tree.map(lambda part: np.asarray(part)[rows], stacked)
