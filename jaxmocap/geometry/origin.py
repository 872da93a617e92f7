"""A local origin for worlds whose own is far away, as geodetic coordinates have it.

INPUTS: points in the world, metres. OUTPUTS: the origin to subtract from them, whole metres.

Tracking and pictures compute in single precision, which keeps 8 µm at 100 m and 6 cm at 1000 km.
Nothing else may be added to such a place: the origin is, in double precision, at the end.
"""

import numpy as np

# Nearer than this, metres, single precision is a hundred times finer than markers are.
FAR_M = 100.0
# Points that are looked at, evenly among all.
ENOUGH = 3000


def local_origin(points_world: np.ndarray) -> np.ndarray:
    """The points' median, in each coordinate that is far from 0.

    Args:
        points_world: (..., 3) metres; NaN where missing.

    Returns:
        (3,) whole metres, float64; zeros where the points lie near the world's origin.
    """
    points = np.asarray(points_world)
    # Whole samples: of several markers one may be missing throughout.
    points = np.asarray(points[:: max(1, len(points) // ENOUGH)], float).reshape(-1, 3)
    points = points[np.isfinite(points).all(-1)]
    if not len(points):
        return np.zeros(3)
    middle = np.median(points, 0)
    return np.where(np.abs(middle) > FAR_M, np.round(middle), 0.0)
