"""Placing a camera in the world: the story of the command, from one photograph to a file.

INPUTS: a photograph; a board and where it stands, or listed points; the calibration file.
OUTPUTS: rotation and translation in the camera's section, a picture to look at, and an
ExtrinsicsResult.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.calibration.board.boards import Board
from jaxmocap.calibration.board.corners import Corners, find_corners
from jaxmocap.calibration.board.finding import Picture, hint_of_other_counts
from jaxmocap.calibration.board.result_pictures import draw_placement, picture_folder
from jaxmocap.calibration.extrinsics import (
    Placement,
    advice_on_board_pose,
    board_to_world,
    estimate_placement,
    is_wrong_way_up,
    position_world_of,
)
from jaxmocap.capture.video import check_size
from jaxmocap.formats.cameras.calibration import (
    check_camera_writable,
    read_intrinsics,
    write_camera,
)
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.time_series.axes import R_WORLD_OF_UP
from jaxmocap.formats.time_series.markers import read_points


@dataclass(frozen=True)
class PlacementTarget:
    """Where the board stands, or which points were listed: what the user measured."""

    board: Board | None = None  # in the photograph; None with points
    # Of the board in the world: x, y, z in metres, rx, ry, rz in degrees.
    pose: tuple[float, ...] | None = None
    # Pixel near the board's origin, for boards that look the same when turned.
    origin_xy: tuple[float, float] | None = None
    points: str | Path | None = None  # file of points
    up: str = "z"  # the axis that points up where these were measured, "z" or "y"


@dataclass(frozen=True)
class ExtrinsicsResult:
    """What ``place_camera`` found."""

    camera: str  # name of its section
    image: str  # the photograph's name
    names: tuple[str, ...]  # of the N points or corners
    placement: Placement  # the camera in the world, and residuals
    warnings: tuple[str, ...]  # sentences that a user should see
    files: tuple[Path, ...]  # written

    def text(self) -> str:
        """The camera's place and its standard deviation, warnings, files."""
        placement = self.placement
        x, y, z = placement.position_world
        lines = [
            f"[{self.camera}] stands at ({x:.3f}, {y:.3f}, {z:.3f}) m, looks along "
            f"{_vector(placement.T_cam_world[2, :3])}",
            f"  {self.image}: {placement.rms:.2f} pixels RMS over {placement.used.sum()} of "
            f"{len(self.names)} points",
            f"  standard deviation: {_vector(1e3 * placement.std_m, 1)} mm, "
            f"{placement.std_deg:.2f}°, by the corners' noise alone (not the intrinsics', nor that "
            "of what was measured)",
        ]
        if placement.mirrored is not None:
            lines.append(
                f"  the mirrored solution that a flat target has, at "
                f"{_vector(position_world_of(placement.mirrored))} m, fits "
                f"{placement.mirrored_ratio:.1f} times as badly"
            )
        lines += [f"warning: {sentence}" for sentence in self.warnings]
        return "\n".join([*lines, *(f"written  {path}" for path in self.files)])

    def figures(self) -> dict[str, Any]:
        """The same as figures, metres, degrees, pixels; what is not finite has none."""
        placement, mirrored = self.placement, self.placement.mirrored
        return {
            "camera": self.camera,
            "position_m": placement.position_world,
            "looks_along": placement.T_cam_world[2, :3],
            "rotation": placement.rotation,
            "translation_m": placement.T_cam_world[:3, 3],
            "rms_px": placement.rms,
            "position_std_m": placement.std_m,
            "direction_std_deg": placement.std_deg,
            "points": [
                {"name": name, "error_px": np.linalg.norm(residual), "used": use}
                for name, residual, use in zip(
                    self.names, placement.residuals_xy, placement.used, strict=True
                )
            ],
            "mirrored_position_m": None if mirrored is None else position_world_of(mirrored),
            "mirrored_ratio": placement.mirrored_ratio,
            "warnings": self.warnings,
            "files": self.files,
        }


def _vector(values: Sequence[float] | np.ndarray, digits: int = 2) -> str:
    return f"({', '.join(f'{value:.{digits}f}' for value in values)})"


def place_camera(
    image: str | Path,
    target: PlacementTarget,
    camera: str,
    out: str | Path,
    intrinsics: str | Path | None = None,
    pictures: str | Path | None = None,
    upside_down: bool = False,
) -> ExtrinsicsResult:
    """Place a camera and write its rotation and translation.

    Args:
        image: a photograph.
        target: the board's place, or points.
        camera: name of the section.
        out: the calibration file, .toml.
        intrinsics: file with the camera's intrinsics, .toml or OpenCV's .yml; None: ``out``.
        pictures: folder for what is drawn, or None. It is drawn even if the place is refused.
        upside_down: whether the camera hangs upside down, as from a ceiling.

    Raises:
        InputError: files that cannot be used, no board, one whose origin is ambiguous, or a
            camera that comes out the wrong way up; nothing is written then.
    """
    path, out = Path(image), Path(out)
    check_camera_writable(out, camera)
    folder = picture_folder(pictures, f"extrinsics of {camera}", [path])
    if intrinsics is None and not out.exists():
        expected = f"the intrinsics of {camera} there, or another file by --intrinsics"
        raise InputError(out, f"no such file, expected {expected}")
    lens = read_intrinsics(intrinsics or out, camera)
    picture = Picture(path.name, path)
    photo = picture.image()
    size_warning = check_size(photo.shape[1::-1], lens.size, path, "photograph")
    names, points_world, pixels_xy, T_world_board = _target_points(path, photo, target)
    where = target.points or path
    try:
        placement = estimate_placement(points_world, pixels_xy, lens, upside_down)
    except ArithmeticError as error:
        raise InputError(where, str(error)) from None
    drawings: list[Path] = []
    if folder is not None:
        board = None
        if target.board is not None and T_world_board is not None:
            board = target.board, T_world_board
        drawings = folder.write(partial(draw_placement, picture, lens, placement, pixels_xy, board))
    advice = "are the points in the world's axes (Z up, or --up y), and pixels unmirrored?"
    if T_world_board is not None:
        advice = advice_on_board_pose(placement.T_cam_world, T_world_board, upside_down)
    elif not placement.warnings:
        advice = None
    if is_wrong_way_up(placement.T_cam_world, upside_down):
        raise InputError(where, _refusal(upside_down, advice))
    entries = lens.entries() if intrinsics is not None else {}
    write_camera(out, camera, entries | placement.entries())
    warnings = (
        *([size_warning] if size_warning else []),
        *placement.warnings,
        *([advice] if advice else []),
        *_residual_warnings(placement, names),
    )
    return ExtrinsicsResult(camera, path.name, tuple(names), placement, warnings, (out, *drawings))


def _target_points(
    path: Path, photo: np.ndarray, target: PlacementTarget
) -> tuple[list[str], np.ndarray, np.ndarray, np.ndarray | None]:
    """Names, world places (N, 3), metres, and pixels (N, 2) of points, found or read.

    And T_world_board (4, 4); None with listed points. InputError where there is no board, or one
    whose origin is ambiguous.
    """
    R_world_file = R_WORLD_OF_UP[target.up]
    if target.points is not None:
        names, points, pixels_xy = read_points(target.points)
        return names, points @ R_world_file.T, pixels_xy, None
    board = target.board
    if board is None or target.pose is None:
        raise InputError(path, "needs a board and its pose, or a file of points")
    corners = find_corners(photo, board)
    if corners is None:
        hint = hint_of_other_counts([Picture(path.name, path)], board)
        raise InputError(path, f"found no {board.label} board{hint}")
    pixels_xy = _order_corners(path, corners, target.origin_xy)
    T_world_board = board_to_world(target.pose)
    T_world_board[:3] = R_world_file @ T_world_board[:3]
    points_world = corners.points_board @ T_world_board[:3, :3].T + T_world_board[:3, 3]
    names = [f"corner {i}" for i in range(1, len(points_world) + 1)]
    return names, points_world, pixels_xy, T_world_board


def _order_corners(
    path: Path, corners: Corners, origin_xy: tuple[float, float] | None
) -> np.ndarray:
    """Pixels in the board's order; with a symmetric board the user states the origin."""
    orders = [corners.pixels_xy, *corners.orders]
    if len(orders) == 1:
        return orders[0]
    if origin_xy is None:
        places = " or ".join(f"--origin {x:.0f},{y:.0f}" for x, y in (o[0] for o in orders))
        raise InputError(
            path,
            "the board looks the same when it is rotated (both counts even, or both odd), so its "
            f"origin is ambiguous: state where in the picture it is, {places}",
        )
    return min(orders, key=lambda order: float(np.linalg.norm(order[0] - origin_xy)))


def _refusal(upside_down: bool, advice: str | None) -> str:
    """Why a camera is not written."""
    problem = "the camera comes out upside down, expected it upright"
    remedy = "or does it hang upside down (--upside-down)?"
    if upside_down:
        problem = "the camera comes out upright, expected it upside down as --upside-down states"
        remedy = "or leave that out"
    return "; ".join(filter(None, (problem, advice, remedy)))


def _residual_warnings(placement: Placement, names: list[str]) -> list[str]:
    """Warnings about points that do not fit."""
    off = np.linalg.norm(placement.residuals_xy, axis=-1)
    warnings = [
        f"{names[i]} was left out: {off[i]:.0f} pixels from where the others put it"
        for i in np.flatnonzero(~placement.used)
    ]
    if placement.rms > 3:
        rms = f"{placement.rms:.1f} pixels"
        warnings.append(f"{rms} are a lot: the picture shows which points are off")
    return warnings
