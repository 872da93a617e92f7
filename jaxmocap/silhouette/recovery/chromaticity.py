"""Hues: which hue each place of a body has, and what images show in its stead.

A place's hue is learned where cameras see it; brightness, which changes with every turn of a limb,
tells nothing. Which points are seen follows from their depths, on canvases of few cells.

INPUTS: images uint8, pixels and depths of a body's points. OUTPUTS: their hues; on canvases, how
far what is seen is from what the body would show.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from jaxmocap.images.canvases import sampled
from jaxmocap.images.regions import Region

# Deviation of a hue, shares of all three colours; what is darker than this, grey levels of all
# three, has none; squared deviations, halved, are cut off here.
SPREAD, DARKEST, FARTHEST = 0.04, 60.0, 8.0
# Weight of a new frame in the memory, at least.
NEWEST = 0.05
# Metres behind the nearest point about a cell within which others are seen as well.
BEHIND = 0.05
# Cells about a point that it covers: as points lie apart.
ABOUT = (3, 3)


class BodyAppearance(NamedTuple):
    """Hues of N points of a body.

    Attributes:
        chromaticities: (N, 3) shares of blue, green and red, together 1.
        frames: (N,) frames that they were learned from.
    """

    chromaticities: np.ndarray
    frames: np.ndarray

    @classmethod
    def empty(cls, points: int) -> "BodyAppearance":
        """Before the first frame."""
        return cls(np.zeros((points, 3), np.float32), np.zeros(points, int))

    def updated(self, hues: np.ndarray, seen: np.ndarray) -> "BodyAppearance":
        """After a frame that showed hues (C, N, 3) of the points that were seen, (C, N) bool."""
        told = seen & np.isfinite(hues[..., 0])
        count = told.sum(0)
        mean = np.where(told[..., None], hues, 0).sum(0) / np.maximum(count, 1)[:, None]
        weight = np.where(count > 0, np.maximum(NEWEST, 1 / (self.frames + 1)), 0)[:, None]
        after = self.chromaticities + weight * (mean - self.chromaticities)
        return BodyAppearance(after.astype(np.float32), self.frames + (count > 0))

    def means(self, places: np.ndarray, count: int) -> np.ndarray:
        """(count, 3) mean hues of points by the places (N,) they belong to; -1 where not known.

        A negative place is none.
        """
        on = (places >= 0) & (self.frames > 0)
        sums = _sums(places[on], self.chromaticities[on], count)
        mean = sums[:, :3] / np.maximum(sums[:, 3:], 1)
        return np.where(sums[:, 3:] > 0, mean, -1).astype(np.float32)


class PointCells(NamedTuple):
    """Where N points lie on C canvases of S x S cells.

    Attributes:
        cells: (C, N) indices into a canvas; S * S for points beside it.
        depths: (C, N) metres.
        size: S.
    """

    cells: np.ndarray
    depths: np.ndarray
    size: int

    @classmethod
    def of(
        cls, pixels_xy: np.ndarray, depths: np.ndarray, region: Region, size: int
    ) -> "PointCells":
        """Of pixels (C, N, 2) on canvases whose origins and scales are stacked."""
        origin, scale = np.asarray(region.origin), np.asarray(region.scale)
        at = np.rint((pixels_xy - origin[:, None]) / scale[:, None, None] - 0.5)
        at = np.clip(np.nan_to_num(at, nan=-1.0), -1, size).astype(int)
        inside = ((at >= 0) & (at < size)).all(-1)
        cells = np.where(inside, at[..., 1] * size + at[..., 0], size * size)
        return cls(cells, depths, size)

    def nearest_depths(self, points: np.ndarray) -> np.ndarray:
        """(C, S, S) depth of the nearest of some points (N,) bool about each cell, or infinite."""
        found = np.full((len(self.cells), self.size**2 + 1), np.inf, np.float32)
        for row, cells, depths in zip(found, self.cells, self.depths, strict=True):
            np.minimum.at(row, cells[points], depths[points])
        grids = found[:, :-1].reshape(-1, self.size, self.size)
        about, edge = np.ones(ABOUT, np.uint8), cv2.BORDER_REPLICATE
        return np.stack([cv2.erode(grid, about, borderType=edge) for grid in grids])

    def visible(self, nearest: np.ndarray) -> np.ndarray:
        """(C, N) bool: points on the canvases that nothing nearer hides."""
        flat = nearest.reshape(len(nearest), -1)
        flat = np.pad(flat, ((0, 0), (0, 1)), constant_values=-np.inf)
        return self.depths < np.take_along_axis(flat, self.cells, 1) + BEHIND

    def appearance_cost(
        self, hues: np.ndarray, known: BodyAppearance, seen: np.ndarray
    ) -> np.ndarray:
        """(C, S, S) half the squared deviations of hues (C, S, S, 3) from those of points seen.

        0 where nothing is known: no point is about, or it is too dark.
        """
        found = np.zeros(hues.shape[:3], np.float32)
        for off, shown, cells, on in zip(found, hues, self.cells, seen, strict=True):
            told = on & (known.frames > 0)
            sums = _sums(cells[told], known.chromaticities[told], self.size**2 + 1)[:-1]
            sums = cv2.blur(sums.reshape(self.size, self.size, 4), ABOUT)
            # The body is a small part of the canvas.
            there = (sums[..., 3] > 1e-6) & np.isfinite(shown[..., 0])
            expected = sums[there, :3] / sums[there, 3:]
            away = np.sum((shown[there] - expected) ** 2, -1) / (2 * SPREAD**2)
            off[there] = np.minimum(away, FARTHEST)
        return found


def chromaticity(colour: np.ndarray) -> np.ndarray:
    """(..., 3) shares of colours (..., 3) uint8; NaN where it is too dark to tell."""
    colour = colour.astype(np.float32)
    total = colour @ np.ones(3, np.float32)
    total = np.where(total > DARKEST, total, np.nan)
    return colour / total[..., None]


def chromaticity_at(images: Sequence[np.ndarray | None], pixels_xy: np.ndarray) -> np.ndarray:
    """(C, N, 3) hues at pixels (C, N, 2); NaN where there is no image, or it is too dark."""
    found = np.full((*pixels_xy.shape[:2], 3), np.nan, np.float32)
    for camera, (image, at) in enumerate(zip(images, pixels_xy, strict=True)):
        if image is None:
            continue
        x, y = np.rint(np.nan_to_num(at, nan=-1.0)).astype(int).T
        rows = np.flatnonzero((x >= 0) & (y >= 0) & (x < image.shape[1]) & (y < image.shape[0]))
        found[camera, rows] = chromaticity(image[y[rows], x[rows]])
    return found


def chromaticity_canvases(
    images: Sequence[np.ndarray | None], regions: Sequence[Region], size: int
) -> np.ndarray:
    """(C, S, S, 3) hues of images on canvases; NaN where there is none, or it is too dark."""
    found = np.full((len(images), size, size, 3), np.nan, np.float32)
    for camera, (image, region) in enumerate(zip(images, regions, strict=True)):
        if image is not None:
            found[camera] = chromaticity(sampled(image, region, size))
    return found


def _sums(places: np.ndarray, hues: np.ndarray, count: int) -> np.ndarray:
    """(count, 4) sums of hues (N, 3) by place (N,), and of how many there are."""
    parts = [np.bincount(places, part, count) for part in (*hues.T, np.ones(len(places)))]
    return np.stack(parts, -1).astype(np.float32)
