"""Points on rays, measured in both directions across them, as pixels of markers would be."""

import numpy as np

from jaxmocap.body.surfaces.surface import BodyPoints
from jaxmocap.geometry.lines import Lines
from jaxmocap.silhouette.points import PointRays


def on_rays(points: BodyPoints, lines: Lines, weights: np.ndarray | None = None) -> PointRays:
    """Points on rays in full, as in (3.11): measured in both directions across the ray."""
    n = np.asarray(lines.directions)
    weights = np.ones_like(n[..., 0]) if weights is None else weights
    return PointRays(points, lines, any_normals(n), weights, np.ones_like(weights))


def any_normals(directions: np.ndarray) -> np.ndarray:
    """Some unit vectors (..., 3) at right angles to unit directions (..., 3)."""
    directions = np.asarray(directions)
    upright = np.abs(directions[..., 2:]) > 0.8
    beside = np.where(upright, np.eye(3)[0], np.eye(3)[2]).astype(directions.dtype)
    across = np.cross(directions, beside)
    return across / np.linalg.norm(across, axis=-1, keepdims=True)
