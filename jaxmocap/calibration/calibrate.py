"""Calibrating a camera's intrinsics: the story of the command, from photographs to a file.

INPUTS: photographs or videos of a board; the calibration file to change.
OUTPUTS: the camera's section in that file, pictures to look at, and an IntrinsicsResult.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.calibration.board.boards import Board
from jaxmocap.calibration.board.finding import MIN_VIEWS, BoardDetections, find_boards
from jaxmocap.calibration.board.opencv_lenses import LensKind, tilt_degrees
from jaxmocap.calibration.board.result_pictures import draw_views, picture_folder
from jaxmocap.calibration.intrinsics import (
    ImageCoverage,
    IntrinsicsEstimate,
    estimate_intrinsics,
    image_coverage,
    intrinsics_warnings,
    why_undetermined,
)
from jaxmocap.formats.cameras.calibration import (
    Intrinsics,
    check_camera_writable,
    read_intrinsics,
    write_camera,
)
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.toml import read_toml

_PIXELS = ("fx", "fy", "cx", "cy")


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

    def text(self) -> str:
        """Pictures with their errors, parameters with their deviations, warnings, files."""
        width, height = self.estimate.lens.size
        pictures = [
            f"  {name}: {error:.2f} px, {tilt:.0f}°"
            if use
            else f"  {name}: {error:.2f} px, LEFT OUT: its corners do not fit the other views"
            for name, error, tilt, use in self.rows()
        ]
        used = sum(self.estimate.used)
        total = len(self.detections.pictures)
        lines = [
            f"[{self.camera}] {width:g} × {height:g} pixels, {used} of {total} pictures used, "
            f"{self.estimate.rms:.3f} pixels RMS",
            "",
            "picture: reprojection, tilt of the board",
            *pictures,
            *(f"  {name}: no board found" for name in self.detections.not_found),
            *(f"  {name}: the same as an earlier one" for name in self.detections.duplicates),
            "",
            *_parameters(self.estimate),
            "",
            f"coverage: {100 * self.coverage.share:.0f} % of the image",
            *(f"warning: {sentence}" for sentence in self.warnings),
            *(f"written  {path}" for path in self.files),
        ]
        return "\n".join(lines)

    def figures(self) -> dict[str, Any]:
        """The same as figures, pixels, degrees; what is not finite has none."""
        estimate = self.estimate
        parameters = {
            name: {
                "value": estimate.values[i],
                "std": estimate.std[i],
                "jackknife_std": estimate.jackknife_std[i],
                "left_out_min": estimate.leave_one_out[:, i].min(),
                "left_out_max": estimate.leave_one_out[:, i].max(),
            }
            for i, name in enumerate(estimate.parameters)
        }
        pictures = [
            {"name": name, "rms_px": error, "tilt_deg": tilt, "used": use}
            for name, error, tilt, use in self.rows()
        ]
        return {
            "camera": self.camera,
            "size_px": [int(n) for n in estimate.lens.size],
            "board": self.detections.board.label,
            "rms_px": estimate.rms,
            "pictures": pictures,
            "used": sum(estimate.used),
            "left_out": [name for name, _, _, use in self.rows() if not use],
            "not_found": self.detections.not_found,
            "repeated": self.detections.duplicates,
            "parameters": parameters,
            "coverage_share": self.coverage.share,
            "empty": self.coverage.empty,
            "warnings": self.warnings,
            "files": self.files,
        }


def _parameters(estimate: IntrinsicsEstimate) -> list[str]:
    rows = [["", "value", "std", "one view left out", "jackknife std"]]
    ranges = np.stack([estimate.leave_one_out.min(0), estimate.leave_one_out.max(0)], -1)
    columns = estimate.parameters, estimate.values, estimate.std, ranges, estimate.jackknife_std
    for name, value, std, (low, high), jackknife in zip(*columns, strict=True):
        if value == 0 and std == 0:
            continue
        digits = 1 if name in _PIXELS else 4
        cells = [f"{number:.{digits}f}" for number in (value, std, low, high, jackknife)]
        rows.append([name, cells[0], cells[1], f"{cells[2]} to {cells[3]}", cells[4]])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(c.rjust(w) for c, w in zip(row, widths, strict=True)) for row in rows]


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
