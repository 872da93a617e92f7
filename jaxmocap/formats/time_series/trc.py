"""TRC: the marker files of OpenSim, Pose2Sim and Cortex.

INPUTS: a .trc file, its unit in the header (m, cm or mm); or times and points in metres.
OUTPUTS: Markers in metres, in the file's own axes; or a .trc file in metres.
"""

from collections.abc import Mapping
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from jaxmocap.formats.files.errors import InputError, short_name, short_repr
from jaxmocap.formats.files.reading import numbered_lines
from jaxmocap.formats.files.writing import write_lines
from jaxmocap.formats.time_series.tables import (
    METRES_PER_UNIT,
    Markers,
    declared_count,
    make_markers,
    parse_rows,
    row_texts,
    stack_points,
    usual_step,
)
from jaxmocap.geometry.rows import Rows

_KEYS = (
    *("DataRate", "CameraRate", "NumFrames", "NumMarkers"),
    *("Units", "OrigDataRate", "OrigDataStartFrame", "OrigNumFrames"),
)
_HEADER_LINES = 5


def read_trc(path: str | Path) -> Markers:
    """Read a TRC file.

    Empty cells and ``NaN`` are missing markers. The names in line 4 say how many markers there
    are; the header's NumMarkers, which exporters often get wrong, is not needed.

    Raises:
        InputError: no such file, or the line that is not TRC, is cut off, has an unknown unit, or
            a time not later than the one before.
    """
    lines = numbered_lines(path)
    head = [line for _, line in islice(lines, _HEADER_LINES)]
    if not head[0].startswith("PathFileType"):
        raise InputError(path, f"line 1: found {head[0][:20]!r}, expected 'PathFileType'")
    if len(head) < _HEADER_LINES:
        raise InputError(path, f"line {len(head)}: the file ends within its header")
    header = dict(zip(_cells(head[1]), _cells(head[2]), strict=False))
    if "Units" not in header:
        raise InputError(path, "line 2: found no 'Units' in the header")
    scale = METRES_PER_UNIT.get((unit := header["Units"]).lower())
    if scale is None:
        expected = ", ".join(METRES_PER_UNIT)
        problem = f"unknown unit {short_repr(unit)}, expected one of {expected}"
        raise InputError(path, f"line 3: {problem}")
    names = _names(path, head[3], head[4])
    data = ((number, line.split("\t")) for number, line in lines)
    table, numbers = parse_rows(path, data, 2 + 3 * len(names))
    # A file that was cut off between two lines still says how long it was.
    count = declared_count(declared := header.get("NumFrames", ""))
    if count is not None and count > len(table):
        problem = f"NumFrames is {short_name(declared)}, but the file ends after {len(table)}"
        raise InputError(path, f"line 3: {problem} frames")
    table[:, 2:] *= scale
    markers = make_markers(path, table[:, 1:], numbers, names, "line 4")
    return replace(markers, rate=_rate(header))


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.split("\t")]


def _rate(header: dict[str, str]) -> float | None:
    """DataRate, where it is a positive number."""
    try:
        rate = float(header.get("DataRate", ""))
    except ValueError:
        return None
    return rate if 0 < rate < float("inf") else None


def _names(path: str | Path, name_line: str, axis_line: str) -> list[str]:
    cells = _cells(name_line)
    if not cells[0].lower().startswith("frame") or cells[1:2] not in (["Time"], ["time"]):
        text = repr(name_line[:20])
        raise InputError(path, f"line 4: found {text}, expected 'Frame#', 'Time' and names")
    names = [cell for cell in cells[2:] if cell]
    axes = [cell for cell in _cells(axis_line) if cell]
    if not names:
        raise InputError(path, "line 4: names no marker")
    if len(axes) != 3 * len(names):
        raise InputError(
            path,
            f"line 5: found {len(axes)} coordinates, expected {3 * len(names)} "
            f"for the {len(names)} markers of line 4",
        )
    return names


def write_trc(
    path: str | Path, times: np.ndarray, points: Mapping[str, Rows], rate: float | None = None
) -> None:
    """Write a TRC file in metres; missing markers are empty cells.

    Args:
        path: of the file.
        times: (T,) seconds, ascending.
        points: marker -> (T, 3) positions, metres.
        rate: samples per second for the header; None takes it from the times.

    Raises:
        ValueError: shapes or names that do not fit.
    """
    times, positions = stack_points(times, points, "\t\r\n\0", path)
    if rate is None:
        rate = 1 / usual_step(times) if len(times) > 1 else 1.0
    count, rate_text = len(times), f"{round(rate, 2):g}"
    values = [rate_text, rate_text, count, len(points), "m", rate_text, 1, count]
    axes = [f"{axis}{i}" for i in range(1, len(points) + 1) for axis in "XYZ"]
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{Path(path).name}",
        "\t".join(_KEYS),
        "\t".join(map(str, values)),
        "\t".join(["Frame#", "Time", *(f"{name}\t\t" for name in points)]),
        "\t".join(["", "", *axes]),
        "",
    ]
    rows = zip(times, row_texts(positions, "\t"), strict=True)
    write_lines(path, lines, (f"{i}\t{time:.9f}\t{row}" for i, (time, row) in enumerate(rows, 1)))
