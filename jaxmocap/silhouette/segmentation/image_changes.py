"""Glances: does a camera that stands still show about what it showed before, or something else?

A torn frame, a black one, one of another camera differ from the last good one nearly everywhere;
a person who moves, or other people behind, change a small part of it.

INPUTS: images of C cameras, frame after frame. OUTPUTS: which of them are what they seem.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

# Cells of a glance, width and height; a cell differs by so many grey levels of any colour.
CELLS, DIFFERENT = (40, 30), 25.0


class ImageHistory(NamedTuple):
    """What C cameras showed last, and for how long they have not.

    Attributes:
        thumbnails: of each camera the last image that was believed, in few cells; None before it.
        rejections: frames of each, one after the other, that were not believed.
    """

    thumbnails: tuple[np.ndarray | None, ...]
    rejections: tuple[int, ...]

    @classmethod
    def empty(cls, cameras: int) -> "ImageHistory":
        """Before the first frame."""
        return cls((None,) * cameras, (0,) * cameras)

    def accepted(
        self, images: Sequence[np.ndarray | None], share: float, patience: int
    ) -> tuple[list[np.ndarray | None], "ImageHistory"]:
        """The images that are to be believed, None in place of the others.

        Args:
            images: (H, W, 3) uint8 of each camera, None where there is none.
            share: of its cells in which an image may differ from the last believed one.
            patience: after so many frames a camera is believed again, whatever it shows: somebody
                switched the light on.
        """
        kept, small, refused = [], [], []
        for image, last, count in zip(images, self.thumbnails, self.rejections, strict=True):
            now = None if image is None else thumbnail(image)
            other = now is not None and last is not None and changed_share(last, now) > share
            if other and count < patience:
                kept.append(None)
                small.append(last)
                refused.append(count + 1)
                continue
            kept.append(image)
            small.append(last if now is None else now)
            refused.append(0)
        return kept, ImageHistory(tuple(small), tuple(refused))


def thumbnail(image: np.ndarray) -> np.ndarray:
    """An image (H, W, 3) uint8 in few cells, int16."""
    return cv2.resize(image, CELLS, interpolation=cv2.INTER_AREA).astype(np.int16)


def changed_share(before: np.ndarray, now: np.ndarray) -> float:
    """The share of cells in which two glances differ."""
    return float(np.mean(np.abs(now - before).max(-1) > DIFFERENT))
