"""Marker files of any kind, by their suffix.

INPUTS: a .trc, .csv or .c3d file; or a .bvh or .glb file, whose joints are the markers.
OUTPUTS: Markers in metres, in the file's own axes.
"""

from pathlib import Path

from jaxmocap.formats.animation.bvh_in import read_bvh
from jaxmocap.formats.animation.gltf_in import read_gltf
from jaxmocap.formats.armatures.armature import Armature, joint_positions
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.time_series.c3d import read_c3d
from jaxmocap.formats.time_series.csv import read_csv
from jaxmocap.formats.time_series.tables import Markers
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
    """Read a marker file by its suffix.

    Raises:
        InputError: an unknown suffix, or what the reader of that format finds wrong.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _READERS:
        raise InputError(path, f"unknown suffix {suffix!r}, expected one of {', '.join(_READERS)}")
    return _READERS[suffix](path)
