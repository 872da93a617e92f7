"""Cameras of which people are drawn.

INPUTS: where to put one. OUTPUTS: a Camera.
"""

from typing import Any

import numpy as np

from jaxmocap.geometry.cameras import Camera


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


def look_around(
    azimuth: float, distance: float, height: float, target: tuple[float, float, float], **how: Any
) -> Camera:
    """A camera at an azimuth about the world's origin, degrees, metres; more as in ``look_at``.

    Of somebody who faces +x, positive azimuths are to the left.
    """
    turn = np.deg2rad(azimuth)
    position = (distance * np.cos(turn), distance * np.sin(turn), height)
    return look_at(position, target, **how)


def image_size(camera: Camera) -> tuple[int, int]:
    """Width and height, pixels."""
    width, height = (int(n) for n in np.asarray(camera.size))
    return width, height
