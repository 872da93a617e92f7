"""Pose of a rigid object by its contour (second paper, 3.1.1 to 3.1.5, Figs. 9 to 12).

INPUTS: a closed curve of any form by its Fourier descriptors, or a surface; pixels of its outline
in one to four cameras; a pose to start from.
OUTPUTS: the pose that brings the contour onto the outlines' rays, and how far it stays from them.

    (a) the outlines' pixels become rays: Pluecker lines of the world
    (b) each ray goes with the nearest point of the contour, and each point with the nearest ray
    (c) one twist brings the points nearer to their rays; its exponential moves the object
    (d) again from (b)

A wire is its own contour. A surface's is the rim that a camera sees, new in each cycle. At first
the object has its lowest frequencies alone, of which few are caught in a wrong valley; it gets
higher ones as the pose settles, and in the end all of them. Then pairs that lie far off in space,
against the others, count for nothing.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.geometry import twists
from jaxmocap.geometry.cameras import Camera, stack_cameras
from jaxmocap.geometry.fourier import fourier_series
from jaxmocap.geometry.lines import Lines, camera_lines
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.silhouette.contour_step import (
    Rays,
    SpaceContour,
    StepWeights,
    contour_of_rim,
    contour_of_wire,
    distances_off,
    step_towards,
)
from jaxmocap.silhouette.surfaces.rigid import RigidSurface
from jaxmocap.solvers.status import Status


class ContourPoseSettings(NamedTuple):
    """What a user may tune.

    Attributes:
        harmonics: of the low-passes, one stage each; all of the object's follow; static. Of a
            surface, some of its own.
        low_cycles: of (b) to (d) in each of these stages.
        cycles: of each of the last three stages, at most.
        rest: a step that moves no point of the object farther ends a stage; by its radius.
        both_ways: whether the contour's points look for rays too; the paper's look for none. Where
            an outline shows a part of a curve only, let them not; static.
        along_weight: of pairs along the contour, by that across, in the last two stages, which
            bring the digits; before it is 1, as in (3.11), and contours slide along slowly.
        deviation: least spread of pairs about their rays, by the object's radius.
        reach: pairs farther off than this many spreads of all of them are outliers in the last
            stage, as in ``solve_pose``; infinite for none. Before, what is far off leads the way.
        damping: share of all pairs' weight that holds what no ray determines.
        samples: of the curve, and of each outline, evenly; static.
    """

    harmonics: tuple[int, ...] = (1, 2, 4, 8)
    low_cycles: int = 3
    cycles: int = 60
    rest: Array | float = 1e-3
    both_ways: bool = True
    along_weight: float = 0.1
    deviation: Array | float = 0.01
    reach: float = 4.685
    damping: Array | float = 1e-6
    samples: int = 128


class ContourPose(NamedTuple):
    """Where the object is.

    Attributes:
        T_world_object: (4, 4) from the object's frame, metres.
        distances: of each camera (Q,) of its rays from the contour, metres.
        shares: of each camera (Q,) from 0, an outlier, to 1.
        cycles: (S,) made in each stage.
        status: a Status; with ``BROKEN`` the pose is the start.
    """

    T_world_object: np.ndarray
    distances: tuple[np.ndarray, ...]
    shares: tuple[np.ndarray, ...]
    cycles: np.ndarray
    status: Status


def solve_contour_pose(
    shape: np.ndarray | RigidSurface,
    cameras: Sequence[Camera],
    outlines: Sequence[np.ndarray],
    start: np.ndarray,
    settings: ContourPoseSettings | None = None,
) -> ContourPose:
    """The pose of a rigid object by its outlines.

    Args:
        shape: a surface; or a closed curve's descriptors (N + 1, 3), complex, metres, as
            ``geometry.fourier.phase_vectors`` makes them of points along the curve, in the
            object's frame: (3.13) to (3.15).
        cameras: C of them, calibrated in one world.
        outlines: of each camera (Q, 2) pixels of the object's outline, in any order; none where
            it does not appear.
        start: (4, 4) T_world_object, metres.
        settings: how to work.

    Raises:
        ValueError: arrays of other shapes, no pixel at all, or harmonics that a surface lacks.

    Example:
        A bent wire, turned by 40 degrees, before two cameras:

        >>> import numpy as np
        >>> from jaxmocap.geometry.cameras import Camera, project
        >>> from jaxmocap.geometry.fourier import phase_vectors
        >>> from jaxmocap.silhouette import solve_contour_pose
        >>> phi = np.linspace(0, 2 * np.pi, 200, endpoint=False)
        >>> lobes = 0.1 + 0.02 * np.cos(3 * phi)
        >>> height = 0.03 * np.sin(2 * phi)
        >>> wire = np.stack([1.5 * lobes * np.cos(phi), lobes * np.sin(phi), height], 1)
        >>> matrix = [[800, 0, 320], [0, 800, 240], [0, 0, 1]]
        >>> above = Camera.create((640, 480), matrix, rotation=[np.pi, 0, 0], translation=[0, 0, 1])
        >>> aside = Camera.create((640, 480), matrix, rotation=[2.4, 0, 0], translation=[0, 0, 1])
        >>> truth, turn = np.eye(4), np.radians(40)
        >>> truth[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        >>> there = wire @ truth[:3, :3].T
        >>> outlines = [np.asarray(project(each, there)) for each in (above, aside)]
        >>> found = solve_contour_pose(phase_vectors(wire), [above, aside], outlines, np.eye(4))
        >>> bool(np.abs(found.T_world_object - truth).max() < 1e-3)
        True

        An ellipsoid, whose rim is where rays touch it, turned by 20 degrees:

        >>> from jaxmocap.silhouette import RigidSurface
        >>> axes, theta = np.array([0.1, 0.15, 0.2]), np.linspace(0, np.pi, 40)[:, None]
        >>> unit = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta + 0 * phi)
        >>> def outline(camera, R):
        ...     eye = np.asarray(camera.position_world) @ R / axes
        ...     _, _, (_, x, y) = np.linalg.svd(eye[None])
        ...     ring = np.sqrt(1 - 1 / (eye @ eye)) * np.exp(1j * phi)[:, None]
        ...     rim = eye / (eye @ eye) + ring.real * x + ring.imag * y
        ...     return np.asarray(project(camera, (axes * rim) @ R.T))
        >>> R = np.array([[0.94, -0.342, 0], [0.342, 0.94, 0], [0, 0, 1]])
        >>> outlines = [outline(each, R) for each in (above, aside)]
        >>> surface = RigidSurface(axes * np.stack(unit, -1))
        >>> found = solve_contour_pose(surface, [above, aside], outlines, np.eye(4))
        >>> bool(np.abs(found.T_world_object[:3, :3] - R).max() < 0.01)
        True
    """
    how = settings or ContourPoseSettings()
    _check(shape, cameras, outlines, start, how)
    kept = []
    for outline in outlines:
        count = min(how.samples, len(outline))
        evenly = np.arange(count) * len(outline) // max(count, 1)
        kept.append(np.asarray(outline, float)[evenly].reshape(-1, 2))
    rays = _rays_of(cameras, kept, how.samples)
    begun = jnp.asarray(start, rays.lines.moments.dtype)
    levels, radius, contour = _contours_of(shape, cameras, begun.dtype, how)
    T, moved, counts = begun, np.inf, []
    for level, most, weights in _stages(levels, how):
        count, moved = 0, np.inf
        while count < most and moved > float(how.rest):
            T, step = _move_pose(rays, contour(T, level), T, radius, weights, how.both_ways)
            count, moved = count + 1, float(step)
        counts.append(count)
    T, distances, shares, status = _measure_end(
        rays, begun, T, moved, contour(T, -1), how.deviation * radius, how.rest, how.reach
    )
    off, left = (
        tuple(row[: len(pixels)] for row, pixels in zip(np.array(part), kept, strict=True))
        for part in (distances, shares)
    )
    return ContourPose(np.asarray(T), off, left, np.array(counts), Status(int(status)))


def _check(
    shape: np.ndarray | RigidSurface,
    cameras: Sequence[Camera],
    outlines: Sequence[np.ndarray],
    start: np.ndarray,
    how: ContourPoseSettings,
) -> None:
    """ValueError where something has another shape."""
    if isinstance(shape, RigidSurface):
        if missing := set(how.harmonics) - set(shape.harmonics):
            raise ValueError(f"found harmonics {sorted(missing)}, expected of the surface's "
                             f"{shape.harmonics}")  # fmt: skip
    elif np.ndim(shape) != 2 or np.shape(shape)[0] < 2 or np.shape(shape)[1] != 3:
        raise ValueError(
            f"found descriptors {np.shape(shape)}, expected (N + 1, 3) with N at least 1"
        )
    if len(outlines) != len(cameras):
        raise ValueError(f"found {len(outlines)} outlines, expected one of each of the "
                         f"{len(cameras)} cameras")  # fmt: skip
    for k, outline in enumerate(outlines):
        if np.size(outline) and (np.ndim(outline) != 2 or np.shape(outline)[1] != 2):
            raise ValueError(f"found outline {k} {np.shape(outline)}, expected (Q, 2) pixels")
    if not any(map(np.size, outlines)):
        raise ValueError("found no pixel in any outline, expected some in one camera at least")
    if np.shape(start) != (4, 4):
        raise ValueError(f"found a start {np.shape(start)}, expected (4, 4)")


def _rays_of(cameras: Sequence[Camera], outlines: Sequence[np.ndarray], count: int) -> Rays:
    """Step (a); outlines of fewer pixels are padded."""
    real = np.array([np.arange(count) < len(pixels) for pixels in outlines])
    rows = []
    for camera, pixels in zip(cameras, outlines, strict=True):
        padded = np.zeros((count, 2))
        padded[: len(pixels)] = pixels
        rows.append(camera_lines(camera, jnp.asarray(padded, float)))
    return Rays(Lines(*(jnp.stack(parts) for parts in zip(*rows, strict=True))), jnp.asarray(real))


def _stages(levels: Sequence[int], how: ContourPoseSettings) -> list[tuple[int, int, StepWeights]]:
    """Low-passes, the object, its contour free to slide, and without what lies far off.

    Of each which low-pass, -1 for the object; most cycles; what pairs count.
    """
    firm = StepWeights(1.0, how.deviation, np.inf, how.damping)
    free = firm._replace(along=how.along_weight)
    full = (firm, free, free._replace(reach=how.reach))
    return [(level, how.low_cycles, firm) for level in levels] + [
        (-1, how.cycles, weights) for weights in full
    ]


def _radius(points: np.ndarray) -> float:
    """Root mean square distance of points (P, 3) from their middle."""
    return float(np.sqrt(np.mean(np.sum((points - points.mean(0)) ** 2, -1))))


def _contours_of(
    shape: np.ndarray | RigidSurface,
    cameras: Sequence[Camera],
    dtype: jnp.dtype,
    how: ContourPoseSettings,
) -> tuple[Sequence[int], float, Callable[[Array, int], SpaceContour]]:
    """Low-passes that lead the way, the radius, and the contour at a pose of one, -1 for none."""
    if isinstance(shape, RigidSurface):
        stacked, radius = stack_cameras(cameras), _radius(shape.nodes[-1])

        def of_surface(T: Array, level: int) -> SpaceContour:
            rim = shape.rim(T, stacked, level)
            points = shape.nodes[level][rim.nodes].astype(dtype)
            return contour_of_rim(stacked, rim, points, T, radius)

        return [shape.harmonics.index(each) for each in how.harmonics], radius, of_surface
    phases = 2 * np.pi * np.arange(how.samples) / how.samples
    low = [h for h in how.harmonics if h < len(shape) - 1]
    curves = [fourier_series(shape, phases, h) for h in (*low, None)]

    def of_wire(T: Array, level: int) -> SpaceContour:
        return contour_of_wire(curves[level].astype(dtype), T, len(cameras))

    return range(len(low)), _radius(curves[-1]), of_wire


@partial(jax.jit, static_argnames="both_ways")
def _move_pose(
    rays: Rays,
    contour: SpaceContour,
    T: Array,
    radius: Array,
    weights: StepWeights,
    both_ways: bool,
) -> tuple[Array, Array]:
    """A pose after one cycle, and by how much of the radius the contour moved."""
    step = step_towards(rays, contour, radius, weights, both_ways)
    ways = jnp.linalg.norm(twists.move(step, contour.points) - contour.points, axis=-1)
    there = jnp.matmul(step, T, precision=HIGHEST)
    return there, jnp.max(jnp.where(contour.real, ways, 0.0)) / radius


@jax.jit
def _measure_end(
    rays: Rays,
    start: Array,
    T: Array,
    moved: Array,
    contour: SpaceContour,
    deviation: Array,
    rest: Array,
    reach: Array,
) -> tuple[Array, Array, Array, Array]:
    """The pose (4, 4), distances and shares (C, Q) of the rays, and a status."""
    broken = ~jnp.all(jnp.isfinite(T))
    status = jnp.where(moved > rest, Status.OUT_OF_STEPS, Status.CONVERGED)
    status = jnp.where(broken, Status.BROKEN, status).astype(jnp.int32)
    off = distances_off(rays, contour, deviation, reach)
    return jnp.where(broken, start, T), *off, status
