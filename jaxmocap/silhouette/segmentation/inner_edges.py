"""Boundaries between limbs: no mask shows an arm before the trunk, its colours may.

INPUTS: images of C cameras, rims with their inner points. OUTPUTS: pairs like the outlines'.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from jaxmocap.silhouette.fit.correspond import Matches
from jaxmocap.silhouette.surfaces.rim import Rim

# Colours are averaged over so many places along the line, this far apart, pixels.
ALONG = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
# Samples next to the line, on either side, that mix the sides' colours.
BETWEEN = 3
# Cells of the rim's canvas to either side within which an edge is looked for, and samples there.
REACH, SAMPLES = 4.0, 10
# Two limbs' colours must lie so many times their deviations apart: an arm in a shirt before the
# same shirt has no edge, though the shirt's pattern has.
CONTRAST = 1.4
# Of one bone's boundary that determine its two colours.
LEAST_POINTS = 5
# Of a pair, by that of the outline's.
EDGE_WEIGHT = 0.5


def colour_profiles(
    image: np.ndarray, pixels_xy: np.ndarray, normals: np.ndarray, offsets: np.ndarray
) -> np.ndarray:
    """(R, K, 3) colours across lines at pixels (R, 2), by offsets (K,), pixels, along normals."""
    across = pixels_xy[:, None] + offsets[:, None] * normals[:, None]
    beside = np.stack([-normals[:, 1], normals[:, 0]], 1)
    places = across[:, :, None] + ALONG[:, None] * beside[:, None, None]
    flat = places.reshape(len(pixels_xy), -1, 2).astype(np.float32)
    taken = cv2.remap(
        image, flat[..., 0], flat[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    several = taken.astype(np.float32).reshape(*places.shape[:3], 3)
    # Faster than their mean, over so few.
    return np.add.reduce([several[:, :, i] for i in range(len(ALONG))]) / np.float32(len(ALONG))


def colour_boundary(profiles: np.ndarray) -> tuple[np.ndarray, float]:
    """Where profiles (R, K, 3) of one line go over from the colour before to the one behind.

    Returns:
        (R,) places between samples, NaN where a profile stays on one side; how far apart the two
        colours are, by the deviations about them.
    """
    half = profiles.shape[1] // 2
    before, behind = slice(half - BETWEEN + 1), slice(half + BETWEEN, None)
    first, second = (profiles[:, side].mean((0, 1)) for side in (before, behind))
    way = first - second
    apart = max(float(way @ way), 1e-6)
    along = profiles @ way
    spread = (along[:, before].var() + along[:, behind].var()) / apart
    # 1 before the line and 0 behind it.
    share = (along - second @ way) / apart
    gain = np.cumsum(np.clip(share, -0.5, 1.5) - 0.5, 1)
    best = gain.argmax(1)
    lasting = (gain.max(1) > 0.5) & (best < profiles.shape[1] - 1)
    after = gain[:, -1] < gain.max(1) - 0.5
    place = np.where(lasting & after, best + 0.5, np.nan)
    return place, float(np.sqrt(apart / max(spread, 1e-6)))


def inner_edge_pairs(images: Sequence[np.ndarray | None], rim: Rim, bones: np.ndarray) -> Matches:
    """Pairs (C, R) of the rims' inner points and the edges next to them in images (H, W, 3).

    ``bones`` (M,) carry the nodes of the rim's surface.
    """
    rows = [_of_camera(image, rim, bones, camera) for camera, image in enumerate(images)]
    return Matches(*(np.stack(parts) for parts in zip(*rows, strict=True)))


def _of_camera(
    image: np.ndarray | None, rim: Rim, bones: np.ndarray, camera: int
) -> tuple[np.ndarray, ...]:
    """One camera's row of all fields."""
    inner = rim.inner[camera]
    nodes, pixels, normals, real = (part[camera][inner] for part in rim[:3] + rim[4:5])
    offset = np.full(len(nodes), np.nan, np.float32)
    if image is not None and real.any():
        reach = REACH * float(rim.region.scale[camera])
        offsets = np.linspace(-reach, reach, 2 * SAMPLES + 1)
        profiles = colour_profiles(image, pixels, normals, offsets)
        for bone in np.unique(bones[nodes[real]]):
            one = np.flatnonzero(real & (bones[nodes] == bone))
            if len(one) < LEAST_POINTS:
                continue
            place, apart = colour_boundary(profiles[one])
            if apart > CONTRAST:
                offset[one] = np.interp(place, np.arange(len(offsets)), offsets)
    is_detected = np.isfinite(offset)
    offset = np.where(is_detected, offset, 0.0)
    there = (pixels + offset[:, None] * normals).astype(np.float32)
    return nodes, there, normals.astype(np.float32), np.abs(offset), is_detected


def concatenate_pairs(outlines: Matches, edges: Matches) -> Matches:
    """Pairs (C, N) of outlines and (C, R) of edges as one."""
    both = zip(outlines, edges, strict=True)
    return Matches(*(np.concatenate([a, b.astype(a.dtype)], 1) for a, b in both))
