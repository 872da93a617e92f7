"""What C cameras show of the person, as contours, or that a camera shows nothing of use.

INPUTS: images of C cameras, rims of the predicted pose. OUTPUTS: contours, and the level sets.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from jaxmocap.images.background_model import Background
from jaxmocap.images.canvases import canvas, keep_attached, silhouette_distance
from jaxmocap.images.regions import Region
from jaxmocap.silhouette.fit.correspond import Contour
from jaxmocap.silhouette.segmentation.contour import contours
from jaxmocap.silhouette.segmentation.segment import (
    CanvasImages,
    Histograms,
    Segmentation,
    segment,
)
from jaxmocap.silhouette.segmentation.sharpen import sharpen_silhouette
from jaxmocap.silhouette.settings import Settings
from jaxmocap.silhouette.surfaces.rim import Rim

# Fewer points of a contour are none.
LEAST_POINTS = 16
# OpenCV lets other threads work meanwhile.
_THREADS = ThreadPoolExecutor(2, "sharpening")


class Outlines(NamedTuple):
    """What C cameras show."""

    contours: tuple[Contour, ...]  # one a camera; without points where it shows nothing
    segmentation: Segmentation  # level sets (C, S, S), on the canvases of ``region``
    region: Region  # the canvases' places


def find_outlines(
    images: Sequence[np.ndarray | None],
    backgrounds: Sequence[Background | None],
    rim: Rim,
    before: Histograms,
    settings: Settings,
) -> Outlines:
    """Segment images (H, W, 3), BGR uint8 or None, from the silhouettes that are predicted."""
    size, region = settings.rim.size, Region(*map(np.asarray, rim.region))
    views = [Region(*each) for each in zip(*region, strict=True)]
    taken = [
        canvas(image, view, size, background)
        for image, view, background in zip(images, views, backgrounds, strict=True)
    ]
    start = np.stack([silhouette_distance(mask) for mask in rim.masks])
    canvases = CanvasImages.of(taken)
    segmentation = segment(canvases, start, before, settings.level_set, settings.plan)
    phi = np.stack(
        [keep_attached(*each) for each in zip(np.asarray(segmentation.phi), start, strict=True)]
    )
    phi = _sharpen_contours(images, backgrounds, phi, views)
    # Without an image there is only the prediction.
    phi[[image is None for image in images]] = -1
    segmentation = segmentation._replace(phi=phi)
    traced = contours(
        segmentation.phi, segmentation.log_ratio, canvases.inside, region, settings.points,
        settings.level_set.largest_log_ratio,
    )  # fmt: skip
    clear = np.asarray(traced.valid) & (np.asarray(traced.contrast) > settings.contrast)
    clear &= clear.sum(1, keepdims=True) >= LEAST_POINTS
    clear &= np.array([[image is not None] for image in images])
    points, normals = np.asarray(traced.points_xy), np.asarray(traced.normals)
    lines = tuple(Contour(points[c][on], normals[c][on]) for c, on in enumerate(clear))
    return Outlines(lines, segmentation, region)


def _sharpen_contours(
    images: Sequence[np.ndarray | None],
    backgrounds: Sequence[Background | None],
    phi: np.ndarray,
    views: Sequence[Region],
) -> np.ndarray:
    """Φ (C, S, S), its contours corrected by pixels; all cameras at once."""

    def one(camera: int) -> np.ndarray:
        image, now, view = images[camera], phi[camera], views[camera]
        if image is None or not (now > 0).any():
            return now
        return keep_attached(
            sharpen_silhouette(image, now, view, backgrounds[camera]).phi(view, len(now)), now
        )

    return np.stack(list(_THREADS.map(one, range(len(phi)))))
