"""The first paper's chamfer sum: how far the area of an arm lies from edges, (12) to (14).

The paper sums distances over the filled silhouette. Drawn, that is a soft raster of every sample of
the region; integrated, it is a sum over few points that move with the limbs. Such a sum falls when
the limb hides or shrinks, so the default evidence is the outline's (``evidence.edges``).

INPUTS: one arm's limbs, a camera, the distance fields of its region. OUTPUTS: a cost.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose
from jaxmocap.body.surfaces.cones import Cones, project_cones
from jaxmocap.compilation.settings import settings, static, traced
from jaxmocap.evidence.edges import EdgeEvidence, EdgeFields
from jaxmocap.evidence.outlines.traced import TracedOutline, disc_components
from jaxmocap.geometry.areas import Areas, area_points
from jaxmocap.geometry.cameras import (
    Camera,
    depth,
    focal_length,
    pixel_components,
    pixels_per_metre,
)
from jaxmocap.geometry.outlines import Discs, signed_distance, swept, touch_swept
from jaxmocap.images.regions import Region, discs_in_region
from jaxmocap.images.sampling import look_up, look_up_smoothly


def soft_coverage(limbs: Discs, size: int, softness: Array | float) -> Array:
    """Coverage (size, size) of the union of N limbs: ``1 - prod(1 - sigmoid(-d / softness))``.

    Differentiable by the limbs; as ``softness`` (samples) goes to 0 it becomes b_ij of (12).
    """
    axis = jnp.arange(size, dtype=limbs.near.dtype)
    grid = jnp.stack(jnp.meshgrid(axis, axis), -1)
    each = Discs(*(part[:, None, None] for part in limbs))
    inside = jax.nn.sigmoid(-signed_distance(each, grid) / softness)
    return 1 - jnp.prod(1 - inside, 0)


# Points along each limb, and from side to side.
ALONG, ACROSS = 5, 4
# Depths nearer than this count as this, metres.
LEAST_DEPTH_M = 0.1


@settings
class Chamfer(EdgeEvidence):
    """Both arms on edges by equation (13); the field has no directions."""

    drawn: bool = static(
        True,
        "draw every sample of a soft raster, as the paper does; else, and always by least squares, "
        "the sum is integrated over some points a limb",
    )
    softness: Array = traced(1.0, "of the raster's borders, samples")

    def camera_cost(
        self, camera: Camera, region: Region, fields: Array, limbs: Cones, start: Cones
    ) -> Array:
        """Equation (13), metres, of limbs (..., 3), a pixel measured at the start's depth."""
        unit = {"softness": self.softness, "at_depth": mean_depth(camera, start)}
        if not self.drawn:
            return integrate_distance(camera, region, fields, limbs, **unit)
        of_place = partial(draw_distance, camera, region, fields, **unit)
        for _ in range(limbs.near.ndim - 2):
            of_place = jax.vmap(of_place)
        return of_place(limbs)

    def on_limbs(
        self, camera: Camera, region: Region, fields: Array, limbs: Cones, start: Cones
    ) -> Array:
        """Roots (3, K) of twice the prices of points over the limbs."""
        at_depth = mean_depth(camera, start)
        traced = trace_area(camera, region, fields, limbs, self.softness, at_depth)
        # What is hidden has no share: its root has no slope.
        shares = jnp.maximum(traced.weights, jnp.finfo(traced.weights.dtype).eps ** 2)
        return jnp.sqrt(shares) * self.root_of_price(traced, jnp.inf)

    def roots_of_shares(self, model: Model, fields: EdgeFields, start: Pose) -> Array:
        """(2, C, 3, 1): an area's shares move with the limbs, and are taken there."""
        shape = (2, model.camera_count, 3, 1)
        return jnp.ones(shape, model.dtype)


def chamfer_sum(
    camera: Camera, region: Region, fields: Array, limbs: Cones, softness: Array
) -> Array:
    """Equation (13), softened: the sum of coverage times distance, samples of the region.

    The plain field is the least over the directions.
    """
    discs = discs_in_region(region, project_cones(camera, limbs))
    coverage = soft_coverage(discs, fields.shape[-1], softness)
    return jnp.sum(coverage * jnp.min(fields, 0))


def draw_distance(
    camera: Camera, region: Region, fields: Array, limbs: Cones, softness: Array, at_depth: Array
) -> Array:
    """Equation (13) over the area that the limbs would cover side on: metres.

    While a pixel is measured at a fixed depth, nothing of the unit moves with the limbs: the
    minimum is the paper's, and the priors' weights do not depend on the resolution.

    Args:
        camera: that sees the arm.
        region: of the arm in this camera (no batch).
        fields: (K, S, S) distances, samples of the region.
        limbs: three cones, world, metres.
        softness: of the borders, samples.
        at_depth: () at which a pixel is measured, metres.
    """
    samples_per_metre = pixels_per_metre(camera, at_depth) / region.scale
    area = side_on_area(limbs) * samples_per_metre**2
    return chamfer_sum(camera, region, fields, limbs, softness) / area / samples_per_metre


def mean_depth(camera: Camera, limbs: Cones) -> Array:
    """(...) of the joints of limbs (..., 3), metres."""
    return jnp.maximum(jnp.mean(depth(camera, limbs.near), -1), LEAST_DEPTH_M)


def side_on_area(limbs: Cones) -> Array:
    """The area (...) of limbs (..., 3) side on, square metres."""
    lengths = jnp.sqrt(jnp.sum((limbs.far - limbs.near) ** 2, -1) + 1e-12)
    return jnp.sum(lengths * jnp.sum(limbs.radii, -1), -1)


def integrate_distance(
    camera: Camera, region: Region, fields: Array, limbs: Cones, softness: Array, at_depth: Array
) -> Array:
    """``draw_distance`` by few points: metres.

    Args:
        camera: that sees the arm.
        region: of the arm in this camera (no batch).
        fields: (K, S, S) distances, samples of the region.
        limbs: (..., 3) cones, world, metres: one arm's, in one place or many.
        softness: of the borders where one limb covers another, samples.
        at_depth: () at which a pixel is measured, metres.
    """
    areas, distances_px = _sample_limbs(camera, region, fields, limbs, softness, smoothly=False)
    total = jnp.sum(areas.weights * distances_px, (0, 1)) * at_depth**2
    return total / side_on_area(limbs) / pixels_per_metre(camera, at_depth)


def trace_area(
    camera: Camera, region: Region, fields: Array, limbs: Cones, softness: Array, at_depth: Array
) -> TracedOutline:
    """Look an arm's area up in the fields of its region, with a continuous slope.

    The weights are shares of the area that the limbs would cover side on.

    Args:
        camera: that sees the arm.
        region: of the arm in this camera (no batch).
        fields: (K, S, S) distances, samples of the region.
        limbs: three cones, world, metres.
        softness: of the borders where one limb covers another, samples.
        at_depth: () at which a pixel is measured, metres.
    """
    areas, distances_px = _sample_limbs(camera, region, fields, limbs, softness, smoothly=True)
    return TracedOutline(
        jnp.stack([areas.x, areas.y], -1).swapaxes(0, 1),
        distances_px.T,
        jnp.broadcast_to(1 / pixels_per_metre(camera, at_depth), (len(limbs.near), 1)),
        areas.weights.T * at_depth**2 / side_on_area(limbs),
    )


def _sample_limbs(
    camera: Camera, region: Region, fields: Array, limbs: Cones, softness: Array, smoothly: bool
) -> tuple[Areas, Array]:
    """Points (K, 3, ...) over limbs (..., 3), each place counted once, and their distances, px."""
    discs, depths = disc_components(camera, limbs)
    areas = area_points(*discs, ALONG, ACROSS)
    soft = softness * region.scale / focal_length(camera)
    in_front = jnp.minimum(depths[0], depths[1]) > 0
    counted = jnp.where(in_front, areas.weights, 0.0) * _not_covered(discs, areas, soft)
    pixels = pixel_components(camera, areas.x, areas.y)
    samples = (
        (pixel - corner) / region.scale - 0.5
        for pixel, corner in zip(pixels, region.origin, strict=True)
    )
    plain = jnp.min(fields, 0, keepdims=True)
    if smoothly:
        distances = look_up_smoothly(plain, jnp.zeros_like(areas.x), *samples)
    else:
        distances = look_up(plain, jnp.zeros((), jnp.int32), *samples)
    return areas._replace(weights=counted), distances * region.scale


def _not_covered(discs: tuple[Array, Array, Array], areas: Areas, softness: Array) -> Array:
    """(K, 3, ...) shares of points that no limb before theirs covers.

    A union's coverage is ``b_1 + b_2 (1 - b_1) + b_3 (1 - b_1) (1 - b_2)``.
    """
    x, y, radii = discs
    near, far = (jnp.stack([x[end], y[end]], -1) for end in (0, 1))
    hulls = swept(Discs(near, far, jnp.moveaxis(radii, 0, -1)))
    shares = [jnp.ones_like(areas.x[:, 0])]
    for limb in range(1, areas.x.shape[1]):
        free = jnp.ones_like(shares[0])
        for other in range(limb):
            hull = jax.tree.map(lambda part, i=other: part[i], hulls)
            away = touch_swept(hull, areas.x[:, limb], areas.y[:, limb]).distance
            free = free * jax.nn.sigmoid(away / softness)
        shares.append(free)
    return jnp.stack(shares, 1)
