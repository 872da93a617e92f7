"""An arm's outline in one camera, samples over the distance fields of its region; what hides it.

INPUTS: limbs, a camera, distance fields of edges. OUTPUTS: outline points, their distances.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.arms import Arms, flesh
from jaxmocap.body.kinematics import Frames
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.cones import Cones, cones
from jaxmocap.geometry.cameras import (
    NEAREST_M,
    Camera,
    camera_components,
    normals_in_pixels,
    pixel_components,
    pixels_per_metre,
    to_camera,
)
from jaxmocap.geometry.outlines import (
    Discs,
    Pieces,
    depth_along,
    outline_pieces,
    project_limb,
    touch,
)
from jaxmocap.images.regions import Region
from jaxmocap.images.sampling import look_up, look_up_smoothly

# Outline points along each side of a limb.
POINTS_PER_SIDE = 8
# Outline points on each arc.
POINTS_PER_ARC = 1
# The hand is no cone: its outline counts half.
LIMB_WEIGHTS = (1.0, 1.0, 0.5)
# Which ends are free: of the three limbs only the hand's far one.
OPEN_ENDS = ((0.0, 0.0), (0.0, 0.0), (0.0, 1.0))
# Pixels this near to the image's border are not scored.
BORDER_PX = 2.0


class TracedOutline(NamedTuple):
    """An arm's outline in one camera, samples over the distance fields."""

    points: Array  # (3, K, 2) of the three limbs, on the plane z = 1
    distances_px: Array  # (3, K) to the nearest edge of each point's direction, pixels
    metres_per_px: Array  # (3, 1) at the limbs' depth
    weights: Array  # (3, K) length of outline that each point stands for; 0 outside the image


def disc_components(camera: Camera, limbs: Cones) -> tuple[tuple[Array, Array, Array], Array]:
    """Centres x and y and radii (2, 3, ...) of limbs' ends on the plane z = 1, and their depths.

    Of limbs (..., 3), near and far ends first.
    """
    ends = jnp.moveaxis(jnp.stack([limbs.near, limbs.far]), (-1, -2), (0, 2))
    x, y, depths = camera_components(camera, *ends)
    near = 1 / jnp.maximum(depths, NEAREST_M)
    radii = jnp.broadcast_to(limbs.radii, (*limbs.near.shape[:-1], 2))
    return (x * near, y * near, jnp.moveaxis(radii, (-1, -2), (0, 1)) * near), depths


def _pieces(camera: Camera, limbs: Cones) -> tuple[tuple[Pieces, Pieces], Array, Array]:
    """Sides and arcs of limbs (..., 3), the limbs' shares (3, ...), metres per pixel (3, ...)."""
    discs, depths = disc_components(camera, limbs)
    by_limb = (len(LIMB_WEIGHTS), *(1,) * (limbs.near.ndim - 2))
    free = jnp.asarray(OPEN_ENDS, depths.dtype).T.reshape(2, *by_limb)
    pieces = outline_pieces(*discs, POINTS_PER_SIDE, POINTS_PER_ARC, free)
    front = jnp.minimum(depths[0], depths[1]) > 0
    shares = jnp.where(front, jnp.asarray(LIMB_WEIGHTS, depths.dtype).reshape(by_limb), 0.0)
    return pieces, shares, 1 / pixels_per_metre(camera, (depths[0] + depths[1]) / 2)


def _points_in_fields(
    camera: Camera, region: Region, fields: Array, points: Pieces, shares: Array, smoothly: bool
) -> tuple[Array, Array]:
    """Distances, pixels, and weights, 0 outside the image, of points (2, K, 3, ...) in the fields.

    Points are sides, arcs or both of limbs (3, ...), whose shares (3, ...) weigh them.
    """
    x, y = pixel_components(camera, points.x, points.y)
    normals = normals_in_pixels(camera, (points.x, points.y), points.normal_x, points.normal_y)
    turns = _turns(*normals, fields.shape[0])
    samples = (
        (pixel - corner) / region.scale - 0.5
        for pixel, corner in ((x, region.origin[0]), (y, region.origin[1]))
    )
    if smoothly:
        distances_px = look_up_smoothly(fields, turns, *samples) * region.scale
    else:
        channels = jnp.minimum(jnp.floor(turns).astype(jnp.int32), fields.shape[0] - 1)
        distances_px = look_up(fields, channels, *samples) * region.scale
    right, bottom = camera.size[0] - 1 - BORDER_PX, camera.size[1] - 1 - BORDER_PX
    inside = (x >= BORDER_PX) & (x <= right) & (y >= BORDER_PX) & (y <= bottom)
    return distances_px, jnp.where(inside, points.weights * shares, 0.0)


def trace_outline(camera: Camera, region: Region, fields: Array, limbs: Cones) -> TracedOutline:
    """Look an arm's outline up in the fields of its region, with a continuous slope.

    Args:
        camera: that sees the arm.
        region: of the arm in this camera (no batch).
        fields: (K, S, S) distances, samples of the region.
        limbs: three cones, world, metres.
    """
    pieces, shares, metres_per_px = _pieces(camera, limbs)
    # Sides and arcs at one go: what is differentiated is half as long.
    points = jax.tree.map(lambda *parts: jnp.concatenate(parts, 1), *map(_even, pieces))
    samples = _points_in_fields(camera, region, fields, points, shares, smoothly=True)
    x, y, distances_px, weights = (
        part.reshape(-1, part.shape[-1]).T for part in (points.x, points.y, *samples)
    )
    return TracedOutline(jnp.stack([x, y], -1), distances_px, metres_per_px[:, None], weights)


def _even(pieces: Pieces) -> Pieces:
    """The same, each of its parts with a number for each point."""
    return Pieces(*(jnp.broadcast_to(part, pieces.x.shape) for part in pieces))


def outline_distance(
    camera: Camera, region: Region, fields: Array, limbs: Cones, truncation: Array
) -> tuple[Array, Array]:
    """Mean distance of arms' outlines to the edges of their direction.

    Args:
        camera: that sees the arm.
        region: of the arm in this camera (no batch).
        fields: (K, S, S) distances, samples of the region.
        limbs: (..., 3) cones, world, metres: one arm's, in one place or many.
        truncation: metres at the limb's depth.

    Returns:
        The mean (...) in metres at the limbs' depth, and the same in pixels; ``truncation`` where
        nothing of the arm is within the image.
    """
    pieces, shares, metres_per_px = _pieces(camera, limbs)
    samples = [_points_in_fields(camera, region, fields, each, shares, False) for each in pieces]

    def summed(values: Callable[[Array], Array]) -> Array:
        sides, arcs = (jnp.sum(weights * values(px), (0, 1, 2)) for px, weights in samples)
        return sides + arcs

    total = summed(jnp.ones_like)
    metres = summed(lambda px: jnp.minimum(px * metres_per_px, truncation))
    pixels = summed(lambda px: px)
    visible = total > 1e-6
    shared = 1 / jnp.where(visible, total, 1.0)
    return (
        jnp.where(visible, metres * shared, truncation),
        jnp.where(visible, pixels * shared, jnp.nan),
    )


def _turns(x: Array, y: Array, count: int) -> Array:
    """Turns (...) of outline normals in the image, from 0 to the fields' count of directions.

    The arc tangent, dear to XLA, is computed once and kept; counting the borders that a normal has
    passed would be repeated at each of the many look-ups.
    """
    # A normal and its opposite are one direction: turn it to the upper half plane.
    flip = jnp.where((y < 0) | ((y == 0) & (x < 0)), -1.0, 1.0)
    still = (x == 0) & (y == 0)
    angle = jnp.arctan2(flip * y, jnp.where(still, 1.0, flip * x))
    return angle * (count / np.pi)


# A limb must be nearer by this, between the axes, to hide another, metres: limbs side by side and
# the shoulder on its own chest hide nothing.
NEARER_M = 0.04


def blockers(skeleton: Skeleton, frames: Frames, arms: Arms) -> Cones:
    """What may hide each arm: (2, N) cones, the other arm's limbs and then the torso's."""
    torso = cones(skeleton, frames, skeleton.tree.bones_in("spine"))
    crossed = jax.tree.map(lambda part: part[::-1], flesh(arms))
    return jax.tree.map(
        lambda other, own: jnp.concatenate([other, jnp.broadcast_to(own, (2, *own.shape))], 1),
        crossed,
        torso,
    )


def hidden(camera: Camera, limbs: Cones, points: Array, others: Cones) -> Array:
    """Which points of one arm's outline lie behind another limb.

    Args:
        camera: that sees them.
        limbs: three cones, world.
        points: (3, K, 2) on the limbs' outlines, on the plane z = 1.
        others: N cones that may hide them, world.

    Returns:
        (3, K) True where hidden.
    """
    near, far = to_camera(camera, limbs.near), to_camera(camera, limbs.far)
    x, y = points[..., 0], points[..., 1]
    limb = Discs(*(part[:, None] for part in project_limb(near, far, limbs.radii)))
    own = depth_along(touch(limb, x, y), near[:, 2:], far[:, 2:])

    def behind(other: Cones) -> Array:
        a, b = to_camera(camera, other.near), to_camera(camera, other.far)
        at = touch(project_limb(a, b, other.radii), x, y)
        ahead = jnp.minimum(a[2], b[2]) > 0
        return (at.distance < 0) & ahead & (depth_along(at, a[2], b[2]) + NEARER_M < own)

    return jnp.any(jax.vmap(behind)(others), 0)
