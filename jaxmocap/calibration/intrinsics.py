"""A camera's intrinsics from views of a board: Zhang's method, through OpenCV.

INPUTS: Views (corners of a board in several pictures), the pictures' size.
OUTPUTS: Intrinsics: the Lens, what was left out, and how far each figure is to be trusted.

The method is the one that the paper's section 3 names: Zhengyou Zhang, "Flexible camera calibration
by viewing a plane from unknown orientations", ICCV 1999. A view whose corners are wrong would spoil
all (one of seven is enough), and hides among the others' residuals once it did. So the views that
agree best with each other are calibrated first, and the rest is judged by what they say (least
trimmed squares: Rousseeuw & Van Driessen 2006).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from jaxmocap.calibration.board.opencv_lenses import LensFit, LensKind, fit_lens
from jaxmocap.calibration.planar_poses import Pose, find_poses, rms
from jaxmocap.formats.cameras.calibration import Lens

# A view is false where its residual is this many times the median of the views that agree, and not
# merely one of the sharp pictures' fractions of a pixel.
FALSE_TIMES, FALSE_PX = 4.0, 0.5
_ROUNDS = 10


@dataclass(frozen=True)
class View:
    """A board's corners in one picture.

    Attributes:
        name: of the picture.
        points_board: (N, 3) metres.
        pixels_xy: (N, 2) where they are seen.
    """

    name: str
    points_board: np.ndarray
    pixels_xy: np.ndarray


@dataclass(frozen=True)
class Intrinsics:
    """A calibration and what there is to say of it.

    Attributes:
        parameters: names of the P values.
        lens: the result.
        rms: reprojection error over all views used, pixels.
        poses: of the board in each view, used or not; None where there is none.
        used: which views the result rests on.
        values: (P,) pixels and plain numbers.
        std: (P,) standard deviations by least squares: as if corners erred independently.
        left_out: (V, P) the values with each of the V views used left out in turn.
    """

    parameters: tuple[str, ...]
    lens: Lens
    rms: float
    poses: tuple[Pose | None, ...]
    used: tuple[bool, ...]
    values: np.ndarray
    std: np.ndarray
    left_out: np.ndarray

    @property
    def jackknife(self) -> np.ndarray:
        """(P,) standard deviations by the jackknife over views: what views have in common shows."""
        n = len(self.left_out)
        return np.sqrt((n - 1) / n * ((self.left_out - self.left_out.mean(0)) ** 2).sum(0))

    @property
    def doubt(self) -> np.ndarray:
        """(P,) the larger of both standard deviations."""
        return np.maximum(self.std, self.jackknife)


def calibrate(
    views: Sequence[View], size: tuple[int, int], kind: LensKind | None = None
) -> Intrinsics:
    """Calibrate a camera from views of a board, without those whose corners are wrong.

    Args:
        views: at least three.
        size: width and height of the pictures, pixels.
        kind: of the lens; defaults to an ordinary one with k1 k2 p1 p2.

    Raises:
        ArithmeticError: the views determine nothing.
    """
    kind = kind or LensKind()
    used = agreeing(views, size, kind)
    kept = [view for view, use in zip(views, used, strict=True) if use]
    fit = _fit(kept, size, kind)
    poses = [_pose(view, fit.lens) for view in views]
    without = [_fit([*kept[:i], *kept[i + 1 :]], size, kind).values for i in range(len(kept))]
    left_out = np.array(without) if len(kept) > 3 else np.tile(fit.values, (1, 1))
    return Intrinsics(
        kind.parameters,
        fit.lens,
        fit.rms,
        tuple(poses),
        tuple(used.tolist()),
        fit.values,
        fit.std,
        left_out,
    )


def agreeing(views: Sequence[View], size: tuple[int, int], kind: LensKind) -> np.ndarray:
    """(V,) which views agree with one calibration.

    It starts from the half whose corners are most nearly a plane's picture, and calibrates the half
    that the last calibration explains best, until it stays; then all that fit join in.
    """
    count = max(3, len(views) // 2 + 1)
    flatness = np.array([_off_a_plane(view) for view in views])
    used = _smallest(flatness, count)
    for _ in range(_ROUNDS):
        residuals = _judged(views, used, size, kind)
        best = _smallest(residuals, count)
        if (best == used).all():
            break
        used = best
    for _ in range(_ROUNDS):
        residuals = _judged(views, used, size, kind)
        limit = max(FALSE_PX, FALSE_TIMES * float(np.median(residuals[used])))
        fitting = residuals <= limit
        if (fitting == used).all():
            break
        used = fitting
    return used


def _smallest(figures: np.ndarray, count: int) -> np.ndarray:
    chosen = np.zeros(len(figures), bool)
    chosen[np.argsort(figures, kind="stable")[:count]] = True
    return chosen


def _off_a_plane(view: View) -> float:
    """RMS distance of the corners from the best perspective picture of the board, pixels."""
    H, _ = cv2.findHomography(view.points_board[:, :2], view.pixels_xy)
    if H is None:
        return np.inf
    seen = cv2.perspectiveTransform(view.points_board[None, :, :2], H)[0]
    return rms(seen - view.pixels_xy)


def _judged(
    views: Sequence[View], used: np.ndarray, size: tuple[int, int], kind: LensKind
) -> np.ndarray:
    """(V,) RMS residual of every view under the calibration of those used, pixels."""
    kept = [view for view, use in zip(views, used, strict=True) if use]
    lens = _fit(kept, size, kind).lens
    poses = [_pose(view, lens) for view in views]
    return np.array([np.inf if pose is None else pose.rms for pose in poses])


def _pose(view: View, lens: Lens) -> Pose | None:
    return next(iter(find_poses(view.points_board, view.pixels_xy, lens)), None)


def _fit(views: Sequence[View], size: tuple[int, int], kind: LensKind) -> LensFit:
    return fit_lens([v.points_board for v in views], [v.pixels_xy for v in views], size, kind)
