"""Finding a board in many pictures.

INPUTS: photographs or videos, a Board. OUTPUTS: BoardDetections: views that differ, and which
pictures show no board or nothing new.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from jaxmocap.calibration.board.boards import Board
from jaxmocap.calibration.board.corners import find_coarsely, find_corners
from jaxmocap.calibration.board.pictures import Picture, open_pictures
from jaxmocap.calibration.intrinsics import BoardView
from jaxmocap.formats.files.errors import InputError

# Fewer views than this are refused.
MIN_VIEWS = 5
# Two pictures whose corners differ less than this on average show the same, pixels.
SAME_VIEW_PX = 1.0
# Pictures without a board that are searched for a board of other counts.
_MAX_HINT_PICTURES = 3
# Pictures that are named in a message.
_MAX_NAMED = 8


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
