"""What a camera shows of a room, by a picture, or learned while a person is followed through it.

INPUTS: a picture of the empty room; or frames, and for each where the person is, as level sets on
canvases. OUTPUTS: a Background.
"""

import cv2
import numpy as np

from jaxmocap.images.background import MOST_FRAMES, Background, learn_background
from jaxmocap.images.canvases import full_mask
from jaxmocap.images.foreground import shrink
from jaxmocap.images.regions import Region

# Rows at which a room is learned, and cells about the person that count as the person.
ROWS, AROUND = 720, 2.0
# Deviation of a frame from a picture of the same room, grey levels: that of two frames.
PICTURE_NOISE = 4.0


def pictured(picture: np.ndarray) -> Background:
    """The room by one picture (H, W, 3) uint8 without the person."""
    ones = np.ones(picture.shape[:2], np.float32)
    return Background(picture.astype(np.float32), PICTURE_NOISE * ones, ones)


class RoomLearner:
    """Collects some frames of one camera and where the person was in them.

    Attributes:
        every: of so many frames one is kept.
    """

    def __init__(self, frames: int):
        """Prepare for a recording of so many frames."""
        self.every = max(1, -(-frames // MOST_FRAMES))
        self._told, self._frames, self._bodies = 0, [], []
        self._size = (0, 0)

    def tell(self, image: np.ndarray, phi: np.ndarray, region: Region) -> None:
        """Look at a frame (H, W, 3) uint8 in which the person is where Φ (S, S) is positive."""
        self._told += 1
        if (self._told - 1) % self.every:
            return
        self._size = image.shape[1], image.shape[0]
        body = full_mask(phi + AROUND, region, image.shape[:2])
        small = shrink(image, ROWS)
        self._frames.append(small)
        self._bodies.append(shrink(body.astype(np.uint8), ROWS) > 0)

    def learned(self) -> Background | None:
        """The room, as large as the frames; None without any frame."""
        if not self._frames:
            return None
        small = learn_background(np.stack(self._frames), np.stack(self._bodies))
        return Background(
            *(cv2.resize(part, self._size) for part in (small.colour, small.noise, small.known))
        )
