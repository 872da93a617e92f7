"""From an image to the distance fields of its edges (section 5.1, Fig. 4), by OpenCV.

An outline should lie on edges that run its way, so edges are sorted by the direction of their
normal into channels, each with a distance field of its own. One channel is the paper's plain field.

INPUTS: a crop of a video frame, uint8. OUTPUTS: distances to the nearest edge, float32, pixels.
"""

from typing import Literal, NamedTuple

import cv2
import numpy as np

from jaxmocap.compilation.settings import settings, static

# Of a Gaussian of this standard deviation 99 % lie within five pixels.
WIDEST_OF_FIVE = 1.0
LEVELS = 256


@settings
class EdgeSettings:
    """How edges are found."""

    blur: float = static(1.0, "standard deviation of the Gaussian low-pass, pixels", (0, 20))
    equalise: Literal["none", "region", "image"] = static(
        "none",
        "whose histogram is equalised; a region flickers as it moves, and where it shows a bare "
        "wall its noise is raised",
    )
    blur_first: bool = static(
        True, "the low-pass comes before the equalising, as in the paper; else after it"
    )
    canny: Literal["percentiles", "thresholds"] = static(
        "percentiles", "Canny's two thresholds: by the region's gradients, or the same in all"
    )
    percentiles: tuple[float, float] = static(
        (75.0, 90.0), "of the gradient's magnitude in the region, low and high", (0, 100)
    )
    thresholds: tuple[float, float] = static(
        (50.0, 150.0), "low and high, L1 gradient of 8-bit grey", (0, 2040)
    )
    floor: float = static(
        40.0, "least high threshold by percentiles: below it lies the sensor's noise", (0, 2040)
    )
    memory: float = static(
        0.8,
        "share of the last frame's percentiles and levels of grey in the present ones; 1 keeps "
        "those of the first frame",
        (0, 1),
    )
    farthest: float = static(
        20.0,
        "distances are cut off here, pixels of the region: farther edges are some other thing's",
        (1, 1000),
    )


class Thresholds(NamedTuple):
    """What the next frame begins with; None before the first."""

    low_high: np.ndarray | None = None  # (2,) Canny's thresholds by percentiles
    levels: np.ndarray | None = None  # (256,) that equalise the histogram, by grey


class Edges(NamedTuple):
    """Canny's edges (H, W), uint8, 255 on edges, and Sobel's derivatives (H, W), int16, there."""

    image: np.ndarray
    dx: np.ndarray
    dy: np.ndarray


def to_grey(image: np.ndarray) -> np.ndarray:
    """8-bit grey (H, W) of a BGR (H, W, 3) or grey image."""
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def equalise_levels(
    grey: np.ndarray, settings: EdgeSettings, before: Thresholds
) -> tuple[np.ndarray, Thresholds]:
    """An image of equal shares of all grey levels (H, W), and what the next frame begins with."""
    if settings.blur_first and settings.blur > 0:
        # The narrow kernel leaves what equalising would raise.
        grey = cv2.GaussianBlur(grey, (0, 0), settings.blur)
    below = np.cumsum(np.bincount(grey.ravel(), minlength=LEVELS))
    first, last = below[int(grey.min())], below[-1]
    levels = np.arange(LEVELS, dtype=float)
    if last > first:
        levels = np.maximum(below - first, 0) * ((LEVELS - 1) / (last - first))
    if before.levels is not None:
        levels = _mix_levels(settings, before.levels, levels)
    return cv2.LUT(grey, np.rint(levels).astype(np.uint8)), before._replace(levels=levels)


def find_edges(
    grey: np.ndarray, settings: EdgeSettings, before: Thresholds
) -> tuple[Edges, Thresholds]:
    """Canny's edges of a region.

    Args:
        grey: (H, W) uint8, of an image that is equalised where the settings say so.
        settings: how edges are found.
        before: of this region, after the last frame.
    """
    if settings.equalise == "region":
        grey, before = equalise_levels(grey, settings, before)
    if settings.blur > 0 and (settings.equalise == "none" or not settings.blur_first):
        # For 5 x 5 OpenCV has a way of its own, three times as fast as for 7 x 7.
        size = (5, 5) if settings.blur <= WIDEST_OF_FIVE else (0, 0)
        grey = cv2.GaussianBlur(grey, size, settings.blur)
    dx, dy = cv2.spatialGradient(grey)
    if settings.canny == "thresholds":
        return Edges(cv2.Canny(dx, dy, *settings.thresholds), dx, dy), before
    # Every third row and column is enough for a percentile.
    sample = np.abs(dx[::3, ::3]) + np.abs(dy[::3, ::3])
    low_high = np.array(percentiles(sample.ravel(), settings.percentiles))
    low_high = np.maximum(low_high, (settings.floor / 2, settings.floor))
    if before.low_high is not None:
        low_high = _mix_levels(settings, before.low_high, low_high)
    edges = cv2.Canny(dx, dy, float(low_high[0]), float(low_high[1]))
    return Edges(edges, dx, dy), before._replace(low_high=low_high)


def _mix_levels(settings: EdgeSettings, last: np.ndarray, now: np.ndarray) -> np.ndarray:
    return settings.memory * last + (1 - settings.memory) * now


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
    edges, after = find_edges(grey, settings, thresholds)
    channel_edges = by_direction(*edges, channels, spacing)
    fields = np.empty(channel_edges.shape, np.float32) if out is None else out
    for channel, field in zip(channel_edges, fields, strict=True):
        distance_field(channel, settings.farthest / spacing, field)
    return fields, edges.image, after
