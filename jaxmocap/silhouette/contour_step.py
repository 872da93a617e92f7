"""One step of a rigid object's pose by its contour (second paper, 3.1.3 and 3.1.4).

INPUTS: rays of C cameras; in the world the contour that each of them sees of the object.
OUTPUTS: the motion that brings contour and rays together; how far the rays are off.

    (b) each ray goes with the nearest point of the contour, and each point with the nearest ray
    (c) one twist brings the points nearer to their rays

A wire is one contour for all cameras; a surface's rim is another for each.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.geometry import twists
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.lines import Lines, incidence
from jaxmocap.geometry.rotations import HIGHEST, cross, rotate
from jaxmocap.silhouette.points import contour_rays
from jaxmocap.silhouette.surfaces.rim import Rim
from jaxmocap.solvers.robust import robust_shares

# Points of a rim one after the other lie on one outline where they are no farther apart than this,
# by the object's radius.
LONGEST_LINK = 0.3


class Rays(NamedTuple):
    """Of C cameras, Q each (C, Q), padded."""

    lines: Lines
    real: Array


class SpaceContour(NamedTuple):
    """P points of the object for each of C cameras, padded; metres or another unit."""

    points: Array  # (C, P, 3)
    after: Array  # (C, P, 3) the end of the stretch that begins at each point; the point for none
    tangents: Array  # (C, P, 3) along the contour, of any length
    real: Array  # (C, P)


class StepWeights(NamedTuple):
    """What pairs count; traced."""

    along: Array | float  # of pairs along the contour, by that across
    deviation: Array | float  # least spread of pairs, by the object's radius
    # A pair farther off than this many spreads is an outlier; infinite for none.
    reach: Array | float
    damping: Array | float  # share of all pairs' weight that holds what no ray determines


@partial(jax.jit, static_argnames="cameras")
def contour_of_wire(curve: Array, T_world_object: Array, cameras: int) -> SpaceContour:
    """A closed curve (P, 3), object's frame, the same for all cameras."""
    points = twists.move(T_world_object, curve)
    before, after = (jnp.roll(points, k, 0) for k in (1, -1))
    parts = jnp.stack([points, after, after - before])[:, None]
    points, after, tangents = jnp.broadcast_to(parts, (3, cameras, *points.shape))
    return SpaceContour(points, after, tangents, jnp.ones(points.shape[:2], bool))


@jax.jit
def contour_of_rim(
    cameras: Camera, rim: Rim, points: Array, T_world_object: Array, radius: Array | float
) -> SpaceContour:
    """What C cameras (stacked) see of a surface, by the rim's points (C, P, 3), object's frame."""
    pixels_xy, normals = jnp.asarray(rim.pixels_xy), jnp.asarray(rim.normals)
    lines, across = jax.vmap(contour_rays)(cameras, pixels_xy, normals)
    x, real = twists.move(T_world_object, points), jnp.asarray(rim.valid)

    there, both = jnp.roll(x, -1, 1), real & jnp.roll(real, -1, 1)
    near = both & (jnp.linalg.norm(there - x, axis=-1) < LONGEST_LINK * radius)
    tangents = cross(lines.directions, across)
    return SpaceContour(x, jnp.where(near[..., None], there, x), tangents, real)


def step_towards(
    rays: Rays, contour: SpaceContour, radius: Array, weights: StepWeights, both_ways: bool
) -> Array:
    """(4, 4) the motion of the world that brings pairs together: steps (b) and (c).

    The twist is taken about the contours' middle, with lengths by the object's radius: so the
    system is as well conditioned wherever the object is, and however large.
    """
    counted = contour.real.astype(contour.points.dtype)[..., None]
    centre = jnp.sum(counted * contour.points, (0, 1)) / jnp.sum(counted)
    n = rays.lines.directions
    rays = rays._replace(lines=Lines(n, (rays.lines.moments - cross(centre, n)) / radius))
    points, after = ((part - centre) / radius for part in contour[:2])
    contour = contour._replace(points=points, after=after)
    pairs = [(*nearest_points(rays.lines, contour), rays.lines, rays.real)]
    if both_ways:
        # Every point of the contours with its camera's nearest ray: (C, P) pairs.
        squared = sum((r**2 for r in _incidences(rays.lines, contour.points)), jnp.zeros(()))
        best = jnp.argmin(jnp.where(rays.real[..., None], squared, jnp.inf), 1)[..., None]
        nearest = Lines(*(jnp.take_along_axis(part, best, 1) for part in rays.lines))
        count = contour.real & jnp.any(rays.real, 1, keepdims=True)
        pairs.append((contour.points, contour.tangents, nearest, count))
    x, tangents, lines, real = jax.tree.map(
        lambda *parts: jnp.concatenate([part.reshape(-1, *part.shape[2:]) for part in parts]),
        *pairs,
    )
    A, b = linearise_pairs(x, tangents, lines, weights.along)
    # Of contours without a camera, and of cameras without a ray.
    shares = robust_shares(jnp.sum(b**2, -1), real, weights.deviation, weights.reach)[1]
    shares = jnp.where(real, shares, 0.0)
    weight = jnp.sqrt(shares / jnp.sum(shares))[:, None]
    held = jnp.sqrt(weights.damping) * jnp.eye(6, dtype=x.dtype)
    Q, R = jnp.linalg.qr(jnp.concatenate([(weight[..., None] * A).reshape(-1, 6), held]))
    wanted = jnp.matmul(Q[:-6].T, (weight * b).ravel(), precision=HIGHEST)
    T = twists.exp(jax.scipy.linalg.solve_triangular(R, wanted))
    # From the middle's frame back to the world's.
    return twists.rigid(T[:3, :3], centre + radius * T[:3, 3] - rotate(T[:3, :3], centre))


def distances_off(
    rays: Rays, contour: SpaceContour, deviation: Array, reach: Array | float
) -> tuple[Array, Array]:
    """Of all rays (C, Q) how far the contour is off, and the share of an outlier or not."""
    off = incidence(rays.lines, nearest_points(rays.lines, contour)[0])
    squared, real = jnp.sum(off**2, -1).ravel(), rays.real.ravel()
    distances, shares, _ = robust_shares(squared, real, deviation, reach)
    return distances.reshape(rays.real.shape), shares.reshape(rays.real.shape)


def linearise_pairs(
    x: Array, tangents: Array, lines: Lines, along_weight: Array | float
) -> tuple[Array, Array]:
    """Equation (3.12), (I + xi) x x n = m: A (N, 3, 6) and b (N, 3) with A xi = b.

    What moves a point along the contour counts by its weight.
    """
    unit = twists.hat(jnp.eye(6, dtype=x.dtype))[:, :3]
    homogeneous = jnp.concatenate([x, jnp.ones_like(x[:, :1])], -1)
    moves = jnp.einsum("jab,nb->nja", unit, homogeneous, precision=HIGHEST)
    A = jnp.swapaxes(cross(moves, lines.directions[:, None]), 1, 2)
    b = -incidence(lines, x)
    along = cross(tangents, lines.directions)
    squared = jnp.maximum(jnp.sum(along**2, -1, keepdims=True), 1e-12)
    less = (1 - along_weight) * along / squared
    b = b - jnp.sum(b * along, -1, keepdims=True) * less
    return A - jnp.sum(A * along[..., None], 1, keepdims=True) * less[..., None], b


def nearest_points(lines: Lines, contour: SpaceContour) -> tuple[Array, Array]:
    """Of each camera's contour the points (C, Q, 3) nearest to its lines, and tangents there."""
    off = _incidences(lines, contour.points)
    ways = [end - start for start, end in zip(off, _incidences(lines, contour.after), strict=True)]
    length = sum((way**2 for way in ways), jnp.zeros(()))
    towards = -sum((r * way for r, way in zip(off, ways, strict=True)), jnp.zeros(()))
    share = jnp.clip(towards / jnp.maximum(length, 1e-12), 0, 1)
    squared = sum(((r + share * way) ** 2 for r, way in zip(off, ways, strict=True)), jnp.zeros(()))
    best = jnp.argmin(jnp.where(contour.real[:, None], squared, jnp.inf), -1)[..., None]
    start, end, tangents = (jnp.take_along_axis(part, best, 1) for part in contour[:3])
    return start + jnp.take_along_axis(share, best, -1) * (end - start), tangents


def _incidences(lines: Lines, points: Array) -> tuple[Array, Array, Array]:
    """Each component (C, Q, P) of (3.2) for all points (C, P, 3) and lines (C, Q)."""
    x, y, z = (points[:, None, :, k] for k in range(3))
    a, b, c = (lines.directions[..., k, None] for k in range(3))
    d, e, f = (lines.moments[..., k, None] for k in range(3))
    return y * c - z * b - d, z * a - x * c - e, x * b - y * a - f
