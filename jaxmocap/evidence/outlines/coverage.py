"""Coverage: how far the soft raster of an arm lies from edges, equations (12) to (14).

The paper sums distances over the filled silhouette; such a sum falls when the limb hides or
shrinks, so the default is the outline's mean distance (``edges``).

INPUTS: one arm's limbs, a camera, the distance fields of its region. OUTPUTS: a cost.
"""

import jax.numpy as jnp
from jax import Array

from jaxmocap.body.surfaces.cones import Cones, project_cones
from jaxmocap.geometry.cameras import Camera, depth, pixels_per_metre
from jaxmocap.images.raster import soft_coverage
from jaxmocap.images.regions import Region, discs_in_region


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
