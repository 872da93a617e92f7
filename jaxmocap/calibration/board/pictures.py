"""Photographs of a board, and the frames of a video that show it best.

INPUTS: image and video files, a Board. OUTPUTS: Pictures, whose images are read when asked for.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from jaxmocap.calibration.board.boards import Board
from jaxmocap.calibration.board.corners import find_coarsely
from jaxmocap.capture.photographs import is_picture_file, read_picture
from jaxmocap.capture.video import NO_VIDEO, Video
from jaxmocap.formats.files.errors import InputError

# Frames of a video that are examined.
MAX_EXAMINED_FRAMES = 150
# Frames of a video that are chosen.
MAX_CHOSEN_FRAMES = 20
# A frame is blurred where its board has less than this part of the median board's sharpness.
MIN_SHARPNESS = 0.5
# Views that differ less than this (in units of the image) show nothing new.
MIN_NEW_DISTANCE = 0.02


@dataclass(frozen=True)
class Picture:
    """One photograph, or one frame of a video."""

    name: str  # for reports: the file's name, with the frame's number for a video
    path: Path  # of the file
    frame: np.ndarray | None = None  # (H, W, 3) BGR of a video's frame; None for a photograph

    def image(self) -> np.ndarray:
        """(H, W, 3) BGR uint8; InputError where the file is not an image."""
        if self.frame is not None:
            return self.frame
        return read_picture(self.path)


def open_pictures(paths: Sequence[str | Path], board: Board) -> tuple[list[Picture], list[str]]:
    """Pictures of files in their order, and a warning for each video.

    Raises:
        InputError: a file that is missing, or neither an image nor a video.
    """
    pictures: list[Picture] = []
    warnings: list[str] = []
    files = [Path(path) for path in paths]
    for path in files:
        alone = len({other for other in files if other.name == path.name}) == 1
        if path.is_dir():
            raise InputError(path, "is a folder, expected images or a video")
        if is_picture_file(path):
            # All are read before any work begins.
            read_picture(path)
            pictures.append(Picture(path.name if alone else str(path), path))
            continue
        try:
            video = Video(path)
        except InputError as error:
            if error.problem != NO_VIDEO:
                raise
            raise InputError(path, "is neither an image nor a video that can be read") from None
        chosen, sentence = _chosen_frames(video, board)
        pictures += chosen
        warnings.append(sentence)
    return pictures, warnings


def _chosen_frames(video: Video, board: Board) -> tuple[list[Picture], str]:
    """Sharp frames that differ from one another in the board's place, size and tilt."""
    step = max(1, -(-len(video) // MAX_EXAMINED_FRAMES))
    candidates = []
    for number, (_, grey) in enumerate(video.frames(luma=True)):
        if grey is not None and number % step == 0:
            pixels = find_coarsely(grey, board)
            if pixels is not None:
                features = _features(pixels, board, grey)
                candidates.append((number, _sharpness(grey, pixels), features))
    examined = -(-len(video) // step)
    sentence = f"{video.path.name}: board found in {len(candidates)} of {examined} frames examined"
    if not candidates:
        return [], sentence
    numbers, sharpness, features = map(np.array, zip(*candidates, strict=True))
    sharp = sharpness >= MIN_SHARPNESS * np.median(sharpness)
    numbers, sharpness, features = numbers[sharp], sharpness[sharp], features[sharp]
    # The sharpest first, then each as far as can be from those chosen before it; those that show
    # nothing new are not chosen.
    spread, distances = [int(sharpness.argmax())], np.full(len(numbers), np.inf)
    while len(spread) < MAX_CHOSEN_FRAMES:
        away = np.linalg.norm(features - features[spread[-1]], axis=-1)
        distances = np.minimum(distances, away)
        if distances.max() < MIN_NEW_DISTANCE:
            break
        spread.append(int(distances.argmax()))
    wanted = set(numbers[spread].tolist())
    chosen = [
        Picture(f"{video.path.name} frame {i}", video.path, image)
        for i, (_, image) in enumerate(video.frames())
        if i in wanted and image is not None
    ]
    blurred = len(candidates) - len(numbers)
    return chosen, f"{sentence}, {blurred} blurred, {len(chosen)} chosen for their spread"


def _sharpness(grey: np.ndarray, pixels_xy: np.ndarray) -> float:
    """Steepness of the edges about the corners, relative to the board's contrast."""
    left, top = np.maximum(pixels_xy.min(0), 0).astype(int)
    right, bottom = pixels_xy.max(0).astype(int) + 1
    crop = grey[top:bottom, left:right].astype(np.float32)
    dx, dy = cv2.Sobel(crop, cv2.CV_32F, 1, 0), cv2.Sobel(crop, cv2.CV_32F, 0, 1)
    return float(np.percentile(np.hypot(dx, dy), 95) / (crop.std() + 1.0))


def _features(pixels_xy: np.ndarray, board: Board, grey: np.ndarray) -> np.ndarray:
    """(7,) where the board is, how large, its direction, how foreshortened along x and y.

    In units of the image; foreshortening (opposite sides that differ in length) is what determines
    the focal length, so it counts double.
    """
    grid = pixels_xy.reshape(board.rows, board.columns, 2)
    sides = [grid[0, -1] - grid[0, 0], grid[-1, -1] - grid[-1, 0]]
    sides += [grid[-1, 0] - grid[0, 0], grid[-1, -1] - grid[0, -1]]
    bottom, top, left, right = (float(np.linalg.norm(side)) for side in sides)
    centre = pixels_xy.mean(0) / grey.shape[::-1]
    size = np.sqrt((bottom + top) * (left + right)) / 2 / max(grey.shape)
    direction = (sides[0] + sides[1]) / (np.linalg.norm(sides[0] + sides[1]) + 1e-9)
    tilt = 2 * np.log([bottom / top, left / right])
    return np.array([*centre, size, *(direction / 4), *tilt])
