"""Calibrations of Qualisys Track Manager: ``.qca.txt``, or .xml.

INPUTS: ``<calibration><cameras><camera serial=…>`` with ``<fov_video>``, ``<transform>`` and
``<intrinsic>``. OUTPUTS: its cameras; millimetres, Z up.

As Pose2Sim reads it (D. Pagnon, ``calibration.py``, ``read_qca``): r11 … r33 are the camera's axes
in the world, row by row, as OpenGL has them; x y z is its place. Intrinsics count in 1/64 pixel
from the sensor's first pixel, ``fov_video`` in whole pixels.

The coefficients of distortion are OpenCV's as they stand. Pose2Sim divides them by 64 as well; but
on photographs by two such cameras OpenCV measures k1 = -0.066 and -0.051 where the file has -0.046
and -0.048, and k2 likewise. Qualisys does not document whether 0 is the first pixel's centre or its
edge: it is taken as the centre, as Pose2Sim does.
"""

import math

import numpy as np

from jaxmocap.formats.calibrations.source import Source, SourceCalibration, left_out
from jaxmocap.formats.calibrations.xml_cameras import R_CAM_OPENGL, XmlCamera, pinhole
from jaxmocap.formats.files.errors import comma_list
from jaxmocap.formats.files.toml import TomlTable

SUB_PIXELS = 64


def read(source: Source) -> SourceCalibration | None:
    """The cameras that are calibrated; InputError where a field of one does not fit."""
    elements = source.xml.findall("calibration/cameras/camera")
    if not elements:
        return None
    cameras, uncalibrated, rotated = [], [], []
    for element in elements:
        camera = XmlCamera(source.path, element, "serial")
        if element.get("calibrated", "true").lower() == "false":
            uncalibrated.append(camera.name)
            continue
        if element.get("viewrotation", "0") not in ("0", ""):
            rotated.append(camera.name)
        cameras.append(_camera(camera))
    notes = left_out("not calibrated", uncalibrated)
    if rotated:
        notes.append(
            f"viewrotation: {comma_list(rotated)}: the calibration is of the picture as the sensor "
            "has it, a video that was rotated does not fit"
        )
    return SourceCalibration(cameras, "mm", "z", notes=notes)


def _camera(camera: XmlCamera) -> tuple[str, TomlTable]:
    lens = camera.fields("intrinsic")
    # How many pixels the sensor has to its last sub-pixel: of that, or of its last pixel.
    sensor = [math.ceil((lens.number(f"sensorMax{axis}", None, 0) + 1) / SUB_PIXELS)
              for axis in "UV"]  # fmt: skip
    left_top, size = np.zeros(2), np.array(sensor)
    if camera.element.find("fov_video") is not None:
        left_top = camera.numbers("fov_video", "left", "top")
        right_bottom = camera.numbers("fov_video", "right", "bottom")
        size = right_bottom - left_top + 1
        if (right_bottom >= sensor).any():
            shown = f"{sensor[0]} x {sensor[1]} pixels of 1/{SUB_PIXELS}"
            problem = (
                f"found {right_bottom.tolist()}, beyond the sensor's {shown} (a binned video?)"
            )
            error = camera.fields("fov_video").error
            raise error("right, bottom", f"{problem}, expected Qualisys' units")
    focal = camera.numbers("intrinsic", "focalLengthU", "focalLengthV") / SUB_PIXELS
    centre = camera.numbers("intrinsic", "centerPointU", "centerPointV") / SUB_PIXELS
    matrix = pinhole(focal, centre - left_top, lens.number("skew", 0.0) / SUB_PIXELS)
    rows = (f"r{row}{column}" for row in "123" for column in "123")
    R_cam_world = R_CAM_OPENGL @ camera.rotation("transform", *rows)
    # Qualisys writes tangental, others tangential.
    word = "tangental" if "tangentalDistortion1" in lens else "tangential"
    keys = ("radialDistortion1", "radialDistortion2", f"{word}Distortion1", f"{word}Distortion2")
    k3 = lens.number("radialDistortion3", 0.0)
    distortions = np.append(camera.numbers("intrinsic", *keys), k3)
    position = camera.numbers("transform", *"xyz")
    return camera.section(size, matrix, distortions, R_cam_world, position)
