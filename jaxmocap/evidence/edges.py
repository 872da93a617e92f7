"""Edges: how well arms lie on edges of the image (section 5.1).

The default is the mean distance of the outline to edges that run its way; the other choice is the
paper's own sum over the area (``outlines.coverage``).

INPUTS: arms, cameras, the distance fields of their regions. OUTPUTS: costs, whitened residuals.
"""

from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.arms import ARM_LANDMARKS, Arms, arms_of, flesh, limb_bones
from jaxmocap.body.kinematics import forward
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose
from jaxmocap.body.surfaces.cones import Cones
from jaxmocap.compilation.settings import settings, static, traced
from jaxmocap.evidence.outlines.coverage import drawn_distance, integrated_distance, trace_area
from jaxmocap.evidence.outlines.traced import (
    TracedOutline,
    blockers,
    hidden,
    outline_distance,
    trace_outline,
)
from jaxmocap.evidence.terms import Measurements, PosedBody, Term
from jaxmocap.geometry.cameras import Camera
from jaxmocap.images.regions import Region


class EdgeFields(NamedTuple):
    """What C cameras measured of both arms: distances to the nearest edges about them.

    Attributes:
        region: where the fields lie: origins (C, 2, 2), scales (C, 2).
        distances: (C, 2, K, S, S) to edges of K directions, samples of the region.
        available: (C, 2) whether there is an image; the distances mean nothing where not.
    """

    region: Region
    distances: Array | np.ndarray
    available: Array | np.ndarray

    def by_arm(self) -> "EdgeFields":
        """The same with the arms' axis before the cameras'."""
        return jax.tree.map(lambda part: jnp.swapaxes(jnp.asarray(part), 0, 1), self)


class WeightedEdges(NamedTuple):
    """Edges, and how much each outline point counts, which is settled where a solve starts.

    Attributes:
        fields: of both arms.
        weights: (2, C, 3, K) roots of the points' shares of their outline; 0 where one is hidden.
            For coverage, whose shares move with the limbs: (2, C, 3, 1), 1 where there is an image.
    """

    fields: EdgeFields
    weights: Array


@settings
class EdgeEvidence(Term):
    """Both arms on edges; measured ``edges``, a ``WeightedEdges``.

    The simplex and the search take ``arm_cost``; least squares take the residual, whose distances d
    cost d^2 / (sqrt(d^2 + b^2) + b): square near the edge, then straight. An outline's price levels
    out towards the truncation.
    """

    compared: Literal["outline", "coverage"] = static(
        "outline", "the mean distance along the outline, or the paper's sum (13) over the area"
    )
    drawn: bool = static(
        False,
        "draw the coverage, every sample of a soft raster, as the paper does; else, and always by "
        "least squares, it is integrated over some points a limb",
    )
    bend: Array = traced(
        0.005, "distance to an edge at which its price turns from square to straight, metres"
    )
    truncation: Array = traced(
        0.06, "an outline's distances count no more than this, metres at the limb's depth"
    )
    scale: Array = traced(0.0042, "distance that costs one unit, metres at the limb's depth")
    softness: Array = traced(1.0, "of the coverage's borders, samples")

    def arm_cost(self, cameras: Camera | None, fields: EdgeFields, limbs: Cones) -> Array:
        """Cost of one arm, summed over C cameras; 0 where no camera has an image of it.

        Args:
            cameras: C, stacked.
            fields: of this arm: regions (C), distances (C, K, S, S), available (C,).
            limbs: (..., 3) cones, world: the arm in one place, or in many for many costs (...).
        """
        assert cameras is not None

        def of_camera(camera: Camera, region: Region, distances: Array) -> Array:
            if self.compared == "outline":
                return outline_distance(camera, region, distances, limbs, self.truncation)[0]
            if not self.drawn:
                return integrated_distance(camera, region, distances, limbs, self.softness)
            of_place = partial(drawn_distance, camera, region, distances, softness=self.softness)
            for _ in range(limbs.near.ndim - 2):
                of_place = jax.vmap(of_place)
            return of_place(limbs)

        each = jax.vmap(of_camera)(cameras, fields.region, jnp.asarray(fields.distances))
        available = jnp.asarray(fields.available).reshape(-1, *(1,) * (each.ndim - 1))
        return jnp.sum(jnp.where(available, each, 0.0), 0) / self.scale

    def outline_px(self, cameras: Camera, fields: EdgeFields, arms: Arms) -> Array:
        """Mean distance (2,) of both arms' outlines to edges, pixels; NaN without an image."""

        def of_camera(camera: Camera, region: Region, distances: Array, limbs: Cones) -> Array:
            return outline_distance(camera, region, distances, limbs, self.truncation)[1]

        def of_arm(own: EdgeFields, limbs: Cones) -> Array:
            each = jax.vmap(of_camera, (0, 0, 0, None))(
                cameras, own.region, jnp.asarray(own.distances), limbs
            )
            return jnp.nanmean(jnp.where(own.available, each, jnp.nan))

        return jax.vmap(of_arm)(fields.by_arm(), flesh(arms))

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(2, C, 3, K): roots of twice the prices, weighted."""
        edges = measured["edges"]
        radii = model.skeleton.diameters[limb_bones(model.skeleton.tree)] / 2
        ends = body.landmarks[ARM_LANDMARKS]
        limbs = Cones(ends[:, :3], ends[:, 1:], radii)
        of_camera = self._on_outline if self.compared == "outline" else self._over_area
        return edges.weights * _each_arm_and_camera(of_camera, model, edges.fields, limbs)

    def _on_outline(self, camera: Camera, region: Region, distances: Array, limbs: Cones) -> Array:
        traced = trace_outline(camera, region, distances, limbs)
        return self._root_of_price(traced, self.truncation)

    def _over_area(self, camera: Camera, region: Region, distances: Array, limbs: Cones) -> Array:
        traced = trace_area(camera, region, distances, limbs, self.softness)
        # What is hidden has no share: its root has no slope.
        shares = jnp.maximum(traced.weights, jnp.finfo(traced.weights.dtype).eps ** 2)
        return jnp.sqrt(shares) * self._root_of_price(traced, jnp.inf)

    def _root_of_price(self, traced: TracedOutline, truncation: Array | float) -> Array:
        d = traced.distances_px * traced.metres_per_px
        steep = jnp.sqrt(d**2 + self.bend**2) + self.bend
        return d * jnp.sqrt(2 / (steep + d**2 / truncation) / self.scale)

    def weighted(self, model: Model, fields: EdgeFields, start: Pose) -> WeightedEdges:
        """Edges with the weights of points as a pose shows them."""
        available = jnp.asarray(fields.available).T[..., None, None]
        if self.compared == "coverage":
            each = jnp.broadcast_to(available, (*available.shape[:2], 3, 1))
            return WeightedEdges(fields, each.astype(model.dtype))
        frames = forward(model.skeleton, start)
        arms = arms_of(model.skeleton, frames, model.grips)
        limbs = (flesh(arms), blockers(model.skeleton, frames, arms))
        shares = _each_arm_and_camera(_shares, model, fields, limbs)
        counts = available & (shares > 0)
        roots = jnp.where(counts, jnp.sqrt(jnp.where(counts, shares, 1.0)), 0.0)
        return WeightedEdges(fields, roots)


def _shares(camera: Camera, region: Region, distances: Array, limbs: tuple[Cones, Cones]) -> Array:
    """(3, K) of an arm's outline, as far as nothing hides it."""
    own, others = limbs
    traced = trace_outline(camera, region, distances, own)
    share = traced.weights / jnp.maximum(jnp.sum(traced.weights), 1e-6)
    return jnp.where(hidden(camera, own, traced.points, others), 0.0, share)


def _each_arm_and_camera(function, model: Model, fields: EdgeFields, limbs) -> Array:
    """A function of camera, region, distances and limbs, for each arm (2) in each camera (C)."""
    by_camera = jax.vmap(function, (0, 0, 0, None))
    by_arm = jax.vmap(by_camera, (None, 0, 0, 0))
    own = fields.by_arm()
    return by_arm(model.cameras, own.region, jnp.asarray(own.distances), limbs)
