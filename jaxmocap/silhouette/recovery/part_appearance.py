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
from jaxmocap.silhouette.recovery.settings import PartAppearanceSettings


class PartAppearance(NamedTuple):
    """Chromaticities of P parts in C cameras.

    Attributes:
        mean: (P, C, 3) shares of blue, green and red, together 1.
        variance: (P, C) about it.
        frames: (P, C) that it was learned from.
        strange_frames: (P,) one after the other, in which the part looked otherwise.
    """

    mean: np.ndarray
    variance: np.ndarray
    frames: np.ndarray
    strange_frames: np.ndarray

    @classmethod
    def empty(cls, parts: int, cameras: int) -> "PartAppearance":
        """Before the first frame."""
        zeros = np.zeros((parts, cameras))
        return cls(np.zeros((parts, cameras, 3)), zeros, zeros.astype(int), np.zeros(parts, int))

    def compared(
        self,
        images: Sequence[np.ndarray | None],
        pixels_xy: np.ndarray,
        parts: np.ndarray,
        settings: PartAppearanceSettings,
    ) -> tuple[np.ndarray, "PartAppearance"]:
        """Which parts (P,) look otherwise, and the memory after.

        Args:
            images: (H, W, 3) uint8 of each camera, None where it shows nothing of use.
            pixels_xy: (C, N, 2) of points of the body.
            parts: (P, N) bool: which points are on which part.
            settings: thresholds.
        """
        now = np.stack([
            mean_chromaticities(image, at, parts, settings.least_points)
            for image, at in zip(images, pixels_xy, strict=True)
        ], 1)  # fmt: skip
        there = np.isfinite(now[..., 0])
        off = np.where(there, np.abs(now - self.mean).max(-1), 0.0)
        is_learned = there & (self.frames >= settings.youngest)
        strange = is_learned & (off > settings.share + settings.deviations * np.sqrt(self.variance))
        other = strange.any(1) & (2 * strange.sum(1) >= is_learned.sum(1))
        lasting = np.where(other, self.strange_frames + 1, 0)
        learn = there & (~strange | (lasting > settings.longest)[:, None])
        gain = np.where(learn, np.maximum(settings.gain, 1 / (self.frames + 1)), 0.0)
        step = np.where(there[..., None], now - self.mean, 0.0)
        mean = self.mean + gain[..., None] * step
        # Nothing deviates from the first frame.
        squares = np.where(self.frames > 0, off**2, 0.0)
        variance = self.variance + gain * (squares - self.variance)
        after = PartAppearance(mean, variance, self.frames + learn, lasting)
        return other & (lasting <= settings.longest), after


def mean_chromaticities(
    image: np.ndarray | None, pixels_xy: np.ndarray, parts: np.ndarray, least_points: int
) -> np.ndarray:
    """(P, 3) of the parts' points within an image; NaN of a part with few of them, or none."""
    means = np.full((len(parts), 3), np.nan)
    if image is None:
        return means
    x, y, within = pixels_within(image, pixels_xy)
    for number, on in enumerate(parts & within):
        if on.sum() >= least_points:
            colour = image[y[on], x[on]].mean(0)
            means[number] = colour / colour.sum() if colour.sum() > DARKEST else np.nan
    return means
