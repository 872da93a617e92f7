"""A person's surface as a cloud of texels, dense enough for photographs.

INPUTS: a Surface, its atlas and mesh, its nodes in some pose. OUTPUTS: places and normals;
which is nearest at each cell of a canvas, and pictures (H, W, 3) BGR uint8.
"""

from collections.abc import Iterable
from typing import NamedTuple

import cv2
import numpy as np

from jaxmocap.body.surfaces.mesh import Atlas, SurfaceMesh, normals_of
from jaxmocap.body.surfaces.surface import Surface
from jaxmocap.silhouette.modelling.pictures.views import PhotographView


class SurfacePhotograph(NamedTuple):
    """A photograph of the surface."""

    image: np.ndarray  # (H, W, 3) BGR uint8
    view: PhotographView  # mask and camera
    # (N, 3) of the surface in the pose that it shows, in the camera's world, metres.
    nodes_world: np.ndarray


class Texels(NamedTuple):
    """The surface as K texels of its atlas."""

    rows: np.ndarray  # (K,) of the picture
    columns: np.ndarray  # (K,) of it
    patches: np.ndarray  # (K,) number of each one's patch
    points: np.ndarray  # (K, 3) world, metres
    normals: np.ndarray  # (K, 3) unit, outward


def texels_of(surface: Surface, atlas: Atlas, mesh: SurfaceMesh, nodes: np.ndarray) -> Texels:
    """All texels, the nodes at (N, 3)."""
    upright = np.zeros_like(nodes)
    upright[mesh.nodes] = normals_of(nodes[mesh.nodes], mesh.triangles)
    # Half a million places: single numbers are exact to a micrometre.
    both = np.concatenate([nodes, upright], 1).astype(np.float32)
    texels = []
    for i, (patch, rectangle) in enumerate(zip(surface.patches, atlas.rectangles, strict=True)):
        grid = both[patch.nodes].reshape(patch.along, patch.around, 6)
        values = rectangle.texels(grid).reshape(-1, 6)
        row, column = np.divmod(np.arange(len(values)), rectangle.width)
        number = np.full(len(values), i)
        texels.append((row + rectangle.top, column + rectangle.left, number, values))
    rows, columns, patches, values = (np.concatenate(part) for part in zip(*texels, strict=True))
    lengths = np.linalg.norm(values[:, 3:], axis=1, keepdims=True)
    return Texels(rows, columns, patches, values[:, :3], values[:, 3:] / np.maximum(lengths, 1e-9))


NONE = -1
PAPER = 245


def nearest_points(cells_xy: np.ndarray, depths: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(H, W) number of the nearest of the points in each cell, ``NONE`` without one.

    Columns and rows (K, 2) are not rounded, and may lie beside the canvas; depths are (K,).
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
    """(K,) bool: nothing hides a point of ``nearest_points``.

    ``slacks`` are, for each number of cells about a point's own, how far before it what lies there
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


def splat_points(
    cells_xy: np.ndarray, depths: np.ndarray, colours: np.ndarray, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """A picture of ``nearest_points``, and where it shows them (H, W) bool.

    Their colours are (K, 3) BGR uint8; single open cells are closed.
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
