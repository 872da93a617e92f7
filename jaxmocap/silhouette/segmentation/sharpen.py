"""Sharpening: a silhouette's end to a pixel, from one that is some pixels off.

Cells of a level set are larger than pixels, and a histogram against a sharp background takes
every pixel for the person that is not quite background. Here each pixel next to the contour is
estimated by how much the person covers it: its colour lies between those of both close by.

INPUTS: an image uint8, Φ on a canvas, a Background. OUTPUTS: a mask of the image's own pixels, of a
few of them at a time where the person is large; Φ of it on the canvas again.
"""

from typing import NamedTuple

import cv2
import numpy as np

from jaxmocap.images.background_model import Background
from jaxmocap.images.canvases import full_mask, resample_values, silhouette_distance
from jaxmocap.images.regions import Region

# Pixels from the contour to where a side's colours are its own.
DEPTH_PX = 1
# Round by round, how many pixels the contour may move inwards and outwards: the first has to find
# the limbs' ends, the second starts next to them.
ROUNDS = ((2, 5), (2, 2))
# Window over which each side's colours, and the light on the background, are averaged, pixels.
BESIDE_PX = 7
# Window over which the contour is smoothed where colours do not separate the sides, pixels.
SMOOTH_PX = 11
# Light on the background may fall to, or rise to, so much of the model's.
DIMMEST = 0.5
BRIGHTEST = 1.3
# Brightness, and two chromaticities, by blue, green, red and 1. Videos hold chromaticities at half
# the resolution, blurred over a silhouette's edge: they count for less.
BLURRED = 0.6
CHANNELS = np.array([
    [0.114, 0.587, 0.299, 0],
    [BLURRED * 0.5, BLURRED * -0.331, BLURRED * -0.169, 128],
    [BLURRED * -0.081, BLURRED * -0.419, BLURRED * 0.5, 128],
], np.float32)  # fmt: skip
BLACK = np.array([0, 128, 128, 255], np.float32)
ALL_CHANNELS = np.ones(4, np.float32)
# Squared difference of two images of the same place by their noise, of those channels.
SQUARED_NOISE = 40.0
# A pixel is the person's from this share on: bodies are darker at their rim than the mean beside.
COVERED_SHARE = 0.4
# Contrast of the two sides, squared levels, at which their decision counts by half.
HALF_CONTRAST = 150.0
# Deviation of the blur over the decision, pixels.
SOFTNESS_PX = 0.7
# Pixels around the silhouette that are examined.
MARGIN_PX = 16
# Pixels to a cell of the canvas that suffice.
FINE = 2.0


class SilhouettePatch(NamedTuple):
    """A part of an image, maybe shrunk."""

    mask: np.ndarray  # (h, w) bool, where the person is
    region: Region  # its pixels in the image's: the corner, and how many of the image one has

    def phi(self, region: Region, size: int) -> np.ndarray:
        """Φ (S, S) float32 on a canvas: cells from the mask's border, positive within."""
        step = np.float32(self.region.scale)
        here = Region((region.origin - self.region.origin) / step - 0.5, region.scale / step)
        distance = resample_values(_distance(self.mask), here, size)
        return distance / np.float32(here.scale)


def sharpen_silhouette(
    image: np.ndarray, phi: np.ndarray, region: Region, background: Background | None = None
) -> SilhouettePatch:
    """The silhouette to a pixel in an image (H, W, 3), BGR uint8, by Φ (S, S) on a canvas.

    Without a background, by what is visible beside the person.
    """
    step = max(1, min(int(float(region.scale) / FINE), *image.shape[:2]))
    rows, columns = _box(phi > 0, region, image.shape[:2], step)
    corner = np.array([columns.start, rows.start], np.float32)
    there = Region(np.asarray(region.origin) - corner, region.scale)
    before = full_mask(phi, there, (rows.stop - rows.start, columns.stop - columns.start))
    channels = _channels(_shrunk(image[rows, columns], step))
    behind = None
    if background is not None:
        colour, certainty = background.colour[rows, columns], background.certainty[rows, columns]
        behind = _channels(cv2.convertScaleAbs(_shrunk(colour, step))), _shrunk(certainty, step)
    mask = _shrunk(255 * before.astype(np.uint8), step) > 127
    for inwards, outwards in ROUNDS:
        mask = _move_border(channels, mask, behind, inwards, outwards)
    return SilhouettePatch(mask, Region(corner - np.float32(0.5), np.array(step, np.float32)))


def _channels(image: np.ndarray) -> np.ndarray:
    """(h, w, 4) uint8: ``CHANNELS``, and 255, which a mask takes away."""
    return cv2.cvtColor(cv2.transform(image, CHANNELS), cv2.COLOR_BGR2BGRA)


def _move_border(
    channels: np.ndarray,
    mask: np.ndarray,
    background: tuple[np.ndarray, np.ndarray] | None,
    inwards: int,
    outwards: int,
) -> np.ndarray:
    """The mask (h, w) after its border has moved by the pixels (h, w, 4) uint8 next to it.

    How much of a pixel is the person's follows from how far its colour lies from the background's:
    where that was learned, in any direction, for a body has more colours than their mean beside;
    else along the way to the person's, for a background has more than one as well.
    """
    filled = mask.astype(np.uint8)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * DEPTH_PX + 1,) * 2)
    inner, outer = cv2.erode(filled, disc), 1 - cv2.dilate(filled, disc)
    out, within = (np.ones((2 * px + 1,) * 2, np.uint8) for px in (outwards, inwards))
    near = cv2.dilate(filled, out) - cv2.erode(filled, within)
    at = np.flatnonzero(near.view(bool))
    (person, sure), (other, free) = (_beside(channels, side, at) for side in (inner, outer))
    certainty = np.zeros(len(at), np.float32)
    if background is not None:
        certainty = _take_pixels(background[1], at)
        (lit, _), colour = (
            _beside(background[0], outer, at),
            _take_pixels(background[0], at) - BLACK,
        )
        light = np.clip(other[:, 0] / np.maximum(lit[:, 0], 1.0), DIMMEST, BRIGHTEST)
        behind = BLACK + np.where(free, light, np.float32(1))[:, None] * colour
        other += certainty[:, None] * (behind - other)
        free = free | (certainty > 0.5)
    apart, away = person - other, _take_pixels(channels, at) - other
    contrast, off = apart**2 @ ALL_CHANNELS, away**2 @ ALL_CHANNELS
    along = (apart * away) @ ALL_CHANNELS / np.maximum(contrast, 1.0)
    far = np.sqrt(np.maximum(off - SQUARED_NOISE, 0) / np.maximum(contrast, 1.0))
    covered = along + certainty * (far - along)
    weight = contrast / (contrast + HALF_CONTRAST) * (sure & free)
    before = _take_pixels(cv2.blur(255 * filled, (SMOOTH_PX, SMOOTH_PX)), at)
    share = 255 * np.clip(covered - COVERED_SHARE + 0.5, 0, 1)
    decided = 255 * filled
    decided.ravel()[at] = np.rint(before + weight * (share - before))
    return cv2.GaussianBlur(decided, (0, 0), SOFTNESS_PX) > 127


def _beside(
    channels: np.ndarray, side: np.ndarray, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean channels (N, 4) of a side (h, w) about some pixels, and whether any of it is there."""
    one_side = cv2.bitwise_and(channels, channels, mask=side)
    sums = cv2.boxFilter(one_side, cv2.CV_16U, (BESIDE_PX, BESIDE_PX), normalize=False)
    chosen = _take_pixels(sums, at)
    weight = chosen[:, 3:]
    return chosen * (255 / np.maximum(weight, 1.0)), weight[:, 0] > 0


def _take_pixels(image: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Some pixels of an image (h, w) or (h, w, 4), as float32 (N) or (N, 4)."""
    if image.ndim == 2:
        return image.ravel()[at].astype(np.float32)
    # Four channels are picked as one number, many times as fast.
    packed = image.view(f"u{4 * image.itemsize}").ravel()[at]
    return packed.view(image.dtype).reshape(-1, 4).astype(np.float32)


def _box(
    within: np.ndarray, region: Region, shape: tuple[int, ...], step: int
) -> tuple[slice, slice]:
    """Rows and columns of an image about what a canvas (S, S) shows, filled multiples of ``step``.

    One of them, where that is nothing or wholly outside.
    """
    slices = []
    for axis, size in ((1, shape[0]), (0, shape[1])):
        some = np.flatnonzero(within.any(axis))
        cells = np.array([some[0], some[-1] + 1] if len(some) else [0, 0])
        edges = region.origin[axis] + 0.5 + region.scale * cells
        low, high = np.rint(edges).astype(int) + np.array([-1, 1]) * MARGIN_PX * step
        low = int(np.clip(low, 0, size - step))
        count = max(1, (min(int(high), size) - low) // step)
        slices.append(slice(low, low + count * step))
    return slices[0], slices[1]


def _shrunk(image: np.ndarray, step: int) -> np.ndarray:
    """Means of ``step`` by ``step`` pixels."""
    if step == 1:
        return image
    size = (image.shape[1] // step, image.shape[0] // step)
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def _distance(mask: np.ndarray) -> np.ndarray:
    """``silhouette_distance`` (h, w), slightly smoothed."""
    return cv2.GaussianBlur(silhouette_distance(mask, 3), (0, 0), SOFTNESS_PX)
