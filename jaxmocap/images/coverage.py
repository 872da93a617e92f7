"""What of a canvas points of a body cover.

INPUTS: pixels of many points, where a canvas lies. OUTPUTS: a mask of its cells.
"""

import cv2
import numpy as np

from jaxmocap.images.regions import Region


def covered(pixels_xy: np.ndarray, region: Region, size: int, around: int) -> np.ndarray:
    """(S, S) bool: cells within ``around`` cells of a point, by rows or columns.

    Args:
        pixels_xy: (N, 2) in the whole image.
        region: of the canvas.
        size: S.
        around: at least half of what lies between neighbouring points, or gaps stay open.
    """
    cells = np.rint((pixels_xy - region.origin) / region.scale - 0.5).astype(int)
    column, row = cells[((cells >= 0) & (cells < size)).all(1)].T
    mask = np.zeros((size, size), np.uint8)
    mask[row, column] = 1
    return cv2.dilate(mask, np.ones((2 * around + 1,) * 2, np.uint8)) > 0
