"""A silhouette and the camera that saw it, in NumPy: any number of points costs no program.

INPUTS: a mask, a Camera; points of the world, or pixels and a plane.
OUTPUTS: pixels; points where rays meet a plane; how far a silhouette reaches along a line.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from jaxmocap.geometry.cameras import Camera, on_host, plane_components, project

# Steps along a line on which a silhouette is looked up, metres.
STEP_M = 0.001


@dataclass(frozen=True)
class PhotographView:
    """What one camera saw."""

    mask: np.ndarray  # (H, W) bool, the person
    camera: Camera  # calibrated in the world in which the person faces +x
    # (3,) how far the person has moved since the front view, metres: all points are where they were
    # then.
    shift: np.ndarray = field(default_factory=lambda: np.zeros(3))

    @cached_property
    def _from_person(self) -> Camera:
        """The camera, as it stands about the person's place in the front view."""
        camera = on_host(self.camera)
        R, t = np.split(camera.T_cam_world, [3], 1)
        return replace(camera, T_cam_world=np.append(R, t + R @ self.shift[:, None], 1))

    @property
    def centre(self) -> np.ndarray:
        """(3,) the camera's place as seen from the person, metres."""
        return np.asarray(self._from_person.position_world)

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """(..., 2) pixels (x, y) of (..., 3) points before the camera."""
        return np.asarray(project(self._from_person, points))

    def rays(self, pixels_xy: np.ndarray) -> np.ndarray:
        """(..., 3) directions, world, of the rays through (..., 2) pixels."""
        camera = self._from_person
        x, y = plane_components(camera, pixels_xy[..., 0], pixels_xy[..., 1])
        return np.stack([x, y, np.ones_like(x)], -1) @ camera.T_cam_world[:3, :3]

    def plane_points(self, pixels_xy: np.ndarray, point: np.ndarray) -> np.ndarray:
        """(..., 3) where the rays through pixels are as far ahead (x) as a point, metres."""
        rays = self.rays(np.asarray(pixels_xy, float))
        share = (point - self.centre)[0] / rays[..., 0]
        return self.centre + share[..., None] * rays

    def covers(self, points: np.ndarray) -> np.ndarray:
        """(...) bool: does the silhouette cover these points (..., 3)?"""
        columns, rows = np.moveaxis(np.rint(self.pixels(points)).astype(int), -1, 0)
        height, width = self.mask.shape
        within = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        return within & self.mask[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)]

    def extent(self, start: np.ndarray, direction: np.ndarray, most: float) -> np.ndarray:
        """How far the silhouette reaches from points (N, 3) in a direction (3,) or (N, 3): (N,).

        Metres, at most ``most``; 0 where a point is not covered itself.
        """
        steps = np.arange(0.0, most, STEP_M)
        line = start[:, None] + steps[:, None] * np.broadcast_to(direction, start.shape)[:, None]
        covered = self.covers(line)
        free = np.argmin(covered, 1)
        return np.where(covered.all(1), most, np.maximum(free - 0.5, 0.0) * STEP_M)
