"""Calibrating a camera's intrinsics: the story of the command, from photographs to a file.

INPUTS: photographs or videos of a board; the calibration file to change.
OUTPUTS: the camera's section in that file, pictures to look at, and an IntrinsicsResult.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from jaxmocap.calibration.board.boards import Board
from jaxmocap.calibration.board.finding import MIN_VIEWS, BoardDetections, find_boards
from jaxmocap.calibration.board.opencv_lenses import LensKind
from jaxmocap.calibration.board.result_pictures import draw_views, picture_folder
from jaxmocap.calibration.intrinsics import (
    ImageCoverage,
    IntrinsicsEstimate,
    estimate_intrinsics,
    image_coverage,
    intrinsics_warnings,
    why_undetermined,
)
from jaxmocap.calibration.planar_poses import tilt_degrees
from jaxmocap.formats.cameras.calibration import (
    Intrinsics,
    check_camera_writable,
    read_intrinsics,
    write_camera,
)
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.toml import read_toml


@dataclass(frozen=True)
class IntrinsicsResult:
    """What ``calibrate_camera`` found."""

    camera: str  # name of its section
    # The board in pictures; ``estimate.used`` says on which views the result rests.
    detections: BoardDetections
    estimate: IntrinsicsEstimate  # the calibration
    coverage: ImageCoverage  # of the image by the views used
    warnings: tuple[str, ...]  # sentences that a user should see
    files: tuple[Path, ...]  # written

    def rows(self) -> list[tuple[str, float, float, bool]]:
        """Name, residual (pixels, RMS), tilt (degrees) and whether it was used, of each view."""
        both = zip(self.detections.views, self.estimate.poses, self.estimate.used, strict=True)
        nothing = float("inf"), float("nan")
        return [
            (view.name, *((pose.rms, tilt_degrees(pose)) if pose else nothing), use)
            for view, pose, use in both
        ]


def calibrate_camera(
    paths: Sequence[str | Path],
    board: Board,
    camera: str,
    out: str | Path,
    kind: LensKind | None = None,
    pictures: str | Path | None = None,
) -> IntrinsicsResult:
    """Calibrate a camera and write its section.

    Args:
        paths: photographs, or videos of which frames are chosen.
        board: that they show.
        camera: name of the section to add or replace.
        out: the calibration file, .toml.
        kind: of the lens: of an ordinary one 0, 1 (k1), 2 (k1 k2), 4 (k1 k2 p1 p2, the default)
            or 5 (and k3) coefficients, of a fisheye 0 to 4.
        pictures: folder for what is drawn, or None. Corners are drawn even if views are refused.

    Raises:
        InputError: files that cannot be used, or views that do not determine the camera.
    """
    out, kind = Path(out), kind or LensKind()
    if kind.coefficients > len(kind.parameters) - 4:
        problem = f"found {kind.coefficients}, expected at most 4 of a fisheye"
        raise InputError("--distortions", problem)
    check_camera_writable(out, camera)
    folder = picture_folder(pictures, f"intrinsics of {camera}", paths)
    section = read_toml(out).get(camera, {}) if out.exists() else {}
    before = read_intrinsics(out, camera) if {"matrix", "size"} <= section.keys() else None
    detections = find_boards(paths, board)
    try:
        result = _checked_estimate(detections, kind)
    except InputError:
        if folder is not None:
            folder.write(partial(draw_views, detections, None))
        raise
    coverage = image_coverage(
        [v for v, use in zip(detections.views, result.used, strict=True) if use], detections.size
    )
    warnings = [
        *detections.warnings,
        *intrinsics_warnings(result, coverage),
        *_change_warnings(result, before, "rotation" in section),
    ]
    drawn = [] if folder is None else folder.write(partial(draw_views, detections, result))
    write_camera(out, camera, result.lens.entries())
    return IntrinsicsResult(camera, detections, result, coverage, tuple(warnings), (out, *drawn))


def _checked_estimate(detections: BoardDetections, kind: LensKind) -> IntrinsicsEstimate:
    """The calibration; InputError with the reason where the views do not determine it."""
    if (why := detections.too_few()) is not None:
        raise InputError(detections.where, why)
    try:
        result = estimate_intrinsics(detections.views, detections.size, kind)
    except ArithmeticError as error:
        raise InputError(detections.where, f"the views determine no camera: {error}") from None
    if (why := why_undetermined(result)) is not None:
        raise InputError(detections.where, why)
    if (count := sum(result.used)) < MIN_VIEWS:
        both = zip(detections.views, result.used, strict=True)
        others = ", ".join(view.name for view, use in both if not use)
        problem = f"only {count} views agree, expected {MIN_VIEWS} or more; not with them: {others}"
        raise InputError(detections.where, problem)
    return result


def _change_warnings(
    result: IntrinsicsEstimate, before: Intrinsics | None, is_placed: bool
) -> list[str]:
    """Warnings about the calibration that the file held already."""
    warnings = []
    if before is not None:
        K = before.matrix
        old = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])
        changes, deviations = result.values[:4] - old, result.max_std[:4]
        far = [
            f"{name} by {change:+.1f} pixels ({abs(change) / std:.0f} standard deviations)"
            for name, change, std in zip(result.parameters, changes, deviations, strict=False)
            if abs(change) > 3 * std
        ]
        if far:
            warnings.append(
                f"differs from the calibration that the file held, {', '.join(far)}: more than "
                "chance explains, so the two methods or models differ systematically"
            )
    if is_placed:
        warnings.append(
            "rotation and translation were kept as they were, found with other intrinsics: run "
            "jaxmocap calibrate extrinsics again"
        )
    return warnings
