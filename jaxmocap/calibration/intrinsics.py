"""A camera's intrinsics from views of a board: Zhang's method, through OpenCV.

INPUTS: BoardViews (corners of a board in several pictures), the pictures' size.
OUTPUTS: an IntrinsicsEstimate: the intrinsics, what was left out, and standard deviations.

The method is the one that the paper's section 3 names: Zhengyou Zhang, "Flexible camera calibration
by viewing a plane from unknown orientations", ICCV 1999. A view whose corners are wrong would spoil
all (one of seven is enough), and hides among the others' residuals once it did. So the views that
agree best with each other are calibrated first, and the rest is tested against them (least
trimmed squares: Rousseeuw & Van Driessen 2006).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from jaxmocap.calibration.planar_poses import CameraPose, candidate_poses, rms_length
from jaxmocap.formats.cameras.calibration import Intrinsics

PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
# Coefficients of distortion that can be asked for, and what OpenCV then holds at zero.
DISTORTION_FLAGS = {
    0: cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    1: cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    2: cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    4: cv2.CALIB_FIX_K3,
    5: 0,
}
# A view is an outlier where its residual is this many times the median of the consistent views,
OUTLIER_RATIO = 4.0
# and more than the fractions of a pixel that sharp pictures have.
MIN_OUTLIER_PX = 0.5
_MAX_ROUNDS = 10


@dataclass(frozen=True)
class BoardView:
    """A board's corners in one picture.

    Attributes:
        name: of the picture.
        points_board: (N, 3) metres.
        pixels_xy: (N, 2) where they are detected.
    """

    name: str
    points_board: np.ndarray
    pixels_xy: np.ndarray


@dataclass(frozen=True)
class IntrinsicsEstimate:
    """A calibration, its residuals and its standard deviations.

    Attributes:
        lens: the result.
        rms: reprojection error over all views used, pixels.
        poses: of the board in each view, used or not; None where there is none.
        used: which views the result rests on.
        values: (9,) in the order of PARAMETERS, pixels and plain numbers.
        std: (9,) standard deviations by least squares: as if corners erred independently.
        leave_one_out: (V, 9) the values with each of the V views used left out in turn.
    """

    lens: Intrinsics
    rms: float
    poses: tuple[CameraPose | None, ...]
    used: tuple[bool, ...]
    values: np.ndarray
    std: np.ndarray
    leave_one_out: np.ndarray

    @property
    def jackknife_std(self) -> np.ndarray:
        """(9,) standard deviations by the jackknife over views: what views have in common shows."""
        n = len(self.leave_one_out)
        return np.sqrt(
            (n - 1) / n * ((self.leave_one_out - self.leave_one_out.mean(0)) ** 2).sum(0)
        )

    @property
    def max_std(self) -> np.ndarray:
        """(9,) the larger of both standard deviations."""
        return np.maximum(self.std, self.jackknife_std)


@dataclass(frozen=True)
class _Fit:
    lens: Intrinsics
    rms: float
    values: np.ndarray
    std: np.ndarray


def estimate_intrinsics(
    views: Sequence[BoardView], size: tuple[int, int], coefficients: int = 4
) -> IntrinsicsEstimate:
    """Calibrate a camera from views of a board, without those whose corners are wrong.

    Args:
        views: at least three.
        size: width and height of the pictures, pixels.
        coefficients: of distortion, one of MODELS (k1; k1 k2; k1 k2 p1 p2; k1 k2 p1 p2 k3).

    Raises:
        ArithmeticError: the views determine nothing.
    """
    used = consistent_views(views, size, coefficients)
    kept = [view for view, use in zip(views, used, strict=True) if use]
    fit = _fit(kept, size, coefficients)
    poses = [_pose(view, fit.lens) for view in views]
    without = [
        _fit([*kept[:i], *kept[i + 1 :]], size, coefficients).values for i in range(len(kept))
    ]
    left_out = np.array(without) if len(kept) > 3 else np.tile(fit.values, (1, 1))
    return IntrinsicsEstimate(
        fit.lens, fit.rms, tuple(poses), tuple(used.tolist()), fit.values, fit.std, left_out
    )


def consistent_views(
    views: Sequence[BoardView], size: tuple[int, int], coefficients: int
) -> np.ndarray:
    """(V,) which views agree with one calibration.

    It starts from the half whose corners are most nearly a plane's picture, and calibrates the half
    that the last calibration explains best, until it stays; then all that fit join in.
    """
    count = max(3, len(views) // 2 + 1)
    flatness = np.array([_planarity_error(view) for view in views])
    used = _is_smallest(flatness, count)
    for _ in range(_MAX_ROUNDS):
        residuals = _view_residuals(views, used, size, coefficients)
        best = _is_smallest(residuals, count)
        if (best == used).all():
            break
        used = best
    for _ in range(_MAX_ROUNDS):
        residuals = _view_residuals(views, used, size, coefficients)
        limit = max(MIN_OUTLIER_PX, OUTLIER_RATIO * float(np.median(residuals[used])))
        fitting = residuals <= limit
        if (fitting == used).all():
            break
        used = fitting
    return used


def _is_smallest(figures: np.ndarray, count: int) -> np.ndarray:
    chosen = np.zeros(len(figures), bool)
    chosen[np.argsort(figures, kind="stable")[:count]] = True
    return chosen


def _planarity_error(view: BoardView) -> float:
    """RMS distance of the corners from the best perspective picture of the board, pixels."""
    H, _ = cv2.findHomography(view.points_board[:, :2], view.pixels_xy)
    if H is None:
        return np.inf
    projected = cv2.perspectiveTransform(view.points_board[None, :, :2], H)[0]
    return rms_length(projected - view.pixels_xy)


def _view_residuals(
    views: Sequence[BoardView], used: np.ndarray, size: tuple[int, int], coefficients: int
) -> np.ndarray:
    """(V,) RMS residual of every view under the calibration of those used, pixels."""
    kept = [view for view, use in zip(views, used, strict=True) if use]
    lens = _fit(kept, size, coefficients).lens
    poses = [_pose(view, lens) for view in views]
    return np.array([np.inf if pose is None else pose.rms for pose in poses])


def _pose(view: BoardView, lens: Intrinsics) -> CameraPose | None:
    return next(iter(candidate_poses(view.points_board, view.pixels_xy, lens)), None)


def _fit(views: Sequence[BoardView], size: tuple[int, int], coefficients: int) -> _Fit:
    points = [view.points_board.astype(np.float32) for view in views]
    pixels = [view.pixels_xy.astype(np.float32) for view in views]
    try:
        error, K, d, _, _, std, _, _ = cv2.calibrateCameraExtended(
            points, pixels, size, np.eye(3), np.zeros(5), flags=DISTORTION_FLAGS[coefficients]
        )
    except cv2.error as problem:
        raise ArithmeticError(f"OpenCV finds no calibration ({problem.err})") from None
    values = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *d.ravel()[:5]])
    if not np.isfinite([*values, error]).all():
        raise ArithmeticError("OpenCV finds no finite calibration")
    count = max(coefficients, 4)
    lens = Intrinsics(np.array(size, float), K, d.ravel()[:count].astype(float))
    return _Fit(lens, float(error), values, std.ravel()[:9])
