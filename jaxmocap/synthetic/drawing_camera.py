"""A camera in NumPy, for drawing.

INPUTS: a Camera, or where to put one. OUTPUTS: pixels and depths of world points.
"""

from dataclasses import dataclass

import numpy as np

from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.lenses import LENSES


def look_at(
    position: tuple[float, float, float],
    target: tuple[float, float, float],
    size: tuple[int, int] = (640, 480),
    focal: float = 790.0,
    distortion: tuple[float, ...] = (-0.09, 0.03, 0.0005, -0.0003),
) -> Camera:
    """An upright camera at a place in the world (metres), looking at another; focal in pixels."""
    forward = np.subtract(target, position)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(forward, right), forward])
    centre = (size[0] - 1) / 2 + 3.5, (size[1] - 1) / 2 - 2.0
    matrix = np.array([[focal, 0, centre[0]], [0, 1.003 * focal, centre[1]], [0, 0, 1]])
    return Camera.create(size, matrix, list(distortion), R, list(-R @ np.array(position)))


@dataclass(frozen=True)
class DrawingCamera:
    """A camera's parameters in NumPy."""

    size: tuple[int, int]  # width and height, pixels
    matrix: np.ndarray  # (3, 3) intrinsic matrix, pixels
    distortion: np.ndarray  # coefficients of the lens
    R_cam_world: np.ndarray  # (3, 3)
    translation_cam: np.ndarray  # (3,) metres
    lens: str  # name in ``LENSES``

    @classmethod
    def of(cls, camera: Camera) -> "DrawingCamera":
        """The same camera."""
        T = np.asarray(camera.T_cam_world, float)
        width, height = (int(n) for n in np.asarray(camera.size))
        matrix, distortion = (np.asarray(a, float) for a in (camera.matrix, camera.distortion))
        return cls((width, height), matrix, distortion, T[:3, :3], T[:3, 3], camera.lens)

    @property
    def position_world(self) -> np.ndarray:
        """(3,) centre of projection, metres."""
        return -self.R_cam_world.T @ self.translation_cam

    def depths(self, points_world: np.ndarray) -> np.ndarray:
        """(...) distances along the optical axis of (..., 3) points, metres."""
        return points_world @ self.R_cam_world[2] + self.translation_cam[2]

    def pixels(self, points_world: np.ndarray) -> np.ndarray:
        """(..., 2) pixels (x, y) of (..., 3) points in front of the camera."""
        points_cam = points_world @ self.R_cam_world.T + self.translation_cam
        x, y = np.moveaxis(points_cam[..., :2] / points_cam[..., 2:], -1, 0)
        distorted = LENSES[self.lens].distort(self.distortion, x, y)
        return np.stack(distorted, -1) @ self.matrix[:2, :2].T + self.matrix[:2, 2]
