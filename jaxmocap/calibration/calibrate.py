"""Calibrating a camera's intrinsics: the story of the command, from photographs to a file.

INPUTS: photographs or videos of a board; the calibration file to change.
OUTPUTS: the camera's section in that file, pictures to look at, and a Calibrated that tells what
was found.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from jaxmocap.calibration.board.boards import Board
from jaxmocap.calibration.board.finding import FEWEST, Found, find_boards
from jaxmocap.calibration.board.opencv_lenses import LensKind
from jaxmocap.calibration.board.sheets import draw_calibrated, draw_found, picture_folder
from jaxmocap.calibration.intrinsics import Intrinsics, calibrate
from jaxmocap.calibration.planar_poses import tilt
from jaxmocap.calibration.view_coverage import Coverage, covered, remarks, too_alike
from jaxmocap.formats.cameras.calibration import Lens, check_writable, read_lens, write_camera
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.toml import read_toml


@dataclass(frozen=True)
class Calibrated:
    """What ``calibrate_intrinsics`` found.

    Attributes:
        camera: name of its section.
        found: the board in pictures; ``result.used`` says on which views the result rests.
        result: the calibration.
        coverage: of the image by the views used.
        remarks: sentences that a user should see.
        files: written.
    """

    camera: str
    found: Found
    result: Intrinsics
    coverage: Coverage
    remarks: tuple[str, ...]
    files: tuple[Path, ...]

    def rows(self) -> list[tuple[str, float, float, bool]]:
        """Name, residual (pixels, RMS), tilt (degrees) and whether it was used, of each view."""
        both = zip(self.found.views, self.result.poses, self.result.used, strict=True)
        nothing = float("inf"), float("nan")
        return [
            (view.name, *((pose.rms, tilt(pose)) if pose else nothing), use)
            for view, pose, use in both
        ]


def calibrate_intrinsics(
    paths: Sequence[str | Path],
    board: Board,
    camera: str,
    out: str | Path,
    kind: LensKind | None = None,
    pictures: str | Path | None = None,
) -> Calibrated:
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
    check_writable(out, camera)
    folder = picture_folder(pictures, f"intrinsics of {camera}", paths)
    before, placed = _already(out, camera)
    found = find_boards(paths, board)
    try:
        result = _determined(found, kind)
    except InputError:
        if folder is not None:
            folder.write(partial(draw_found, found))
        raise
    coverage = covered(
        [v for v, use in zip(found.views, result.used, strict=True) if use], found.size
    )
    said = [*found.said, *remarks(result, coverage), *_changes(result, before, placed)]
    drawn = [] if folder is None else folder.write(partial(draw_calibrated, found, result))
    write_camera(out, camera, result.lens.entries())
    return Calibrated(camera, found, result, coverage, tuple(said), (out, *drawn))


def _already(out: Path, camera: str) -> tuple[Lens | None, bool]:
    """The lens that the file holds of this camera, and whether it holds its place too."""
    table = read_toml(out).get(camera, {}) if out.exists() else {}
    lens = read_lens(out, camera) if "matrix" in table and "size" in table else None
    return lens, "rotation" in table


def _determined(found: Found, kind: LensKind) -> Intrinsics:
    """The calibration; InputError with the reason where the views do not determine it."""
    if (why := found.too_few()) is not None:
        raise InputError(found.where, why)
    try:
        result = calibrate(found.views, found.size, kind)
    except ArithmeticError as error:
        raise InputError(found.where, f"the views determine no camera: {error}") from None
    if (why := too_alike(result)) is not None:
        raise InputError(found.where, why)
    if (count := sum(result.used)) < FEWEST:
        both = zip(found.views, result.used, strict=True)
        others = ", ".join(view.name for view, use in both if not use)
        problem = f"only {count} views agree, expected {FEWEST} or more; not with them: {others}"
        raise InputError(found.where, problem)
    return result


def _changes(result: Intrinsics, before: Lens | None, placed: bool) -> list[str]:
    """What is to be said of the calibration that the file held already."""
    said = []
    if before is not None:
        K = before.matrix
        old = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])
        change, doubt = result.values[:4] - old, result.doubt[:4]
        far = [
            f"{name} by {step:+.1f} pixels ({abs(step) / sure:.0f} standard deviations)"
            for name, step, sure in zip(result.parameters, change, doubt, strict=False)
            if abs(step) > 3 * sure
        ]
        if far:
            said.append(
                f"differs from the calibration that the file held, {', '.join(far)}: more than "
                "chance explains, so the two methods or models differ systematically"
            )
    if placed:
        said.append(
            "rotation and translation were kept as they were, found with other intrinsics: run "
            "jaxmocap calibrate extrinsics again"
        )
    return said
