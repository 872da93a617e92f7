"""Points on rays, measured in both directions across them, as pixels of markers would be."""

import jax.numpy as jnp
from jax import Array

from jaxmocap.body.surfaces.surface import BodyPoints
from jaxmocap.geometry.lines import Lines
from jaxmocap.silhouette.points import PointRays


def on_rays(points: BodyPoints, lines: Lines, weights: Array | None = None) -> PointRays:
    """Points on rays in full, as in (3.11): measured in both directions across the ray."""
    n = lines.directions
    weights = jnp.ones_like(n[..., 0]) if weights is None else weights
    return PointRays(points, lines, any_normals(n), weights, jnp.ones_like(weights))


def any_normals(directions: Array) -> Array:
    """Some unit vectors (..., 3) at right angles to unit directions (..., 3)."""
    upright = jnp.abs(directions[..., 2:]) > 0.8
    beside = jnp.where(upright, jnp.eye(3)[0], jnp.eye(3)[2]).astype(directions.dtype)
    across = jnp.cross(directions, beside)
    return across / jnp.linalg.norm(across, axis=-1, keepdims=True)
