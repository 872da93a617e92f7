"""CSV: markers as any spreadsheet or data frame writes them.

INPUTS: a comma-separated file whose header is ``time,Name.x,Name.y,Name.z,...``: seconds and
metres, one row per sample, empty cells where a marker is missing. A marker with an orientation
has ``Name.qw,Name.qx,Name.qy,Name.qz`` after its place: a unit quaternion from its own axes
to the file's.
OUTPUTS: Markers in the file's own axes; or such a file.
"""

import csv
import io
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from jaxmocap.body.orientations import matrices, quaternions
from jaxmocap.formats.files.errors import InputError, short_repr
from jaxmocap.formats.files.reading import numbered_lines
from jaxmocap.formats.files.writing import write_lines
from jaxmocap.formats.time_series.tables import (
    MAX_VALUES,
    Markers,
    make_markers,
    parse_rows,
    row_texts,
    stack_points,
)
from jaxmocap.geometry.rows import ComputedRows, Index, Rows

HEADER = "'time,Name.x,Name.y,Name.z,...', with Name.qw,Name.qx,Name.qy,Name.qz after or without"

# Numbers of a file with quaternions, each of which becomes nine: 0.4 GB.
MAX_VALUES_WITH_ORIENTATIONS = 35_000_000


def read_csv(path: str | Path) -> Markers:
    """Read a CSV file of markers; InputError names the line that does not fit."""
    lines = numbered_lines(path)
    names, has_orientation = _names(path, next(lines)[1])
    data = ((number, line.split(",")) for number, line in lines)
    widths = [7 if oriented else 3 for oriented in has_orientation]
    most = MAX_VALUES_WITH_ORIENTATIONS if any(has_orientation) else MAX_VALUES
    table, numbers = parse_rows(path, data, 1 + sum(widths), most)
    if not any(has_orientation):
        return make_markers(path, table, numbers, names, "line 1")
    starts = 1 + np.concatenate([[0], np.cumsum(widths)[:-1]])
    columns_of = [0, *(first + axis for first in starts for axis in range(3))]
    markers = make_markers(path, table[:, columns_of], numbers, names, "line 1")
    orientations = np.full((len(table), len(names), 3, 3), np.nan)
    for i, first in enumerate(starts):
        if has_orientation[i]:
            quaternions = table[:, first + 3 : first + 7]
            lengths = np.linalg.norm(quaternions, axis=-1)
            # What is missing is NaN, and no length.
            wrong = np.flatnonzero(np.abs(lengths - 1) > 0.01)
            if len(wrong):
                problem = f"the quaternion of {short_repr(names[i])} has length"
                raise InputError(
                    path,
                    f"line {numbers[wrong[0]]}: {problem} {lengths[wrong[0]]:.3g}, "
                    "expected 1 (or four empty cells where it is missing)",
                )
            orientations[:, i] = matrices(quaternions)
    return replace(markers, orientations=orientations)


def _names(path: str | Path, header: str) -> tuple[list[str], list[bool]]:
    """Names of the markers, and which of them are followed by a quaternion."""
    try:
        # The reader gives an empty line no cell at all.
        cells = [cell.strip() for cell in next(csv.reader([header]))] or [""]
    except csv.Error as error:
        raise InputError(path, f"line 1: {error}, expected {HEADER}") from None
    if cells[0] != "time" or len(cells) < 2:
        raise InputError(path, f"line 1: found {header[:40]!r}, expected {HEADER}")
    names, has_orientation, i = [], [], 1
    while i < len(cells):
        names.append(cells[i].rpartition(".")[0])
        has_orientation.append(cells[i + 3 : i + 4] == [f"{names[-1]}.qw"])
        axes = ("x", "y", "z", *(("qw", "qx", "qy", "qz") if has_orientation[-1] else ()))
        for axis in axes:
            expected = f"{names[-1]}.{axis}"
            cell = cells[i] if i < len(cells) else "the end of the line"
            if cell != expected or not names[-1]:
                problem = f"found {short_repr(cell)}, expected {short_repr(expected)} ({HEADER})"
                raise InputError(path, f"line 1: {problem}")
            i += 1
    return names, has_orientation


def write_csv(
    path: str | Path,
    times: np.ndarray,
    points: Mapping[str, Rows],
    orientations: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write a CSV file of markers.

    Args:
        path: of the file.
        times: (T,) seconds, ascending.
        points: marker -> (T, 3) positions, metres; NaN where missing.
        orientations: marker -> (T, 3, 3) from its own axes to the file's, of those that have one.

    Raises:
        ValueError: shapes or names that do not fit.
    """
    times, positions = stack_points(times, points, "\r\n\0", path)
    header, columns, oriented = io.StringIO(), ["time"], orientations or {}
    for name in points:
        columns += [f"{name}.{axis}" for axis in "xyz"]
        if name in oriented:
            columns += [f"{name}.q{axis}" for axis in "wxyz"]
    csv.writer(header, lineterminator="").writerow(columns)

    def with_orientations(rows: Index) -> np.ndarray:
        places, parts = positions[rows], []
        for i, name in enumerate(points):
            parts.append(places[:, 3 * i : 3 * i + 3])
            if name in oriented:
                parts.append(quaternions(oriented[name][rows]))
        return np.concatenate(parts, 1)

    table = ComputedRows((len(times), len(columns) - 1), with_orientations)
    rows = zip(times, row_texts(table if oriented else positions, ","), strict=True)
    write_lines(path, [header.getvalue()], (f"{time:.9f},{row}" for time, row in rows))
