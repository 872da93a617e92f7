"""How well limbs cover their measured silhouettes on a grid, cell by cell.

INPUTS: limbs as convex hulls of two circles (centres and radii, cells), the measured
silhouette, its weight. OUTPUTS: coverage (rows, columns) in [0, 1], and a sum of squares.
"""

import numpy as np

from jaxmocap.reference.hybrid.raster import signed_distance


def coverage(
    size: int, near_xy: np.ndarray, far_xy: np.ndarray, radii: np.ndarray, softness: float
) -> np.ndarray:
    """Coverage (size, size) by the one of N limbs that reaches farthest over each cell.

    Args:
        size: cells along a side.
        near_xy: (N, 2) centres.
        far_xy: (N, 2) centres.
        radii: (N, 2).
        softness: width of the sigmoid across the outline.
    """
    image = np.zeros((size, size))
    for row in range(size):
        for column in range(size):
            cell = np.array([column, row], float)
            limbs = zip(near_xy, far_xy, radii, strict=True)
            deepest = min(signed_distance(cell, *limb) for limb in limbs)
            image[row, column] = 1 / (1 + np.exp(np.clip(deepest / softness, -700, 700)))
    return image


def coverage_cost(
    covered: np.ndarray, probability: np.ndarray, weight: np.ndarray, visible: np.ndarray
) -> float:
    """The sum of squared weighted differences; all are (size, size)."""
    total = 0.0
    for cell in np.ndindex(*covered.shape):
        difference = covered[cell] * visible[cell] - probability[cell]
        total += (weight[cell] * difference) ** 2
    return float(total)
