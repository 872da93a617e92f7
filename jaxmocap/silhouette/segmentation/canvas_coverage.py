"""What of a canvas points of a body cover, and what lies about it that is no background.

INPUTS: pixels of many points, where a canvas lies; log-ratios on it, an image, its Background.
OUTPUTS: a mask of its cells; log-ratios on a wider canvas.
"""

import cv2
import numpy as np

from jaxmocap.images.background_model import Background
from jaxmocap.images.canvases import canvas, resampled_values
from jaxmocap.images.regions import Region

# What is no background differs from it by so many of its deviations,
DIFFERENT_DEVIATIONS = 6.0
# and by so many grey levels beyond.
DIFFERENT_LEVELS = 30.0


def covered_cells(pixels_xy: np.ndarray, region: Region, size: int, around: int) -> np.ndarray:
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


def extended_log_ratio(
    ratios: np.ndarray,
    region: Region,
    image: np.ndarray | None,
    background: Background | None,
    size: int,
    extent: float,
    largest: float,
) -> tuple[np.ndarray, Region]:
    """Log-ratios on a canvas about another, and beyond that by what differs from the background.

    Args:
        ratios: (S, S) on the canvas of ``region``.
        region: of that canvas.
        image: (H, W, 3) uint8.
        background: its model; without it, or an image, the rest is 0.
        size: of the wider canvas, cells.
        extent: how many times as wide it is.
        largest: log-ratio of what surely is, or is not, background.

    Returns:
        (size, size) and where they lie.
    """
    cells, origin, scale = len(ratios), np.asarray(region.origin), float(region.scale)
    wide_scale = extent * cells / size * scale
    wide = origin - (extent - 1) / 2 * cells * scale
    around = Region(wide.astype(np.float32), np.array(wide_scale, np.float32))
    inner = Region((wide - origin) / scale - 0.5, np.array(wide_scale / scale))
    within = resampled_values(cv2.blur(ratios, (3, 3)), inner, size)
    places = inner.origin[:, None] + (np.arange(size) + 0.5) * inner.scale
    x, y = (places >= 0) & (places <= cells - 1)
    if image is None or background is None:
        return np.where(y[:, None] & x, within, 0).astype(np.float32), around
    shown = canvas(image, around, size, background)
    off = np.abs(shown.colour.astype(np.float32) - shown.room).max(-1)
    other = np.where(off > DIFFERENT_DEVIATIONS * shown.noise + DIFFERENT_LEVELS, largest, -largest)
    return np.where(y[:, None] & x, within, shown.certainty * other).astype(np.float32), around
