"""Pictures of rooms without the person in them.

INPUTS: the files that a recording names. OUTPUTS: images, as large as the videos.
"""

from pathlib import Path

import numpy as np

from jaxmocap.capture.photographs import read_picture
from jaxmocap.formats.files.errors import InputError


def read_empty_room(path: Path, size: tuple[int, int]) -> np.ndarray:
    """What a camera sees where nobody stands: (H, W, 3) BGR uint8.

    Args:
        path: of an image file.
        size: width and height of the camera's video, pixels.

    Raises:
        InputError: no image, or one of another size: it must be the video's own picture.
    """
    picture = read_picture(path)
    height, width = picture.shape[:2]
    if (width, height) != tuple(size):
        problem = (
            f"found {width} × {height} pixels, expected {size[0]} × {size[1]} as the video has"
        )
        raise InputError(path, f"{problem}: a picture of the empty room by the same camera")
    return picture
