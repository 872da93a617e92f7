"""Calibrations of Qualisys Track Manager: ``.qca.txt``, or .xml.

INPUTS: ``<calibration><cameras><camera serial=…>`` with ``<fov_video>``, ``<transform>`` and
``<intrinsic>``. OUTPUTS: its cameras; millimetres, Z up.

As Pose2Sim reads it (D. Pagnon, ``calibration.py``, ``read_qca``): r11 … r33 are the camera's axes
in the world, row by row, x to the right, y up, z backwards; x y z is its place. Intrinsics count in
1/64 pixel from the sensor's first pixel, ``fov_video`` in whole pixels.

The coefficients of distortion are OpenCV's as they stand. Pose2Sim divides them by 64 as well; but
on photographs by two such cameras OpenCV measures k1 = -0.066 and -0.051 where the file has -0.046
and -0.048, and k2 likewise. Qualisys does not document whether 0 is the first pixel's centre or its
edge: it is taken as the centre, as Pose2Sim does.
"""

import math

import numpy as np

from jaxmocap.formats.calibrations.source import (
    Source,
    SourceCalibration,
    SourceCamera,
    camera_place,
    from_position,
)
from jaxmocap.formats.calibrations.xml_text import attributes, text_attribute
from jaxmocap.formats.cameras.calibration import is_rotation
from jaxmocap.formats.files.short_repr import comma_list
from jaxmocap.formats.files.toml import TomlTable

SUB_PIXELS = 64
# From Qualisys' camera frame to OpenCV's, and back.
R_CAM_QUALISYS = np.diag([1.0, -1.0, -1.0])
_ROTATION = tuple(f"r{row}{column}" for row in "123" for column in "123")


def recognises(source: Source) -> bool:
    """Is it an XML file of Qualisys' elements?"""
    root = source.xml
    return (
        root is not None and root.tag == "calibration" and root.find("cameras/camera") is not None
    )


def read(source: Source) -> SourceCalibration:
    """The cameras that are calibrated.

    Raises:
        InputError: a field that is missing or does not fit.
    """
    cameras, left_out, rotated = [], [], []
    assert source.xml is not None
    for element in source.xml.iterfind("cameras/camera"):
        name = text_attribute(source.path, "<camera>", element, "serial")
        if element.get("calibrated", "true").lower() == "false":
            left_out.append(name)
            continue
        if element.get("viewrotation", "0") not in ("0", ""):
            rotated.append(name)
        where = camera_place(name)
        fields = {
            tag: attributes(source.path, where, element.find(tag), tag)
            for tag in ("transform", "intrinsic")
        }
        view = element.find("fov_video")
        window = None if view is None else attributes(source.path, where, view, "fov_video")
        cameras.append(_camera(name, fields["transform"], fields["intrinsic"], window))
    return SourceCalibration(tuple(cameras), "mm", "z", notes=_notes(left_out, rotated))


def _notes(left_out: list[str], rotated: list[str]) -> tuple[str, ...]:
    notes = []
    if left_out:
        notes.append(f"left out: not calibrated: {comma_list(left_out)}")
    if rotated:
        notes.append(
            f"viewrotation: {comma_list(rotated)}: the calibration is of the picture as the sensor "
            "has it, a video that was rotated does not fit"
        )
    return tuple(notes)


def _camera(
    name: str, transform: TomlTable, intrinsic: TomlTable, window: TomlTable | None
) -> SourceCamera:
    sensor = [_pixels(intrinsic, f"sensorMax{axis}") for axis in "UV"]
    left_top, size = np.zeros(2), np.array(sensor)
    if window is not None:
        left_top = np.array([window.number(key) for key in ("left", "top")])
        right_bottom = np.array([window.number(key) for key in ("right", "bottom")])
        size = right_bottom - left_top + 1
        if (right_bottom >= sensor).any():
            shown = f"{sensor[0]} x {sensor[1]} pixels of 1/{SUB_PIXELS}"
            problem = (
                f"found {right_bottom.tolist()}, beyond the sensor's {shown} (a binned video?)"
            )
            raise window.error("right, bottom", f"{problem}, expected Qualisys' units")
    focal = [intrinsic.number(f"focalLength{axis}") / SUB_PIXELS for axis in "UV"]
    centre = [intrinsic.number(f"centerPoint{axis}") / SUB_PIXELS for axis in "UV"] - left_top
    skew = intrinsic.number("skew", 0.0) / SUB_PIXELS
    R_qualisys_world = np.reshape([transform.number(key) for key in _ROTATION], (3, 3))
    if not is_rotation(R_qualisys_world):
        raise transform.error("r11 ... r33", "found a 3 × 3 matrix that is not a rotation")
    R_cam_world = R_CAM_QUALISYS @ R_qualisys_world
    position = np.array([transform.number(axis) for axis in "xyz"])
    return SourceCamera(
        name,
        np.array([[focal[0], skew, centre[0]], [0, focal[1], centre[1]], [0, 0, 1]]),
        _distortions(intrinsic),
        R_cam_world,
        from_position(R_cam_world, position),
        size,
    )


def _pixels(intrinsic: TomlTable, key: str) -> int:
    """How many pixels the sensor has to its last sub-pixel: of that, or of its last pixel."""
    return math.ceil((intrinsic.number(key, None, 0) + 1) / SUB_PIXELS)


def _distortions(intrinsic: TomlTable) -> np.ndarray:
    """k1 k2 p1 p2 k3; Qualisys writes tangental, others tangential."""
    word = "tangental" if "tangentalDistortion1" in intrinsic else "tangential"
    keys = ("radialDistortion1", "radialDistortion2", f"{word}Distortion1", f"{word}Distortion2")
    return np.array(
        [*(intrinsic.number(key) for key in keys), intrinsic.number("radialDistortion3", 0.0)]
    )
