"""The pictures that a calibration leaves to look at.

INPUTS: BoardDetections and an IntrinsicsEstimate, or a Placement. OUTPUTS: JPEG files in a folder.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from jaxmocap.calibration.board.boards import Board
from jaxmocap.calibration.board.drawing import (
    LEGEND,
    AnnotatedPicture,
    draw_coverage,
    magnification,
    write_annotated,
)
from jaxmocap.calibration.board.finding import BoardDetections
from jaxmocap.calibration.board.pictures import Picture
from jaxmocap.calibration.extrinsics import Placement
from jaxmocap.calibration.intrinsics import BoardView, IntrinsicsEstimate
from jaxmocap.calibration.planar_poses import CameraPose, tilt_degrees
from jaxmocap.formats.cameras.calibration import Intrinsics
from jaxmocap.formats.files.output_folder import OutputFolder

# Axes of the world are drawn this long, metres,
_WORLD_AXES_M = 0.5
# and the board's this many squares.
_BOARD_AXES_SQUARES = 2


def picture_folder(
    directory: str | Path | None, kind: str, inputs: Iterable[str | Path]
) -> OutputFolder | None:
    """The folder for a calibration's pictures, checked before any work; None without one.

    Raises:
        InputError: it cannot be written to, or holds one of the inputs.
    """
    return None if directory is None else OutputFolder(directory, kind, (), inputs)


def draw_detections(detections: BoardDetections, folder: str | Path) -> list[Path]:
    """Each picture with the corners that were found in it: all there is without a calibration."""
    views = {view.name: view for view in detections.views}
    files = []
    for number, picture in enumerate(detections.pictures, 1):
        canvas = _titled(detections, picture)
        if picture.name in views:
            canvas.corners(views[picture.name].pixels_xy)
        files.append(write_annotated(_file(folder, number, picture), canvas))
    return files


def draw_intrinsics(
    detections: BoardDetections, result: IntrinsicsEstimate, folder: str | Path
) -> list[Path]:
    """Each picture with corners, residuals and the board's axes; and the coverage."""
    times = magnification(result.rms, detections.size)
    results = {
        view.name: (view, pose, use)
        for view, pose, use in zip(detections.views, result.poses, result.used, strict=True)
    }
    files = []
    for number, picture in enumerate(detections.pictures, 1):
        canvas = _titled(detections, picture)
        if picture.name in results:
            _draw_view(canvas, *results[picture.name], result.lens, detections.board, times)
        files.append(write_annotated(_file(folder, number, picture), canvas))
    used = [
        (view.pixels_xy, pose.residuals_xy) for view, pose, use in results.values() if use and pose
    ]
    coverage = draw_coverage(detections.size, used, times)
    return [*files, write_annotated(Path(folder) / "coverage.jpg", coverage)]


def _titled(detections: BoardDetections, picture: Picture) -> AnnotatedPicture:
    canvas = AnnotatedPicture(picture.image())
    canvas.title(picture.name)
    if picture.name in detections.not_found:
        canvas.title("NO BOARD FOUND")
    elif picture.name in detections.duplicates:
        canvas.title("the same as an earlier one")
    return canvas


def _file(folder: str | Path, number: int, picture: Picture) -> Path:
    # Numbered, so that files of one name from several folders do not meet.
    stem = Path(picture.name).name.replace(picture.path.suffix, "").replace(" ", "_")
    return Path(folder) / f"{number:02d}_{stem}.jpg"


def _draw_view(
    canvas: AnnotatedPicture,
    view: BoardView,
    pose: CameraPose | None,
    use: bool,
    lens: Intrinsics,
    board: Board,
    times: int,
) -> None:
    canvas.corners(view.pixels_xy)
    if not use:
        times = 1
        canvas.title("LEFT OUT: does not fit the other views")
    canvas.title(LEGEND.format(times))
    if pose is not None:
        canvas.title(f"{pose.rms:.2f} px RMS, tilt {tilt_degrees(pose):.0f} degrees")
        canvas.residuals(view.pixels_xy, pose.residuals_xy, times)
        canvas.axes(pose.matrix, lens, _BOARD_AXES_SQUARES * board.square, "origin")


def draw_placement(
    picture: Picture,
    lens: Intrinsics,
    placement: Placement,
    pixels_xy: np.ndarray,
    board: tuple[Board, np.ndarray] | None,
    folder: str | Path,
) -> Path:
    """The photograph with what placed the camera, and the axes of the board and of the world.

    Args:
        picture: the photograph.
        lens: of the camera.
        placement: of the camera.
        pixels_xy: (N, 2) where points were detected.
        board: and its T_world_board; None with listed points.
        folder: to write to.
    """
    photo = picture.image()
    times = magnification(placement.rms, (photo.shape[1], photo.shape[0]))
    canvas = AnnotatedPicture(photo)
    x, y, z = placement.position_world
    canvas.title(picture.name)
    canvas.title(f"camera at ({x:.2f}, {y:.2f}, {z:.2f}) m, {placement.rms:.2f} px RMS")
    canvas.title(LEGEND.format(times))
    if board is None:
        canvas.dots(pixels_xy)
    else:
        canvas.corners(pixels_xy)
        length = _BOARD_AXES_SQUARES * board[0].square
        canvas.axes(placement.T_cam_world @ board[1], lens, length, "board")
    for which, longer in ((placement.used, times), (~placement.used, 1)):
        canvas.residuals(pixels_xy[which], placement.residuals_xy[which], longer)
    if board is None or np.abs(board[1] - np.eye(4)).max() > 1e-6:
        canvas.axes(placement.T_cam_world, lens, _WORLD_AXES_M, "world")
    return write_annotated(Path(folder) / f"{picture.path.stem}_placed.jpg", canvas)
