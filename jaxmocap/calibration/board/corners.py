"""Finding a board's corners in a photograph, in the board's own order.

INPUTS: an image (BGR uint8), a Board. OUTPUTS: Corners, or None where the board is not found.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from jaxmocap.calibration.board.boards import Board
from jaxmocap.formats.files.errors import InputError

_FAST = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
_THOROUGH = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
# What the sector-based detector is asked for in turn, the quick first; the last in a crop only.
_SECTOR_FLAGS = (0, _THOROUGH, _THOROUGH | cv2.CALIB_CB_ACCURACY)
# A crop reaches this part of the board's extent beyond its outermost inner corners.
_CROP_MARGIN = 0.25
# A lens bends the picture of a plane by less than this part of a square.
_MAX_PLANARITY_ERROR = 0.1
# Fewer corners of a ChArUco board determine its place too little.
_MIN_CHARUCO_CORNERS = 8
# Frames of a video are searched at this length of the longer side, pixels.
_COARSE_SIDE = 800


@dataclass(frozen=True)
class Corners:
    """Corners of a board detected in one picture."""

    points_board: np.ndarray  # (N, 3) in the board's frame, metres
    pixels_xy: np.ndarray  # (N, 2) where they are detected
    # Other readings of the same corners, (N, 2) each, where the board looks the same when it is
    # turned.
    orders: tuple[np.ndarray, ...] = ()


def find_corners(image: np.ndarray, board: Board) -> Corners | None:
    """The corners in an image (H, W, 3), BGR uint8, to a fraction of a pixel.

    Of a chessboard all, of a ChArUco board those visible.
    """
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    if board.dictionary is not None:
        return _find_charuco(grey, board)
    pixels = _find_chessboard(grey, board)
    return None if pixels is None else _in_board_order(grey, pixels, board)


def find_coarsely(grey: np.ndarray, board: Board) -> np.ndarray | None:
    """Corners (N, 2) to a pixel or two, quickly: enough to choose frames of a video by.

    Of a ChArUco board there must be all corners: its views are to be compared.
    """
    scale = min(1.0, _COARSE_SIDE / max(grey.shape))
    small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    if board.dictionary is not None:
        corners = _find_charuco(small, board)
        is_complete = corners is not None and len(corners.pixels_xy) == board.columns * board.rows
        return corners.pixels_xy / scale if corners is not None and is_complete else None
    is_detected, pixels = cv2.findChessboardCorners(small, (board.columns, board.rows), flags=_FAST)
    return pixels.reshape(-1, 2) / scale if is_detected else None


def _find_chessboard(grey: np.ndarray, board: Board) -> np.ndarray | None:
    """Corners (N, 2) in one of the orders that the board allows.

    The older detector is quick and finds where the board is; the sector-based one is more precise,
    and surer in a crop than in the full picture. Either may find what the other does not, or find
    what is no board: the first answer that is a plane's picture is taken, else the nearest to one.
    """
    size = (board.columns, board.rows)
    is_complete, rough = cv2.findChessboardCorners(grey, size, flags=_FAST)
    left, top, right, bottom = 0, 0, grey.shape[1], grey.shape[0]
    if is_complete:
        low, high = rough.reshape(-1, 2).min(0), rough.reshape(-1, 2).max(0)
        margin = _CROP_MARGIN * (high - low).max()
        left, top = np.maximum(low - margin, 0).astype(int)
        right, bottom = (high + margin).astype(int) + 1
    crop = np.ascontiguousarray(grey[top:bottom, left:right])
    answers = []
    for flags in _SECTOR_FLAGS if is_complete else _SECTOR_FLAGS[:2]:
        is_found, pixels = cv2.findChessboardCornersSB(crop, size, flags=flags)
        if is_found:
            answers.append(pixels.reshape(-1, 2).astype(float) + np.array([left, top]))
            if _planarity_error(answers[-1], board) < _MAX_PLANARITY_ERROR:
                return answers[-1]
    if is_complete:
        step = _shortest_step(rough.reshape(board.rows, board.columns, 2))
        radius = max(2, round(0.3 * step))
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-4)
        fine = cv2.cornerSubPix(grey, rough, (radius, radius), (-1, -1), criteria)
        answers.append(fine.reshape(-1, 2).astype(float))
    return min(answers, key=lambda pixels: _planarity_error(pixels, board), default=None)


def _planarity_error(pixels_xy: np.ndarray, board: Board) -> float:
    """Largest distance from the best perspective picture of the board, in steps of its corners."""
    residuals = planarity_residuals(board.points_board, pixels_xy)
    step = _shortest_step(pixels_xy.reshape(board.rows, board.columns, 2))
    return float(np.linalg.norm(residuals, axis=-1).max() / max(step, 1e-9))


def planarity_residuals(points_board: np.ndarray, pixels_xy: np.ndarray) -> np.ndarray:
    """(N, 2) pixels to the best perspective picture of (N, 3) points; infinite without one."""
    H, _ = cv2.findHomography(points_board[:, :2], pixels_xy)
    if H is None:
        return np.full(pixels_xy.shape, np.inf)
    return cv2.perspectiveTransform(points_board[None, :, :2], H)[0] - pixels_xy


def _shortest_step(grid_xy: np.ndarray) -> float:
    """Shortest distance of neighbours in a grid (rows, columns, 2), pixels."""
    steps = [np.linalg.norm(np.diff(grid_xy, axis=axis), axis=-1) for axis in (0, 1)]
    return min(float(step.min()) for step in steps)


def _in_board_order(grey: np.ndarray, pixels_xy: np.ndarray, board: Board) -> Corners:
    """Corners in the board's own order: seen from the front, the black end where it belongs."""
    grid = pixels_xy.reshape(board.rows, board.columns, 2)
    along_x, along_y = grid[:, -1] - grid[:, 0], grid[-1] - grid[0]
    x, y = along_x.mean(0), along_y.mean(0)
    # z towards the viewer: x right, y up, and the picture's own y points down.
    if x[0] * y[1] - x[1] * y[0] > 0:
        grid = grid[::-1]
    orders_grid = [grid, grid[::-1, ::-1]]
    if board.columns == board.rows:
        orders_grid += [np.rot90(grid), np.rot90(grid, 3)]
    if board.symmetry_order == 1:
        orders_grid = [max(orders_grid, key=lambda order: _darkness(grey, order))]
    # Where the order is ambiguous, the corner lowest and leftmost in the picture comes first.
    orders_grid.sort(key=lambda order: order[0, 0, 0] - order[0, 0, 1])
    orders = [order.reshape(-1, 2).copy() for order in orders_grid]
    return Corners(board.points_board, orders[0], tuple(orders[1:]))


def _darkness(grey: np.ndarray, grid_xy: np.ndarray) -> float:
    """By how much the first square between the corners, and those of its colour, are darker.

    It touches the outermost square at the origin by a corner, so both have one colour.
    """
    centres = (grid_xy[:-1, :-1] + grid_xy[1:, :-1] + grid_xy[:-1, 1:] + grid_xy[1:, 1:]) / 4
    # A patch of about a third of a square, read at its middle pixel.
    width = max(1, round(_shortest_step(grid_xy) / 3))
    smooth = cv2.blur(grey, (width, width))
    x, y = np.moveaxis(centres.round().astype(int), -1, 0)
    sampled = smooth[y.clip(0, grey.shape[0] - 1), x.clip(0, grey.shape[1] - 1)].astype(float)
    row, column = np.indices(sampled.shape)
    even = (row + column) % 2 == 0
    return float(sampled[~even].mean() - sampled[even].mean())


def _find_charuco(grey: np.ndarray, board: Board) -> Corners | None:
    squares = (board.columns + 1, board.rows + 1)
    dictionary = _dictionary(board.dictionary or "")
    for legacy in (False, True):
        charuco = cv2.aruco.CharucoBoard(squares, board.square, board.marker, dictionary)
        # Boards printed with OpenCV before 4.6 begin with the other colour.
        charuco.setLegacyPattern(legacy)
        pixels, numbers, _, _ = cv2.aruco.CharucoDetector(charuco).detectBoard(grey)
        if numbers is not None and len(numbers) >= _MIN_CHARUCO_CORNERS:
            row, column = np.divmod(numbers.ravel(), board.columns)
            # OpenCV counts rows from the top, the board's y points up.
            indices = (board.rows - 1 - row) * board.columns + column
            return Corners(board.points_board[indices], pixels.reshape(-1, 2).astype(float))
    return None


def _dictionary(name: str) -> "cv2.aruco.Dictionary":
    """OpenCV's dictionary of that name, with or without ``DICT_``; InputError lists them."""
    available = sorted(key[5:] for key in dir(cv2.aruco) if key.startswith("DICT_"))
    wanted = name.upper().removeprefix("DICT_")
    if wanted not in available:
        raise InputError(
            f"ChArUco dictionary {name!r}", f"unknown, expected {', '.join(available)}"
        )
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{wanted}"))
