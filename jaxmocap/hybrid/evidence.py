"""How well an arm fits the edges: equations (13) and (14), and the outline's distance.

The paper sums distances over the filled silhouette; such a sum falls when the limb hides or
shrinks. The default is the mean distance along the outline, to edges that run its way.

INPUTS: one arm's limbs, a camera, the fields of its region. OUTPUTS: a cost.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.flesh import Cones, project_cones
from jaxmocap.geometry.cameras import Camera, to_camera, to_pixels
from jaxmocap.geometry.outlines import outline, project_limb
from jaxmocap.hybrid.arms import Arms, flesh
from jaxmocap.hybrid.observe import Observation
from jaxmocap.hybrid.settings import EvidenceSettings
from jaxmocap.images.raster import soft_coverage
from jaxmocap.images.regions import Region, discs_in_region, to_region
from jaxmocap.images.sampling import bilinear

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


def trace_outline(camera: Camera, region: Region, fields: Array, limbs: Cones) -> Traced:
    """Look an arm's outline up in the fields of its region.

    Args:
        camera: that sees the arm.
        region: of the arm in this camera (no batch).
        fields: (K, S, S) distances, samples of the region.
        limbs: three cones, world, metres.
    """
    near, far = to_camera(camera, limbs.near), to_camera(camera, limbs.far)
    discs = project_limb(near, far, limbs.radii)
    samples = outline(discs, ALONG, AROUND, jnp.asarray(OPEN_ENDS, near.dtype))
    pixels = to_pixels(camera, samples.points)
    channels = _channels(camera, samples.normals, fields.shape[0])
    distances_px = bilinear(fields, channels, to_region(region, pixels)) * region.scale
    x, y = pixels[..., 0], pixels[..., 1]
    right, bottom = camera.size[0] - 1 - BORDER_PX, camera.size[1] - 1 - BORDER_PX
    inside = (x >= BORDER_PX) & (x <= right) & (y >= BORDER_PX) & (y <= bottom)
    front = jnp.minimum(near[:, 2], far[:, 2])[:, None] > 0
    weights = samples.weights * jnp.asarray(LIMB_WEIGHTS, near.dtype)[:, None]
    metres_per_px = ((near[:, 2] + far[:, 2]) / 2 / camera.matrix[0, 0])[:, None]
    weights = jnp.where(inside & front, weights, 0.0)
    return Traced(samples.points, distances_px, metres_per_px, weights)


def outline_distance(
    camera: Camera, region: Region, fields: Array, limbs: Cones, truncation: Array
) -> tuple[Array, Array]:
    """Mean distance of an arm's outline to the edges of its direction.

    Args:
        camera: that sees the arm.
        region: of the arm in this camera (no batch).
        fields: (K, S, S) distances, samples of the region.
        limbs: three cones, world, metres.
        truncation: metres at the limb's depth.

    Returns:
        The mean in metres at the limbs' depth, and the same in pixels; ``truncation`` where
        nothing of the arm is within the image.
    """
    _, distances_px, metres_per_px, weights = trace_outline(camera, region, fields, limbs)
    distances = jnp.minimum(distances_px * metres_per_px, truncation)
    total = jnp.sum(weights)
    visible = total > 1e-6
    mean = jnp.sum(weights * distances) / jnp.where(visible, total, 1.0)
    mean_px = jnp.sum(weights * distances_px) / jnp.where(visible, total, 1.0)
    return jnp.where(visible, mean, truncation), jnp.where(visible, mean_px, jnp.nan)


def _channels(camera: Camera, normals: Array, count: int) -> Array:
    """Channel (...) of outline normals (..., 2) on the plane z = 1.

    The lens' distortion hardly turns them. Counting the borders between channels that a normal
    has passed is cheaper than an arc tangent.
    """
    x = normals[..., 0] * camera.matrix[0, 0]
    y = normals[..., 1] * camera.matrix[1, 1]
    # A normal and its opposite are one direction: turn it to the upper half plane.
    flip = jnp.where((y < 0) | ((y == 0) & (x < 0)), -1.0, 1.0)
    borders = np.arange(1, count) * np.pi / count
    passed = [np.cos(b) * y - np.sin(b) * x for b in borders.tolist()]
    zero = jnp.zeros(x.shape, jnp.int32)
    return sum(((flip * side >= 0).astype(jnp.int32) for side in passed), start=zero)


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
    depth = jnp.maximum(jnp.mean(to_camera(camera, limbs.near)[:, 2]), 0.1)
    samples_per_metre = camera.matrix[0, 0] / depth / region.scale
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
        limbs: three cones, world.
    """

    def of_camera(camera: Camera, region: Region, fields: Array) -> Array:
        if kind == "raster":
            return raster_distance(camera, region, fields, limbs, settings.softness)
        return outline_distance(camera, region, fields, limbs, settings.truncation)[0]

    distances = jax.vmap(of_camera)(cameras, observation.region, jnp.asarray(observation.fields))
    return jnp.sum(jnp.where(observation.seen, distances, 0.0)) / settings.edge_scale


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
