"""Finding a board in photographs, and in the frames of a video that show it best.

INPUTS: image and video files, a Board. OUTPUTS: BoardDetections: views that differ, and which
pictures show no board or nothing new.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from jaxmocap.calibration.board.boards import Board
from jaxmocap.calibration.board.corners import find_coarsely, find_corners
from jaxmocap.calibration.intrinsics import BoardView
from jaxmocap.capture.photographs import is_picture_file, read_picture
from jaxmocap.capture.video import NO_VIDEO, Video
from jaxmocap.formats.files.errors import InputError

# Fewer views than this are refused.
MIN_VIEWS = 5
# Two pictures whose corners differ less than this on average show the same, pixels.
SAME_VIEW_PX = 1.0
# Pictures without a board that are searched for a board of other counts.
_MAX_HINT_PICTURES = 3
# Pictures that are named in a message.
_MAX_NAMED = 8
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


@dataclass(frozen=True)
class BoardDetections:
    """Where a board was found in pictures."""

    where: str  # the pictures in a few words, for messages
    board: Board  # that was looked for
    pictures: tuple[Picture, ...]  # all that were searched
    size: tuple[int, int]  # width and height that all have, pixels
    views: tuple[BoardView, ...]  # the board's corners, each different view once
    not_found: tuple[str, ...]  # names of the pictures without a board
    duplicates: tuple[str, ...]  # names of the pictures that show the same as an earlier one
    warnings: tuple[str, ...]  # a sentence for each video

    def too_few(self) -> str | None:
        """In how few pictures the board was found, and in which it was not; None where enough."""
        if len(self.views) >= MIN_VIEWS:
            return None
        count = f"{len(self.views)} different pictures of {len(self.pictures)}"
        parts = [f"found the {self.board.label} board in {count}", *self.warnings]
        for names, what in (
            (self.not_found, "no board in"),
            (self.duplicates, "the same as an earlier one:"),
        ):
            if names:
                more = f" and {len(names) - _MAX_NAMED} more" if len(names) > _MAX_NAMED else ""
                parts.append(f"{what} {', '.join(names[:_MAX_NAMED])}{more}")
        without = [picture for picture in self.pictures if picture.name in self.not_found]
        hint = hint_of_other_counts(without[:_MAX_HINT_PICTURES], self.board)
        return "; ".join([*parts, f"expected {MIN_VIEWS} or more"]) + hint


def find_boards(paths: Sequence[str | Path], board: Board) -> BoardDetections:
    """Look for a board in photographs, and in frames of videos that are chosen for it.

    Raises:
        InputError: a file that is missing or neither image nor video, or pictures that differ in
            size.
    """
    where = str(paths[0]) if len(paths) == 1 else f"{paths[0]} and {len(paths) - 1} more"
    pictures, warnings = open_pictures(paths, board)
    views: list[BoardView] = []
    missing, repeated = [], []
    sizes: dict[tuple[int, int], str] = {}
    for picture in pictures:
        image = picture.image()
        sizes.setdefault((image.shape[1], image.shape[0]), picture.name)
        corners = find_corners(image, board)
        if corners is None:
            missing.append(picture.name)
            continue
        view = BoardView(picture.name, corners.points_board, corners.pixels_xy)
        if any(_is_same_view(view, other) for other in views):
            repeated.append(view.name)
        else:
            views.append(view)
    if len(sizes) > 1:
        differing = ", ".join(f"{name} {w} × {h}" for (w, h), name in sizes.items())
        raise InputError(where, f"pictures differ in size, expected one camera's: {differing}")
    return BoardDetections(
        where,
        board,
        tuple(pictures),
        next(iter(sizes), (0, 0)),
        tuple(views),
        tuple(missing),
        tuple(repeated),
        tuple(warnings),
    )


def _is_same_view(a: BoardView, b: BoardView) -> bool:
    if len(a.pixels_xy) != len(b.pixels_xy) or (a.points_board != b.points_board).any():
        return False
    return float(np.linalg.norm(a.pixels_xy - b.pixels_xy, axis=-1).mean()) < SAME_VIEW_PX


def hint_of_other_counts(pictures: Sequence[Picture], board: Board) -> str:
    """A hint where the pictures show a board of other counts; nothing where they do not."""
    c, r = board.columns, board.rows
    tried = {
        (c - 1, r - 1): "inner corners are counted, where four squares meet, not squares",
        (c + 1, r + 1): "all inner corners are counted, where four squares meet",
    }
    if board.dictionary is not None:
        tried = {(r, c): "the first number runs along the markers' upper edges"} | tried
    for (columns, rows), why in tried.items():
        if min(columns, rows) < 3:
            continue
        other = replace(board, columns=columns, rows=rows)
        for picture in pictures:
            grey = cv2.cvtColor(picture.image(), cv2.COLOR_BGR2GRAY)
            if find_coarsely(grey, other) is not None:
                return f"; {picture.name} shows a {other.label} board: {why}"
    return ""


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
