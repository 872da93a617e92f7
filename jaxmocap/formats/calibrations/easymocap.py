"""Calibrations of EasyMocap: ``intri.yml`` beside ``extri.yml``.

INPUTS: one of the two, or their folder, in OpenCV's YAML: K_NAME, dist_NAME, and W_NAME and H_NAME
where there are; R_NAME (Rodrigues vector) or Rot_NAME (matrix) and T_NAME. OUTPUTS: the cameras.

As EasyMocap reads it (``mytools/camera_utils.py``, ``read_camera``): R and T are OpenCV's, from the
world to the camera. The world is the chessboard's: unit and axes are what a user gave it.
"""

import os

from jaxmocap.formats.calibrations.source import Source, SourceCalibration
from jaxmocap.formats.cameras.calibration import read_place
from jaxmocap.formats.cameras.opencv_yaml import camera_table, read_entries
from jaxmocap.formats.files.errors import InputError, short_name
from jaxmocap.formats.files.reading import regular_file
from jaxmocap.formats.files.toml import TomlTable

INTRINSICS, EXTRINSICS = "intri.yml", "extri.yml"
_LENS = {"matrix": "K", "distortions": "dist D", "size": "W H"}
_PLACE = {"rotation": "R Rot", "translation": "T"}


def read(source: Source) -> SourceCalibration | None:
    """The cameras that both files name; InputError where a file or a field is missing or wrong."""
    folder = source.path if os.path.isdir(source.path) else source.path.parent
    if folder == source.path:
        if not (folder / INTRINSICS).is_file():
            return None
    elif not any(key.startswith(("K_", "T_")) for key in source.yaml):
        return None
    files = {"K_": folder / INTRINSICS, "T_": folder / EXTRINSICS}
    # The file that was named has its part, whatever it is called.
    for part in files:
        if folder != source.path and any(key.startswith(part) for key in source.yaml):
            files[part] = source.path
    lenses, places = map(regular_file, files.values())
    of_lenses, of_places = read_entries(lenses), read_entries(places)
    cameras = []
    for name in (key.removeprefix("K_") for key in of_lenses if key.startswith("K_")):
        where = f"camera {short_name(name)}"
        lens = camera_table(lenses, of_lenses, _camera_keys(_LENS, name))
        place = camera_table(places, of_places, keys := _camera_keys(_PLACE, name))
        if missing := [each[0] for field, each in keys.items() if field not in place]:
            raise InputError(places, f"{where}: {missing[0]} is missing")
        read_place(TomlTable(places, where, place), "the board's unit")
        cameras.append((name, TomlTable(lenses, where, lens | place)))
    return SourceCalibration(cameras, "m", "z", states_unit=False, assumed_up="z is up")


def _camera_keys(keys: dict[str, str], name: str) -> dict[str, list[str]]:
    """Field -> keys of one camera."""
    return {field: [f"{key}_{name}" for key in each.split()] for field, each in keys.items()}
