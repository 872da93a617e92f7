"""A box of an image at a network's size, and the way back.

INPUTS: an image, a box. OUTPUTS: the crop; pixels of the crop in the image.
"""

from typing import NamedTuple

import cv2
import numpy as np


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
