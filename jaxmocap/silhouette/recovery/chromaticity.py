"""Chromaticity: which colour, regardless of brightness, each point of a body has.

A point's chromaticity is learned where cameras see it; brightness changes with every turn of a
limb and is ignored. Which points are visible follows from their depths, on canvases of few cells.

INPUTS: images uint8, pixels and depths of a body's points. OUTPUTS: their chromaticities; on
canvases, how far the image is from what the body would show.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from jaxmocap.images.canvases import resample_values
from jaxmocap.images.regions import Region

# A colour darker than this has no chromaticity, grey levels of all three channels together.
DARKEST = 60.0
# Deviation of a chromaticity about its mean, shares of all three colours.
DEVIATION = 0.04
# Half squared deviations are cut off here.
LARGEST_COST = 8.0
# Weight of a new frame in the mean, at least.
LEAST_WEIGHT = 0.05
# A point so far behind the nearest about its cell is visible as well.
DEPTH_MARGIN_M = 0.05
# Cells about a point that it covers, columns and rows: as points lie apart.
WINDOW = (3, 3)


class BodyAppearance(NamedTuple):
    """Chromaticities of N points of a body."""

    chromaticities: np.ndarray  # (N, 3) shares of blue, green and red, together 1
    frames: np.ndarray  # (N,) that they were learned from

    @classmethod
    def empty(cls, points: int) -> "BodyAppearance":
        """Before the first frame."""
        return cls(np.zeros((points, 3), np.float32), np.zeros(points, int))

    def update(self, chromaticities: np.ndarray, visible: np.ndarray) -> "BodyAppearance":
        """After a frame with chromaticities (C, N, 3) of the points visible in it, (C, N) bool."""
        counted = visible & np.isfinite(chromaticities[..., 0])
        count = counted.sum(0)
        sums = np.where(counted[..., None], chromaticities, 0).sum(0)
        mean = sums / np.maximum(count, 1)[:, None]
        gain = np.maximum(LEAST_WEIGHT, 1 / (self.frames + 1))
        gain = np.where(count > 0, gain, 0)[:, None]
        after = self.chromaticities + gain * (mean - self.chromaticities)
        return BodyAppearance(after.astype(np.float32), self.frames + (count > 0))

    def means(self, bins: np.ndarray, count: int) -> np.ndarray:
        """(count, 3) mean chromaticities of points by their bins (N,); -1 where none was learned.

        A negative bin is none.
        """
        on = (bins >= 0) & (self.frames > 0)
        sums = _sums(bins[on], self.chromaticities[on], count)
        mean = sums[:, :3] / np.maximum(sums[:, 3:], 1)
        return np.where(sums[:, 3:] > 0, mean, -1).astype(np.float32)


class PointCells(NamedTuple):
    """Where N points lie on C canvases of S x S cells."""

    cells: np.ndarray  # (C, N) indices into a canvas; S * S for points beside it
    depths: np.ndarray  # (C, N) metres
    size: int  # S

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
        nearest = np.full((len(self.cells), self.size**2 + 1), np.inf, np.float32)
        for row, cells, depths in zip(nearest, self.cells, self.depths, strict=True):
            np.minimum.at(row, cells[points], depths[points])
        grids = nearest[:, :-1].reshape(-1, self.size, self.size)
        about, edge = np.ones(WINDOW, np.uint8), cv2.BORDER_REPLICATE
        return np.stack([cv2.erode(grid, about, borderType=edge) for grid in grids])

    def visible(self, nearest: np.ndarray) -> np.ndarray:
        """(C, N) bool: points on the canvases that nothing nearer, (C, S, S) depths, hides."""
        flat = nearest.reshape(len(nearest), -1)
        flat = np.pad(flat, ((0, 0), (0, 1)), constant_values=-np.inf)
        limit = np.take_along_axis(flat, self.cells, 1) + DEPTH_MARGIN_M
        return self.depths < limit

    def appearance_cost(
        self, chromaticities: np.ndarray, appearance: BodyAppearance, visible: np.ndarray
    ) -> np.ndarray:
        """(C, S, S) half squared deviations of (C, S, S, 3) from those of points visible (C, N).

        0 where nothing was learned: no point is about, or it is too dark.
        """
        costs = np.zeros(chromaticities.shape[:3], np.float32)
        rows = zip(costs, chromaticities, self.cells, visible, strict=True)
        for cost, shown, cells, on in rows:
            is_learned = on & (appearance.frames > 0)
            sums = _sums(
                cells[is_learned], appearance.chromaticities[is_learned], self.size**2 + 1
            )[:-1]
            sums = cv2.blur(sums.reshape(self.size, self.size, 4), WINDOW)
            # The body is a small part of the canvas.
            there = (sums[..., 3] > 1e-6) & np.isfinite(shown[..., 0])
            expected = sums[there, :3] / sums[there, 3:]
            squares = np.sum((shown[there] - expected) ** 2, -1)
            cost[there] = np.minimum(squares / (2 * DEVIATION**2), LARGEST_COST)
        return costs


def chromaticity(colour: np.ndarray) -> np.ndarray:
    """(..., 3) shares of colours (..., 3) uint8; NaN where it is too dark."""
    colour = colour.astype(np.float32)
    total = colour @ np.ones(3, np.float32)
    total = np.where(total > DARKEST, total, np.nan)
    return colour / total[..., None]


def chromaticity_at(images: Sequence[np.ndarray | None], pixels_xy: np.ndarray) -> np.ndarray:
    """(C, N, 3) at pixels (C, N, 2); NaN where there is no image, or it is too dark."""
    result = np.full((*pixels_xy.shape[:2], 3), np.nan, np.float32)
    for camera, (image, at) in enumerate(zip(images, pixels_xy, strict=True)):
        if image is None:
            continue
        x, y, within = pixels_within(image, at)
        result[camera, within] = chromaticity(image[y[within], x[within]])
    return result


def pixels_within(
    image: np.ndarray, pixels_xy: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns and rows (N,) nearest to pixels (N, 2), and whether an image (H, W, ...) has them."""
    x, y = np.rint(np.nan_to_num(pixels_xy, nan=-1.0)).astype(int).T
    return x, y, (x >= 0) & (y >= 0) & (x < image.shape[1]) & (y < image.shape[0])


def chromaticity_canvases(
    images: Sequence[np.ndarray | None], regions: Sequence[Region], size: int
) -> np.ndarray:
    """(C, S, S, 3) of images on canvases; NaN where there is none, or it is too dark."""
    result = np.full((len(images), size, size, 3), np.nan, np.float32)
    for camera, (image, region) in enumerate(zip(images, regions, strict=True)):
        if image is not None:
            result[camera] = chromaticity(resample_values(image, region, size))
    return result


def _sums(bins: np.ndarray, chromaticities: np.ndarray, count: int) -> np.ndarray:
    """(count, 4) sums of chromaticities (N, 3) by bin (N,), and of how many there are."""
    channels = (*chromaticities.T, np.ones(len(bins)))
    parts = [np.bincount(bins, channel, count) for channel in channels]
    return np.stack(parts, -1).astype(np.float32)
