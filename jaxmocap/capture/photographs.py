"""Photographs from files.

INPUTS: an image file, the camera that took it. OUTPUTS: (H, W, 3) BGR uint8, of the camera's size.
"""

from pathlib import Path

import cv2
import numpy as np

from jaxmocap.formats.errors import InputError
from jaxmocap.formats.reading import read_bytes
from jaxmocap.formats.writing import replacing
from jaxmocap.geometry.cameras import Camera


def read_photograph(path: str | Path, camera: Camera) -> np.ndarray:
    """Read one.

    Raises:
        InputError: no such file, not an image, or of another size than the camera's.
    """
    path = Path(path)
    image = picture_of(path, read_bytes(path))
    width, height = (int(n) for n in np.asarray(camera.size))
    if image.shape[:2] != (height, width):
        found = f"{image.shape[1]} x {image.shape[0]}"
        raise InputError(
            path, f"found an image of {found} pixels, the calibration says {width} x {height}"
        )
    return image


def write_picture(path: str | Path, picture: np.ndarray) -> Path:
    """Write a picture (H, W, 3), BGR uint8, in the format that the path's suffix names."""
    with replacing(path) as beside:
        cv2.imwrite(str(beside), picture)
    return Path(path)


def picture_of(path: str | Path, content: bytes) -> np.ndarray:
    """The picture (H, W, 3), BGR uint8, in an image file's content.

    Raises:
        InputError: it is not an image; ``path`` is what the message names.
    """
    data = np.frombuffer(content, np.uint8)
    image = cv2.imdecode(data, cv2.IMREAD_COLOR) if data.size else None
    if image is None:
        raise InputError(path, "is not an image that can be read")
    return np.asarray(image)


def png_of(picture: np.ndarray) -> bytes:
    """A PNG file's content of a picture (H, W, 3), BGR uint8."""
    return cv2.imencode(".png", picture)[1].tobytes()
