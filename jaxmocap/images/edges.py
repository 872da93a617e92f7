"""From an image to the distance fields of its edges (section 5.1, Fig. 4), by OpenCV.

An outline should lie on edges that run its way, so edges are sorted by the direction of their
normal into channels, each with a distance field of its own. One channel is the paper's plain field.

INPUTS: a crop of a video frame, uint8. OUTPUTS: distances to the nearest edge, float32, pixels.
"""

from dataclasses import dataclass

import cv2
import numpy as np

# Distances are cut off here (pixels of the crop): farther edges are some other thing's.
FARTHEST_PX = 20.0


@dataclass(frozen=True)
class EdgeSettings:
    """How edges are found.

    Attributes:
        blur: standard deviation of the Gaussian low-pass, pixels of the crop.
        equalise: equalise the histogram first, as the paper does. Over a moving region it flickers,
            so the default takes Canny's thresholds from the gradients' percentiles instead.
        percentiles: of the gradient's magnitude, Canny's low and high threshold.
        floor: least high threshold (L1 gradient of 8-bit grey): below it lies the sensor's noise.
        memory: share of the last frame's thresholds in the present ones.
    """

    blur: float = 1.0
    equalise: bool = False
    percentiles: tuple[float, float] = (75.0, 90.0)
    floor: float = 40.0
    memory: float = 0.8


@dataclass
class Thresholds:
    """Canny's thresholds, smoothed over the frames; None before the first."""

    low_high: np.ndarray | None = None


def to_grey(image: np.ndarray) -> np.ndarray:
    """8-bit grey (H, W) of a BGR (H, W, 3) or grey image."""
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def gradients(grey: np.ndarray, settings: EdgeSettings) -> tuple[np.ndarray, np.ndarray]:
    """Sobel's derivatives (H, W), int16, by x and by y, of the smoothed image."""
    if settings.blur > 0:
        grey = cv2.GaussianBlur(grey, (0, 0), settings.blur)
    if settings.equalise:
        grey = cv2.equalizeHist(grey)
    return cv2.Sobel(grey, cv2.CV_16S, 1, 0), cv2.Sobel(grey, cv2.CV_16S, 0, 1)


def edge_image(
    dx: np.ndarray, dy: np.ndarray, settings: EdgeSettings, thresholds: Thresholds
) -> np.ndarray:
    """Canny's edges (H, W) uint8, 255 on edges; updates ``thresholds``."""
    # Every third row and column is enough for a percentile.
    sample = np.abs(dx[::3, ::3]).astype(np.float32) + np.abs(dy[::3, ::3])
    now = np.percentile(sample, settings.percentiles)
    now = np.maximum(now, (settings.floor / 2, settings.floor))
    last = thresholds.low_high
    mixed = now if last is None else settings.memory * last + (1 - settings.memory) * now
    thresholds.low_high = mixed
    return cv2.Canny(dx, dy, float(mixed[0]), float(mixed[1]))


def by_direction(edges: np.ndarray, dx: np.ndarray, dy: np.ndarray, channels: int) -> np.ndarray:
    """Sort edges (H, W) by the direction of their normal into (channels, H, W), uint8.

    Channel k takes normals within pi / channels of (k + 1/2) pi / channels: neighbours overlap by
    half, so that no outline falls between two of them.
    """
    if channels == 1:
        return edges[None]
    rows, columns = np.nonzero(edges)
    normal = np.arctan2(dy[rows, columns], dx[rows, columns]) % np.pi
    below = np.floor(normal / np.pi * channels - 0.5).astype(int)
    sorted_edges = np.zeros((channels, *edges.shape), np.uint8)
    own = np.minimum((normal / np.pi * channels).astype(int), channels - 1)
    neighbour = np.where(below == own, own + 1, below) % channels
    sorted_edges[own, rows, columns] = 255
    sorted_edges[neighbour, rows, columns] = 255
    return sorted_edges


def distance_field(edges: np.ndarray, farthest: float = FARTHEST_PX) -> np.ndarray:
    """Distances (H, W), float32, pixels, to the nearest edge, cut off at ``farthest``.

    The distance transform of the inverted edge image, equation (10). Without any edge all is
    ``farthest`` (OpenCV itself answers 3.4e38).
    """
    field = cv2.distanceTransform(cv2.bitwise_not(edges), cv2.DIST_L2, 5)
    return np.minimum(field, np.float32(farthest), out=field)


def distance_fields(
    grey: np.ndarray, settings: EdgeSettings, thresholds: Thresholds, channels: int
) -> tuple[np.ndarray, np.ndarray]:
    """Fields (channels, H, W) of an 8-bit grey crop, pixels of the crop, and its edges (H, W)."""
    dx, dy = gradients(grey, settings)
    edges = edge_image(dx, dy, settings, thresholds)
    fields = [distance_field(channel) for channel in by_direction(edges, dx, dy, channels)]
    return np.stack(fields), edges
