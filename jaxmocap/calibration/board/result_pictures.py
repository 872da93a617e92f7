"""The pictures that a calibration leaves to look at.

INPUTS: BoardDetections and an IntrinsicsEstimate, or a Placement. OUTPUTS: JPEG files in a folder.
"""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from jaxmocap.calibration.board.boards import Board
from jaxmocap.calibration.board.finding import BoardDetections, Picture
from jaxmocap.calibration.board.opencv_lenses import project_points, tilt_degrees
from jaxmocap.calibration.extrinsics import Placement
from jaxmocap.calibration.intrinsics import IntrinsicsEstimate
from jaxmocap.capture.photographs import write_picture
from jaxmocap.formats.cameras.calibration import Intrinsics
from jaxmocap.formats.files.output_folder import OutputFolder

# BGR.
DETECTED_COLOUR = (90, 230, 90)
REPROJECTED_COLOUR = (60, 60, 255)
RESIDUAL_COLOUR = (0, 220, 255)
AXIS_COLOURS = {"x": (60, 60, 255), "y": (90, 230, 90), "z": (255, 150, 50)}
LEGEND = "green: detected, red: reprojected, yellow: residuals x {}"
WHITE = (255, 255, 255)
GREY = (70, 70, 70)
# Longer side of what is drawn, pixels.
_MAX_SIDE_PX = 1400
# Fractional bits of OpenCV's drawing coordinates.
_FIXED_POINT_BITS = 4
# A residual as large as the root mean square is drawn this part of the image long.
_ARROW_SHARE = 0.02


def magnification(rms: float, size: tuple[int, int]) -> int:
    """A round factor by which residuals are drawn longer, for one and all pictures."""
    wanted = _ARROW_SHARE * max(size) / max(rms, 1e-3)
    power = 10 ** np.floor(np.log10(wanted))
    return max(1, int(max(step * power for step in (1, 2, 5) if step * power <= wanted)))


class AnnotatedPicture:
    """A picture to draw on, in the original's pixels."""

    def __init__(self, image: np.ndarray):
        """Take a copy, smaller where the image is large."""
        self.scale = min(1.0, _MAX_SIDE_PX / max(image.shape[:2]))
        self.image = cv2.resize(
            image, None, fx=self.scale, fy=self.scale, interpolation=cv2.INTER_AREA
        )
        self._rows = 0

    def _at(self, pixel_xy: np.ndarray) -> tuple[int, int]:
        # The centre of pixel 0 moves by half of what the pixels grow; OpenCV overflows far outside.
        scaled = (np.asarray(pixel_xy, float) + 0.5) * self.scale - 0.5
        x, y = (np.clip(scaled, -1e4, 1e4) * 2**_FIXED_POINT_BITS).round().astype(int).tolist()
        return x, y

    def dot(self, pixel_xy: np.ndarray, colour: tuple, radius: int = 3, filled: int = -1) -> None:
        """A disc, or with ``filled`` a ring of that width; radius in drawn pixels."""
        centre, radius = self._at(pixel_xy), radius << _FIXED_POINT_BITS
        cv2.circle(self.image, centre, radius, colour, filled, cv2.LINE_AA, _FIXED_POINT_BITS)

    def line(self, start_xy: np.ndarray, end_xy: np.ndarray, colour: tuple, width: int = 2) -> None:
        """A straight line."""
        start, end = self._at(start_xy), self._at(end_xy)
        cv2.line(self.image, start, end, colour, width, cv2.LINE_AA, _FIXED_POINT_BITS)

    def text(self, text: str, pixel_xy: np.ndarray, colour: tuple) -> None:
        """Text with a dark rim, its lower left at a pixel."""
        x, y = (value >> _FIXED_POINT_BITS for value in self._at(pixel_xy))
        for dx, dy, ink in ((-1, -1, 0), (-1, 1, 0), (1, -1, 0), (1, 1, 0), (0, 0, 1)):
            shade, place = colour if ink else (0, 0, 0), (x + dx, y + dy)
            font = cv2.FONT_HERSHEY_SIMPLEX
            cv2.putText(self.image, text, place, font, 0.6, shade, 1, cv2.LINE_AA)

    def title(self, text: str) -> None:
        """The next line of text at the top left."""
        self._rows += 1
        self.text(text, np.array([10, 24.0 * self._rows]) / self.scale, WHITE)

    def corners(self, pixels_xy: np.ndarray) -> None:
        """Detected corners, a thin line through them in their order."""
        for start, end in pairwise(pixels_xy):
            self.line(start, end, DETECTED_COLOUR, 1)
        self.dots(pixels_xy)

    def dots(self, pixels_xy: np.ndarray) -> None:
        """Detected points."""
        for pixel in pixels_xy:
            self.dot(pixel, DETECTED_COLOUR, 5, 1)

    def residuals(self, pixels_xy: np.ndarray, residuals_xy: np.ndarray, times: int) -> None:
        """Reprojected points, and residuals so many times as long as they are."""
        for pixel, residual in zip(pixels_xy, residuals_xy, strict=True):
            self.line(pixel, pixel + times * residual, RESIDUAL_COLOUR, 2)
            self.dot(pixel + residual, REPROJECTED_COLOUR, 2)

    def axes(self, T_cam_frame: np.ndarray, lens: Intrinsics, length: float, name: str) -> None:
        """Axes of a frame, so long in metres; nothing where their origin is behind the camera."""
        tips = np.vstack([np.zeros(3), length * np.eye(3)])
        if ((tips @ T_cam_frame[2, :3]) + T_cam_frame[2, 3] <= 0.05).any():
            return
        rvec, _ = cv2.Rodrigues(T_cam_frame[:3, :3])
        origin, *ends = project_points(tips, rvec, T_cam_frame[:3, 3], lens)[0]
        for end, (axis, colour) in zip(ends, AXIS_COLOURS.items(), strict=True):
            self.line(origin, end, colour, 3)
            self.text(axis, end + 6, WHITE)
        self.dot(origin, WHITE, 5)
        self.text(name, origin + 10, WHITE)


def draw_coverage(
    size: tuple[int, int], views: Sequence[tuple[np.ndarray, np.ndarray]], times: int
) -> AnnotatedPicture:
    """The image's area: the lighter the more boards, with every corner and its residual.

    Views are pixels and residuals (N, 2) each, which are drawn so many times as long.
    """
    scale = min(1.0, _MAX_SIDE_PX / max(size))
    counts = np.zeros((round(size[1] * scale), round(size[0] * scale)), np.float32)
    for pixels_xy, _ in views:
        mask = np.zeros_like(counts)
        cv2.fillConvexPoly(mask, cv2.convexHull((pixels_xy * scale).round().astype(np.int32)), 1)
        counts += mask
    shade = np.where(counts > 0, 60 + 120 * counts / max(counts.max(), 1), 25).astype(np.uint8)
    canvas = AnnotatedPicture(np.repeat(shade[..., None], 3, axis=2))
    canvas.scale = scale
    for part in (1 / 3, 2 / 3):
        canvas.line(np.array([part * size[0], 0]), np.array([part * size[0], size[1]]), GREY, 1)
        canvas.line(np.array([0, part * size[1]]), np.array([size[0], part * size[1]]), GREY, 1)
    for pixels_xy, residuals_xy in views:
        canvas.residuals(pixels_xy, residuals_xy, times)
    canvas.title(f"corners of {len(views)} views; residuals x {times}")
    return canvas


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


def draw_views(
    detections: BoardDetections, result: IntrinsicsEstimate | None, folder: str | Path
) -> list[Path]:
    """Each picture with the corners that were found in it; of a calibration what came of them too.

    That is residuals, the board's axes, and the coverage.
    """
    times = 1 if result is None else magnification(result.rms, detections.size)
    views = {view.name: (view, None, True) for view in detections.views}
    if result is not None:
        both = zip(detections.views, result.poses, result.used, strict=True)
        views = {view.name: (view, pose, use) for view, pose, use in both}
    files = []
    for number, picture in enumerate(detections.pictures, 1):
        canvas = AnnotatedPicture(picture.image())
        canvas.title(picture.name)
        if picture.name in detections.not_found:
            canvas.title("NO BOARD FOUND")
        elif picture.name in detections.duplicates:
            canvas.title("the same as an earlier one")
        if picture.name in views:
            view, pose, use = views[picture.name]
            canvas.corners(view.pixels_xy)
            if not use:
                canvas.title("LEFT OUT: does not fit the other views")
            if result is not None:
                canvas.title(LEGEND.format(times if use else 1))
            if result is not None and pose is not None:
                canvas.title(f"{pose.rms:.2f} px RMS, tilt {tilt_degrees(pose):.0f} degrees")
                canvas.residuals(view.pixels_xy, pose.residuals_xy, times if use else 1)
                length = _BOARD_AXES_SQUARES * detections.board.square
                canvas.axes(pose.matrix, result.lens, length, "origin")
        # Numbered, so that files of one name from several folders do not meet.
        stem = Path(picture.name).name.replace(picture.path.suffix, "").replace(" ", "_")
        files.append(write_picture(Path(folder) / f"{number:02d}_{stem}.jpg", canvas.image))
    if result is None:
        return files
    used = [
        (view.pixels_xy, pose.residuals_xy) for view, pose, use in views.values() if use and pose
    ]
    coverage = draw_coverage(detections.size, used, times)
    return [*files, write_picture(Path(folder) / "coverage.jpg", coverage.image)]


def draw_placement(
    picture: Picture,
    lens: Intrinsics,
    placement: Placement,
    pixels_xy: np.ndarray,
    board: tuple[Board, np.ndarray] | None,
    folder: str | Path,
) -> list[Path]:
    """The photograph with what placed the camera, and the axes of the board and of the world.

    Points lie at pixels (N, 2); ``board`` comes with its T_world_board, None with listed points.
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
    return [write_picture(Path(folder) / f"{picture.path.stem}_placed.jpg", canvas.image)]
