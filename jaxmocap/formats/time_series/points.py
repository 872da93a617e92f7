"""Points whose places in space and in a picture are both measured.

INPUTS: a comma-separated file whose header is ``x,y,z,u,v`` or ``name,x,y,z,u,v``: metres, and
pixels (u to the right, v down); one row per point.
OUTPUTS: names, (N, 3) metres in the file's own axes, (N, 2) pixels.
"""

from pathlib import Path

import numpy as np

from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.lines import read_lines
from jaxmocap.formats.time_series.tables import parse_rows

_COLUMNS = ["x", "y", "z", "u", "v"]
# Nobody measures more by hand, and the work grows with their square.
MAX_POINTS = 1000


def read_points(path: str | Path) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Read a file of points; one without a name is called by its line.

    Raises:
        InputError: no such file, or the line that does not fit.
    """
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
