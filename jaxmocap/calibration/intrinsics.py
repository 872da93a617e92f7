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

from jaxmocap.calibration.board.opencv_lenses import LensFit, LensKind, fit_lens
from jaxmocap.calibration.planar_poses import CameraPose, candidate_poses, rms_length
from jaxmocap.formats.cameras.calibration import Intrinsics

# A view is false where its residual is this many times the median of the views that agree, and not
# merely one of the sharp pictures' fractions of a pixel.
OUTLIER_RATIO, MIN_OUTLIER_PX = 4.0, 0.5
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
        parameters: names of the P values.
        lens: the result.
        rms: reprojection error over all views used, pixels.
        poses: of the board in each view, used or not; None where there is none.
        used: which views the result rests on.
        values: (P,) pixels and plain numbers.
        std: (P,) standard deviations by least squares: as if corners erred independently.
        leave_one_out: (V, P) the values with each of the V views used left out in turn.
    """

    parameters: tuple[str, ...]
    lens: Intrinsics
    rms: float
    poses: tuple[CameraPose | None, ...]
    used: tuple[bool, ...]
    values: np.ndarray
    std: np.ndarray
    leave_one_out: np.ndarray

    @property
    def jackknife_std(self) -> np.ndarray:
        """(P,) standard deviations by the jackknife over views: what views have in common shows."""
        n = len(self.leave_one_out)
        return np.sqrt(
            (n - 1) / n * ((self.leave_one_out - self.leave_one_out.mean(0)) ** 2).sum(0)
        )

    @property
    def max_std(self) -> np.ndarray:
        """(P,) the larger of both standard deviations."""
        return np.maximum(self.std, self.jackknife_std)


def estimate_intrinsics(
    views: Sequence[BoardView], size: tuple[int, int], kind: LensKind | None = None
) -> IntrinsicsEstimate:
    """Calibrate a camera from views of a board, without those whose corners are wrong.

    Args:
        views: at least three.
        size: width and height of the pictures, pixels.
        kind: of the lens; defaults to an ordinary one with k1 k2 p1 p2.

    Raises:
        ArithmeticError: the views determine nothing.
    """
    kind = kind or LensKind()
    used = consistent_views(views, size, kind)
    kept = [view for view, use in zip(views, used, strict=True) if use]
    fit = _fit(kept, size, kind)
    poses = [_pose(view, fit.lens) for view in views]
    without = [_fit([*kept[:i], *kept[i + 1 :]], size, kind).values for i in range(len(kept))]
    left_out = np.array(without) if len(kept) > 3 else np.tile(fit.values, (1, 1))
    return IntrinsicsEstimate(
        kind.parameters,
        fit.lens,
        fit.rms,
        tuple(poses),
        tuple(used.tolist()),
        fit.values,
        fit.std,
        left_out,
    )


def consistent_views(
    views: Sequence[BoardView], size: tuple[int, int], kind: LensKind
) -> np.ndarray:
    """(V,) which views agree with one calibration.

    It starts from the half whose corners are most nearly a plane's picture, and calibrates the half
    that the last calibration explains best, until it stays; then all that fit join in.
    """
    count = max(3, len(views) // 2 + 1)
    flatness = np.array([_planarity_error(view) for view in views])
    used = _is_smallest(flatness, count)
    for _ in range(_MAX_ROUNDS):
        residuals = _view_residuals(views, used, size, kind)
        best = _is_smallest(residuals, count)
        if (best == used).all():
            break
        used = best
    for _ in range(_MAX_ROUNDS):
        residuals = _view_residuals(views, used, size, kind)
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
    views: Sequence[BoardView], used: np.ndarray, size: tuple[int, int], kind: LensKind
) -> np.ndarray:
    """(V,) RMS residual of every view under the calibration of those used, pixels."""
    kept = [view for view, use in zip(views, used, strict=True) if use]
    lens = _fit(kept, size, kind).lens
    poses = [_pose(view, lens) for view in views]
    return np.array([np.inf if pose is None else pose.rms for pose in poses])


def _pose(view: BoardView, lens: Intrinsics) -> CameraPose | None:
    return next(iter(candidate_poses(view.points_board, view.pixels_xy, lens)), None)


def _fit(views: Sequence[BoardView], size: tuple[int, int], kind: LensKind) -> LensFit:
    return fit_lens([v.points_board for v in views], [v.pixels_xy for v in views], size, kind)
