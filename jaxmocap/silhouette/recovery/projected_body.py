"""A pose and what the cameras show, laid over each other on canvases.

INPUTS: poses, what was segmented, images. OUTPUTS: ProjectedBody records.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import jax
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.surface import BodyPoints, Surface, pose_points
from jaxmocap.compilation.programs import program
from jaxmocap.geometry.cameras import Camera, depth, project
from jaxmocap.images.background_model import Background
from jaxmocap.images.canvases import canvas, resample_values
from jaxmocap.images.regions import Region
from jaxmocap.silhouette.recovery.chromaticity import PointCells, chromaticity_canvases
from jaxmocap.silhouette.segmentation.background_models import covered_cells
from jaxmocap.silhouette.segmentation.outlines import Outlines

# Of the surface's nodes one in so many is drawn,
NODE_STRIDE = 8
# and covers so many cells about it.
CELL_MARGIN = 1
# Of the canvas that limbs are searched on: cells, and extent by that of the segmentation's.
SIZE, EXTENT = 96, 1.5
# Log-ratio of what surely is, or is not, background beyond the segmentation.
BACKGROUND_LOG_RATIO = 2.0
# What is no background differs from it by so many of its deviations,
DIFFERENT_DEVIATIONS = 6.0
# and by so many grey levels beyond.
DIFFERENT_LEVELS = 30.0


class ProjectedBody(NamedTuple):
    """A pose and what the cameras show, laid over each other."""

    pose: Pose  # as estimated
    pixels: np.ndarray  # (C, N, 2) of the body's points
    cells: PointCells  # of the same on the canvases
    log_ratios: np.ndarray  # (C, S, S) of person and rest
    chromaticities: np.ndarray  # (C, S, S, 3) NaN where there are none
    regions: tuple[Region, ...]  # of each camera's canvas
    region: Region  # the same as one
    used: np.ndarray  # (C,) bool

    def covered_cells(self, points: np.ndarray) -> np.ndarray:
        """(C, S, S) bool, what of the canvases some points (N,) bool of the body cover."""
        size, rows = self.log_ratios.shape[-1], zip(self.pixels, self.regions, strict=True)
        return np.stack([covered_cells(at[points], of, size, CELL_MARGIN) for at, of in rows])


class BodyProjector:
    """Lays poses of one person over what C cameras show.

    Attributes:
        points: N of the body's surface.
    """

    def __init__(self, skeleton: Skeleton, surface: Surface, cameras: Camera):
        """Prepare for C cameras (stacked); traces once."""
        self._skeleton, self._cameras = skeleton, cameras
        self.points = BodyPoints(*(np.asarray(part)[::NODE_STRIDE] for part in surface.points))

    def project(
        self,
        pose: Pose,
        outlines: Outlines,
        used: np.ndarray,
        images: Sequence[np.ndarray | None],
        backgrounds: Sequence[Background | None],
    ) -> ProjectedBody:
        """A pose over what was segmented, and what lies about that, of cameras (C,) that count."""
        narrow = zip(*map(np.asarray, outlines.region), strict=True)
        segmented = zip(
            np.asarray(outlines.segmentation.log_ratio), narrow, images, backgrounds, strict=True
        )
        parts = [
            _extended_log_ratio(ratio, Region(*region), image, background)
            for ratio, region, image, background in segmented
        ]
        regions = tuple(region for _, region in parts)
        region = Region(*(np.stack(part) for part in zip(*regions, strict=True)))
        log_ratios = np.stack([ratio for ratio, _ in parts])
        pixels, depths = self.pixels_and_depths(pose)
        cells = PointCells.of(pixels, depths, region, SIZE)
        shown = [image if use else None for image, use in zip(images, used, strict=True)]
        colours = chromaticity_canvases(shown, regions, SIZE)
        return ProjectedBody(pose, pixels, cells, log_ratios, colours, regions, region, used)

    def pixels_and_depths(self, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
        """(C, N, 2) pixels of points all over the body, hidden or not, and (C, N) their depths."""
        pixels, depths = body_pixels(self._skeleton, pose, self._cameras, self.points)
        return np.asarray(pixels), np.asarray(depths)


@program("full")
def body_pixels(
    skeleton: Skeleton, pose: Pose, cameras: Camera, points: BodyPoints
) -> tuple[Array, Array]:
    """(C, N, 2) pixels of points of the body, hidden or not, and (C, N) their depths, metres."""
    positions = pose_points(forward(skeleton, pose), points)

    def one(camera: Camera) -> tuple[Array, Array]:
        return project(camera, positions), depth(camera, positions)

    return jax.vmap(one)(cameras)


def _extended_log_ratio(
    ratios: np.ndarray,
    region: Region,
    image: np.ndarray | None,
    background: Background | None,
) -> tuple[np.ndarray, Region]:
    """Log-ratios (``SIZE``, ``SIZE``) on a canvas about another with (S, S), and where they lie.

    Beyond that one by what differs from the background; without a background, or an image, 0.
    """
    cells, origin, scale = len(ratios), np.asarray(region.origin), float(region.scale)
    wide_scale = EXTENT * cells / SIZE * scale
    wide = origin - (EXTENT - 1) / 2 * cells * scale
    around = Region(wide.astype(np.float32), np.array(wide_scale, np.float32))
    inner = Region((wide - origin) / scale - 0.5, np.array(wide_scale / scale))
    within = resample_values(cv2.blur(ratios, (3, 3)), inner, SIZE)
    places = inner.origin[:, None] + (np.arange(SIZE) + 0.5) * inner.scale
    x, y = (places >= 0) & (places <= cells - 1)
    if image is None or background is None:
        return np.where(y[:, None] & x, within, 0).astype(np.float32), around
    shown = canvas(image, around, SIZE, background)
    off = np.abs(shown.colour.astype(np.float32) - shown.room).max(-1)
    differs = off > DIFFERENT_DEVIATIONS * shown.noise + DIFFERENT_LEVELS
    other = BACKGROUND_LOG_RATIO * np.where(differs, 1.0, -1.0)
    return np.where(y[:, None] & x, within, shown.certainty * other).astype(np.float32), around
