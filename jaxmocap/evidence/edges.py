"""How well an arm fits the edges: equations (13) and (14), and the outline's distance.

The paper sums distances over the filled silhouette; such a sum falls when the limb hides or
shrinks. The default is the mean distance along the outline, to edges that run its way.

INPUTS: one arm's limbs, a camera, the fields of its region. OUTPUTS: a cost.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.arms import Arms, flesh
from jaxmocap.body.surfaces.cones import Cones, project_cones
from jaxmocap.geometry.cameras import (
    NEAREST_M,
    Camera,
    camera_components,
    depth,
    normals_in_pixels,
    pixel_components,
    pixels_per_metre,
)
from jaxmocap.geometry.outlines import Pieces, joined, outline_pieces
from jaxmocap.hybrid.observe import Observation
from jaxmocap.hybrid.settings import EvidenceSettings
from jaxmocap.images.raster import soft_coverage
from jaxmocap.images.regions import Region, discs_in_region
from jaxmocap.images.sampling import look_up

# Outline points per side and per arc of a limb.
ALONG, AROUND = 8, 1
# The hand is no cone: its outline counts half.
LIMB_WEIGHTS = (1.0, 1.0, 0.5)
# Which ends are free: of the three limbs only the hand's far one.
OPEN_ENDS = ((0.0, 0.0), (0.0, 0.0), (0.0, 1.0))
# Pixels this near to the image's border are not scored.
BORDER_PX = 2.0


class Traced(NamedTuple):
    """An arm's outline in one camera, laid over the distance fields.

    Attributes:
        points: (3, K, 2) of the three limbs, on the plane z = 1.
        distances_px: (3, K) to the nearest edge of each point's direction, pixels.
        metres_per_px: (3, 1) at the limbs' depth.
        weights: (3, K) length of outline that each point stands for; 0 outside the image.
    """

    points: Array
    distances_px: Array
    metres_per_px: Array
    weights: Array


class _Laid(NamedTuple):
    """Sides or arcs of limbs (3, ...), laid over the distance fields: (2, K, 3, ...) each."""

    points: Pieces  # on the plane z = 1
    distances_px: Array
    weights: Array  # 0 outside the image


def _lay(
    camera: Camera, region: Region, fields: Array, limbs: Cones
) -> tuple[tuple[_Laid, _Laid], Array]:
    """Sides and arcs of limbs (..., 3), laid over the fields; metres per pixel (3, ...) there."""
    batch = limbs.near.ndim - 2
    ends = jnp.moveaxis(jnp.stack([limbs.near, limbs.far]), (-1, -2), (0, 2))
    x, y, depths = camera_components(camera, *ends)
    near = 1 / jnp.maximum(depths, NEAREST_M)
    radii = jnp.broadcast_to(limbs.radii, (*limbs.near.shape[:-1], 2))
    radii = jnp.moveaxis(radii, (-1, -2), (0, 1)) * near
    by_limb = (len(LIMB_WEIGHTS), *(1,) * batch)
    free = jnp.asarray(OPEN_ENDS, x.dtype).T.reshape(2, *by_limb)
    pieces = outline_pieces(x * near, y * near, radii, ALONG, AROUND, free)
    front = jnp.minimum(depths[0], depths[1]) > 0
    shares = jnp.where(front, jnp.asarray(LIMB_WEIGHTS, x.dtype).reshape(by_limb), 0.0)
    sides, arcs = (_look_up(camera, region, fields, piece, shares) for piece in pieces)
    return (sides, arcs), 1 / pixels_per_metre(camera, (depths[0] + depths[1]) / 2)


def _look_up(camera: Camera, region: Region, fields: Array, points: Pieces, shares: Array) -> _Laid:
    """Points (2, K, 3, ...) in the fields; weighed by the limbs' (3, ...) shares."""
    x, y = pixel_components(camera, points.x, points.y)
    normals = points.normal_x, points.normal_y
    normal_x, normal_y = normals_in_pixels(camera, (points.x, points.y), *normals)
    channels = _channels(normal_x, normal_y, fields.shape[0])
    samples = (
        (pixel - corner) / region.scale - 0.5
        for pixel, corner in ((x, region.origin[0]), (y, region.origin[1]))
    )
    distances_px = look_up(fields, channels, *samples) * region.scale
    right, bottom = camera.size[0] - 1 - BORDER_PX, camera.size[1] - 1 - BORDER_PX
    inside = (x >= BORDER_PX) & (x <= right) & (y >= BORDER_PX) & (y <= bottom)
    return _Laid(points, distances_px, jnp.where(inside, points.weights * shares, 0.0))


def trace_outline(camera: Camera, region: Region, fields: Array, limbs: Cones) -> Traced:
    """Look an arm's outline up in the fields of its region.

    Args:
        camera: that sees the arm.
        region: of the arm in this camera (no batch).
        fields: (K, S, S) distances, samples of the region.
        limbs: three cones, world, metres.
    """
    laid, metres_per_px = _lay(camera, region, fields, limbs)

    def rows(parts: list[Array]) -> Array:
        return jnp.concatenate([part.reshape(-1, *part.shape[2:]) for part in parts]).T

    sides, arcs = laid
    return Traced(
        joined((sides.points, arcs.points)).points,
        rows([part.distances_px for part in laid]),
        metres_per_px[:, None],
        rows([part.weights for part in laid]),
    )


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
    laid, metres_per_px = _lay(camera, region, fields, limbs)
    total, metres, pixels = (
        sum(
            jnp.sum(part.weights * values, (0, 1, 2))
            for part, values in zip(laid, each, strict=True)
        )
        for each in (
            [jnp.ones_like(part.weights) for part in laid],
            [jnp.minimum(part.distances_px * metres_per_px, truncation) for part in laid],
            [part.distances_px for part in laid],
        )
    )
    visible = total > 1e-6
    shared = 1 / jnp.where(visible, total, 1.0)
    return (
        jnp.where(visible, metres * shared, truncation),
        jnp.where(visible, pixels * shared, jnp.nan),
    )


def _channels(x: Array, y: Array, count: int) -> Array:
    """Channel (...) of outline normals in the image.

    The arc tangent, dear to XLA, is found once and kept; counting the borders that a
    normal has passed would be done anew at each of the many look-ups.
    """
    # A normal and its opposite are one direction: turn it to the upper half plane.
    flip = jnp.where((y < 0) | ((y == 0) & (x < 0)), -1.0, 1.0)
    still = (x == 0) & (y == 0)
    angle = jnp.arctan2(flip * y, jnp.where(still, 1.0, flip * x))
    return jnp.minimum(jnp.floor(angle * (count / np.pi)).astype(jnp.int32), count - 1)


def chamfer_sum(
    camera: Camera, region: Region, fields: Array, limbs: Cones, softness: Array
) -> Array:
    """Equation (13), softened: the sum of coverage times distance, samples of the region.

    The plain field is the least over the directions.
    """
    discs = discs_in_region(region, project_cones(camera, limbs))
    coverage = soft_coverage(discs, fields.shape[-1], softness)
    return jnp.sum(coverage * jnp.min(fields, 0))


def raster_distance(
    camera: Camera, region: Region, fields: Array, limbs: Cones, softness: Array
) -> Array:
    """Equation (13) over the area that the limbs would cover seen from the side: metres.

    The area depends on the limbs' size and depth alone, so this is the paper's sum in another
    unit: it has the same minimum, and the priors' weights do not depend on the resolution.
    """
    away = jnp.maximum(jnp.mean(depth(camera, limbs.near)), 0.1)
    samples_per_metre = pixels_per_metre(camera, away) / region.scale
    lengths = jnp.sqrt(jnp.sum((limbs.far - limbs.near) ** 2, -1) + 1e-12)
    area = jnp.sum(lengths * jnp.sum(limbs.radii, -1)) * samples_per_metre**2
    return chamfer_sum(camera, region, fields, limbs, softness) / area / samples_per_metre


def arm_cost(
    kind: str, settings: EvidenceSettings, cameras: Camera, observation: Observation, limbs: Cones
) -> Array:
    """Cost of one arm, summed over C cameras; 0 where none sees it.

    Args:
        kind: "outline" or "raster" (static).
        settings: traced.
        cameras: C, stacked.
        observation: of this arm: region (C), fields (C, K, S, S), seen (C,).
        limbs: (..., 3) cones, world: the arm in one place, or in many for many costs (...).
    """

    def of_camera(camera: Camera, region: Region, fields: Array) -> Array:
        if kind == "outline":
            return outline_distance(camera, region, fields, limbs, settings.truncation)[0]
        of_place = partial(raster_distance, camera, region, fields, softness=settings.softness)
        for _ in range(limbs.near.ndim - 2):
            of_place = jax.vmap(of_place)
        return of_place(limbs)

    distances = jax.vmap(of_camera)(cameras, observation.region, jnp.asarray(observation.fields))
    seen = jnp.asarray(observation.seen).reshape(-1, *(1,) * (distances.ndim - 1))
    return jnp.sum(jnp.where(seen, distances, 0.0), 0) / settings.edge_scale


def outline_px(
    settings: EvidenceSettings, cameras: Camera, observation: Observation, arms: Arms
) -> Array:
    """Mean distance (2,) of both arms' outlines to the edges over C cameras, pixels; NaN unseen."""

    def of_camera(camera: Camera, region: Region, fields: Array, limbs: Cones) -> Array:
        return outline_distance(camera, region, fields, limbs, settings.truncation)[1]

    def of_arm(seen: Observation, limbs: Cones) -> Array:
        each = jax.vmap(of_camera, (0, 0, 0, None))(
            cameras, seen.region, jnp.asarray(seen.fields), limbs
        )
        return jnp.nanmean(jnp.where(seen.seen, each, jnp.nan))

    return jax.vmap(of_arm)(observation.by_arm(), flesh(arms))
