"""The index image and its boundaries, node by node and cell by cell.

INPUTS: where nodes of a surface fall on a small canvas, and how far away they are.
OUTPUTS: the nearest node at each cell, the body's mask, the cells of its boundary and of steps in
depth.
"""

import numpy as np

AROUND = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
BESIDE = [(-1, 0), (1, 0), (0, -1), (0, 1)]


def nearest_nodes(x: np.ndarray, y: np.ndarray, depths: np.ndarray, size: int) -> np.ndarray:
    """(size, size) number of the nearest node in each cell, -1 where there is none."""
    nodes = np.full((size, size), -1)
    for node in np.argsort(-np.asarray(depths, float), kind="stable"):
        column, row = int(np.rint(x[node])), int(np.rint(y[node]))
        if 0 <= column < size and 0 <= row < size:
            nodes[row, column] = node
    return nodes


def body_mask(nodes: np.ndarray) -> np.ndarray:
    """(S, S) where the body is: widened by a cell, then narrowed by one."""
    size, filled = len(nodes), nodes >= 0
    wide = np.array([[any(_about(filled, y, x)) for x in range(size)] for y in range(size)])
    return np.array([[all(_about(wide, y, x)) for x in range(size)] for y in range(size)])


def _about(mask: np.ndarray, y: int, x: int) -> list[bool]:
    """A cell and its eight neighbours, as far as they are on the canvas."""
    size = len(mask)
    cells = [(y + dy, x + dx) for dy, dx in AROUND]
    return [bool(mask[r, c]) for r, c in cells if 0 <= r < size and 0 <= c < size]


def boundary_cells(mask: np.ndarray) -> set[tuple[int, int]]:
    """(column, row) of the body's cells within the canvas that have something else beside them."""
    size, cells = len(mask), set()
    for y in range(1, size - 1):
        for x in range(1, size - 1):
            if mask[y, x] and not all(mask[y + dy, x + dx] for dy, dx in BESIDE):
                cells.add((x, y))
    return cells


def step_cells(depth: np.ndarray, jump: float) -> set[tuple[int, int]]:
    """(column, row) of the cells that lie farther in front than ``jump`` of one beside them."""
    size, cells = len(depth), set()
    for y in range(size):
        for x in range(size):
            for dy, dx in BESIDE:
                r, c = y + dy, x + dx
                on_canvas = 0 <= r < size and 0 <= c < size
                if on_canvas and np.isfinite(depth[r, c]) and depth[r, c] - depth[y, x] > jump:
                    cells.add((x, y))
    return cells
