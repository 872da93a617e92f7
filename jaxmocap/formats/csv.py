"""CSV: markers as any spreadsheet or data frame writes them.

INPUTS: a comma-separated file whose header is ``time,Name.x,Name.y,Name.z,...``: seconds and
metres, one row per sample, empty cells where a marker is missing.
OUTPUTS: Markers in the file's own axes; or such a file.
"""

import csv
import io
from pathlib import Path

import numpy as np

from jaxmocap.formats.atomic import replacing
from jaxmocap.formats.errors import InputError
from jaxmocap.formats.tables import (
    Markers,
    format_rows,
    make_markers,
    parse_rows,
    read_lines,
    stack_points,
)

HEADER = "'time,Name.x,Name.y,Name.z,...'"


def read_csv(path: str | Path) -> Markers:
    """Read a CSV file of markers.

    Raises:
        InputError: no such file, or the line that does not fit.
    """
    lines = read_lines(path)
    names = _names(path, lines[0])
    data = ((i, line.split(",")) for i, line in enumerate(lines, 1) if i > 1)
    table, numbers = parse_rows(path, data, 1 + 3 * len(names))
    return make_markers(path, table, numbers, names, "line 1")


def _names(path: str | Path, header: str) -> list[str]:
    try:
        # The reader gives an empty line no cell at all.
        cells = [cell.strip() for cell in next(csv.reader([header]))] or [""]
    except csv.Error as error:
        raise InputError(path, f"line 1: {error}, expected {HEADER}") from None
    names = [cell[:-2] for cell in cells[1::3]]
    if cells[0] != "time" or not names:
        raise InputError(path, f"line 1: found {header[:40]!r}, expected {HEADER}")
    expected = [f"{name}.{axis}" for name in names for axis in "xyz"]
    for i, cell in enumerate(expected):
        found = cells[i + 1] if i + 1 < len(cells) else "the end of the line"
        if found != cell or len(cell) == 2:
            raise InputError(path, f"line 1: found {found!r} where {cell!r} belongs ({HEADER})")
    return names


def write_csv(path: str | Path, times: np.ndarray, points: dict[str, np.ndarray]) -> None:
    """Write a CSV file of markers.

    Args:
        path: of the file.
        times: (T,) seconds, ascending.
        points: marker -> (T, 3) positions, metres; NaN where missing.

    Raises:
        ValueError: shapes or names that do not fit.
    """
    times, positions = stack_points(times, points, forbidden="\r\n\0")
    header = io.StringIO()
    columns = ["time", *(f"{name}.{axis}" for name in points for axis in "xyz")]
    csv.writer(header, lineterminator="\n").writerow(columns)
    rows = zip(times, format_rows(positions), strict=True)
    lines = [",".join([f"{t:.9f}", *row]) for t, row in rows]
    with replacing(path) as beside:
        beside.write_text(header.getvalue() + "\n".join(lines) + "\n", "utf-8", newline="\n")
