"""What of a surface a camera sees: node by node, cell by cell, by rays against every triangle.

INPUTS: where nodes of a surface fall on a small canvas, and how far away they are; triangles.
OUTPUTS: the nearest node at each cell, the body's mask, the cells of its boundary and of steps in
depth; the outline's cells with their nodes; which points are hidden.
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


def outline(
    x: np.ndarray, y: np.ndarray, depths: np.ndarray, size: int
) -> dict[tuple[int, int], int]:
    """Cell (column, row) on the body's outline -> the node visible there, or the nearest beside it.

    Args:
        x: (M,) column of every node on the canvas, not rounded.
        y: (M,) row.
        depths: (M,) from the camera, metres.
        size: of the canvas.
    """
    nodes, result = nearest_nodes(x, y, depths, size), {}
    for column, row in boundary_cells(body_mask(nodes)):
        node = nodes[row, column]
        beside = [nodes[row + dy, column + dx] for dy, dx in AROUND]
        beside = [n for n in beside if n >= 0]
        if node < 0 and beside:
            node = min(beside, key=lambda n: depths[n])
        if node >= 0:
            result[column, row] = int(node)
    return result


def hidden(eye: np.ndarray, points: np.ndarray, triangles: np.ndarray, nearer: float) -> np.ndarray:
    """(N,) whether any triangle lies on the line of sight, so much nearer to the eye.

    Args:
        eye: (3,) of the camera, metres.
        points: (N, 3) looked at.
        triangles: (F, 3, 3).
        nearer: metres by which a triangle must lie before the point.
    """
    corner, one, other = triangles[:, 0], *(triangles[:, k] - triangles[:, 0] for k in (1, 2))
    from_corner = eye - corner
    across = np.cross(from_corner, one)
    is_hidden = np.zeros(len(points), bool)
    for i, point in enumerate(points):
        away = np.linalg.norm(point - eye)
        way = (point - eye) / away
        # Moeller and Trumbore: eye + t way = corner + u one + v other.
        normal = np.cross(way, other)
        scale = np.sum(one * normal, 1)
        flat = np.abs(scale) < 1e-12
        scale = np.where(flat, 1.0, scale)
        u = np.sum(from_corner * normal, 1) / scale
        v = across @ way / scale
        t = np.sum(other * across, 1) / scale
        hit = ~flat & (u >= 0) & (v >= 0) & (u + v <= 1)
        is_hidden[i] = np.any(hit & (t > 0) & (t < away - nearer))
    return is_hidden
