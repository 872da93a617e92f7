"""Drawn hulls of projected limbs, by OpenCV: where in an image a body may be.

INPUTS: discs in pixels. OUTPUTS: masks.
"""

import cv2
import numpy as np

from jaxmocap.geometry.outlines import Discs

# Directions in which a hull's corners lie.
ANGLES = np.linspace(0, 2 * np.pi, 24, endpoint=False)
WAYS = np.stack([np.cos(ANGLES), np.sin(ANGLES)], 1)
# Pixels farther out than this are no longer whole numbers that OpenCV takes.
FARTHEST_PX = 1e5


def draw_hulls(discs: Discs, size: tuple[int, int]) -> np.ndarray:
    """The union (h, w) bool of K hulls in an image of width and height ``size``.

    Args:
        discs: K, pixels; those that are not finite, or too far away, are left out.
        size: of the image.
    """
    mask = np.zeros((size[1], size[0]), np.uint8)
    near, far, radii = (np.asarray(part, float) for part in discs)
    ends = np.stack([near, far], 1)
    # What is not a number is not less either.
    kept = (np.abs(np.concatenate([near, far, radii], 1)) < FARTHEST_PX).all(1)
    ends, radii = ends[kept, :, None], radii[kept, :, None]
    # In each direction the hull reaches as far as the disc that reaches farther.
    farther = np.argmax(np.sum(ends * WAYS, -1) + radii, 1)[:, None, :, None]
    corners = np.take_along_axis(ends + radii[..., None] * WAYS, farther, 1)[:, 0]
    for polygon in np.round(corners).astype(np.int32):
        cv2.fillConvexPoly(mask, polygon, 1)
    return mask.view(bool)
