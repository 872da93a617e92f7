"""Does a camera that stands still show about what it showed before, or something else?

A torn frame, a black one, one of another camera differ from the last good one nearly everywhere;
a person who moves, or other people behind, change a thumbnails part of it.

INPUTS: images of C cameras, frame after frame. OUTPUTS: those that are to be used.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

# Size of a thumbnail: columns and rows;
THUMBNAIL_SIZE = (40, 30)
# and pixels of a cell, from side to side, that are averaged.
PIXELS_ACROSS = 4
# Its cells differ from so many grey levels of any colour on.
DIFFERENT_LEVELS = 25.0


class ImageHistory(NamedTuple):
    """What C cameras showed last."""

    # Of each camera, of the last image that was accepted; None before it.
    thumbnails: tuple[np.ndarray | None, ...]
    rejections: tuple[int, ...]  # frames of each, one after the other, that were rejected

    @classmethod
    def empty(cls, cameras: int) -> "ImageHistory":
        """Before the first frame."""
        return cls((None,) * cameras, (0,) * cameras)

    def accept(
        self, images: Sequence[np.ndarray | None], share: float, patience: int
    ) -> tuple[list[np.ndarray | None], "ImageHistory"]:
        """The images (H, W, 3) uint8 that are to be used, None in place of the others.

        One may differ from the last accepted one in a ``share`` of its cells. After ``patience``
        rejections a camera is accepted again, whatever it shows: somebody switched the light on.
        An image of one colour, such as a black one, shows nobody and is never used.
        """
        kept, thumbnails, rejections = [], [], []
        for image, last, count in zip(images, self.thumbnails, self.rejections, strict=True):
            if image is None:
                # At other cameras' instants a slower one shows nothing, and waits no longer for it.
                kept.append(None)
                thumbnails.append(last)
                rejections.append(count)
                continue
            now = thumbnail(image)
            plain = np.ptp(now, (0, 1)).max() < DIFFERENT_LEVELS
            other = last is not None and changed_share(last, now) > share
            is_rejected = plain or (other and count < patience)
            kept.append(None if is_rejected else image)
            thumbnails.append(last if is_rejected else now)
            rejections.append(count + 1 if is_rejected else 0)
        return kept, ImageHistory(tuple(thumbnails), tuple(rejections))


def thumbnail(image: np.ndarray) -> np.ndarray:
    """An image (H, W, 3) uint8 in few cells (30, 40, 3), int16."""
    across = min(image.shape[0] // THUMBNAIL_SIZE[1], image.shape[1] // THUMBNAIL_SIZE[0])
    every = max(1, across // PIXELS_ACROSS)
    image = image[::every, ::every]
    return cv2.resize(image, THUMBNAIL_SIZE, interpolation=cv2.INTER_AREA).astype(np.int16)


def changed_share(before: np.ndarray, now: np.ndarray) -> float:
    """The share of cells in which two thumbnails differ."""
    return float(np.mean(np.abs(now - before).max(-1) > DIFFERENT_LEVELS))
