"""Correspondences: the contour's pixels and the points of the surface's rim (3.1.4, 3.2).

INPUTS: contours of C cameras, for example of level sets; the rims at the present pose.
OUTPUTS: pairs of body points and rays, for ``solve_pose``.

A rim point goes with the nearest pixel of the contour, and a pixel of the contour with the nearest
rim point: one way alone, what sticks out of the other would go unmatched. Near means near in place
and in direction: the two sides of an arm are close to each other and face apart.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.spatial import KDTree

from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.lines import Lines
from jaxmocap.silhouette.points import BodyPoints, PointRays, contour_rays
from jaxmocap.silhouette.surfaces.index_image import subsample_rows
from jaxmocap.silhouette.surfaces.rim import Rim

# Pixels kept of each camera's contour, evenly along it.
PIXELS = 256
# Cells of the rim's canvas that a radian between normals is worth, nearly.
NORMAL_WEIGHT = 20.0
# Least cosine between the normals of a pair.
LEAST_COSINE = 0.5
# Cells between the two of a pair, at most.
LARGEST_DISTANCE = 40.0
# Weight of a pair along the contour, by that across.
ALONG_WEIGHT = 0.1


class Contour(NamedTuple):
    """Pixels (K, 2) of a camera's contour in the whole image, and unit normals (K, 2) out of it."""

    pixels_xy: np.ndarray
    normals: np.ndarray


class Matches(NamedTuple):
    """N pairs of each of C cameras, padded."""

    nodes: np.ndarray  # (C, N) of the rim's surface
    pixels_xy: np.ndarray  # (C, N, 2) of the contour
    normals: np.ndarray  # (C, N, 2) of the contour there
    distances: np.ndarray  # (C, N) between them, pixels; 0 for padding
    valid: np.ndarray  # (C, N) False for padding, and where nothing fits


class ContourPairs(NamedTuple):
    """Pairs of a cycle, C cameras with N each: see ``Matches``."""

    points: BodyPoints  # C * N of the body
    pixels_xy: Array | np.ndarray  # (C, N, 2)
    normals: Array | np.ndarray  # (C, N, 2)
    weights: Array | np.ndarray  # (C, N), 0 for no pair
    nodes: Array | np.ndarray  # (C, N) of the surface
    # (C * N, 3, S) of the points by drivers, see ``morph``; None without any.
    moves: Array | np.ndarray | None = None


def match_pairs(rim: Rim, contours: Sequence[Contour]) -> Matches:
    """Pairs of the rims' outer points and the contours of C cameras, however those were found."""
    rows = []
    for camera, contour in enumerate(contours):
        # What no mask shows has no pair.
        outline = ~rim.inner[camera]
        nodes, pixels, normals, real = (part[camera][outline] for part in rim[:3] + rim[4:5])
        scale = float(rim.region.scale[camera])
        rows.append(_match_camera(nodes, pixels, normals, real, contour, scale))
    return Matches(*(np.stack(parts) for parts in zip(*rows, strict=True)))


def _match_camera(
    nodes: np.ndarray,
    pixels: np.ndarray,
    normals: np.ndarray,
    kept: np.ndarray,
    contour: Contour,
    scale: float,
) -> Matches:
    """One camera's pairs: first from every rim point, then from pixels of the contour."""
    width = len(nodes) + PIXELS
    if not kept.any() or not len(contour.pixels_xy):
        empty = np.zeros(width, np.float32)
        places = np.zeros((width, 2), np.float32)
        return Matches(np.zeros(width, nodes.dtype), places, places, empty, np.zeros(width, bool))
    chosen = Contour(*subsample_rows(contour, PIXELS))
    rims = np.flatnonzero(kept)
    turn = NORMAL_WEIGHT * scale
    to_contour = KDTree(_places(*contour, turn)).query(_places(pixels, normals, turn))[1]
    to_rim = rims[
        KDTree(_places(pixels[rims], normals[rims], turn)).query(_places(*chosen, turn))[1]
    ]
    which = np.concatenate([np.arange(len(nodes)), to_rim])
    there = np.concatenate([contour.pixels_xy[to_contour], chosen.pixels_xy])
    ways = np.concatenate([contour.normals[to_contour], chosen.normals])
    real = np.concatenate([kept, np.ones(len(to_rim), bool)])
    away = np.linalg.norm(there - pixels[which], axis=1)
    real &= np.sum(ways * normals[which], 1) > LEAST_COSINE
    real &= away < LARGEST_DISTANCE * scale
    matches = Matches(nodes[which], there, ways, np.where(real, away, 0.0), real)
    return Matches(*(_pad_field(part, width) for part in matches))


def _places(pixels: np.ndarray, normals: np.ndarray, turn: float) -> np.ndarray:
    """Place and direction as one point (N, 4)."""
    return np.concatenate([pixels, turn * normals], 1)


def _pad_field(part: np.ndarray, width: int) -> np.ndarray:
    """A field up to its static length, in single precision where it has any."""
    kind = np.float32 if part.dtype == np.float64 else part.dtype
    padded = np.zeros((width, *part.shape[1:]), kind)
    padded[: len(part)] = part
    return padded


def pairs_of(cameras: Camera, pairs: ContourPairs, along_weight: float = ALONG_WEIGHT) -> PointRays:
    """Pairs (C * N) of C cameras (stacked) for ``solve_pose``."""
    pixels_xy, normals, weights = (jnp.asarray(part) for part in pairs[1:4])
    lines, across = jax.vmap(contour_rays)(cameras, pixels_xy, normals)
    flat = Lines(*(part.reshape(-1, 3) for part in lines))
    firm = jnp.full(weights.size, along_weight, weights.dtype)
    across = across.reshape(-1, 3)
    return PointRays(pairs.points, flat, across, weights.ravel(), firm, pairs.moves)
