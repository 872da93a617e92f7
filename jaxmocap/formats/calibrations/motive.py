"""Calibrations of OptiTrack's Motive: ``.mcal``, from Motive 3.2 on.

INPUTS: ``<Camera Serial=…>`` with ``<Attributes>``, ``<IntrinsicStandardCameraModel>`` and
``<Extrinsic>``. OUTPUTS: its cameras; metres, Y up.

OptiTrack documents the elements (".mcal XML Calibration Files"). Of the two lens models the
standard one is OpenCV's; ``<Intrinsic>`` is Motive's own and is not described. X Y Z is the
camera's place. OrientMatrix0 … 8 is R_world_camera, row by row, of a camera frame as OpenGL has it:
x to the right, y up, z backwards. So two published readers have it that were compared with
pictures. OptiTrack states neither that nor the order of the tangential terms, which are taken as
OpenCV's p1 p2: a note says so.
"""

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
from jaxmocap.formats.files.toml import TomlTable

R_CAM_OPENGL = np.diag([1.0, -1.0, -1.0])
NOTE = (
    "assumed: camera frames like OpenGL's and tangential terms in OpenCV's order, which OptiTrack "
    "does not state: look at an overlay first"
)
MODEL = "IntrinsicStandardCameraModel"
_CAMERAS = "Calibration/Cameras/Camera"


def recognises(source: Source) -> bool:
    """Is it an XML file of Motive's elements?"""
    return source.xml is not None and source.xml.find(_CAMERAS) is not None


def read(source: Source) -> SourceCalibration:
    """All cameras.

    Raises:
        InputError: a field that is missing or does not fit.
    """
    assert source.xml is not None
    cameras = []
    for element in source.xml.iterfind(_CAMERAS):
        name = text_attribute(source.path, "<Camera>", element, "Serial")
        where = camera_place(name)
        sensor, lens, place = (
            attributes(source.path, where, element.find(tag), tag)
            for tag in ("Attributes", MODEL, "Extrinsic")
        )
        cameras.append(_camera(name, sensor, lens, place))
    return SourceCalibration(tuple(cameras), "m", "y", notes=(NOTE,))


def _camera(name: str, sensor: TomlTable, lens: TomlTable, place: TomlTable) -> SourceCamera:
    size = np.array([sensor.number(f"ImagerPixel{side}") for side in ("Width", "Height")])
    focal = [lens.number(f"{axis}FocalLength") for axis in ("Horizontal", "Vertical")]
    centre = [lens.number(f"LensCenter{axis}") for axis in "XY"]
    keys = ("k1", "k2", "TangentialX", "TangentialY", "k3")
    R_world_opengl = np.reshape([place.number(f"OrientMatrix{i}") for i in range(9)], (3, 3))
    if not is_rotation(R_world_opengl):
        raise place.error("OrientMatrix0 ... 8", "found a 3 × 3 matrix that is not a rotation")
    R_cam_world = R_CAM_OPENGL @ R_world_opengl.T
    position = np.array([place.number(axis) for axis in "XYZ"])
    return SourceCamera(
        name,
        np.array([[focal[0], 0, centre[0]], [0, focal[1], centre[1]], [0, 0, 1]]),
        np.array([lens.number(key) for key in keys]),
        R_cam_world,
        from_position(R_cam_world, position),
        size,
    )
