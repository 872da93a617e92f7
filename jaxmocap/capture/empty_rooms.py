"""Pictures of rooms without the person in them.

INPUTS: the files that a recording names. OUTPUTS: images, as large as the videos.
"""

from pathlib import Path

import cv2
import numpy as np

from jaxmocap.formats.errors import InputError
from jaxmocap.formats.reading import read_bytes


def read_empty_room(path: Path, size: tuple[int, int]) -> np.ndarray:
    """What a camera sees where nobody stands: (H, W, 3) BGR uint8.

    Args:
        path: of an image file.
        size: width and height of the camera's video, pixels.

    Raises:
        InputError: no image, or one of another size: it must be the video's own picture.
    """
    found = cv2.imdecode(np.frombuffer(read_bytes(path), np.uint8), cv2.IMREAD_COLOR)
    if found is None:
        raise InputError(path, "cannot be read as an image, expected .png or .jpg")
    height, width = found.shape[:2]
    if (width, height) != tuple(size):
        said = f"found {width} × {height} pixels, expected {size[0]} × {size[1]} as the video has"
        raise InputError(path, f"{said}: a picture of the empty room by the same camera")
    return found
