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

from jaxmocap.calibration.board.corners import planarity_residuals
from jaxmocap.calibration.board.opencv_lenses import (
    CameraPose,
    LensFit,
    LensKind,
    candidate_poses,
    fit_lens,
    rms_length,
)
from jaxmocap.formats.cameras.calibration import Intrinsics
from jaxmocap.geometry.lenses import LENSES, WIDEST_RAD

# A view is false where its residual is this many times the median of the views that agree, and not
# merely one of the sharp pictures' fractions of a pixel.
OUTLIER_RATIO, MIN_OUTLIER_PX = 4.0, 0.5
_MAX_ROUNDS = 10


@dataclass(frozen=True)
class BoardView:
    """A board's corners in one picture: (N, 3) metres, detected at pixels (N, 2)."""

    name: str
    points_board: np.ndarray
    pixels_xy: np.ndarray


@dataclass(frozen=True)
class IntrinsicsEstimate(LensFit):
    """A calibration by several views, and what each of them has to do with it.

    Its standard deviations by least squares are as if corners erred independently.
    """

    parameters: tuple[str, ...]  # names of the P values
    # Of the board in each view, used or not; None where there is none.
    poses: tuple[CameraPose | None, ...]
    used: tuple[bool, ...]  # which views the result rests on
    leave_one_out: np.ndarray  # (V, P) the values with each of the V views used left out in turn

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
    """Calibrate a camera by three views of a board or more, without those whose corners are wrong.

    The pictures' ``size`` is their width and height, pixels.

    Raises:
        ArithmeticError: the views determine nothing.
    """
    kind = kind or LensKind()
    used = consistent_views(views, size, kind)
    kept = [view for view, use in zip(views, used, strict=True) if use]
    fit = _fit(kept, size, kind)
    poses = [_pose(view, fit.lens) for view in views]
    without = [_fit([*kept[:i], *kept[i + 1 :]], size, kind).values for i in range(len(kept))]
    left_out = np.array(without) if len(kept) > 3 else fit.values[None]
    of_views = kind.parameters, tuple(poses), tuple(used.tolist()), left_out
    return IntrinsicsEstimate(fit.lens, fit.rms, fit.values, fit.std, *of_views)


def consistent_views(
    views: Sequence[BoardView], size: tuple[int, int], kind: LensKind
) -> np.ndarray:
    """(V,) which views agree with one calibration.

    It starts from the half whose corners are most nearly a plane's picture, and calibrates the half
    that the last calibration explains best, until it stays; then all that fit join in.
    """
    count = max(3, len(views) // 2 + 1)
    off = (planarity_residuals(view.points_board, view.pixels_xy) for view in views)
    flatness = np.array([rms_length(residuals_xy) for residuals_xy in off])
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


# Fewer views get a warning.
MIN_VIEWS_ADVISED = 10
# Largest standard deviation of a focal length, as a share of it.
MAX_FOCAL_STD = 0.02
# A principal point with a larger standard deviation, as a share of the image, gets a warning.
MAX_CENTRE_STD = 0.002
# Names of the image's ninths, in which corners are counted.
_ROWS = ("top", "middle", "bottom")
_COLUMNS = ("left", "middle", "right")
_MASK_SIDE = 200


@dataclass(frozen=True)
class ImageCoverage:
    """Where in the image boards were detected."""

    share: float  # of the image that was within a board's corners at least once, 0 to 1
    empty: tuple[str, ...]  # names of the ninths of the image without any corner


def image_coverage(views: Sequence[BoardView], size: tuple[int, int]) -> ImageCoverage:
    """Coverage of an image of that size by views."""
    scale = _MASK_SIDE / max(size)
    mask = np.zeros((round(size[1] * scale), round(size[0] * scale)), np.uint8)
    counts = np.zeros((3, 3), int)
    for view in views:
        hull = cv2.convexHull((view.pixels_xy * scale).round().astype(np.int32))
        cv2.fillConvexPoly(mask, hull, 1)
        column, row = np.clip(3 * view.pixels_xy / size, 0, 2).astype(int).T
        np.add.at(counts, (row, column), 1)
    empty = [
        f"{_ROWS[i]} {_COLUMNS[j]}".replace("middle middle", "middle")
        for i, j in np.argwhere(counts == 0)
    ]
    return ImageCoverage(float(mask.mean()), tuple(empty))


def why_undetermined(result: IntrinsicsEstimate) -> str | None:
    """Why the views do not determine the camera; None where they do.

    Boards that are all parallel, however far apart, leave the focal length open.
    """
    percent = 100 * (result.max_std[:2] / result.values[:2]).max()
    if percent <= 100 * MAX_FOCAL_STD:
        return None
    text = f"± {percent:.1f} %" if percent < 100 else "more than itself"
    return (
        f"the views are too alike: they leave the focal length open by {text}, expected "
        f"{100 * MAX_FOCAL_STD:.0f} % or less; tilt the board by 30° to 45°, to several sides"
    )


def intrinsics_warnings(result: IntrinsicsEstimate, coverage: ImageCoverage) -> list[str]:
    """Warnings on what the figures mean."""
    warnings = []
    few = sum(result.used) < MIN_VIEWS_ADVISED or coverage.empty
    centre = result.max_std[2:4]
    if few or centre.max() > MAX_CENTRE_STD * max(result.lens.size):
        warnings.append(
            f"the views determine the principal point poorly: ± {centre[0]:.1f} and "
            f"{centre[1]:.1f} pixels if the lens is as modelled and the board flat, several times "
            "that where they are not; a shift of it looks like a rotation of the camera, so find "
            "the extrinsics with these intrinsics, and show the board near all edges of the image, "
            "turned and tilted"
        )
    ratio = result.jackknife_std[:4] / result.std[:4]
    if ratio.max() > 1.5:
        warnings.append(
            "leaving out one view changes the result by more than the corners' noise explains: "
            "use the jackknife's standard deviations (the board may be bent, or a view blurred)"
        )
    if result.rms > 1.0:
        other = "a fisheye lens, which this model does not describe: try --fisheye"
        if result.lens.fisheye:
            other = "a lens that is no fisheye: try it without --fisheye"
        warnings.append(
            f"{result.rms:.1f} pixels are a lot (0.1 to 0.3 is usual): blurred pictures, a bent "
            f"board, or {other}"
        )
    if not _is_distortion_monotonic(result.lens):
        warnings.append(
            "the lens' distortion turns back within the image, where no corner held it: what is "
            "near the image's edges will be misplaced; show the board there, or try --distortions 2"
        )
    if coverage.empty:
        warnings.append(f"no corner was detected at the image's {', '.join(coverage.empty)}")
    if sum(result.used) < MIN_VIEWS_ADVISED:
        warnings.append(f"{sum(result.used)} views are few: 10 to 20 are better")
    return warnings


def _is_distortion_monotonic(lens: Intrinsics) -> bool:
    """Do points farther from the centre appear farther from it, up to the image's corners?"""
    K = lens.matrix
    corners = np.array([[x, y] for x in (0, lens.size[0]) for y in (0, lens.size[1])])
    farthest = np.linalg.norm((corners - K[:2, 2]) / np.diag(K)[:2], axis=-1).max()
    r = np.linspace(0, farthest, 100)
    if lens.fisheye:
        # A fisheye shows what is so far from its centre about as many radians from its axis.
        r = np.tan(np.minimum(r, WIDEST_RAD))
    model, k = LENSES[lens.model], np.zeros(len(LENSES[lens.model].coefficients))
    k[: len(lens.distortions)] = lens.distortions
    # What moves points sideways is left out.
    k[np.isin(model.coefficients, ("p1", "p2"))] = 0.0
    shown, _ = model.distort(k, r, np.zeros_like(r))
    return bool((np.diff(shown)[np.diff(r) > 0] > 0).all())
