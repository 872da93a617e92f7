"""Sight: a pose and what the cameras show, laid over each other on canvases.

INPUTS: poses, what was segmented, images. OUTPUTS: Sights.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.surface import BodyPoints, Surface, posed
from jaxmocap.geometry.cameras import Camera, depth, project
from jaxmocap.images.background_model import Background
from jaxmocap.images.regions import Region
from jaxmocap.silhouette.recovery.hues import Places, hue_canvases
from jaxmocap.silhouette.segmentation.canvas_coverage import covered, widened
from jaxmocap.silhouette.segmentation.outlines import Outlines

# Of the surface's nodes one in so many says what the body covers, with so many cells about it.
NODES, AROUND = 8, 1
# The canvas that limbs are looked for on: cells, and how many times as wide as the segmentation's.
CELLS, WIDER = 96, 1.5
# Log-ratio of what surely is no room, beyond the segmentation.
MOST = 2.0


class Sight(NamedTuple):
    """A pose and what the cameras show, laid over each other.

    Attributes:
        pose: that was found.
        pixels: (C, N, 2) of the body's points.
        places: of the same on the canvases.
        ratios: (C, S, S) log-ratios of person and rest.
        hues: (C, S, S, 3) NaN where there are none.
        regions: of each camera's canvas.
        region: the same as one.
        used: (C,) bool.
    """

    pose: Pose
    pixels: np.ndarray
    places: Places
    ratios: np.ndarray
    hues: np.ndarray
    regions: tuple[Region, ...]
    region: Region
    used: np.ndarray

    def covered(self, points: np.ndarray) -> np.ndarray:
        """(C, S, S) bool, what of the canvases some points (N,) bool of the body cover."""
        size = self.ratios.shape[-1]
        return np.stack(
            [
                covered(at[points], region, size, AROUND)
                for at, region in zip(self.pixels, self.regions, strict=True)
            ]
        )


class Onlooker:
    """Lays poses of one person over what C cameras show.

    Attributes:
        points: N of the body's surface.
    """

    def __init__(self, skeleton: Skeleton, surface: Surface, cameras: Camera):
        """Prepare for C cameras (stacked); traces once."""
        self.skeleton, self.cameras = skeleton, cameras
        self.points = BodyPoints(*(np.asarray(part)[::NODES] for part in surface.points))

    def sight(
        self,
        pose: Pose,
        seen: Outlines,
        used: np.ndarray,
        images: Sequence[np.ndarray | None],
        rooms: Sequence[Background | None],
    ) -> Sight:
        """A pose over what was segmented, and what lies about that, of cameras (C,) that count."""
        narrow = zip(*map(np.asarray, seen.region), strict=True)
        ratios = np.asarray(seen.segmented.log_ratio)
        parts = [
            widened(ratio, Region(*region), image, room, CELLS, WIDER, MOST)
            for ratio, region, image, room in zip(ratios, narrow, images, rooms, strict=True)
        ]
        regions = tuple(region for _, region in parts)
        region = Region(*(np.stack(part) for part in zip(*regions, strict=True)))
        ratios = np.stack([ratio for ratio, _ in parts])
        pixels, depths = self.placed(pose)
        places = Places.of(pixels, depths, region, CELLS)
        shown = [image if use else None for image, use in zip(images, used, strict=True)]
        hues = hue_canvases(shown, regions, CELLS)
        return Sight(pose, pixels, places, ratios, hues, regions, region, used)

    def placed(self, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
        """(C, N, 2) pixels of points all over the body, hidden or not, and (C, N) their depths."""
        pixels, depths = seen_at(self.skeleton, pose, self.cameras, self.points)
        return np.asarray(pixels), np.asarray(depths)


@jax.jit
def seen_at(
    skeleton: Skeleton, pose: Pose, cameras: Camera, points: BodyPoints
) -> tuple[Array, Array]:
    """(C, N, 2) pixels of points of the body, hidden or not, and (C, N) their depths, metres."""
    places = posed(forward(skeleton, pose), points)

    def one(camera: Camera) -> tuple[Array, Array]:
        return project(camera, places), depth(camera, places)

    return jax.vmap(one)(cameras)
