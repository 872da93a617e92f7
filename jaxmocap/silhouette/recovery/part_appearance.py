"""The appearance of parts of the body: is that still a forearm, or something before it?

A level set takes a box before an arm for the arm; but for its colour. Each camera's mean
chromaticity of each part is remembered, and its variance; a part that half of the cameras show in
another colour is hidden. Brightness, which changes with every turn of an arm, is ignored.

INPUTS: images, the pixels of points on parts of the body. OUTPUTS: which parts look otherwise.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxmocap.silhouette.recovery.chromaticity import DARKEST, pixels_within

# A part has another colour where it is so many deviations from its mean,
DEVIATIONS = 4.0
# and so much of all three colours.
SHARE = 0.03
# Weight of a new frame in mean and variance, at least.
GAIN = 0.1
# Frames before a mean counts.
YOUNGEST = 5
# Visible points that make a mean.
LEAST_POINTS = 8
# After so many frames a part has changed its colour for good: somebody put on a coat.
LONGEST = 90


class PartAppearance(NamedTuple):
    """Chromaticities of P parts in C cameras."""

    mean: np.ndarray  # (P, C, 3) shares of blue, green and red, together 1
    variance: np.ndarray  # (P, C) about it
    frames: np.ndarray  # (P, C) that it was learned from
    strange_frames: np.ndarray  # (P,) one after the other, in which the part looked otherwise

    @classmethod
    def empty(cls, parts: int, cameras: int) -> "PartAppearance":
        """Before the first frame."""
        zeros = np.zeros((parts, cameras))
        return cls(np.zeros((parts, cameras, 3)), zeros, zeros.astype(int), np.zeros(parts, int))

    def compare(
        self, images: Sequence[np.ndarray | None], pixels_xy: np.ndarray, parts: np.ndarray
    ) -> tuple[np.ndarray, "PartAppearance"]:
        """Which parts (P,) look otherwise, and the memory after.

        By images (H, W, 3) uint8, None where one shows nothing of use, pixels (C, N, 2) of points
        of the body, and which of these are on which part (P, N).
        """
        now = np.stack([
            mean_chromaticities(image, at, parts)
            for image, at in zip(images, pixels_xy, strict=True)
        ], 1)  # fmt: skip
        there = np.isfinite(now[..., 0])
        off = np.where(there, np.abs(now - self.mean).max(-1), 0.0)
        is_learned = there & (self.frames >= YOUNGEST)
        strange = is_learned & (off > SHARE + DEVIATIONS * np.sqrt(self.variance))
        other = strange.any(1) & (2 * strange.sum(1) >= is_learned.sum(1))
        lasting = np.where(other, self.strange_frames + 1, 0)
        learn = there & (~strange | (lasting > LONGEST)[:, None])
        gain = np.where(learn, np.maximum(GAIN, 1 / (self.frames + 1)), 0.0)
        step = np.where(there[..., None], now - self.mean, 0.0)
        mean = self.mean + gain[..., None] * step
        # Nothing deviates from the first frame.
        squares = np.where(self.frames > 0, off**2, 0.0)
        variance = self.variance + gain * (squares - self.variance)
        after = PartAppearance(mean, variance, self.frames + learn, lasting)
        return other & (lasting <= LONGEST), after


def mean_chromaticities(
    image: np.ndarray | None, pixels_xy: np.ndarray, parts: np.ndarray
) -> np.ndarray:
    """(P, 3) of the parts' points within an image; NaN of a part with few of them, or none."""
    means = np.full((len(parts), 3), np.nan)
    if image is None:
        return means
    x, y, within = pixels_within(image, pixels_xy)
    for number, on in enumerate(parts & within):
        if on.sum() >= LEAST_POINTS:
            colour = image[y[on], x[on]].mean(0)
            means[number] = colour / colour.sum() if colour.sum() > DARKEST else np.nan
    return means
