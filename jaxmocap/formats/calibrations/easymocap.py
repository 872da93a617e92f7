"""Calibrations of EasyMocap: ``intri.yml`` beside ``extri.yml``.

INPUTS: one of the two, or their folder, in OpenCV's YAML: K_NAME, dist_NAME, and W_NAME and H_NAME
where there are; R_NAME (Rodrigues vector) or Rot_NAME (matrix) and T_NAME. OUTPUTS: the cameras.

As EasyMocap reads it (``mytools/camera_utils.py``, ``read_camera``): R and T are OpenCV's, from the
world to the camera. The world is the chessboard's: unit and axes are what a user gave it.
"""

from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.formats.calibrations.source import (
    Source,
    SourceCalibration,
    SourceCamera,
    camera_place,
)
from jaxmocap.formats.cameras.calibration import read_place
from jaxmocap.formats.cameras.opencv_yaml import matrix_of, read_entries
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.reading import regular_file
from jaxmocap.formats.files.short_repr import short_repr
from jaxmocap.formats.files.toml import TomlTable

INTRINSICS, EXTRINSICS = "intri.yml", "extri.yml"
_MARKS = ("K_", "T_")


def recognises(source: Source) -> bool:
    """Is it one of EasyMocap's two files, or their folder?"""
    if source.is_folder:
        return (source.path / INTRINSICS).is_file()
    return any(key.startswith(_MARKS) for key in source.yaml or ())


def read(source: Source) -> SourceCalibration:
    """The cameras that both files name.

    Raises:
        InputError: one of the files is missing, or a field is missing or does not fit.
    """
    folder = source.path if source.is_folder else source.path.parent
    lenses, places = (regular_file(folder / name) for name in (INTRINSICS, EXTRINSICS))
    of_lenses, of_places = read_entries(lenses), read_entries(places)
    names = [key.removeprefix("K_") for key in of_lenses if key.startswith("K_")]
    cameras = tuple(_camera(name, lenses, of_lenses, places, of_places) for name in names)
    return SourceCalibration(cameras, "m", "z", states_unit=False, assumed_up="z is up")


def _camera(
    name: str, lenses: Path, of_lenses: dict[str, Any], places: Path, of_places: dict[str, Any]
) -> SourceCamera:
    where = camera_place(name)
    matrix = np.array(matrix_of(lenses, f"K_{name}", of_lenses[f"K_{name}"], flat=False))
    if matrix.shape != (3, 3):
        raise InputError(lenses, f"K_{name}: found {matrix.shape}, expected a 3 × 3 matrix")
    found = next((key for key in (f"dist_{name}", f"D_{name}") if key in of_lenses), None)
    distortions = matrix_of(lenses, found, of_lenses[found], flat=True) if found else []
    turned = next((key for key in (f"R_{name}", f"Rot_{name}") if key in of_places), f"R_{name}")
    table = {}
    for field, key in (("rotation", turned), ("translation", f"T_{name}")):
        if key not in of_places:
            raise InputError(places, f"{where}: {key} is missing")
        table[field] = matrix_of(places, key, of_places[key], flat=True)
    rotation, translation = read_place(TomlTable(places, where, table), "the board's unit")
    size = None
    if f"W_{name}" in of_lenses and f"H_{name}" in of_lenses:
        size = np.array([_whole(lenses, f"{side}_{name}", of_lenses) for side in "WH"])
    return SourceCamera(name, matrix, np.array(distortions, float), rotation, translation, size)


def _whole(path: Path, key: str, entries: dict[str, Any]) -> float:
    try:
        return float(entries[key])
    except (TypeError, ValueError):
        found = short_repr(entries[key])
        raise InputError(path, f"{key}: found {found}, expected a number of pixels") from None
