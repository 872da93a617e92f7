"""Soft silhouettes on a pixel grid and the cost of equations (13) and (14), pixel by pixel.

INPUTS: limbs in the image as convex hulls of two circles (centres and radii, pixels).
OUTPUTS: coverage (rows, columns) in [0, 1], and costs.
"""

import numpy as np


def signed_distance(
    point_xy: np.ndarray, near_xy: np.ndarray, far_xy: np.ndarray, radii: np.ndarray
) -> float:
    """Distance, pixels, of a point (2,) from the hull of two circles; negative inside.

    Args:
        point_xy: (2,) pixel.
        near_xy: (2,) centre of the first circle.
        far_xy: (2,) centre of the second circle.
        radii: (2,) of both circles.
    """
    from_near, from_far = np.linalg.norm(point_xy - near_xy), np.linalg.norm(point_xy - far_xy)
    length = np.linalg.norm(far_xy - near_xy)
    if length <= abs(radii[0] - radii[1]):  # one circle holds the other
        return float(from_near - radii[0] if radii[0] >= radii[1] else from_far - radii[1])
    along = (far_xy - near_xy) / length
    x = np.dot(point_xy - near_xy, along)
    y = abs(along[0] * (point_xy - near_xy)[1] - along[1] * (point_xy - near_xy)[0])
    # The straight side leans by the angle whose sine is the radii's difference over the length.
    sine = (radii[0] - radii[1]) / length
    cosine = np.sqrt(1 - sine**2)
    down_the_side = x * cosine - y * sine
    if down_the_side <= 0:
        return float(from_near - radii[0])
    if down_the_side >= length * cosine:
        return float(from_far - radii[1])
    return float(x * sine + y * cosine - radii[0])


def coverage(
    size: tuple[int, int],
    near_xy: np.ndarray,
    far_xy: np.ndarray,
    radii: np.ndarray,
    softness: float,
) -> np.ndarray:
    """Soft form (rows, columns) of P_s of equation (12): the union of N limbs, 1 - prod(1 - c).

    Args:
        size: rows and columns.
        near_xy: (N, 2) centres, pixels.
        far_xy: (N, 2) centres, pixels.
        radii: (N, 2) pixels.
        softness: width of the sigmoid across the outline, pixels.
    """
    image = np.zeros(size)
    for row in range(size[0]):
        for column in range(size[1]):
            outside = 1.0
            for near, far, pair in zip(near_xy, far_xy, radii, strict=True):
                distance = signed_distance(np.array([column, row], float), near, far, pair)
                outside *= 1.0 - 1.0 / (1.0 + np.exp(np.clip(distance / softness, -700, 700)))
            image[row, column] = 1.0 - outside
    return image


def chamfer(coverage_image: np.ndarray, distances: np.ndarray) -> float:
    """Equation (13): the sum of b_ij d_ij."""
    rows, columns = distances.shape
    total = 0.0
    for i in range(rows):
        for j in range(columns):
            total += coverage_image[i, j] * distances[i, j]
    return total


def cost(
    coverage_image: np.ndarray,
    distances: np.ndarray,
    weight: float,
    targets: np.ndarray,
    positions: np.ndarray,
) -> float:
    """Equation (14): (13) plus lambda times the distance of the end effectors from their targets.

    Args:
        coverage_image: (rows, columns) b_ij.
        distances: (rows, columns) d_ij, pixels.
        weight: lambda, pixels per metre.
        targets: (k, 3) t, metres.
        positions: (k, 3) s, metres.
    """
    apart = float(np.sqrt(np.sum((np.asarray(targets) - np.asarray(positions)) ** 2)))
    return chamfer(coverage_image, distances) + weight * apart
