"""Calibrating a camera's intrinsics: the story of the command, from photographs to a file.

INPUTS: photographs or videos of a board; the calibration file to change.
OUTPUTS: the camera's section in that file, pictures to look at, and a Calibrated that tells what
was found.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from jaxmocap.formats.calibration import Lens, check_writable, read_lens, write_camera
from jaxmocap.formats.errors import InputError
from jaxmocap.formats.toml import read_toml
from jaxmocap.setup.boards import Board
from jaxmocap.setup.corners import find_coarsely, find_corners
from jaxmocap.setup.coverage import FEWEST, Coverage, covered, distinct, remarks, too_alike
from jaxmocap.setup.drawing import LEGEND, Canvas, draw_coverage, magnification, write_canvas
from jaxmocap.setup.intrinsics import PARAMETERS, Intrinsics, View, calibrate
from jaxmocap.setup.pictures import Picture, open_pictures
from jaxmocap.setup.poses import tilt

# How many pictures without a board are looked through for a board of other counts.
_HINTS = 3
# Named in a message at most.
_NAMED = 8


@dataclass(frozen=True)
class Calibrated:
    """What ``calibrate_intrinsics`` found.

    Attributes:
        camera: name of its section.
        board: that was looked for.
        views: in which it was found, each once; ``result.used`` says which the result rests on.
        result: the calibration.
        coverage: of the image by the views used.
        not_found: names of the pictures without a board.
        repeated: names of the pictures that show the same as an earlier one.
        before: the lens that the file held of this camera, or None.
        remarks: sentences that a user should see.
        files: written.
    """

    camera: str
    board: Board
    views: tuple[View, ...]
    result: Intrinsics
    coverage: Coverage
    not_found: tuple[str, ...]
    repeated: tuple[str, ...]
    before: Lens | None
    remarks: tuple[str, ...]
    files: tuple[Path, ...] = ()

    @property
    def left_out(self) -> list[tuple[str, float]]:
        """Pictures whose corners do not fit the others', and their residual in pixels."""
        return [(name, error) for name, error, _, use in self.rows() if not use]

    def rows(self) -> list[tuple[str, float, float, bool]]:
        """Name, residual (pixels, RMS), tilt (degrees) and whether it was used, of each view."""
        both = zip(self.views, self.result.poses, self.result.used, strict=True)
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
    coefficients: int = 4,
    pictures: str | Path | None = None,
) -> Calibrated:
    """Calibrate a camera and write its section.

    Args:
        paths: photographs, or videos of which frames are chosen.
        board: that they show.
        camera: name of the section to add or replace.
        out: the calibration file, .toml.
        coefficients: of distortion: 0, 1 (k1), 2 (k1 k2), 4 (k1 k2 p1 p2) or 5 (and k3).
        pictures: folder for what is drawn, or None.

    Raises:
        InputError: files that cannot be used, or views that do not determine the camera.
    """
    check_writable(Path(out), camera)
    before, placed = _already(Path(out), camera)
    shown, said = open_pictures(paths, board)
    where = _together(paths)
    found, missing, size = _search(shown, board, where)
    views, repeated = distinct(found)
    if len(views) < FEWEST:
        hint = other_counts([p for p in shown if p.name in missing][:_HINTS], board)
        raise InputError(where, f"{_too_few(board, views, missing, repeated, said)}{hint}")
    try:
        result = calibrate(views, size, coefficients)
    except ArithmeticError as error:
        raise InputError(where, f"the views determine no camera: {error}") from None
    if (why := too_alike(result)) is not None:
        raise InputError(where, why)
    used = [view for view, use in zip(views, result.used, strict=True) if use]
    if len(used) < FEWEST:
        others = ", ".join(v.name for v, use in zip(views, result.used, strict=True) if not use)
        raise InputError(
            where, f"only {len(used)} views agree, expected {FEWEST} or more; not with: {others}"
        )
    coverage = covered(used, size)
    said = [*said, *remarks(result, coverage), *_changes(result, before, placed)]
    calibrated = Calibrated(
        camera,
        board,
        tuple(views),
        result,
        coverage,
        tuple(missing),
        tuple(repeated),
        before,
        tuple(said),
    )
    drawn = [] if pictures is None else _draw(calibrated, shown, Path(pictures))
    write_camera(out, camera, result.lens.entries())
    return replace(calibrated, files=(Path(out), *drawn))


def _already(out: Path, camera: str) -> tuple[Lens | None, bool]:
    """The lens that the file holds of this camera, and whether it holds its place too."""
    table = read_toml(out).get(camera, {}) if out.exists() else {}
    lens = read_lens(out, camera) if "matrix" in table and "size" in table else None
    return lens, "rotation" in table


def _together(paths: Sequence[str | Path]) -> str:
    return str(paths[0]) if len(paths) == 1 else f"{paths[0]} and {len(paths) - 1} more"


def _search(
    shown: Sequence[Picture], board: Board, where: str
) -> tuple[list[View], list[str], tuple[int, int]]:
    """Views, names of pictures without a board, and the size that all pictures have."""
    views, missing = [], []
    sizes: dict[tuple[int, int], str] = {}
    for picture in shown:
        image = picture.image()
        sizes.setdefault((image.shape[1], image.shape[0]), picture.name)
        if len(sizes) > 1:
            found = ", ".join(f"{name} {w} × {h}" for (w, h), name in sizes.items())
            raise InputError(where, f"pictures differ in size, expected one camera's: {found}")
        corners = find_corners(image, board)
        if corners is None:
            missing.append(picture.name)
        else:
            views.append(View(picture.name, corners.points_board, corners.pixels_xy))
    return views, missing, next(iter(sizes), (0, 0))


def _too_few(
    board: Board,
    views: Sequence[View],
    missing: Sequence[str],
    repeated: Sequence[str],
    said: Sequence[str],
) -> str:
    """In how few pictures the board was found, and in which it was not."""
    total = len(views) + len(missing) + len(repeated)
    parts = [f"found the {board.label} board in {len(views)} different pictures of {total}", *said]
    for names, what in ((missing, "no board in"), (repeated, "the same as an earlier one:")):
        if names:
            more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
            parts.append(f"{what} {', '.join(names[:_NAMED])}{more}")
    return "; ".join([*parts, f"expected {FEWEST} or more"])


def other_counts(pictures: Sequence[Picture], board: Board) -> str:
    """A hint where the pictures show a board of other counts; nothing where they do not."""
    c, r = board.columns, board.rows
    tried = [(c - 1, r - 1), (c + 1, r + 1)]
    if board.dictionary is not None:
        tried.insert(0, (r, c))
    for columns, rows in tried:
        if min(columns, rows) < 3:
            continue
        other = board.resized(columns, rows)
        for picture in pictures:
            grey = cv2.cvtColor(picture.image(), cv2.COLOR_BGR2GRAY)
            if find_coarsely(grey, other) is not None:
                return (
                    f"; {picture.name} shows a {other.label} board: inner corners are counted, "
                    "where four squares meet, not squares"
                )
    return ""


def _changes(result: Intrinsics, before: Lens | None, placed: bool) -> list[str]:
    """What is to be said of the calibration that the file held already."""
    said = []
    if before is not None:
        K = before.matrix
        old = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])
        change, doubt = result.values[:4] - old, result.doubt[:4]
        far = [
            f"{name} by {step:+.1f} pixels ({abs(step) / sure:.0f} standard deviations)"
            for name, step, sure in zip(PARAMETERS, change, doubt, strict=False)
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


def _draw(calibrated: Calibrated, shown: Sequence[Picture], folder: Path) -> list[Path]:
    """One picture for each given one, and the coverage."""
    result, lens = calibrated.result, calibrated.result.lens
    size = (int(lens.size[0]), int(lens.size[1]))
    times = magnification(result.rms, size)
    found = {
        view.name: (view, pose, use)
        for view, pose, use in zip(calibrated.views, result.poses, result.used, strict=True)
    }
    files = []
    for number, picture in enumerate(shown, 1):
        canvas = Canvas(picture.image())
        canvas.title(picture.name)
        if picture.name in found:
            view, pose, use = found[picture.name]
            canvas.corners(view.pixels_xy)
            if pose is not None:
                canvas.title(f"{pose.rms:.2f} px RMS, tilt {tilt(pose):.0f} degrees")
                canvas.residuals(view.pixels_xy, pose.residuals_xy, times if use else 1)
                canvas.axes(pose.matrix, lens, 2 * calibrated.board.square, "origin")
            canvas.title(LEGEND.format(times) if use else f"LEFT OUT, {LEGEND.format(1)}")
        else:
            again = picture.name in calibrated.repeated
            canvas.title("the same as an earlier one" if again else "NO BOARD FOUND")
        stem = picture.name.replace(".", "_").replace(" ", "_")
        files.append(write_canvas(folder / f"{number:02d}_{stem}.jpg", canvas))
    used = [
        (view.pixels_xy, pose.residuals_xy) for view, pose, use in found.values() if use and pose
    ]
    pixels, residuals = zip(*used, strict=True)
    canvas = draw_coverage(size, pixels, residuals, times)
    return [*files, write_canvas(folder / "coverage.jpg", canvas)]
