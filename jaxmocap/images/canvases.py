"""Canvases: the part of an image about the person, on square cells of one static number.

A canvas follows the person at a traced scale, so that another place or distance compiles nothing
anew. Positions on it are ``images.regions``'.

INPUTS: images uint8, masks of where the person is expected, a Background.
OUTPUTS: what a segmentation sees; Φ of a mask; masks at full resolution from Φ.
"""

from typing import NamedTuple

import cv2
import numpy as np

from jaxmocap.images.background_model import Background
from jaxmocap.images.regions import Region

# Signed distances are cut off here, cells.
FARTHEST = 32.0


class Canvas(NamedTuple):
    """What one camera shows on S x S cells."""

    colour: np.ndarray  # (S, S, 3) uint8, BGR
    inside: np.ndarray  # (S, S) float32, 0 to 1, how far the cell lies within the image
    room: np.ndarray  # (S, S, 3) uint8, the background's colour
    noise: np.ndarray  # (S, S) float32, its deviation
    certainty: np.ndarray  # (S, S) float32, 0 to 1, of the background


def canvas(
    image: np.ndarray | None, region: Region, size: int, background: Background | None = None
) -> Canvas:
    """An image (H, W, 3) uint8, and the learned room, on a region's cells; blank without one."""

    def part(values: np.ndarray) -> np.ndarray:
        return resample_values(values, region, size)

    nothing, black = np.zeros((size, size), np.float32), np.zeros((size, size, 3), np.uint8)
    blank = Canvas(black, nothing, black, nothing + 1, nothing)
    if image is None:
        return blank
    filled = blank._replace(colour=part(image), inside=_inside(image.shape[:2], region, size))
    if background is None:
        return filled
    return filled._replace(
        room=np.rint(part(background.colour)).astype(np.uint8),
        noise=part(background.noise),
        certainty=mask_canvas(background.certainty, region, size),
    )


def silhouette_distance(mask: np.ndarray, chamfer: int = 5) -> np.ndarray:
    """Φ (h, w) float32 of a mask (h, w): cells from its border, positive within.

    By a chamfer of 3 x 3 or 5 x 5 cells.
    """
    within = (mask > 0).astype(np.uint8)
    if not within.any() or within.all():
        return np.full(mask.shape, FARTHEST if within.any() else -FARTHEST, np.float32)
    inner, outer = (cv2.distanceTransform(p, cv2.DIST_L2, chamfer) for p in (within, 1 - within))
    # From the border between cells, which lies half a cell from their middles.
    distance = np.where(within > 0, inner - 0.5, 0.5 - outer)
    return np.clip(distance, -FARTHEST, FARTHEST).astype(np.float32)


def mask_canvas(mask: np.ndarray, region: Region, size: int) -> np.ndarray:
    """How far (S, S) float32, 0 to 1, each cell is covered; nothing is beyond the image."""
    covered = resample_values(mask.astype(np.float32), region, size)
    return covered * (_inside(mask.shape, region, size) > 0.5)


def keep_attached(phi: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Φ (S, S) without the pieces of which nothing lies where the person was predicted.

    What else differs from the room are other people, reflections and shadows.
    """
    count, labels = cv2.connectedComponents((phi > 0).astype(np.uint8))
    pieces = np.asarray(labels, np.intp)
    if count <= 2:
        return phi
    meant = np.bincount(pieces[start > 0], minlength=count) > 0
    return np.where((phi > 0) & ~meant[pieces], np.float32(-1), phi)


def full_mask(phi: np.ndarray, region: Region, shape: tuple[int, int]) -> np.ndarray:
    """(H, W) bool, where Φ (S, S) is positive at the pixels of an image of that shape."""
    scale, middle = float(region.scale), np.asarray(region.origin) + region.scale / 2
    to_pixels = np.array([[scale, 0.0, middle[0]], [0.0, scale, middle[1]]])
    far = {"borderMode": cv2.BORDER_CONSTANT, "borderValue": -FARTHEST}
    values = cv2.warpAffine(np.asarray(phi), to_pixels, shape[::-1], flags=cv2.INTER_LINEAR, **far)
    return values > 0


def resample_values(values: np.ndarray, region: Region, size: int) -> np.ndarray:
    """Values (H, W, ...) between pixels at the middles of a region's cells (S, S, ...).

    Not averaged over cells, which takes ten times as long; beyond the border it is replicated.
    """
    scale, middle = float(region.scale), np.asarray(region.origin) + region.scale / 2
    to_pixels = np.array([[scale, 0.0, middle[0]], [0.0, scale, middle[1]]])
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpAffine(
        values, to_pixels, (size, size), flags=how, borderMode=cv2.BORDER_REPLICATE
    )


def _inside(shape: tuple[int, ...], region: Region, size: int) -> np.ndarray:
    """(S, S) float32: the share of each row and column's cells that the image holds."""
    scale = float(region.scale)
    shares = []
    for start, count in zip(np.asarray(region.origin) + 0.5, (shape[1], shape[0]), strict=True):
        edges = np.clip(start + scale * np.arange(size + 1), 0, count)
        shares.append(np.diff(edges) / scale)
    return np.outer(shares[1], shares[0]).astype(np.float32)
