"""Calibrations of Vicon's programs: ``.xcp``.

INPUTS: ``<Cameras><Camera DEVICEID=…><KeyFrames><KeyFrame …>``. OUTPUTS: its cameras; millimetres,
Z up.

As Vicon's CaraPost Reference describes it ("About calibration data (XCP) files"): ORIENTATION is a
quaternion, its last number the real part, and POSITION the camera's place. R_cam_world is that
quaternion's matrix, x to the right, y down, z forward. FOCAL_LENGTH, PRINCIPAL_POINT and the radial
terms are in pixels; a pixel is PIXEL_ASPECT_RATIO times as high as wide.

Vicon's radial polynomial takes distorted pixels to ideal ones, p - c = (d - c) (1 + k1 r² + k2 r⁴ +
k3 r⁶) with r = |d - c|: VICON_RADIAL2 has "Vicon3Parameter" c k1 k2 k3, the older VICON_RADIAL only
k1 k2 about the principal point. OpenCV's takes ideal points to distorted ones. Its coefficients are
fitted over the whole picture, and a note states what the fit leaves.
"""

from contextlib import suppress

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from jaxmocap.formats.calibrations.source import Source, SourceCalibration, left_out
from jaxmocap.formats.calibrations.xml_cameras import XmlCamera, pinhole
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.toml import TomlTable
from jaxmocap.geometry.cameras import lens_problem
from jaxmocap.geometry.lenses import BROWN_CONRADY, LENSES

# Pixels: a fit that leaves more anywhere in the picture does not describe the lens.
LARGEST_RESIDUAL = 0.5
# Below this, less than such a calibration is good to, the five usual coefficients are enough.
SMALL_RESIDUAL = 0.1
# No lens moves a corner of the picture so many times as far out.
LARGEST_STRETCH = 100.0
# Points across and down the picture, its edges included.
GRID = (33, 25)
UNIT_TOLERANCE = 1e-3
RADIAL2_MODEL = "Vicon3Parameter"


def read(source: Source) -> SourceCalibration | None:
    """The cameras that take video; all, where none says that it does.

    Raises:
        InputError: a field that is missing or does not fit, a moving camera, or a lens that
            OpenCV's model does not describe.
    """
    elements = source.xml.findall("Cameras/Camera")
    if not elements:
        return None
    video = [each for each in elements if "video" in each.get("TYPE", "").lower()]
    cameras, unplaced, worst = [], [], 0.0
    for element in video or elements:
        camera = XmlCamera(source.path, element, "DEVICEID")
        if not (frames := element.findall("KeyFrames/KeyFrame")):
            unplaced.append(camera.name)
            continue
        if len(frames) > 1:
            problem = f"found {len(frames)} <KeyFrame>, expected one of a camera that stands still"
            raise InputError(source.path, f"{camera.where}: {problem}")
        section, residual = _camera(camera)
        cameras.append(section)
        worst = max(worst, residual)
    notes = [f"lenses: OpenCV's model fits Vicon's within {worst:.2g} pixels"]
    notes += left_out("not calibrated", unplaced)
    if others := len(elements) - len(video or elements):
        notes.append(f"left out: {others} cameras that take no video")
    return SourceCalibration(cameras, "mm", "z", notes=notes)


def _camera(camera: XmlCamera) -> tuple[tuple[str, TomlTable], float]:
    """Its section, and the largest difference of its fitted lens, pixels."""
    device, frame = camera.fields("."), camera.fields("KeyFrames/KeyFrame")
    size = device.array("SENSOR_SIZE", [(2,)], "width and height in pixels")
    if (size < 1).any():
        raise device.error("SENSOR_SIZE", f"found {size.tolist()}, expected positive numbers")
    focal = frame.number("FOCAL_LENGTH", None, 1e-3)
    aspect = device.number("PIXEL_ASPECT_RATIO", 1.0, 0.1, 10)
    centre = frame.array("PRINCIPAL_POINT", [(2,)], "2 numbers in pixels")
    matrix = pinhole(np.array([focal, focal / aspect]), centre)
    quaternion = frame.array("ORIENTATION", [(4,)], "a quaternion, its real part last")
    if abs(np.linalg.norm(quaternion) - 1) > UNIT_TOLERANCE:
        raise frame.error("ORIENTATION", f"found {quaternion.tolist()}, expected length 1")
    R_cam_world = Rotation.from_quat(quaternion).as_matrix()
    position = frame.array("POSITION", [(3,)], "3 numbers in millimetres")
    distortions, residual = _fitted_lens(*_pairs(frame, matrix, size), matrix)
    if residual > LARGEST_RESIDUAL:
        problem = f"OpenCV's model fits this lens only within {residual:.2g} pixels"
        raise frame.error("VICON_RADIAL", f"{problem}, expected {LARGEST_RESIDUAL:g} or less")
    return camera.section(size, matrix, distortions, R_cam_world, position), residual


def _radial(frame: TomlTable, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre (2,) of the distortion, pixels, and k1 k2 k3 of Vicon's polynomial."""
    if "VICON_RADIAL2" in frame:
        model, *words = str(frame.require("VICON_RADIAL2")).split()
        try:
            numbers = np.array(words, float)
        except ValueError:
            numbers = np.zeros(0)
        if model != RADIAL2_MODEL or numbers.shape != (5,) or not np.isfinite(numbers).all():
            expected = f"{RADIAL2_MODEL} and 5 numbers"
            raise frame.error("VICON_RADIAL2", f"found {model}, expected {expected}")
        return numbers[:2], numbers[2:]
    if "VICON_RADIAL" not in frame:
        return matrix[:2, 2], np.zeros(3)
    numbers = frame.array("VICON_RADIAL", [(2,)], "2 numbers")
    return matrix[:2, 2], np.array([*numbers, 0.0])


def _pairs(frame: TomlTable, matrix: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 2) of the picture, pixels, and where an ideal lens has them on the plane z = 1."""
    centre, (k1, k2, k3) = _radial(frame, matrix)
    about = np.column_stack([matrix[:, :2], [*centre, 1.0]])
    if problem := lens_problem(size, matrix, np.zeros(0)) or lens_problem(size, about, np.zeros(0)):
        raise frame.error("", problem[1])
    sides = [np.linspace(0, n - 1, count) for n, count in zip(size, GRID, strict=True)]
    pixels = np.stack(np.meshgrid(*sides), -1).reshape(-1, 2)
    offsets = pixels - centre
    r2 = (offsets**2).sum(1, keepdims=True)
    with np.errstate(over="ignore", invalid="ignore"):
        slope = 1 + r2 * (3 * k1 + r2 * (5 * k2 + r2 * 7 * k3))
        stretch = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    if not (slope > 0).all():
        problem = "the polynomial folds the picture's corners inwards"
        raise frame.error("VICON_RADIAL", f"{problem}, expected one that grows")
    if not (stretch < LARGEST_STRETCH).all():
        problem = f"the polynomial moves corners {stretch.max():.2g} times as far out"
        raise frame.error("VICON_RADIAL", f"{problem}, expected less than {LARGEST_STRETCH:g}")
    ideal = centre + offsets * stretch
    return pixels, (ideal - matrix[:2, 2]) / matrix[[0, 1], [0, 1]]


def _fitted_lens(
    pixels: np.ndarray, plane: np.ndarray, matrix: np.ndarray
) -> tuple[np.ndarray, float]:
    """k1 k2 p1 p2 k3 k4 k5 k6 of (N, 2) pixels of points on z = 1, and how far the worst is off."""
    focal, centre = matrix[[0, 1], [0, 1]], matrix[:2, 2]
    x, y = plane.T

    def differences(first: np.ndarray) -> np.ndarray:
        k = np.append(first, np.zeros(8 - len(first)))
        distorted = np.stack(LENSES[BROWN_CONRADY].distort(k, x, y), -1)
        return (distorted * focal + centre - pixels).ravel()

    def largest(k: np.ndarray) -> float:
        left = np.linalg.norm(differences(k).reshape(-1, 2), axis=1)
        return float(np.nan_to_num(left, nan=np.inf).max())

    k = np.zeros(8)
    with np.errstate(all="ignore"):
        # In the first five the distortion is linear.
        for count in (5, 8):
            with suppress(ValueError):
                k[:count] = least_squares(differences, k[:count], max_nfev=200).x
            if (residual := largest(k)) <= SMALL_RESIDUAL:
                break
    return k, residual
