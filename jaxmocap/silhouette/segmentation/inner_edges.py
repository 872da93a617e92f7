"""Boundaries between limbs: no mask shows an arm before the trunk, its colours may.

INPUTS: images of C cameras, rims with their inner points. OUTPUTS: pairs like the outlines'.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxmocap.silhouette.fit.correspond import Matches
from jaxmocap.silhouette.segmentation.profiles import colour_boundary, colour_profiles
from jaxmocap.silhouette.surfaces.rim import Rim


class InnerEdgeSettings(NamedTuple):
    """What makes a pair.

    Attributes:
        reach: cells of the rim's canvas to either side within which an edge is looked for.
        samples: to either side.
        contrast: two limbs' colours must lie so many times their deviations apart: an arm in a
            shirt before the same shirt has no edge, though the shirt's pattern has.
        least_points: of one bone's boundary that determine its two colours.
        weight: of a pair, by that of the outline's.
    """

    reach: float = 4.0
    samples: int = 10
    contrast: float = 1.4
    least_points: int = 5
    weight: float = 0.5


def inner_edge_pairs(
    images: Sequence[np.ndarray | None], rim: Rim, bones: np.ndarray, settings: InnerEdgeSettings
) -> Matches:
    """Pairs (C, R) of the rims' inner points and the edges next to them.

    Args:
        images: (H, W, 3) BGR uint8 of each camera, or None.
        rim: with inner points.
        bones: (M,) that carries each node of the rim's surface.
        settings: of edges.
    """
    rows = [_of_camera(image, rim, bones, camera, settings) for camera, image in enumerate(images)]
    return Matches(*(np.stack(parts) for parts in zip(*rows, strict=True)))


def _of_camera(
    image: np.ndarray | None, rim: Rim, bones: np.ndarray, camera: int, settings: InnerEdgeSettings
) -> tuple[np.ndarray, ...]:
    """One camera's row of all fields."""
    inner = rim.inner[camera]
    nodes, pixels, normals, real = (part[camera][inner] for part in rim[:3] + rim[4:5])
    offset = np.full(len(nodes), np.nan, np.float32)
    if image is not None and real.any():
        reach = settings.reach * float(rim.region.scale[camera])
        offsets = np.linspace(-reach, reach, 2 * settings.samples + 1)
        profiles = colour_profiles(image, pixels, normals, offsets)
        for bone in np.unique(bones[nodes[real]]):
            one = np.flatnonzero(real & (bones[nodes] == bone))
            if len(one) < settings.least_points:
                continue
            place, apart = colour_boundary(profiles[one])
            if apart > settings.contrast:
                offset[one] = np.interp(place, np.arange(len(offsets)), offsets)
    is_detected = np.isfinite(offset)
    offset = np.where(is_detected, offset, 0.0)
    there = (pixels + offset[:, None] * normals).astype(np.float32)
    return nodes, there, normals.astype(np.float32), np.abs(offset), is_detected


def concatenated(outlines: Matches, edges: Matches) -> Matches:
    """Pairs (C, N) of outlines and (C, R) of edges as one."""
    both = zip(outlines, edges, strict=True)
    return Matches(*(np.concatenate([a, b.astype(a.dtype)], 1) for a, b in both))
