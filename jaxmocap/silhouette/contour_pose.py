"""Pose of a rigid object by its contour in space (second paper, 3.1.1 to 3.1.4, Figs. 9 to 12).

INPUTS: a closed curve of any form by its Fourier descriptors; pixels of its outline in one to four
cameras; a pose to start from.
OUTPUTS: the pose that brings the curve onto the outlines' rays, and how far it stays from them.

    (a) the outlines' pixels become rays: Pluecker lines of the world
    (b) each ray goes with the nearest point of the curve, and each point with the nearest ray
    (c) one twist brings the points nearer to their rays; its exponential moves the curve
    (d) again from (b)

At first the curve has its lowest frequencies alone, of which few are caught in a wrong valley; it
gets higher ones as the pose settles, and in the end all of them.
"""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.geometry import twists
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.fourier import fourier_series
from jaxmocap.geometry.lines import Lines, camera_lines, incidence
from jaxmocap.geometry.rotations import HIGHEST, rotate
from jaxmocap.solvers.status import Status


class ContourPoseSettings(NamedTuple):
    """What a user may tune.

    Attributes:
        harmonics: of the low-pass curves, one stage each; all of the curve's follow; static.
        low_cycles: of (b) to (d) in each of these stages.
        cycles: of the last two stages, at most.
        rest: a step that moves no point of the curve farther ends a stage; by the curve's radius.
        both_ways: whether the curve's points look for rays too; the paper's look for none. Where an
            outline shows a part of the curve only, let them not; static.
        along_weight: of pairs along the curve, by that across, in the last stage, which brings the
            digits; before it is 1, as in (3.11), and a curve slides along itself slowly.
        damping: share of all pairs' weight that holds what no ray determines.
        samples: of the curve, and of each outline, evenly; static.
    """

    harmonics: tuple[int, ...] = (1, 2, 4, 8)
    low_cycles: Array | int = 3
    cycles: Array | int = 60
    rest: Array | float = 1e-3
    both_ways: bool = True
    along_weight: Array | float = 0.1
    damping: Array | float = 1e-6
    samples: int = 128


class ContourPose(NamedTuple):
    """Where the object is.

    Attributes:
        T_world_object: (4, 4) from the curve's frame, metres.
        distances: of each camera (Q,) of its rays from the curve, metres.
        cycles: (S,) made in each stage.
        status: a Status; with ``BROKEN`` the pose is the start.
    """

    T_world_object: np.ndarray
    distances: tuple[np.ndarray, ...]
    cycles: np.ndarray
    status: Status


class _Rays(NamedTuple):
    """Of C cameras, Q each, padded."""

    lines: Lines
    real: Array


class _Stage(NamedTuple):
    """A curve (P, 3) in the object's frame, most cycles, and the weight along the curve."""

    curve: Array
    cycles: Array
    along_weight: Array


def solve_contour_pose(
    descriptors: np.ndarray,
    cameras: Sequence[Camera],
    outlines: Sequence[np.ndarray],
    start: np.ndarray,
    settings: ContourPoseSettings | None = None,
) -> ContourPose:
    """The pose of a rigid object whose contour in space is a closed curve.

    Args:
        descriptors: (N + 1, 3) complex, metres, as ``geometry.fourier.phase_vectors`` makes them
            of points along the curve, in the object's frame: (3.13) to (3.15).
        cameras: C of them, calibrated in one world.
        outlines: of each camera (Q, 2) pixels where the curve appears, in any order; none where it
            does not.
        start: (4, 4) T_world_object, metres.
        settings: how to work.

    Raises:
        ValueError: arrays of other shapes, or no pixel at all.

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
    """
    how = settings or ContourPoseSettings()
    _check(descriptors, cameras, outlines, start)
    kept = [_evenly(np.asarray(outline, float), how.samples) for outline in outlines]
    rays = _rays_of(cameras, kept, how.samples)
    dtype = rays.lines.moments.dtype
    T, distances, cycles, status = _solved(
        rays,
        _stages(descriptors, how, dtype),
        jnp.asarray(start, dtype),
        how.rest,
        how.damping,
        how.both_ways,
    )
    off = tuple(row[: len(pixels)] for row, pixels in zip(np.array(distances), kept, strict=True))
    return ContourPose(np.asarray(T), off, np.asarray(cycles), Status(int(status)))


def _check(
    descriptors: np.ndarray,
    cameras: Sequence[Camera],
    outlines: Sequence[np.ndarray],
    start: np.ndarray,
) -> None:
    """ValueError where something has another shape."""
    shape = np.shape(descriptors)
    if len(shape) != 2 or shape[0] < 2 or shape[1] != 3:
        raise ValueError(f"found descriptors {shape}, expected (N + 1, 3) with N at least 1")
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


def _evenly(outline: np.ndarray, most: int) -> np.ndarray:
    """At most so many pixels (Q, 2) of an outline."""
    if len(outline) <= most:
        return outline.reshape(-1, 2)
    return outline[np.arange(most) * len(outline) // most]


def _rays_of(cameras: Sequence[Camera], outlines: Sequence[np.ndarray], count: int) -> _Rays:
    """Step (a); outlines of fewer pixels are padded."""
    real = np.array([np.arange(count) < len(pixels) for pixels in outlines])
    rows = []
    for camera, pixels in zip(cameras, outlines, strict=True):
        padded = np.zeros((count, 2))
        padded[: len(pixels)] = pixels
        rows.append(camera_lines(camera, jnp.asarray(padded, float)))
    return _Rays(Lines(*(jnp.stack(parts) for parts in zip(*rows, strict=True))), jnp.asarray(real))


def _stages(descriptors: np.ndarray, how: ContourPoseSettings, dtype: jnp.dtype) -> _Stage:
    """S stages: low-pass curves, the curve, and the curve once more, which may slide."""
    phases = 2 * np.pi * np.arange(how.samples) / how.samples
    low = [h for h in how.harmonics if h < len(descriptors) - 1]
    curves = [fourier_series(descriptors, phases, h) for h in (*low, None, None)]
    cycles = [how.low_cycles] * len(low) + [how.cycles] * 2
    along_weights = [1.0] * (len(low) + 1) + [how.along_weight]
    return _Stage(
        jnp.asarray(np.stack(curves), dtype),
        jnp.asarray(cycles, jnp.int32),
        jnp.asarray(along_weights, dtype),
    )


@partial(jax.jit, static_argnames="both_ways")
def _solved(
    rays: _Rays, stages: _Stage, start: Array, rest: Array, damping: Array, both_ways: bool
) -> tuple[Array, Array, Array, Array]:
    """The pose (4, 4), distances (C, Q), cycles (S,) and status after all stages."""
    whole = stages.curve[-1]
    radius = jnp.sqrt(jnp.mean(jnp.sum((whole - jnp.mean(whole, 0)) ** 2, -1)))

    def stage(T: Array, now: _Stage) -> tuple[Array, tuple[Array, Array]]:
        def unfinished(carry: tuple[Array, Array, Array]) -> Array:
            return (carry[0] < now.cycles) & (carry[2] > rest)

        def cycle(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
            count, T, _ = carry
            curve = twists.move(T, now.curve)
            step = _step(rays, curve, radius, now.along_weight, damping, both_ways)
            moved = jnp.linalg.norm(twists.move(step, curve) - curve, axis=-1)
            return count + 1, jnp.matmul(step, T, precision=HIGHEST), jnp.max(moved) / radius

        far = jnp.asarray(jnp.inf, T.dtype)
        count, T, moved = jax.lax.while_loop(unfinished, cycle, (jnp.zeros((), jnp.int32), T, far))
        return T, (count, moved)

    T, (counts, moved) = jax.lax.scan(stage, start, stages)
    broken = ~jnp.all(jnp.isfinite(T))
    status = jnp.where(moved[-1] > rest, Status.OUT_OF_STEPS, Status.CONVERGED)
    T = jnp.where(broken, start, T)
    off = incidence(rays.lines, _nearest_points(rays.lines, twists.move(T, whole))[0])
    status = jnp.where(broken, Status.BROKEN, status).astype(jnp.int32)
    return T, jnp.linalg.norm(off, axis=-1), counts, status


def _step(
    rays: _Rays, curve: Array, radius: Array, along_weight: Array, damping: Array, both_ways: bool
) -> Array:
    """(4, 4) the motion that brings pairs together: steps (b) and (c).

    The twist is taken about the curve's middle, with lengths by its radius: so the system is as
    well conditioned wherever the object is, and however large.
    """
    centre = jnp.mean(curve, 0)
    n = rays.lines.directions
    lines = Lines(n, (rays.lines.moments - jnp.cross(centre, n)) / radius)
    curve = (curve - centre) / radius
    points, tangents = _nearest_points(lines, curve)
    weights = rays.real.astype(curve.dtype)
    pairs = [(points, tangents, lines, weights)]
    if both_ways:
        pairs.append(_nearest_lines(rays._replace(lines=lines), curve))
    x, tangents, lines, weights = jax.tree.map(
        lambda *parts: jnp.concatenate([part.reshape(-1, *part.shape[2:]) for part in parts]),
        *pairs,
    )
    A, b = _linearised(x, tangents, lines, along_weight)
    weight = jnp.sqrt(weights / jnp.sum(weights))[:, None]
    held = jnp.sqrt(damping) * jnp.eye(6, dtype=x.dtype)
    Q, R = jnp.linalg.qr(jnp.concatenate([(weight[..., None] * A).reshape(-1, 6), held]))
    wanted = jnp.matmul(Q[:-6].T, (weight * b).ravel(), precision=HIGHEST)
    T = twists.exp(jax.scipy.linalg.solve_triangular(R, wanted))
    # From the middle's frame back to the world's.
    return twists.rigid(T[:3, :3], centre + radius * T[:3, 3] - rotate(T[:3, :3], centre))


def _linearised(
    x: Array, tangents: Array, lines: Lines, along_weight: Array
) -> tuple[Array, Array]:
    """Equation (3.12), (I + xi) x x n = m: A (N, 3, 6) and b (N, 3) with A xi = b.

    What moves a point along the curve counts by its weight.
    """
    unit = twists.hat(jnp.eye(6, dtype=x.dtype))[:, :3]
    homogeneous = jnp.concatenate([x, jnp.ones_like(x[:, :1])], -1)
    moves = jnp.einsum("jab,nb->nja", unit, homogeneous, precision=HIGHEST)
    A = jnp.swapaxes(jnp.cross(moves, lines.directions[:, None]), 1, 2)
    b = -incidence(lines, x)
    along = jnp.cross(tangents, lines.directions)
    squared = jnp.maximum(jnp.sum(along**2, -1, keepdims=True), 1e-12)
    less = (1 - along_weight) * along / squared
    b = b - jnp.sum(b * along, -1, keepdims=True) * less
    return A - jnp.sum(A * along[..., None], 1, keepdims=True) * less[..., None], b


def _nearest_points(lines: Lines, curve: Array) -> tuple[Array, Array]:
    """Of a closed curve (P, 3) the points (C, Q, 3) nearest to lines, and tangents there."""
    best = jnp.argmin(_squared_distances(lines, curve), -1)
    before, here, after = (jnp.roll(curve, k, 0)[best] for k in (1, 0, -1))
    options = [_on_segment(lines, here, there) for there in (before, after)]
    first, second = (jnp.sum(incidence(lines, x) ** 2, -1, keepdims=True) for x in options)
    return jnp.where(first < second, *options), after - before


def _on_segment(lines: Lines, start: Array, end: Array) -> Array:
    """Between two points (..., 3) the one that is nearest to a line."""
    change = jnp.cross(end - start, lines.directions)
    squared = jnp.maximum(jnp.sum(change**2, -1, keepdims=True), 1e-12)
    share = -jnp.sum(incidence(lines, start) * change, -1, keepdims=True) / squared
    return start + jnp.clip(share, 0, 1) * (end - start)


def _nearest_lines(rays: _Rays, curve: Array) -> tuple[Array, Array, Lines, Array]:
    """Every point of a curve (P, 3) with each camera's nearest ray: (C, P) pairs and weights."""
    squared = jnp.where(rays.real[..., None], _squared_distances(rays.lines, curve), jnp.inf)
    best = jnp.argmin(squared, 1)[..., None]
    lines = Lines(*(jnp.take_along_axis(part, best, 1) for part in rays.lines))
    tangents = jnp.roll(curve, -1, 0) - jnp.roll(curve, 1, 0)
    points, tangents = (jnp.broadcast_to(x, lines.moments.shape) for x in (curve, tangents))
    weights = jnp.broadcast_to(jnp.any(rays.real, 1, keepdims=True), best.shape[:2])
    return points, tangents, lines, weights.astype(curve.dtype)


def _squared_distances(lines: Lines, curve: Array) -> Array:
    """(C, Q, P) of points (P, 3) from lines: (3.3) and (3.4)."""
    x, y, z = curve.T
    a, b, c = (lines.directions[..., k, None] for k in range(3))
    d, e, f = (lines.moments[..., k, None] for k in range(3))
    return (y * c - z * b - d) ** 2 + (z * a - x * c - e) ** 2 + (x * b - y * a - f) ** 2
