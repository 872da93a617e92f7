"""Corners of a path: where it turns most sharply, after Chetverikov and Szabo (the paper's [12]).

INPUTS: points along a path. OUTPUTS: points evenly along it, and the angles at them.
"""

import numpy as np


def evenly_spaced(points: np.ndarray, spacing: float = 1.0) -> np.ndarray:
    """(N, 2) points so far apart along a path through (M, 2) points."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    way = np.append(0.0, np.cumsum(steps))
    kept = np.append(True, steps > 0)
    places = np.arange(0.0, way[-1], spacing)
    return np.stack([np.interp(places, way[kept], line[kept]) for line in points.T], 1)


def turning_angles(points: np.ndarray, reach: float) -> np.ndarray:
    """(N,) by how much a path with points 1 apart turns at each of them, radians; 0 at its ends.

    The arms of the angle reach from the point to those ``reach`` before and after: the largest
    triangle inscribed there.
    """
    k = max(1, int(reach))
    turned = np.zeros(len(points))
    if len(points) <= 2 * k:
        return turned
    before, after = points[k:-k] - points[: -2 * k], points[2 * k :] - points[k:-k]
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    turned[k:-k] = np.abs(np.arctan2(cross, np.sum(before * after, 1)))
    return turned
