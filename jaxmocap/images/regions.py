"""Regions of interest: where in the image an arm is looked for (section 5.2, Fig. 5).

INPUTS: projected points, pixels, or a box; an image. OUTPUTS: a square window, and the image
resampled to its one static size, or a network's. Origin and scale are traced, so that a moving
region compiles once.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jax import Array

from jaxmocap.compilation.arrays import namespace
from jaxmocap.geometry.outlines import Discs
from jaxmocap.images.edges import to_grey

# Regions this many times as large as their image hold a few samples of it only.
LARGEST_SIDE = 8


class Region(NamedTuple):
    """A square window of ``size`` x ``size`` samples on an image."""

    # (..., 2) pixel (x, y) of the window's left upper corner (pixel edge, whole - 0.5).
    origin: Array | np.ndarray
    scale: Array | np.ndarray  # (...) image pixels per sample


def region_around(
    pixels_xy: Array | np.ndarray, size: int, margin: Array | float, finest: float = 1.0
) -> Region:
    """The window around (..., P, 2) pixels with a margin, as a fraction of their extent.

    Its scale is at least ``finest``: a person far away is not enlarged.
    """
    low, high = pixels_xy.min(-2), pixels_xy.max(-2)
    extent = (high - low).max(-1) * (1 + 2 * margin)
    scale = namespace(pixels_xy).maximum(extent / size, finest)
    return Region(_corner((low + high) / 2, scale[..., None] * size), scale)


def region_of_side(low: np.ndarray, high: np.ndarray, side: float, size: int) -> Region:
    """The window of a given side, pixels, about boxes (..., 2) from ``low`` to ``high``."""
    scale = np.full(low.shape[:-1], side / size, low.dtype)
    return Region(np.asarray(_corner((low + high) / 2, side), low.dtype), scale)


def _corner(middle: Array | np.ndarray, side: Array | float) -> Array | np.ndarray:
    """A pixel's edge."""
    return (middle - side / 2).round() - 0.5


def to_region(region: Region, pixels_xy: Array) -> Array:
    """Image pixels (..., K, 2) to sample coordinates of the region (centres at whole numbers)."""
    scale = region.scale[..., None, None]
    return (pixels_xy - region.origin[..., None, :]) / scale - 0.5


def discs_in_region(region: Region, discs: Discs) -> Discs:
    """Limbs (K), pixels, in samples of one region."""
    near, far = to_region(region, discs.near), to_region(region, discs.far)
    return Discs(near, far, discs.radii / region.scale)


def in_other_region(discs: Discs, here: Region, there: Region) -> Discs:
    """Limbs (K) in samples of one region, in those of another one of the same image."""
    ratio, shift = here.scale / there.scale, (here.origin - there.origin) / there.scale
    near, far = ((end + 0.5) * ratio + shift - 0.5 for end in (discs.near, discs.far))
    return Discs(near, far, discs.radii * ratio)


def crop(
    image: np.ndarray, origin: np.ndarray, scale: float, size: int, grey: bool = False
) -> np.ndarray:
    """Resample a region of an image to ``size`` x ``size``; beyond the border it is replicated.

    Args:
        image: (H, W) or (H, W, 3).
        origin: (2,) of the region.
        scale: of the region.
        size: of the result.
        grey: turn a BGR image to grey before it is resampled, in a third of the time.
    """
    height, width = image.shape[:2]
    side = max(1, round(float(scale) * size))
    x, y = (round(float(value) + 0.5) for value in origin)
    # Of a region wholly outside, or of an arm beside the lens, nothing is visible.
    x0, x1 = (int(np.clip(value, 0, width)) for value in (x, x + side))
    y0, y1 = (int(np.clip(value, 0, height)) for value in (y, y + side))
    if x0 >= x1 or y0 >= y1 or side > LARGEST_SIDE * max(height, width):
        return np.zeros((size, size, *(() if grey else image.shape[2:])), image.dtype)
    window = to_grey(image[y0:y1, x0:x1]) if grey else image[y0:y1, x0:x1]
    pads = (y0 - y, y + side - y1, x0 - x, x + side - x1)
    if any(pads):
        window = cv2.copyMakeBorder(window, *pads, cv2.BORDER_REPLICATE)
    if side == size:
        return window
    # Averaging matters only where several pixels fall into one sample, and takes ten times as long.
    way = cv2.INTER_AREA if side > 2 * size else cv2.INTER_LINEAR
    return cv2.resize(window, (size, size), interpolation=way)


class Crop(NamedTuple):
    """A part of an image, resampled."""

    image: np.ndarray  # (h, w, 3) uint8
    corner_xy: np.ndarray  # (2,) pixels of the image where the crop's pixel (0, 0) lies
    scale: float  # pixels of the image to one of the crop

    def pixels_of(self, points_xy: np.ndarray) -> np.ndarray:
        """Pixels (..., 2) of the crop as pixels of the image."""
        return self.corner_xy + self.scale * points_xy


def crop_image(image: np.ndarray, box: np.ndarray, size: tuple[int, int]) -> Crop:
    """The box, grown to the crop's form about its middle; black beyond the image.

    Args:
        image: (H, W, 3) uint8.
        box: (4,) left, top, right, bottom, pixels.
        size: width and height of the crop, pixels.
    """
    low, high = np.asarray(box[:2], float), np.asarray(box[2:], float)
    width, height = np.maximum(high - low, 1.0)
    scale = float(max(width / size[0], height / size[1]))
    corner = (low + high) / 2 - scale * (np.array(size) - 1) / 2
    to_image = np.array([[scale, 0, corner[0]], [0, scale, corner[1]]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return Crop(cv2.warpAffine(image, to_image, size, flags=flags), corner, scale)
