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

from jaxmocap.formats.calibrations.source import (
    Source,
    SourceCalibration,
    SourceCamera,
    camera_place,
    from_position,
)
from jaxmocap.formats.calibrations.xml_text import attributes, text_attribute
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.short_repr import comma_list
from jaxmocap.formats.files.toml import TomlTable
from jaxmocap.geometry.lenses import BROWN_CONRADY, LENSES

# Pixels: a fit that leaves more anywhere in the picture does not describe the lens.
LARGEST_RESIDUAL = 0.5
# Below this, less than such a calibration is good to, the five usual coefficients are enough.
SMALL_RESIDUAL = 0.1
# Points across and down the picture, its edges included.
GRID = (33, 25)
UNIT_TOLERANCE = 1e-3
RADIAL2_MODEL = "Vicon3Parameter"


def recognises(source: Source) -> bool:
    """Is it an XML file of Vicon's elements?"""
    root = source.xml
    return root is not None and root.tag == "Cameras" and root.find("Camera") is not None


def read(source: Source) -> SourceCalibration:
    """The cameras that take video; all, where none says that it does.

    Raises:
        InputError: a field that is missing or does not fit, a moving camera, or a lens that
            OpenCV's model does not describe.
    """
    assert source.xml is not None
    elements = source.xml.findall("Camera")
    video = [each for each in elements if "video" in each.get("TYPE", "").lower()]
    cameras, left_out, worst = [], [], 0.0
    for element in video or elements:
        name = text_attribute(source.path, "<Camera>", element, "DEVICEID")
        where = camera_place(name)
        frames = element.findall("KeyFrames/KeyFrame")
        if not frames:
            left_out.append(name)
            continue
        if len(frames) > 1:
            problem = f"found {len(frames)} <KeyFrame>, expected one of a camera that stands still"
            raise InputError(source.path, f"{where}: {problem}")
        frame = attributes(source.path, where, frames[0], "KeyFrame")
        camera, residual = _camera(name, attributes(source.path, where, element, "Camera"), frame)
        cameras.append(camera)
        worst = max(worst, residual)
    notes = [f"lenses: OpenCV's model fits Vicon's within {worst:.2g} pixels"]
    if left_out:
        notes.append(f"left out: not calibrated: {comma_list(left_out)}")
    if others := len(elements) - len(video or elements):
        notes.append(f"left out: {others} cameras that take no video")
    return SourceCalibration(tuple(cameras), "mm", "z", notes=tuple(notes))


def _camera(name: str, device: TomlTable, frame: TomlTable) -> tuple[SourceCamera, float]:
    """A camera, and the largest difference of its fitted lens, pixels."""
    size = device.array("SENSOR_SIZE", [(2,)], "width and height in pixels")
    if (size < 1).any():
        raise device.error("SENSOR_SIZE", f"found {size.tolist()}, expected positive numbers")
    focal = frame.number("FOCAL_LENGTH", None, 1e-3)
    aspect = device.number("PIXEL_ASPECT_RATIO", 1.0, 0.1, 10)
    centre = frame.array("PRINCIPAL_POINT", [(2,)], "2 numbers in pixels")
    matrix = np.array([[focal, 0, centre[0]], [0, focal / aspect, centre[1]], [0, 0, 1]])
    quaternion = frame.array("ORIENTATION", [(4,)], "a quaternion, its real part last")
    if abs(np.linalg.norm(quaternion) - 1) > UNIT_TOLERANCE:
        raise frame.error("ORIENTATION", f"found {quaternion.tolist()}, expected length 1")
    R_cam_world = Rotation.from_quat(quaternion).as_matrix()
    position = frame.array("POSITION", [(3,)], "3 numbers in millimetres")
    distortions, residual = fitted_lens(*_pairs(frame, matrix, size), matrix)
    if residual > LARGEST_RESIDUAL:
        problem = f"OpenCV's model fits this lens only within {residual:.2g} pixels"
        raise frame.error("VICON_RADIAL", f"{problem}, expected {LARGEST_RESIDUAL:g} or less")
    translation = from_position(R_cam_world, position)
    return SourceCamera(name, matrix, distortions, R_cam_world, translation, size), residual


def _radial(frame: TomlTable, matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre (2,) of the distortion, pixels, and k1 k2 k3 of Vicon's polynomial."""
    if "VICON_RADIAL2" in frame:
        model, *words = str(frame.required("VICON_RADIAL2")).split()
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
    sides = [np.linspace(0, n - 1, count) for n, count in zip(size, GRID, strict=True)]
    pixels = np.stack(np.meshgrid(*sides), -1).reshape(-1, 2)
    offsets = pixels - centre
    r2 = (offsets**2).sum(1, keepdims=True)
    slope = 1 + r2 * (3 * k1 + r2 * (5 * k2 + r2 * 7 * k3))
    if not (slope > 0).all():
        problem = "the polynomial folds the picture's corners inwards"
        raise frame.error("VICON_RADIAL", f"{problem}, expected one that grows")
    ideal = centre + offsets * (1 + r2 * (k1 + r2 * (k2 + r2 * k3)))
    return pixels, (ideal - matrix[:2, 2]) / matrix[[0, 1], [0, 1]]


def fitted_lens(
    pixels: np.ndarray, plane: np.ndarray, matrix: np.ndarray
) -> tuple[np.ndarray, float]:
    """OpenCV's coefficients of a lens that is given by points.

    Args:
        pixels: (N, 2) distorted points, pixels.
        plane: (N, 2) the same points on the plane z = 1.
        matrix: (3, 3) intrinsic matrix.

    Returns:
        k1 k2 p1 p2 k3, with k4 k5 k6 where the lens needs them, else 0; and the largest distance
        that they leave, pixels.
    """
    focal, centre = matrix[[0, 1], [0, 1]], matrix[:2, 2]
    x, y = plane.T

    def differences(k: np.ndarray) -> np.ndarray:
        return np.stack(LENSES[BROWN_CONRADY].distort(k, x, y), -1) * focal + centre - pixels

    def largest(k: np.ndarray) -> float:
        left = np.linalg.norm(differences(k), axis=1)
        return float(np.nan_to_num(left, nan=np.inf).max())

    k = np.append(_polynomial(x, y, (pixels - centre) / focal), np.zeros(3))
    with np.errstate(all="ignore"):
        if largest(k) > SMALL_RESIDUAL:
            with suppress(ValueError):
                k = least_squares(lambda k: differences(k).ravel(), k, max_nfev=200).x
        return k, largest(k)


def _polynomial(x: np.ndarray, y: np.ndarray, target: np.ndarray) -> np.ndarray:
    """k1 k2 p1 p2 k3, in which the distortion is linear."""
    r2 = x * x + y * y
    across = [x * r2, x * r2**2, 2 * x * y, r2 + 2 * x * x, x * r2**3]
    down = [y * r2, y * r2**2, r2 + 2 * y * y, 2 * x * y, y * r2**3]
    terms = np.concatenate([np.stack(across, -1), np.stack(down, -1)])
    off = (target - np.stack([x, y], -1)).T.ravel()
    return np.linalg.lstsq(terms, off, rcond=None)[0]
