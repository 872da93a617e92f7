"""Drawn hulls of projected limbs, by OpenCV: where in an image a body may be.

INPUTS: discs in pixels. OUTPUTS: masks.
"""

import cv2
import numpy as np

from jaxmocap.geometry.outlines import Discs

CORNERS = np.linspace(0, 2 * np.pi, 24, endpoint=False)
CIRCLE = np.stack([np.cos(CORNERS), np.sin(CORNERS)], 1)
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
    for a, b, r in zip(near, far, radii, strict=True):
        # What is not a number is not less either.
        if (np.abs([*a, *b, *r]) < FARTHEST_PX).all():
            corners = np.concatenate([a + r[0] * CIRCLE, b + r[1] * CIRCLE])
            hull = cv2.convexHull(np.round(corners).astype(np.int32))
            cv2.fillConvexPoly(mask, hull, 1)
    return mask.astype(bool)
