"""Calibrations of OpenCap: ``cameraIntrinsicsExtrinsics.pickle``, one for each camera.

INPUTS: such a file, or a session's folder (``Videos/Cam0/cameraIntrinsicsExtrinsics.pickle``).
OUTPUTS: its cameras, named after their folders; millimetres, the checkerboard's axes.

As OpenCap writes it (opencap-core, ``utilsChecker.calcExtrinsics``): rotation and translation are
OpenCV's, from the board to the camera; imageSize is height, width. The board stands on end: its y
points down, or up where it is upside down, which OpenCap decides by the first camera
(``isCheckerboardUpsideDown``). A board on the ground needs --source-up.
"""

from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.formats.calibrations.plain_pickle import (
    FIRST_BYTE,
    MAX_PICKLE_BYTES,
    read_plain_pickle,
)
from jaxmocap.formats.calibrations.source import Source, SourceCalibration
from jaxmocap.formats.files.errors import InputError, short_name, short_repr
from jaxmocap.formats.files.reading import read_bytes
from jaxmocap.formats.files.toml import TomlTable

FILE = "cameraIntrinsicsExtrinsics.pickle"
MAX_CAMERAS = 100
# Of a session, of a folder with nothing else, or of one camera's.
_FOLDERS = (f"Videos/*/{FILE}", f"*/{FILE}", FILE, "*.pickle")
_FIELDS = {"intrinsicMat": 9, "imageSize": 2, "rotation": 9, "translation": 3}
_MOST_COEFFICIENTS = 14


def read(source: Source) -> SourceCalibration | None:
    """The cameras of a file or of a folder; InputError for other than plain, fitting values."""
    files = next(filter(None, (sorted(source.path.glob(each)) for each in _FOLDERS)), [])
    if len(files) > MAX_CAMERAS:
        raise InputError(source.path, f"found {len(files)} cameras, expected at most {MAX_CAMERAS}")
    cameras = [] if source.pickled is None else [_camera(source.path, source.pickled)]
    for path in files:
        content = read_bytes(path, MAX_PICKLE_BYTES)
        if content[:1] != FIRST_BYTE:
            raise InputError(path, "not a pickle of protocol 2 or later")
        cameras.append(_camera(path, read_plain_pickle(path, content)))
    if not cameras:
        return None
    upside_down = cameras[0][1].entries["rotation"][1][1] < 0
    side, up = ("upside down", "y") if upside_down else ("not upside down", "minus-y")
    return SourceCalibration(
        cameras, "mm", up, assumed_up=f"the checkerboard stands on end, {side}"
    )


def _camera(path: Path, table: Any) -> tuple[str, TomlTable]:
    name = path.parent.name if path.name == FILE else path.stem
    if not isinstance(table, dict):
        expected = f"expected a dict with {', '.join(_FIELDS)} and distortion"
        raise InputError(path, f"found {short_repr(table)}, {expected}")
    where = f"camera {short_name(name)}"
    # Arrays as flat lists of numbers; whatever else there is as its description.
    lists = {key: value.ravel().tolist() if isinstance(value, np.ndarray) else short_repr(value)
             for key, value in table.items()}  # fmt: skip
    fields = TomlTable(path, where, lists)
    flat = {key: fields.array(key, [(count,)], f"an array of {count} numbers")
            for key, count in _FIELDS.items()}  # fmt: skip
    counts = [(n,) for n in range(_MOST_COEFFICIENTS + 1)]
    distortions = fields.array("distortion", counts, f"at most {_MOST_COEFFICIENTS} numbers")
    section = {
        "size": flat["imageSize"][::-1].tolist(),
        "matrix": flat["intrinsicMat"].reshape(3, 3).tolist(),
        "distortions": distortions.tolist(),
        "rotation": flat["rotation"].reshape(3, 3).tolist(),
        "translation": flat["translation"].tolist(),
    }
    return name, TomlTable(path, where, section)
