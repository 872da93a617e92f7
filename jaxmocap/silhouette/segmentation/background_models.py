"""What a camera shows of a room, by a picture, or learned while a person is followed through it.

What the body covers where it was found is no room, even where the level set denies it: a hand that
stands on the floor all the time is else learned as floor once it has been missed. Nor is what was
segmented beside the body, which may be a limb that was lost.

INPUTS: a picture of the empty room; or frames, and for each where the person is, as level sets on
canvases and as the body's points. OUTPUTS: a Background.
"""

import cv2
import numpy as np

from jaxmocap.images.background_model import (
    MOST_FRAMES,
    Background,
    RunningBackground,
    learn_background,
)
from jaxmocap.images.canvases import full_mask
from jaxmocap.images.foreground import shrink
from jaxmocap.images.regions import Region
from jaxmocap.silhouette.segmentation.canvas_coverage import covered_cells

# Rows at which a room is learned, and at which it is as the frames go by.
ROWS, RUNNING_ROWS = 720, 480
# Cells about the person that count as the person; and about the body as the frames go by, when the
# first poses are hardly known, nor the person's shape.
AROUND, FARTHER = 2, 6
# Of what a pixel shows of the room so much is darker: a person's shadow is seen for a while.
LIT = 0.7
# Deviation of a frame from a picture of the same room, grey levels: that of two frames.
PICTURE_NOISE = 4.0


def background_of_picture(picture: np.ndarray) -> Background:
    """The room by one picture (H, W, 3) uint8 without the person."""
    ones = np.ones(picture.shape[:2], np.float32)
    return Background(picture.astype(np.float32), PICTURE_NOISE * ones, ones)


class BackgroundLearner:
    """Collects some frames of one camera and where the person was in them.

    Attributes:
        every: of so many frames one is kept.
    """

    def __init__(self, frames: int):
        """Prepare for a recording of so many frames."""
        self.every = max(1, -(-frames // MOST_FRAMES))
        self._told, self._frames, self._bodies = 0, [], []
        self._size = (0, 0)

    def add_frame(
        self,
        image: np.ndarray,
        phi: np.ndarray,
        region: Region,
        pixels_xy: np.ndarray | None = None,
    ) -> None:
        """Look at a frame (H, W, 3) uint8 with the person in it.

        Args:
            image: the frame.
            phi: (S, S) cells, positive within the person.
            region: where they lie.
            pixels_xy: (N, 2) of points all over the body as it was found.
        """
        self._told += 1
        if (self._told - 1) % self.every:
            return
        self._size = image.shape[1], image.shape[0]
        body = possible_person(phi, region, pixels_xy, image.shape[:2], AROUND)
        self._frames.append(shrink(image, ROWS))
        self._bodies.append(shrink(body.astype(np.uint8), ROWS) > 0)

    def background(self) -> Background | None:
        """The room, as large as the frames; None without any frame."""
        if not self._frames:
            return None
        return _enlarged(
            learn_background(np.stack(self._frames), np.stack(self._bodies), LIT), self._size
        )


class OnlineBackground:
    """One camera's room as far as the frames so far tell: for a first pass, that knows no other.

    The first frames tell of all that the person is not near to: a limb that moves there is seen.
    """

    def __init__(self):
        self._past = RunningBackground(enough=1)

    def updated(
        self, image: np.ndarray, phi: np.ndarray, region: Region, pixels_xy: np.ndarray
    ) -> Background:
        """The room after another frame, arguments as those of ``RoomLearner.tell``."""
        body = possible_person(phi, region, pixels_xy, image.shape[:2], FARTHER)
        self._past.update(
            shrink(image, RUNNING_ROWS), shrink(body.astype(np.uint8), RUNNING_ROWS) > 0
        )
        return _enlarged(self._past.background(), (image.shape[1], image.shape[0]))


def possible_person(
    phi: np.ndarray,
    region: Region,
    pixels_xy: np.ndarray | None,
    shape: tuple[int, int],
    around: int,
) -> np.ndarray:
    """(H, W) bool: what may be the person by level set or body, ``around`` cells beyond the body.

    Args:
        phi: (S, S) cells, positive within the person.
        region: where they lie.
        pixels_xy: (N, 2) of points all over the body; None if only the level set tells.
        shape: H, W.
        around: cells.
    """
    within = phi + AROUND > 0
    if pixels_xy is not None:
        within = within | covered_cells(pixels_xy, region, len(phi), around)
    return full_mask(np.where(within, np.float32(1), np.float32(-1)), region, shape)


def _enlarged(small: Background, size: tuple[int, int]) -> Background:
    """A room at an image's width and height."""
    parts = (small.colour, small.noise, small.known)
    return Background(*(cv2.resize(part, size) for part in parts))
