"""Camera calibrations in the TOML layout that anipose and Pose2Sim share.

INPUTS: a .toml file with one section per camera: size, matrix, distortions, rotation (Rodrigues
vector, world to camera), translation (metres, world to camera), fisheye.
OUTPUTS: Cameras by the name of their section; or such a file.
"""

from pathlib import Path

import numpy as np

from jaxmocap.formats.errors import InputError
from jaxmocap.formats.toml import Fields, read_toml, toml_key, write_toml
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.rotations import log

# A section of this name tells about the calibration, not of a camera.
METADATA = "metadata"
# How far R Rᵀ may be from the identity: files print four digits or more.
ORTHONORMAL = 1e-3
_COUNTS = [(n,) for n in range(9)]


def read_calibration(path: str | Path) -> dict[str, Camera]:
    """Read every camera of a calibration file.

    Raises:
        InputError: no such file, no camera in it, or a field that is missing or does not fit.
    """
    path = Path(path)
    sections = {name: table for name, table in read_toml(path).items() if name != METADATA}
    if not sections:
        raise InputError(path, "found no camera section")
    return {name: _camera(Fields(path, f"[{name}]", table)) for name, table in sections.items()}


def pick_camera(path: str | Path, cameras: dict[str, Camera], name: str) -> Camera:
    """The camera of that section; InputError lists the sections there are."""
    if name not in cameras:
        raise InputError(path, f"section [{name}] is missing, found {', '.join(cameras)}")
    return cameras[name]


def _camera(fields: Fields) -> Camera:
    if fields.table.get("fisheye", False):
        raise fields.error("fisheye", "fisheye lenses are not supported yet, expected false")
    size = fields.array("size", [(2,)], "[width, height] in pixels")
    if (size <= 0).any():
        raise fields.error("size", f"found {size.tolist()}, expected two positive numbers")
    distortions = (
        fields.array("distortions", _COUNTS, "at most 8 numbers (k1 k2 p1 p2 k3 k4 k5 k6)")
        if "distortions" in fields
        else np.zeros(0)
    )
    translation = fields.array("translation", [(3,)], "3 numbers in metres")
    return Camera.create(
        (size[0], size[1]), _matrix(fields), distortions, _rotation(fields), translation
    )


def _matrix(fields: Fields) -> np.ndarray:
    matrix = fields.array("matrix", [(3, 3)], "a 3 × 3 matrix")
    if matrix[0, 0] <= 0 or matrix[1, 1] <= 0 or not np.allclose(matrix[2], [0, 0, 1]):
        raise fields.error(
            "matrix",
            f"found {matrix.tolist()}, expected positive focal lengths and a last row of 0 0 1",
        )
    return matrix


def _rotation(fields: Fields) -> np.ndarray:
    expected = "a Rodrigues vector of 3 numbers or a 3 × 3 rotation matrix"
    rotation = fields.array("rotation", [(3,), (3, 3)], expected)
    if rotation.ndim == 2 and (not orthonormal(rotation) or np.linalg.det(rotation) < 0):
        raise fields.error("rotation", "found a 3 × 3 matrix that is not a rotation")
    return rotation


def orthonormal(matrix: np.ndarray) -> bool:
    """Are the rows of a (3, 3) matrix unit vectors at right angles, as far as files print them?"""
    return bool(np.abs(matrix @ matrix.T - np.eye(3)).max() <= ORTHONORMAL)


def write_calibration(path: str | Path, cameras: dict[str, Camera]) -> None:
    """Write a calibration file with one section per camera.

    Args:
        path: of the file.
        cameras: section -> Camera.
    """
    tables = []
    for name, camera in cameras.items():
        distortion = np.asarray(camera.distortion, float)
        # Four coefficients where that is all, as most readers expect them.
        count = 4 if not distortion[4:].any() else 5 if not distortion[5:].any() else 8
        T_cam_world = np.asarray(camera.T_cam_world, float)
        entries = {
            "name": name,
            "size": np.asarray(camera.size, float),
            "matrix": np.asarray(camera.matrix, float),
            "distortions": distortion[:count],
            "rotation": np.asarray(log(camera.T_cam_world[:3, :3]), float),
            "translation": T_cam_world[:3, 3],
            "fisheye": False,
        }
        tables.append((f"[{toml_key(name)}]", entries))
    write_toml(path, tables)
