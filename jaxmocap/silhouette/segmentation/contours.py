"""Closed contours as periodic signals, one to a coordinate (second paper, 3.1.4).

INPUTS: points along a closed curve, in the plane or in space. OUTPUTS: the same curve evenly
sampled; its low-pass, for matching coarse shapes before fine ones; its normals.
"""

import numpy as np


def even_contour(points: np.ndarray, count: int) -> np.ndarray:
    """(count, D) points evenly spaced along the closed polygon through (N, D) points.

    The first stays the first: phi = 0 of (3.13).
    """
    closed = np.concatenate([points, points[:1]]).astype(float)
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1)))
    at = np.arange(count) * way[-1] / count
    return np.stack([np.interp(at, way, signal) for signal in closed.T], 1)


def low_pass(contour: np.ndarray, harmonics: int, count: int | None = None) -> np.ndarray:
    """The contour (N, D) with its lowest ``harmonics`` only, equation (3.15).

    Args:
        contour: evenly spaced points.
        harmonics: N of (3.15); 0 leaves the centre, 1 an ellipse.
        count: points of the result, as many as there were without it.
    """
    size = len(contour)
    phases = np.fft.rfft(contour, axis=0)[: harmonics + 1]
    wanted = size if count is None else count
    full = np.zeros((wanted // 2 + 1, contour.shape[1]), complex)
    kept = min(len(phases), len(full))
    full[:kept] = phases[:kept]
    return np.fft.irfft(full, wanted, axis=0) * (wanted / size)


def normals(contour: np.ndarray) -> np.ndarray:
    """Unit normals (N, 2) of an evenly sampled plane contour, by its series' derivative.

    They point to the right of the way along it as one looks at x to the right and y upwards; in an
    image, whose y goes down, to the left.
    """
    size = len(contour)
    orders = np.arange(size // 2 + 1)[:, None] * 1j
    # The wave at half the sampling rate has no derivative at the samples.
    if size % 2 == 0:
        orders[-1] = 0
    tangents = np.fft.irfft(np.fft.rfft(contour, axis=0) * orders, size, axis=0)
    across = np.stack([tangents[:, 1], -tangents[:, 0]], 1)
    return across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
