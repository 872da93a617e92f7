"""Pictures of a dense cloud of points: which is nearest at each cell.

INPUTS: where points fall on a canvas, and how far away they are; their colours.
OUTPUTS: the nearest point at each cell; a picture (H, W, 3) BGR uint8.
"""

from collections.abc import Iterable

import cv2
import numpy as np

NONE = -1
PAPER = 245


def nearest_points(cells_xy: np.ndarray, depths: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(H, W) number of the nearest of the points in each cell, ``NONE`` without one.

    Args:
        cells_xy: (K, 2) column and row of each point, not rounded; beside the canvas is allowed.
        depths: (K,) of the points.
        shape: of the canvas.
    """
    columns, rows = np.rint(cells_xy).astype(int).T
    within = (rows >= 0) & (rows < shape[0]) & (columns >= 0) & (columns < shape[1])
    # Of those written to one cell the last stays.
    order = np.flatnonzero(within)[np.argsort(-depths[within], kind="stable")]
    canvas = np.full(shape, NONE)
    canvas[rows[order], columns[order]] = order
    return canvas


def visible_points(
    cells_xy: np.ndarray,
    depths: np.ndarray,
    shape: tuple[int, int],
    slacks: Iterable[tuple[int, float]],
) -> np.ndarray:
    """(K,) bool: nothing hides a point.

    Args:
        cells_xy: (K, 2) as for ``nearest_points``.
        depths: (K,) of the points.
        shape: of the canvas.
        slacks: for each number of cells about a point's own, how far before it what lies there
            hides it.
    """
    nearest = nearest_points(cells_xy, depths, shape)
    buffer = np.where(nearest == NONE, np.inf, depths[nearest]).astype(np.float32)
    near = [
        cv2.erode(buffer, np.ones((2 * cells + 1, 2 * cells + 1), np.uint8)) + np.float32(slack)
        for cells, slack in slacks
    ]
    before = np.min(near, 0)
    columns, rows = np.rint(cells_xy).astype(int).T
    inside = (rows >= 0) & (rows < shape[0]) & (columns >= 0) & (columns < shape[1])
    is_visible = np.zeros(len(depths), bool)
    is_visible[inside] = depths[inside] <= before[rows[inside], columns[inside]]
    return is_visible


def splatted(
    cells_xy: np.ndarray, depths: np.ndarray, colours: np.ndarray, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """A picture of points, and where it shows them (H, W) bool; single open cells are closed.

    Args:
        cells_xy: (K, 2) as for ``nearest_points``.
        depths: (K,) of the points.
        colours: (K, 3) BGR uint8.
        shape: of the picture.
    """
    nearest = nearest_points(cells_xy, depths, shape)
    filled = nearest != NONE
    picture = np.where(filled[..., None], colours[nearest], np.uint8(PAPER)).astype(np.uint8)
    closed = cv2.morphologyEx(filled.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    open_cells = (closed > 0) & ~filled
    # The mean of those beside an open cell that are not.
    total = cv2.blur(picture * filled[..., None].astype(np.float32), (3, 3))
    count = cv2.blur(filled.astype(np.float32), (3, 3))
    mended = total / np.maximum(count, 1e-6)[..., None]
    picture[open_cells] = np.rint(mended[open_cells]).astype(np.uint8)
    return picture, closed > 0
