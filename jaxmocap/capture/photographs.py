"""Photographs and other pictures from files, and to files.

INPUTS: an image file, the camera that took it. OUTPUTS: (H, W, 3) BGR uint8, of the camera's size.
"""

import io
import os
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image

from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.reading import open_regular, read_bytes
from jaxmocap.formats.files.writing import write_bytes

# More than 8K video has; the search for a board takes some thirty bytes for each.
MAX_PIXELS = 50_000_000
# Bytes by which a file is recognised as a picture.
SIGNATURE_BYTES = 32
# What is read, as Pillow names it.
PICTURE_FORMATS = ("PNG", "JPEG", "BMP", "TIFF", "WEBP", "GIF", "PPM")
_STANDARD_ERROR = 2


def read_photograph(
    path: str | Path, size: Any, of: str = "as the calibration states"
) -> np.ndarray:
    """Read one; InputError for no image, or one of another width and height than expected."""
    image = read_picture(path)
    height, width = image.shape[:2]
    if (width, height) != (expected := tuple(np.asarray(size, int).tolist())):
        problem = f"found {width} × {height} pixels"
        raise InputError(path, f"{problem}, expected {expected[0]} × {expected[1]} {of}")
    return image


def read_picture(path: str | Path) -> np.ndarray:
    """The picture (H, W, 3), BGR uint8, of an image file; InputError as in ``picture_of``."""
    return picture_of(path, read_bytes(path))


def is_picture_file(path: str | Path) -> bool:
    """Whether a file says by its first bytes that it is a picture."""
    with open_regular(path, sys.maxsize) as file:
        return _reader(file.read(SIGNATURE_BYTES)) is not None


def picture_size(content: bytes) -> tuple[int, int] | None:
    """Width and height as the header states them; None of what is no picture."""
    read = _reader(content[:SIGNATURE_BYTES])
    # A damaged header breaks any of the steps, or is warned of.
    with warnings.catch_warnings(), suppress(Exception):
        warnings.simplefilter("ignore")
        return None if read is None else read(io.BytesIO(content), "").size
    return None


def _reader(start: bytes) -> Callable[[io.BytesIO, str], Image.Image] | None:
    """What reads the header of a file that begins so; it decodes nothing yet."""
    Image.init()
    readers = [Image.OPEN[name] for name in PICTURE_FORMATS if name in Image.OPEN]
    return next((read for read, accept in readers if accept and accept(start) is True), None)


def picture_of(path: str | Path, content: bytes) -> np.ndarray:
    """(H, W, 3) BGR uint8 of a file's content; InputError about ``path`` for none, or too large."""
    if not content:
        raise InputError(path, "is not an image that can be read, it is empty")
    size = picture_size(content)
    if size is None:
        raise InputError(
            path, f"is not an image that can be read, expected {', '.join(PICTURE_FORMATS)}"
        )
    width, height = size
    # Before it is decoded: some kilobytes of file may state any size.
    if not 0 < width * height <= MAX_PIXELS:
        expected = f"expected up to {MAX_PIXELS / 1e6:g} million"
        raise InputError(path, f"found an image of {width} x {height} pixels, {expected}")
    try:
        with _silenced_decoders():
            image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:
        image = None
    if image is None:
        raise InputError(path, "is not an image that can be read, it is damaged")
    return np.asarray(image)


@contextmanager
def _silenced_decoders() -> Iterator[None]:
    """What decoders print of damage, in words of their own and not through Python, goes nowhere."""
    try:
        kept = os.dup(_STANDARD_ERROR)
    except OSError:
        # There is none that anything could be printed to.
        yield
        return
    with open(os.devnull, "wb") as nowhere:
        os.dup2(nowhere.fileno(), _STANDARD_ERROR)
    try:
        yield
    finally:
        os.dup2(kept, _STANDARD_ERROR)
        os.close(kept)


def read_empty_room(path: Path, size: tuple[int, int]) -> np.ndarray:
    """A picture (H, W, 3), BGR uint8, of an empty room; InputError unless of the video's size."""
    of = "as the video has: a picture of the empty room by the same camera"
    return read_photograph(path, size, of)


def write_picture(path: str | Path, picture: np.ndarray) -> Path:
    """Write (H, W, 3) BGR uint8 in the format of the path's suffix; see ``write_bytes``."""
    write_bytes(path, cv2.imencode(Path(path).suffix, picture)[1].tobytes())
    return Path(path)


def png_of(picture: np.ndarray) -> bytes:
    """A PNG file's content of a picture (H, W, 3), BGR uint8."""
    return cv2.imencode(".png", picture)[1].tobytes()
