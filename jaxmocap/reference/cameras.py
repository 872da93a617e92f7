"""Projection with OpenCV's distortion, of ordinary lenses and of fisheyes, point by point.

INPUTS: a camera (anything with a Camera's attributes), points (metres).
OUTPUTS: pixels (x, y); float64.
"""

from typing import Any

import numpy as np

# Points nearer than this to the camera's plane, or behind it, are projected as if they lay here.
NEAREST_M = 0.05


def to_camera(camera: Any, points_world: np.ndarray) -> np.ndarray:
    """Points (N, 3) of the world in the camera's frame, metres."""
    T_cam_world = np.asarray(camera.T_cam_world, float)
    homogeneous = [np.append(point, 1.0) for point in np.asarray(points_world, float)]
    return np.array([(T_cam_world @ point)[:3] for point in homogeneous])


def normalise(points_cam: np.ndarray) -> np.ndarray:
    """Central projection of (N, 3) camera points onto the plane z = 1: (N, 2)."""
    return np.array([[x / max(z, NEAREST_M), y / max(z, NEAREST_M)] for x, y, z in points_cam])


def distort(camera: Any, points_plane: np.ndarray) -> np.ndarray:
    """OpenCV's distortion of (N, 2) points on the plane z = 1, by the camera's lens."""
    of_lens = _fisheye if str(camera.lens) == "fisheye" else _brown_conrady
    return of_lens(np.asarray(camera.distortion, float), points_plane)


def _fisheye(coefficients: np.ndarray, points_plane: np.ndarray) -> np.ndarray:
    """Kannala and Brandt's polynomial of the angle from the optical axis."""
    k1, k2, k3, k4 = coefficients
    distorted = []
    for x, y in points_plane:
        theta = np.arctan(np.hypot(x, y))
        theta_d = theta * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8)
        azimuth = np.arctan2(y, x)
        distorted.append([theta_d * np.cos(azimuth), theta_d * np.sin(azimuth)])
    return np.array(distorted)


def _brown_conrady(coefficients: np.ndarray, points_plane: np.ndarray) -> np.ndarray:
    """The rational radial and tangential distortion."""
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    distorted = []
    for x, y in points_plane:
        r = np.hypot(x, y)
        radial = (1 + k1 * r**2 + k2 * r**4 + k3 * r**6) / (1 + k4 * r**2 + k5 * r**4 + k6 * r**6)
        dx = 2 * p1 * x * y + p2 * (r**2 + 2 * x**2)
        dy = p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y
        distorted.append([x * radial + dx, y * radial + dy])
    return np.array(distorted)


def to_pixels(camera: Any, points_plane: np.ndarray) -> np.ndarray:
    """Distort (N, 2) points on the plane z = 1 and apply the intrinsic matrix: pixels (x, y)."""
    matrix = np.asarray(camera.matrix, float)
    return np.array([(matrix @ [x, y, 1.0])[:2] for x, y in distort(camera, points_plane)])


def project(camera: Any, points_world: np.ndarray) -> np.ndarray:
    """Project (N, 3) world points, metres, to (N, 2) pixels (x, y); equation (11)."""
    return to_pixels(camera, normalise(to_camera(camera, points_world)))
