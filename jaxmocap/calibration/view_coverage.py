"""Whether views of a board are enough: how many, how different, and where in the image.

INPUTS: Views, Intrinsics. OUTPUTS: reasons to refuse, Coverage, words of warning.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from jaxmocap.calibration.intrinsics import Intrinsics, View
from jaxmocap.formats.cameras.calibration import Lens
from jaxmocap.geometry.lenses import LENSES, WIDEST_RAD

# Fewer views are said to be few.
MANY = 10
# A focal length known worse than this part of itself is not known.
FOCAL_DOUBT = 0.02
# A principal point known worse than this part of the image is said to be uncertain.
CENTRE_DOUBT = 0.002
# Cells of the image's side into which the coverage is counted, and their names.
_ROWS, _COLUMNS = ("top", "middle", "bottom"), ("left", "middle", "right")
_MASK = 200


@dataclass(frozen=True)
class Coverage:
    """Where in the image boards were seen.

    Attributes:
        share: of the image that was within a board's corners at least once, 0 to 1.
        empty: names of the ninths of the image without any corner.
    """

    share: float
    empty: tuple[str, ...]


def covered(views: Sequence[View], size: tuple[int, int]) -> Coverage:
    """Coverage of an image of that size by views."""
    scale = _MASK / max(size)
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
    return Coverage(float(mask.mean()), tuple(empty))


def too_alike(result: Intrinsics) -> str | None:
    """Why the views do not determine the camera; None where they do.

    Boards that are all parallel, however far apart, leave the focal length open.
    """
    doubt = 100 * (result.doubt[:2] / result.values[:2]).max()
    if doubt <= 100 * FOCAL_DOUBT:
        return None
    shown = f"± {doubt:.1f} %" if doubt < 100 else "more than itself"
    return (
        f"the views are too alike: they leave the focal length open by {shown}, expected "
        f"{100 * FOCAL_DOUBT:.0f} % or less; tilt the board by 30° to 45°, to several sides"
    )


def remarks(result: Intrinsics, coverage: Coverage) -> list[str]:
    """Plain words on what the figures mean."""
    said = []
    few = sum(result.used) < MANY or coverage.empty
    centre = result.doubt[2:4]
    if few or centre.max() > CENTRE_DOUBT * max(result.lens.size):
        said.append(
            f"the views determine the principal point poorly: ± {centre[0]:.1f} and "
            f"{centre[1]:.1f} pixels if the lens is as modelled and the board flat, several times "
            "that where they are not; a shift of it looks like a turn of the camera, so find the "
            "extrinsics with these intrinsics, and show the board near all edges of the image, "
            "turned and tilted"
        )
    ratio = result.jackknife[:4] / result.std[:4]
    if ratio.max() > 1.5:
        said.append(
            "leaving out one view changes the result by more than the corners' noise explains: "
            "trust the jackknife's standard deviations (the board may be bent, or a view blurred)"
        )
    if result.rms > 1.0:
        said.append(
            f"{result.rms:.1f} pixels are a lot (0.1 to 0.3 is usual): blurred pictures, a bent "
            f"board, or {_other_lens(result.lens)}"
        )
    if not _distorts_evenly(result.lens):
        said.append(
            "the lens' distortion turns back within the image, where no corner held it: what is "
            "near the image's edges will be misplaced; show the board there, or try --distortions 2"
        )
    if coverage.empty:
        said.append(f"no corner was seen at the image's {', '.join(coverage.empty)}")
    if sum(result.used) < MANY:
        said.append(f"{sum(result.used)} views are few: 10 to 20 are better")
    return said


def _other_lens(lens: Lens) -> str:
    if lens.fisheye:
        return "a lens that is no fisheye: try it without --fisheye"
    return "a fisheye lens, which this model does not describe: try --fisheye"


def _distorts_evenly(lens: Lens) -> bool:
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
