"""Whether views of a board are enough: how many, how different, and where in the image.

INPUTS: BoardViews, an IntrinsicsEstimate. OUTPUTS: reasons to refuse, ImageCoverage, warnings.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from jaxmocap.calibration.intrinsics import BoardView, IntrinsicsEstimate
from jaxmocap.formats.cameras.calibration import Intrinsics
from jaxmocap.geometry.lenses import LENSES, WIDEST_RAD

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
    """Where in the image boards were detected.

    Attributes:
        share: of the image that was within a board's corners at least once, 0 to 1.
        empty: names of the ninths of the image without any corner.
    """

    share: float
    empty: tuple[str, ...]


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
