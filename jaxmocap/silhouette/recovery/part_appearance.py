"""What parts of the body look like: is that still a forearm, or something before it?

A level set takes a box before an arm for the arm; but for its colour. Each camera's mean hue of
each part is remembered, and how much it varies; a part that half of the cameras show in another hue
is not seen. Brightness, which changes with every turn of an arm, tells nothing.

INPUTS: images, the pixels of points on parts of the body. OUTPUTS: which parts look otherwise.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

# Another hue differs by so many deviations, and by this share of all three colours; what is darker
# than this, grey levels of all three, has none.
DEVIATIONS, SHARE, DARKEST = 4.0, 0.03, 60.0
# Weight of a new frame in the memory; frames before it says anything; points to a colour at least.
NEWEST, YOUNG, FEWEST = 0.1, 5, 8
# After so many frames a part has changed its hue for good: somebody put on a coat.
LONGEST = 90


class PartAppearance(NamedTuple):
    """Hues of P parts in C cameras.

    Attributes:
        mean: (P, C, 3) shares of blue, green and red, together 1.
        variance: (P, C) about it.
        frames: (P, C) frames that it was learned from.
        strange_frames: (P,) frames, one after the other, in which the part looked otherwise.
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
        self, images: Sequence[np.ndarray | None], pixels_xy: np.ndarray, parts: np.ndarray
    ) -> tuple[np.ndarray, "PartAppearance"]:
        """Which parts (P,) look otherwise, and the memory after.

        Args:
            images: (H, W, 3) uint8 of each camera, None where it shows nothing of use.
            pixels_xy: (C, N, 2) of points of the body.
            parts: (P, N) bool: which points are on which part.
        """
        seen = np.stack([
            mean_chromaticities(image, at, parts) for image, at in zip(images, pixels_xy, strict=True)
        ], 1)  # fmt: skip
        there = np.isfinite(seen[..., 0])
        off = np.where(there, np.abs(seen - self.mean).max(-1), 0.0)
        known = there & (self.frames >= YOUNG)
        strange = known & (off > SHARE + DEVIATIONS * np.sqrt(self.variance))
        other = strange.any(1) & (2 * strange.sum(1) >= known.sum(1))
        lasting = np.where(other, self.strange_frames + 1, 0)
        learn = there & (~strange | (lasting > LONGEST)[:, None])
        weight = np.where(learn, np.maximum(NEWEST, 1 / (self.frames + 1)), 0.0)
        step = np.where(there[..., None], seen - self.mean, 0.0)
        mean = self.mean + weight[..., None] * step
        # Nothing deviates from the first frame.
        spread = np.where(self.frames > 0, off**2, 0.0)
        variance = self.variance + weight * (spread - self.variance)
        after = PartAppearance(mean, variance, self.frames + learn, lasting)
        return other & (lasting <= LONGEST), after


def mean_chromaticities(
    image: np.ndarray | None, pixels_xy: np.ndarray, parts: np.ndarray
) -> np.ndarray:
    """(P, 3) of the parts' points within an image; NaN of a part with few of them, or none."""
    found = np.full((len(parts), 3), np.nan)
    if image is None:
        return found
    x, y = np.rint(np.nan_to_num(pixels_xy, nan=-1.0)).astype(int).T
    within = (x >= 0) & (y >= 0) & (x < image.shape[1]) & (y < image.shape[0])
    for number, on in enumerate(parts & within):
        if on.sum() >= FEWEST:
            colour = image[y[on], x[on]].mean(0)
            found[number] = colour / colour.sum() if colour.sum() > DARKEST else np.nan
    return found
