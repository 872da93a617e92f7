"""Marker files of any kind, told by their suffix.

INPUTS: a .trc, .csv or .c3d file.
OUTPUTS: Markers in metres, in the file's own axes.
"""

from pathlib import Path

from jaxmocap.formats.c3d import read_c3d
from jaxmocap.formats.csv import read_csv
from jaxmocap.formats.errors import InputError
from jaxmocap.formats.tables import Markers
from jaxmocap.formats.trc import read_trc

_READERS = {".trc": read_trc, ".csv": read_csv, ".c3d": read_c3d}


def read_markers(path: str | Path) -> Markers:
    """Read a marker file by its suffix.

    Raises:
        InputError: an unknown suffix, or what the reader of that format finds wrong.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _READERS:
        raise InputError(path, f"unknown suffix {suffix!r}, expected one of {', '.join(_READERS)}")
    return _READERS[suffix](path)
