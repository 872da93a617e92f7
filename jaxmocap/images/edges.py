"""From an image to the distance fields of its edges (section 5.1, Fig. 4), by OpenCV.

An outline should lie on edges that run its way, so edges are sorted by the direction of their
normal into channels, each with a distance field of its own. One channel is the paper's plain field.

INPUTS: a crop of a video frame, uint8. OUTPUTS: distances to the nearest edge, float32, pixels.
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

# Of a Gaussian of this standard deviation 99 % lie within five pixels.
WIDEST_OF_FIVE = 1.0


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
        farthest: distances are cut off here, pixels of the crop: farther edges are some other
            thing's.
    """

    blur: float = 1.0
    equalise: bool = False
    percentiles: tuple[float, float] = (75.0, 90.0)
    floor: float = 40.0
    memory: float = 0.8
    farthest: float = 20.0


class Thresholds(NamedTuple):
    """Canny's thresholds, smoothed over the frames; None before the first."""

    low_high: np.ndarray | None = None


def to_grey(image: np.ndarray) -> np.ndarray:
    """8-bit grey (H, W) of a BGR (H, W, 3) or grey image."""
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def gradients(grey: np.ndarray, settings: EdgeSettings) -> tuple[np.ndarray, np.ndarray]:
    """Sobel's derivatives (H, W), int16, by x and by y, of the smoothed image."""
    if settings.blur > 0:
        # For 5 x 5 OpenCV has a way of its own, three times as fast as for 7 x 7; equalising would
        # raise what that leaves.
        narrow = settings.blur <= WIDEST_OF_FIVE and not settings.equalise
        grey = cv2.GaussianBlur(grey, (5, 5) if narrow else (0, 0), settings.blur)
    if settings.equalise:
        grey = cv2.equalizeHist(grey)
    dx, dy = cv2.spatialGradient(grey)
    return dx, dy


def edge_image(
    dx: np.ndarray, dy: np.ndarray, settings: EdgeSettings, thresholds: Thresholds
) -> tuple[np.ndarray, Thresholds]:
    """Canny's edges (H, W) uint8, 255 on edges; the thresholds for the next frame."""
    # Every third row and column is enough for a percentile.
    sample = np.abs(dx[::3, ::3]) + np.abs(dy[::3, ::3])
    now = np.array(percentiles(sample.ravel(), settings.percentiles))
    now = np.maximum(now, (settings.floor / 2, settings.floor))
    last = thresholds.low_high
    mixed = now if last is None else settings.memory * last + (1 - settings.memory) * now
    return cv2.Canny(dx, dy, float(mixed[0]), float(mixed[1])), Thresholds(mixed)


def percentiles(values: np.ndarray, percents: tuple[float, ...]) -> list[float]:
    """``np.percentile`` of (N,) values, a tenth of its time: it sorts no more than it must."""
    places = [(len(values) - 1) * percent / 100 for percent in percents]
    below = [min(int(place), max(len(values) - 2, 0)) for place in places]
    ends = [end for low in below for end in (low, min(low + 1, len(values) - 1))]
    ordered = np.partition(values, ends)
    pairs = ordered[ends].astype(float).reshape(-1, 2).tolist()
    return [
        low + (high - low) * (place - at)
        for (low, high), place, at in zip(pairs, places, below, strict=True)
    ]


def by_direction(
    edges: np.ndarray, dx: np.ndarray, dy: np.ndarray, channels: int, spacing: int = 1
) -> np.ndarray:
    """Sort edges (H, W) by the direction of their normal into (channels, H', W'), uint8.

    Channel k takes normals within pi / channels of (k + 1/2) pi / channels: neighbours overlap by
    half, so that no outline falls between two of them. A sample of the result stands for
    ``spacing`` x ``spacing`` pixels and is an edge where one of them is.
    """
    rows, columns = (-(-side // spacing) for side in edges.shape)
    sorted_edges = np.zeros((channels, rows * columns), np.uint8)
    points = cv2.findNonZero(edges)
    if points is not None:
        x, y = points.reshape(-1, 2).T
        sample, pixel = y // spacing * columns + x // spacing, y * edges.shape[1] + x
        normal_x, normal_y = (part.ravel()[pixel].astype(np.float32) for part in (dx, dy))
        # Even and odd halves of a channel's own share lie towards its two neighbours.
        turned = cv2.phase(normal_x, normal_y).ravel() * np.float32(2 * channels / np.pi)
        halves = turned.astype(np.int32)
        own, odd = halves // 2, halves % 2
        sorted_edges[own % channels, sample] = 255
        sorted_edges[(own + 2 * odd - 1) % channels, sample] = 255
    return sorted_edges.reshape(channels, rows, columns)


def distance_field(
    edges: np.ndarray, farthest: float = EdgeSettings.farthest, out: np.ndarray | None = None
) -> np.ndarray:
    """Distances (H, W), float32, pixels, to the nearest edge, cut off at ``farthest``.

    The distance transform of the inverted edge image, equation (10). Without any edge all is
    ``farthest`` (OpenCV itself answers 3.4e38).
    """
    field = cv2.distanceTransform(cv2.bitwise_not(edges), cv2.DIST_L2, 5, dst=out)
    return np.minimum(field, np.float32(farthest), out=field)


def distance_fields(
    grey: np.ndarray,
    settings: EdgeSettings,
    thresholds: Thresholds,
    channels: int,
    spacing: int = 1,
    out: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, Thresholds]:
    """Distance fields of an 8-bit grey crop (H, W).

    Args:
        grey: the crop.
        settings: how edges are found.
        thresholds: of this region, after the last frame.
        channels: directions.
        spacing: pixels of the crop per sample of the fields.
        out: (channels, H / spacing, W / spacing) float32 to write the fields to.

    Returns:
        The fields, in samples of theirs, cut off at ``farthest``; the crop's
        edges (H, W); the thresholds for the next frame.
    """
    dx, dy = gradients(grey, settings)
    edges, after = edge_image(dx, dy, settings, thresholds)
    channel_edges = by_direction(edges, dx, dy, channels, spacing)
    fields = np.empty(channel_edges.shape, np.float32) if out is None else out
    for channel, field in zip(channel_edges, fields, strict=True):
        distance_field(channel, settings.farthest / spacing, field)
    return fields, edges, after
