"""Several pictures of one thing as one: sampled, of one brightness, blended, holes closed.

INPUTS: colours that pictures show at the same places, and how much each counts there.
OUTPUTS: one picture.
"""

from collections.abc import Sequence

import cv2
import numpy as np

# Only what counts more than this share of the best counts at all: fewer ghosts.
LEAST_SHARE = 0.5
# What counts less than this counts nothing.
FAINT = 1e-3
# Darker than this a channel's ratio to another is not used, grey levels.
DARKEST = 8.0
# Holes are filled from aside rather than from above and below, by this factor: collars, sleeves and
# belts run around a body.
ASIDE = 6


def sampled_colours(image: np.ndarray, pixels_xy: np.ndarray, step: float) -> np.ndarray:
    """(K, C) float32 values of an image (H, W, C) or (H, W) at (K, 2) pixels, ``step`` apart."""
    smooth = image
    if step > 1.5:
        smooth = cv2.GaussianBlur(image, (0, 0), step / 3)
    # OpenCV's images have at most 2**15 columns and rows.
    width = 8192
    padded = np.zeros((-(-len(pixels_xy) // width) * width, 2), np.float32)
    padded[: len(pixels_xy)] = pixels_xy
    there = padded.reshape(-1, width, 2)
    sampled = cv2.remap(smooth, there, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)  # type: ignore[call-overload]
    channels = 1 if image.ndim == 2 else image.shape[2]
    return sampled.reshape(-1, channels)[: len(pixels_xy)].astype(np.float32)


def gains(
    colours: Sequence[np.ndarray], weights: Sequence[np.ndarray], backdrops: np.ndarray
) -> np.ndarray:
    """(P, 3) factors that bring P pictures to the first one's exposure and white balance.

    By the backdrop, where it is the same: where that makes colours of places agree which both
    pictures show. By these alone it could not be separated from light that comes from one side.

    Each picture's colours (K, 3) and the backdrops' (P, 3) are grey levels; weights (K,) are 0
    where a picture does not show the place.
    """
    factors = [np.ones(3)]
    for colour, weight, backdrop in zip(colours[1:], weights[1:], backdrops[1:], strict=True):
        both = (np.minimum(weights[0], weight) > FAINT) & (
            np.minimum(colours[0], colour).min(1) > DARKEST
        )
        by_backdrop = np.maximum(backdrops[0], DARKEST) / np.maximum(backdrop, DARKEST)
        off = np.median(np.log(colours[0][both] / colour[both]), 0) if both.any() else np.zeros(3)
        better = np.abs(off - np.log(by_backdrop)).sum() < np.abs(off).sum()
        factors.append(by_backdrop if better else np.ones(3))
    return np.array(factors)


def blend_colours(
    colours: Sequence[np.ndarray], weights: Sequence[np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """The linear blend (..., 3) of P colours (..., 3) by weights (...), and the largest weight."""
    best = np.maximum(np.max(weights, 0), 1e-9)
    shares = [np.maximum(w / best - LEAST_SHARE, 0) for w in weights]
    total = np.sum(shares, 0)
    blend = np.sum([s[..., None] * c for s, c in zip(shares, colours, strict=True)], 0)
    return blend / np.maximum(total, 1e-9)[..., None], np.where(best > FAINT, best, 0)


def wide_blend(colours: Sequence[np.ndarray], weights: Sequence[np.ndarray]) -> np.ndarray:
    """(..., 3) logarithms of colours, blended linearly over all that several pictures show."""
    total = np.maximum(np.sum(weights, 0), 1e-9)
    parts = zip(colours, weights, strict=True)
    return np.sum([(w / total)[..., None] * np.log(np.maximum(c, 1)) for c, w in parts], 0)


def weighted_blur(values: np.ndarray, weight: np.ndarray, width: float) -> np.ndarray:
    """(H, W, 3) weighted means of values about each place, by a Gaussian of so many cells."""
    both = np.concatenate([values * weight[..., None], weight[..., None]], -1).astype(np.float32)
    blurred = cv2.GaussianBlur(both, (0, 0), width)
    return blurred[..., :3] / np.maximum(blurred[..., 3:], 1e-6)


def close_holes(picture: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """A picture (H, W, 3) float32 that closes around, its unknown places filled from those about.

    By a pyramid: the coarser picture's colours, in which holes are small.
    """
    height, width = valid.shape
    if valid.all() or not valid.any():
        return picture.astype(np.float32)
    # A half of a period on either side, so that left and right are neighbours.
    half = width // 2
    wide = [(0, 0), (half, half)]
    there = np.pad(valid, wide, mode="wrap").astype(np.float32)
    colour = np.pad(picture.astype(np.float32), [*wide, (0, 0)], mode="wrap") * there[..., None]
    narrow = max((width + 2 * half) // ASIDE, 1), height
    small, coarse_weight = (
        cv2.resize(p, narrow, interpolation=cv2.INTER_AREA) for p in (colour, there)
    )
    filled = cv2.resize(_pull_colours(small, coarse_weight), (width + 2 * half, height))
    return np.where(valid[..., None], picture, filled[:, half : half + width]).astype(np.float32)


def _pull_colours(colour: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Colours times weights (H, W, 3), weights (H, W) -> colours everywhere."""
    own = colour / np.maximum(weight, 1e-6)[..., None]
    if min(weight.shape) < 2:
        mean = colour.sum((0, 1)) / max(float(weight.sum()), 1e-6)
        return np.where(weight[..., None] > 0, own, mean).astype(np.float32)
    # The coarser picture's weights, where there are any, count fully: means, not shades.
    small, coarse_weight = cv2.pyrDown(colour), cv2.pyrDown(weight)
    full = np.minimum(1.0, 4 * coarse_weight)
    small = small * (full / np.maximum(coarse_weight, 1e-6))[..., None]
    coarse = cv2.pyrUp(_pull_colours(small, full), dstsize=weight.shape[::-1])
    part = np.minimum(weight, 1)[..., None]
    return part * own + (1 - part) * coarse


def feathered_weight(hidden: np.ndarray, width: float) -> np.ndarray:
    """(H, W) from 0 where hidden to 1 at ``width`` cells from there."""
    distance = cv2.distanceTransform((~hidden).astype(np.uint8), cv2.DIST_L2, 3)
    return np.minimum(distance / width, 1).astype(np.float32)


def background_colour(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(3,) middle colour of what an image (H, W, 3) shows well beside a mask (H, W)."""
    near = cv2.dilate(mask.astype(np.uint8), np.ones((15, 15), np.uint8))
    return np.ones(3) if near.all() else np.median(image[near == 0], 0)
