"""Edges: how well arms lie on edges of the image (section 5.1).

It is the mean distance of the outline to edges that run its way. The first paper's own sum over the
area is ``hybrid.paper.chamfer``.

INPUTS: arms, cameras, the distance fields of their regions. OUTPUTS: costs, whitened residuals.
"""

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.arms import ARM_LANDMARKS, Arms, arms_of, flesh, limb_bones
from jaxmocap.body.kinematics import forward
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose
from jaxmocap.body.surfaces.cones import Cones
from jaxmocap.compilation.settings import settings, traced
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
    """What C cameras measured of both arms: distances to the nearest edges about them."""

    region: Region  # where the fields lie: origins (C, 2, 2), scales (C, 2)
    distances: Array | np.ndarray  # (C, 2, K, S, S) to edges of K directions, samples of the region
    # (C, 2) whether there is an image; the distances mean nothing where not.
    available: Array | np.ndarray

    def by_arm(self) -> "EdgeFields":
        """The same with the arms' axis before the cameras'."""
        return jax.tree.map(lambda part: jnp.swapaxes(jnp.asarray(part), 0, 1), self)


class WeightedEdges(NamedTuple):
    """Edges, and what is settled where a solve starts."""

    fields: EdgeFields  # of both arms
    weights: Array  # (2, C, 3, K) roots of the points' shares; 0 where one is hidden
    start: Cones  # (2, 3) limbs, world, metres


@settings
class EdgeEvidence(Term):
    """Both arms on edges; measured ``edges``, a ``WeightedEdges``.

    The simplex and the search take ``arm_cost``; least squares take the residual, whose distances d
    cost d^2 / (sqrt(d^2 + b^2) + b): square near the edge, then straight. An outline's price levels
    out towards the truncation.
    """

    needs: ClassVar[tuple[str, ...]] = ("edges",)
    bend: Array = traced(
        0.005, "distance to an edge at which its price turns from square to straight, metres"
    )
    truncation: Array = traced(
        0.06, "an outline's distances count no more than this, metres at the limb's depth"
    )
    scale: Array = traced(0.0042, "distance that costs one unit, metres at the limb's depth")

    def arm_cost(
        self, cameras: Camera | None, fields: EdgeFields, limbs: Cones, start: Cones
    ) -> Array:
        """Cost of one arm, summed over C cameras; 0 where no camera has an image of it.

        Args:
            cameras: C, stacked.
            fields: of this arm: regions (C), distances (C, K, S, S), available (C,).
            limbs: (..., 3) cones, world: the arm in one place, or in many for many costs (...).
            start: (3,) cones, world: the arm where the solve starts.
        """
        assert cameras is not None
        of_camera = jax.vmap(self.camera_cost, (0, 0, 0, None, None))
        each = of_camera(cameras, fields.region, jnp.asarray(fields.distances), limbs, start)
        available = jnp.asarray(fields.available).reshape(-1, *(1,) * (each.ndim - 1))
        return jnp.sum(jnp.where(available, each, 0.0), 0) / self.scale

    def camera_cost(
        self, camera: Camera, region: Region, fields: Array, limbs: Cones, start: Cones
    ) -> Array:
        """Mean distance (...) of outlines to edges in one camera, metres."""
        return outline_distance(camera, region, fields, limbs, self.truncation)[0]

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
        edges = measured.edges
        radii = model.skeleton.diameters[limb_bones(model.skeleton.tree)] / 2
        ends = body.landmarks[ARM_LANDMARKS]
        limbs = Cones(ends[:, :3], ends[:, 1:], radii)
        each = _each_arm_and_camera(self.on_limbs, model, edges.fields, limbs, edges.start)
        return edges.weights * each

    def on_limbs(
        self, camera: Camera, region: Region, fields: Array, limbs: Cones, start: Cones
    ) -> Array:
        """Roots (3, K) of twice the prices of one arm's points in one camera."""
        return self.root_of_price(trace_outline(camera, region, fields, limbs), self.truncation)

    def root_of_price(self, traced: TracedOutline, truncation: Array | float) -> Array:
        """(3, K): of twice the price of each point's distance."""
        d = traced.distances_px * traced.metres_per_px
        steep = jnp.sqrt(d**2 + self.bend**2) + self.bend
        return d * jnp.sqrt(2 / (steep + d**2 / truncation) / self.scale)

    def weigh(self, model: Model, fields: EdgeFields, start: Pose) -> WeightedEdges:
        """Edges with the weights of points as a pose shows them."""
        available = jnp.asarray(fields.available).T[..., None, None]
        limbs = flesh(arms_of(model.skeleton, forward(model.skeleton, start), model.grips))
        roots = jnp.where(available, self.roots_of_shares(model, fields, start), 0.0)
        return WeightedEdges(fields, roots, limbs)

    def roots_of_shares(self, model: Model, fields: EdgeFields, start: Pose) -> Array:
        """(2, C, 3, K): roots of shares of an outline, as far as nothing hides it."""
        frames = forward(model.skeleton, start)
        arms = arms_of(model.skeleton, frames, model.grips)
        others = blockers(model.skeleton, frames, arms)
        shares = _each_arm_and_camera(_shares, model, fields, flesh(arms), others)
        return jnp.where(shares > 0, jnp.sqrt(jnp.where(shares > 0, shares, 1.0)), 0.0)


def _shares(camera: Camera, region: Region, distances: Array, own: Cones, others: Cones) -> Array:
    """(3, K) of an arm's outline, as far as nothing hides it."""
    traced = trace_outline(camera, region, distances, own)
    share = traced.weights / jnp.maximum(jnp.sum(traced.weights), 1e-6)
    return jnp.where(hidden(camera, own, traced.points, others), 0.0, share)


def _each_arm_and_camera(function, model: Model, fields: EdgeFields, *limbs: Cones) -> Array:
    """A function of camera, region, distances and limbs, for each arm (2) in each camera (C)."""
    by_camera = jax.vmap(function, (0, 0, 0, *(None for _ in limbs)))
    by_arm = jax.vmap(by_camera, (None, *(0 for _ in range(2 + len(limbs)))))
    own = fields.by_arm()
    return by_arm(model.cameras, own.region, jnp.asarray(own.distances), *limbs)
