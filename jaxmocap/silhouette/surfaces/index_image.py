"""The index image of a projected surface, and the boundaries that it shows (second paper, 3.1.5).

INPUTS: where nodes of a surface fall on a small canvas, and how far away they are.
OUTPUTS: at each cell the nearest node; the occluding boundary, cell by cell, with its node.

The paper's field F looks up the surface's node at a pixel. Here nodes lie closer than cells, every
cell keeps the nearest of those that fall into it, and what little stays open is closed.
"""

from typing import NamedTuple

import cv2
import jax.numpy as jnp
import numpy as np
from jax import Array

# A key holds a node's depth above its number, so that the least key is the nearest node.
NODE_BITS = 17
DEPTH_STEPS = 1 << (31 - NODE_BITS)
EMPTY = np.int32(2**31 - 1)
# The tangent is taken between the cells so many to either side along the boundary.
TANGENT = 3
SQUARE = np.ones((3, 3), np.uint8)
# Cells that windows of five and of twice three reach to either side.
REACH = 3


class Boundary(NamedTuple):
    """K cells of a canvas on the body's boundary."""

    cells: np.ndarray  # (K, 2) column and row
    nodes: np.ndarray  # (K,) of the surface
    normals: np.ndarray  # (K, 2) unit vectors away from what occludes


def node_keys(x: Array, y: Array, depths: Array, size: int) -> tuple[Array, Array]:
    """Where M nodes fall on a canvas, and their keys, (M,) int32 each; for ``index_image``.

    Columns and rows (M,) are not rounded. Places count row by row, ``size * size`` is beside the
    canvas. Depths (M,) are metres.
    """
    column, row = (jnp.round(jnp.clip(part, -1, size)).astype(jnp.int32) for part in (x, y))
    within = (column >= 0) & (column < size) & (row >= 0) & (row < size)
    near, far = jnp.min(depths), jnp.max(depths)
    share = (depths - near) / jnp.maximum(far - near, 1e-6)
    steps = (share * (DEPTH_STEPS - 2)).astype(jnp.int32)
    keys = (steps << NODE_BITS) | jnp.arange(len(depths), dtype=jnp.int32)
    return jnp.where(within, row * size + column, size * size), keys


def index_image(places: np.ndarray, keys: np.ndarray, size: int) -> np.ndarray:
    """Keys (size, size) int32 of the nearest node at each cell; ``EMPTY`` where there is none.

    On the host: NumPy takes a fifteenth of the time of XLA's scattering on a processor.
    """
    canvas = np.full(size * size + 1, EMPTY, np.int32)
    np.minimum.at(canvas, places, keys)
    return canvas[:-1].reshape(size, size)


def nodes_at(keys: np.ndarray) -> np.ndarray:
    """Nodes of an index image, -1 where there is none."""
    return np.where(keys == EMPTY, -1, keys & ((1 << NODE_BITS) - 1))


def body_mask(keys: np.ndarray) -> np.ndarray:
    """(S, S) uint8: 1 where the body is; cells that no node happened to fall into are closed."""
    return cv2.morphologyEx((keys != EMPTY).astype(np.uint8), cv2.MORPH_CLOSE, SQUARE)


def outer_boundary(keys: np.ndarray, mask: np.ndarray, count: int | None = None) -> Boundary:
    """The body's outline, holes between its limbs too, as a mask (S, S) can show it.

    A cell's node is the nearest in or beside it; cells without one are left out. No more cells than
    ``count``, evenly along it.
    """
    boundary = trace_boundary(mask)
    cells, normals = boundary if count is None else subsample_rows(boundary, count)
    padded = np.pad(keys, 1, constant_values=EMPTY)
    x, y = cells.T
    here = padded[y + 1, x + 1]
    beside = np.min([padded[y + dy, x + dx] for dy in range(3) for dx in range(3)], 0)
    nodes = nodes_at(np.where(here == EMPTY, beside, here))
    has_node = nodes >= 0
    return Boundary(cells[has_node], nodes[has_node], normals[has_node])


def trace_boundary(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The cells (K, 2) along the inside of a mask's outlines, column and row, and their normals.

    Cells at the canvas' edge, which is no edge of the body, are left out, and so are specks.
    """
    outlines, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    chains = [chain[:, 0] for chain in outlines if len(chain) > 2 * TANGENT]
    if not chains:
        return np.zeros((0, 2), int), np.zeros((0, 2))
    cells = np.concatenate(chains)
    # OpenCV goes about a body against the clock in the image, and about a hole with it.
    x, y = np.concatenate([np.roll(c, -TANGENT, 0) - np.roll(c, TANGENT, 0) for c in chains]).T
    normals = np.stack([-y, x], 1).astype(float)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    # Where a chain turns back on itself it has no tangent.
    kept = ((cells > 0) & (cells < len(mask) - 1)).all(1) & normals.any(1)
    return cells[kept], normals[kept]


def inner_boundary(
    keys: np.ndarray, depths: np.ndarray, jump: float, parts: np.ndarray | None = None
) -> Boundary:
    """Where one part of the body ends ``jump`` metres before another: colours may show it, no mask.

    By keys (S, S) and the nodes' depths (M,), metres. Boundaries of ``parts`` (M,) with one another
    count alone, where there are any: where one and the same lies at a glancing angle it recedes
    as fast.
    """
    there = keys != EMPTY
    if not there.any():
        return Boundary(np.zeros((0, 2), int), np.zeros(0, int), np.zeros((0, 2)))
    # The body is narrower than the canvas.
    box = tuple(_extent(there.any(axis)) for axis in (1, 0))
    nodes = nodes_at(keys[box])
    depth = np.where(nodes >= 0, depths[nodes], np.float32(np.inf)).astype(np.float32)
    # Single cells through which the far side shows take the depth of those about them.
    depth = cv2.morphologyEx(depth, cv2.MORPH_OPEN, SQUARE)
    is_covered = np.isfinite(depth)
    if parts is not None:
        part = np.where(nodes >= 0, parts[nodes] + 1, 0).astype(np.uint8)
        least = cv2.erode(np.where(nodes >= 0, part, np.uint8(255)), SQUARE)
        is_covered &= least != cv2.dilate(part, SQUARE)
    x, y = _steps_back(depth, jump, *np.nonzero(is_covered))
    rows, columns = np.nonzero(((x != 0) | (y != 0)) & (nodes >= 0))
    # Cells have but eight directions: those about them give it better.
    x, y = (cv2.blur(steps, (5, 5)) for steps in (x, y))
    ways = np.stack([x[rows, columns], y[rows, columns]], 1).astype(float)
    lengths = np.linalg.norm(ways, axis=1, keepdims=True)
    kept = lengths[:, 0] > 1e-3
    rows, columns, ways = rows[kept], columns[kept], ways[kept] / lengths[kept]
    cells = np.stack([columns + box[1].start, rows + box[0].start], 1)
    return Boundary(cells, nodes[rows, columns], ways)


def _extent(there: np.ndarray) -> slice:
    """Where a row of cells is not empty, with what the windows about a cell reach besides."""
    filled = np.flatnonzero(there)
    return slice(max(int(filled[0]) - REACH, 0), int(filled[-1]) + REACH + 1)


def _steps_back(
    depth: np.ndarray, jump: float, rows: np.ndarray, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Steps of some cells along x and along y, (S, S) float32.

    1 where the next cell lies farther back, -1 where the last one does, 0 where both do. Beside
    nothing there is no step: that is the outline.
    """
    wide = np.pad(depth, 1, constant_values=np.inf)
    here = depth[rows, columns] + np.float32(jump)

    def farther(down: int, right: int) -> np.ndarray:
        there = wide[rows + 1 + down, columns + 1 + right]
        return (np.isfinite(there) & (there > here)).astype(np.float32)

    x, y = np.zeros_like(depth), np.zeros_like(depth)
    x[rows, columns] = farther(0, 1) - farther(0, -1)
    y[rows, columns] = farther(1, 0) - farther(-1, 0)
    return x, y


def subsample_rows(parts: tuple[np.ndarray, ...], count: int) -> tuple[np.ndarray, ...]:
    """At most ``count`` of the rows that all parts have, evenly along them."""
    rows = len(parts[0])
    if rows <= count:
        return tuple(parts)
    kept = np.linspace(0, rows, count, endpoint=False).astype(int)
    return tuple(part[kept] for part in parts)
