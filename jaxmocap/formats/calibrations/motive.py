"""Calibrations of OptiTrack's Motive: ``.mcal``, from Motive 3.2 on.

INPUTS: ``<Camera Serial=…>`` with ``<Attributes>``, ``<IntrinsicStandardCameraModel>`` and
``<Extrinsic>``. OUTPUTS: its cameras; metres, Y up.

OptiTrack documents the elements (".mcal XML Calibration Files"). Of the two lens models the
standard one is OpenCV's; ``<Intrinsic>`` is Motive's own and is not described. X Y Z is the
camera's place. OrientMatrix0 … 8 is R_world_camera, row by row, of a camera frame as OpenGL has it.
So two published readers have it that were compared with pictures. OptiTrack states neither that nor
the order of the tangential terms, which are taken as OpenCV's p1 p2: a note says so.
"""

from jaxmocap.formats.calibrations.source import Source, SourceCalibration
from jaxmocap.formats.calibrations.xml_cameras import R_CAM_OPENGL, XmlCamera, pinhole

NOTE = (
    "assumed: camera frames like OpenGL's and tangential terms in OpenCV's order, which OptiTrack "
    "does not state: look at an overlay first"
)
MODEL = "IntrinsicStandardCameraModel"


def read(source: Source) -> SourceCalibration | None:
    """All cameras; InputError where a field of one does not fit."""
    cameras = []
    for element in source.xml.findall("*/Calibration/Cameras/Camera"):
        camera = XmlCamera(source.path, element, "Serial")
        size = camera.numbers("Attributes", "ImagerPixelWidth", "ImagerPixelHeight")
        focal = camera.numbers(MODEL, "HorizontalFocalLength", "VerticalFocalLength")
        centre = camera.numbers(MODEL, "LensCenterX", "LensCenterY")
        distortions = camera.numbers(MODEL, "k1", "k2", "TangentialX", "TangentialY", "k3")
        orientation = camera.rotation("Extrinsic", *(f"OrientMatrix{i}" for i in range(9)))
        position = camera.numbers("Extrinsic", *"XYZ")
        R_cam_world = R_CAM_OPENGL @ orientation.T
        matrix = pinhole(focal, centre)
        cameras.append(camera.section(size, matrix, distortions, R_cam_world, position))
    return SourceCalibration(cameras, "m", "y", notes=(NOTE,)) if cameras else None
