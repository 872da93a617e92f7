"""Boards seen through a lens, drawn pixel by pixel: with a true calibration."""

from functools import cache
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.calibration.board.boards import Board
from jaxmocap.formats.cameras.calibration import Intrinsics

SIZE = (640, 480)
LENS = Intrinsics(
    np.array(SIZE, float),
    np.array([[620.0, 0, 335], [0, 615, 228], [0, 0, 1]]),
    np.array([-0.12, 0.05, 0.001, -0.0005]),
)
# A camera that shows 115 degrees from side to side.
FISHEYE_LENS = Intrinsics(
    np.array(SIZE, float),
    np.array([[310.0, 0, 325], [0, 308, 236], [0, 0, 1]]),
    np.array([0.04, -0.02, 0.006, -0.001]),
    fisheye=True,
)
BOARD = Board(4, 7, 0.06)
CHARUCO = Board(4, 7, 0.06, "5X5_100", 0.045)
# Each pixel is the mean of so many by so many samples.
FINE = 2
PAPER, BLACK, WALL = 225.0, 25.0, 120.0


@cache
def rays(fisheye: bool = False) -> np.ndarray:
    """(H · FINE, W · FINE, 2) points on the plane z = 1 that the samples of the image see."""
    x = (np.arange(SIZE[0] * FINE) + 0.5) / FINE - 0.5
    y = (np.arange(SIZE[1] * FINE) + 0.5) / FINE - 0.5
    grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 1, 2)
    lens, model = (FISHEYE_LENS, cv2.fisheye) if fisheye else (LENS, cv2)
    undistorted = model.undistortPoints(grid, lens.matrix, lens.distortions)
    return undistorted.reshape(SIZE[1] * FINE, SIZE[0] * FINE, 2).astype(np.float32)


def draw(board: Board, T_cam_board: np.ndarray, seed: int = 0, fisheye: bool = False) -> np.ndarray:
    """(480, 640, 3) BGR: the board before a wall, with a little noise."""
    M = np.linalg.inv(T_cam_board[:3, [0, 1, 3]])
    plane = rays(fisheye) @ M[:, :2].T.astype(np.float32) + M[:, 2].astype(np.float32)
    across, up = np.moveaxis(plane[..., :2] / plane[..., 2:], -1, 0) / board.square
    shade = charuco_shade(board, across, up) if board.dictionary else chess_shade(board, across, up)
    paper = (across > -2) & (across < board.columns + 1) & (up > -2) & (up < board.rows + 1)
    image = np.where(paper & (plane[..., 2] > 0), shade, WALL)
    image = image.reshape(SIZE[1], FINE, SIZE[0], FINE).mean((1, 3))
    image += np.random.default_rng(seed).normal(0, 1.5, image.shape)
    return np.repeat(image.round().clip(0, 255).astype(np.uint8)[..., None], 3, axis=2)


def chess_shade(board: Board, across: np.ndarray, up: np.ndarray) -> np.ndarray:
    """The square next to the origin, within the corners, is black."""
    inside = (across > -1) & (across < board.columns) & (up > -1) & (up < board.rows)
    black = (np.floor(across) + np.floor(up)) % 2 == 0
    return np.where(inside & black, BLACK, PAPER)


def charuco_shade(board: Board, across: np.ndarray, up: np.ndarray) -> np.ndarray:
    """OpenCV's picture of the board, whose rows run from the top."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    squares = (board.columns + 1, board.rows + 1)
    made = cv2.aruco.CharucoBoard(squares, board.square, board.marker, dictionary)
    picture = made.generateImage((squares[0] * 80, squares[1] * 80))
    x = np.clip((across + 1) * 80, 0, picture.shape[1] - 1).astype(int)
    y = np.clip((board.rows - up) * 80, 0, picture.shape[0] - 1).astype(int)
    inside = (across > -1) & (across < board.columns) & (up > -1) & (up < board.rows)
    return np.where(inside, BLACK + (PAPER - BLACK) * picture[y, x] / 255.0, PAPER)


def pixels_of(
    points: np.ndarray, T_cam_points: np.ndarray, noise: float = 0.0, seed: int = 0, lens=LENS
) -> np.ndarray:
    """Pixels (N, 2) of points (N, 3), as the lens shows them, with noise in pixels."""
    rvec, _ = cv2.Rodrigues(T_cam_points[:3, :3])
    places, tvec = np.asarray(points, float)[:, None], T_cam_points[:3, 3]
    project = cv2.fisheye.projectPoints if lens.fisheye else cv2.projectPoints
    pixels = project(places, rvec, tvec, lens.matrix, lens.distortions)[0].reshape(-1, 2)
    return pixels + np.random.default_rng(seed).normal(0, noise, pixels.shape)


def held(board: Board, tilt_x: float, tilt_y: float, turn: float, at_cam=(0.0, 0.0, 0.9)):
    """T_cam_board: the board's middle at a place before the camera, print towards it, degrees.

    With no tilt and no turn its x points right and its y up.
    """
    T = np.eye(4)
    upright = np.diag([1.0, -1.0, -1.0])
    R = Rotation.from_euler("zyx", [turn, tilt_y, tilt_x], degrees=True).as_matrix()
    T[:3, :3] = R @ upright
    T[:3, 3] = np.array(at_cam) - T[:3, :3] @ board.points_board.mean(0)
    return T


# Tilts about x and y, turn (degrees), and the middle's place: to several sides, over the image.
HELD = (
    (35, 0, 10, (-0.15, -0.05, 0.85)),
    (-35, 10, 0, (0.15, 0.05, 0.85)),
    (0, 35, 80, (0.05, -0.1, 0.8)),
    (5, -35, 95, (-0.1, 0.1, 0.85)),
    (25, 25, 45, (0.15, -0.1, 0.95)),
    (-25, 25, -30, (-0.2, 0.1, 1.0)),
    (20, -25, 175, (0.0, 0.0, 0.8)),
)


# The same of a board before the fisheye, near enough to be large.
HELD_BEFORE_FISHEYE = (
    (35, 0, 10, (-0.2, -0.05, 0.42)),
    (-35, 10, 0, (0.22, 0.1, 0.45)),
    (0, 35, 80, (0.05, -0.18, 0.4)),
    (5, -35, 95, (-0.1, 0.18, 0.42)),
    (25, 25, 45, (0.3, -0.15, 0.5)),
    (-25, 25, -30, (-0.3, 0.15, 0.5)),
    (20, -25, 175, (0.0, 0.0, 0.38)),
    (-20, -30, 20, (0.3, 0.2, 0.5)),
    (30, 20, -70, (-0.3, -0.2, 0.5)),
)


def views(board: Board = BOARD, fisheye: bool = False) -> list[np.ndarray]:
    """T_cam_board of each of HELD, or of HELD_BEFORE_FISHEYE."""
    return [held(board, *each) for each in (HELD_BEFORE_FISHEYE if fisheye else HELD)]


def write_views(folder: Path, board: Board = BOARD, fisheye: bool = False) -> list[str]:
    """Photographs ``view_1.png`` and so on; their paths."""
    paths = []
    for i, T_cam_board in enumerate(views(board, fisheye), 1):
        path = folder / f"view_{i}.png"
        cv2.imwrite(str(path), draw(board, T_cam_board, seed=i, fisheye=fisheye))
        paths.append(str(path))
    return paths
