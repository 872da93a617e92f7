"""Marker files of any kind, by their suffix.

INPUTS: a .trc, .csv or .c3d file; or a .bvh or .glb file, whose joints are the markers.
OUTPUTS: Markers in metres, in the file's own axes. Or points whose places in space and in a picture
are both measured.
"""

from pathlib import Path

import numpy as np

from jaxmocap.formats.animation.bvh import read_bvh
from jaxmocap.formats.animation.gltf_in import read_gltf
from jaxmocap.formats.armatures.armature import Armature, joint_positions
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.reading import read_lines
from jaxmocap.formats.time_series.c3d import read_c3d
from jaxmocap.formats.time_series.csv import read_csv
from jaxmocap.formats.time_series.tables import Markers, parse_rows
from jaxmocap.formats.time_series.trc import read_trc


def _joints(armature: Armature) -> Markers:
    return Markers(armature.times, armature.names, joint_positions(armature))


_READERS = {
    ".trc": read_trc,
    ".csv": read_csv,
    ".c3d": read_c3d,
    ".bvh": lambda path: _joints(read_bvh(path)),
    ".glb": lambda path: _joints(read_gltf(path)),
}


def default_up(path: str | Path) -> str:
    """The vertical axis, "y" or "z", that files of a suffix have if nobody says otherwise."""
    return "y" if Path(path).suffix.lower() in (".bvh", ".glb") else "z"


def read_markers(path: str | Path) -> Markers:
    """Read a marker file by its suffix; InputError for an unknown one, or as its reader says."""
    suffix = Path(path).suffix.lower()
    if suffix not in _READERS:
        raise InputError(path, f"unknown suffix {suffix!r}, expected one of {', '.join(_READERS)}")
    return _READERS[suffix](path)


_COLUMNS = ["x", "y", "z", "u", "v"]
# Nobody measures more by hand, and the work grows with their square.
MAX_POINTS = 1000


def read_points(path: str | Path) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Read a file of points, those without a name called by their line; InputError names it."""
    lines = read_lines(path)
    header = [cell.strip() for cell in lines[0].split(",")]
    named = header == ["name", *_COLUMNS]
    if not named and header != _COLUMNS:
        problem = f"line 1: found {lines[0][:40]!r}, expected 'x,y,z,u,v' or 'name,x,y,z,u,v'"
        raise InputError(path, problem)
    rows = [(i, line.split(",")) for i, line in enumerate(lines, 1) if i > 1]
    table, numbers = parse_rows(path, ((i, cells[named:]) for i, cells in rows), len(_COLUMNS))
    if len(table) > MAX_POINTS:
        raise InputError(path, f"found {len(table)} points, expected at most {MAX_POINTS}")
    missing = np.isnan(table).any(1)
    if missing.any():
        raise InputError(path, f"line {numbers[int(missing.argmax())]}: a number is missing")
    labels = {i: cells[0].strip() for i, cells in rows} if named else {}
    names = [labels.get(i) or f"line {i}" for i in numbers]
    return names, table[:, :3], table[:, 3:]
