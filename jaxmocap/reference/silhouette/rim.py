"""What of a surface a camera sees at its outline: by cells, and by rays against every triangle.

INPUTS: nodes of a surface as a camera sees them; a camera's place and triangles (metres).
OUTPUTS: the outline's cells with their nodes; which points are hidden.
"""

import numpy as np

from jaxmocap.reference.silhouette.index_image import (
    AROUND,
    body_mask,
    boundary_cells,
    nearest_nodes,
)


def outline(
    x: np.ndarray, y: np.ndarray, depths: np.ndarray, size: int
) -> dict[tuple[int, int], int]:
    """Cell (column, row) on the body's outline -> the node seen there, or the nearest beside it.

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
