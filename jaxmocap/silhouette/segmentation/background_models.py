"""Background models, by a picture, or learned while a person is tracked before the background.

What the body covers in the estimated pose is no background, even where the level set has none of
it: a hand that stands on the floor all the time is else learned as floor once it has been missed.
Nor is what was segmented beside the body, which may be a limb that was lost.

INPUTS: a picture without the person; or frames, and for each where the person is, as level sets on
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

# Rows of an image at which a background is learned.
ROWS = 720
# And at which it is learned frame by frame.
ONLINE_ROWS = 480
# Cells about the person that count as the person.
MARGIN_CELLS = 2
# And about the body frame by frame, when the first poses and the shape are uncertain.
ONLINE_MARGIN_CELLS = 6
# Quantile of what a pixel shows that is background: a person's shadow darkens it for a while.
LIT_QUANTILE = 0.7
# Deviation of a frame from a picture of the same background, grey levels: that of two frames.
PICTURE_NOISE = 4.0


def background_of_picture(picture: np.ndarray) -> Background:
    """By one picture (H, W, 3) uint8 without the person."""
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
        self._count, self._frames, self._bodies = 0, [], []
        self._size = (0, 0)

    def add_frame(
        self,
        image: np.ndarray,
        phi: np.ndarray,
        region: Region,
        pixels_xy: np.ndarray | None = None,
    ) -> None:
        """Learn from an image (H, W, 3) uint8 with the person in it.

        Φ (S, S), cells, is positive there; ``pixels_xy`` (N, 2) are of points all over the body as
        estimated.
        """
        self._count += 1
        if (self._count - 1) % self.every:
            return
        self._size = image.shape[1], image.shape[0]
        body = possible_person(phi, region, pixels_xy, image.shape[:2], MARGIN_CELLS)
        self._frames.append(shrink(image, ROWS))
        self._bodies.append(shrink(body.astype(np.uint8), ROWS) > 0)

    def background(self) -> Background | None:
        """As large as the frames; None without any frame."""
        if not self._frames:
            return None
        return _enlarge(
            learn_background(np.stack(self._frames), np.stack(self._bodies), LIT_QUANTILE),
            self._size,
        )


class OnlineBackground:
    """One camera's background by the frames so far: for a first pass, that has no other.

    The first frames show all that the person is not near to: a limb that moves there stands out.
    """

    def __init__(self):
        self._running = RunningBackground(enough=1)

    def update(
        self, image: np.ndarray, phi: np.ndarray, region: Region, pixels_xy: np.ndarray
    ) -> Background:
        """After another frame, arguments as those of ``BackgroundLearner.add_frame``."""
        body = possible_person(phi, region, pixels_xy, image.shape[:2], ONLINE_MARGIN_CELLS)
        self._running.update(
            shrink(image, ONLINE_ROWS), shrink(body.astype(np.uint8), ONLINE_ROWS) > 0
        )
        return _enlarge(self._running.background(), (image.shape[1], image.shape[0]))


def possible_person(
    phi: np.ndarray,
    region: Region,
    pixels_xy: np.ndarray | None,
    shape: tuple[int, int],
    around: int,
) -> np.ndarray:
    """(H, W) bool: what may be the person by level set or body, ``around`` cells beyond the body.

    Φ (S, S), cells, is positive within the person; pixels (N, 2) are of points all over the body.
    """
    within = phi + MARGIN_CELLS > 0
    if pixels_xy is not None:
        within = within | covered_cells(pixels_xy, region, len(phi), around)
    return full_mask(np.where(within, np.float32(1), np.float32(-1)), region, shape)


def covered_cells(pixels_xy: np.ndarray, region: Region, size: int, around: int) -> np.ndarray:
    """(S, S) bool: cells within ``around`` cells of pixels (N, 2), by rows or columns.

    That is at least half of what lies between neighbouring points, or gaps stay open.
    """
    cells = np.rint((pixels_xy - region.origin) / region.scale - 0.5).astype(int)
    column, row = cells[((cells >= 0) & (cells < size)).all(1)].T
    mask = np.zeros((size, size), np.uint8)
    mask[row, column] = 1
    return cv2.dilate(mask, np.ones((2 * around + 1,) * 2, np.uint8)) > 0


def _enlarge(small: Background, size: tuple[int, int]) -> Background:
    """A background at an image's width and height."""
    return Background(*(cv2.resize(part, size) for part in small))
