"""C3D: the marker files of optical systems, through ezc3d.

INPUTS: a .c3d file, its unit in POINT:UNITS; or Markers.
OUTPUTS: Markers in metres, in the file's own axes; or a .c3d file in millimetres.

A point is missing where its residual is negative, a coordinate is not a number, or all three are
exactly 0, as some writers have it. Times count from the capture's first frame: a trial cut out
of it begins where its header says. Labels lose a prefix that all share (``Derrick:LFHD``).
Analog channels, events and what else a C3D file may hold are not read.
"""

import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.formats.errors import InputError
from jaxmocap.formats.reading import read_bytes
from jaxmocap.formats.tables import Markers, even_rate, make_markers, stack_points
from jaxmocap.formats.trc import METRES
from jaxmocap.formats.writing import replacing

_UNITS = METRES | {"dm": 0.1, "in": 0.0254, "inch": 0.0254, "inches": 0.0254}
# Frames are counted by 16 bits; residuals are held in steps of a scale, 255 at most.
MOST_FRAMES, RESIDUAL_STEPS = 65535, 255
_BIG_ENDIAN = 86
# How a file is tried out, and how long that may take.
TRIAL, LONGEST_S = "import sys, ezc3d; ezc3d.c3d(sys.argv[1])", 120
_MM, _SMALLEST_MM = 1e-3, 1e-6


def read_c3d(path: str | Path) -> Markers:
    """Read the points of a C3D file, with their residuals.

    Raises:
        InputError: no such file, not C3D or cut off, without points, or of an unknown unit.
    """
    content = read_bytes(path)
    file = _opened(path)
    points, group = file["data"]["points"], file["parameters"]["POINT"]
    if not points.shape[1] or not points.shape[2]:
        raise InputError(path, "found no points")
    declared = _declared_frames(content)
    if points.shape[2] < declared:
        problem = f"the header says {declared} frames, the file ends after {points.shape[2]}"
        raise InputError(path, problem)
    scale, header = _scale(path, group), file["header"]["points"]
    rate = float(header["frame_rate"])
    if not (np.isfinite(rate) and rate > 0):
        raise InputError(path, f"POINT:RATE: found {rate:g}, expected frames per second")
    positions = np.moveaxis(points[:3], 0, 2).swapaxes(0, 1) * scale
    residuals = file["data"]["meta_points"]["residuals"][0].T * scale
    missing = (residuals < 0) | ~np.isfinite(positions).all(-1) | (positions == 0).all(-1)
    positions[missing], residuals[missing] = np.nan, np.nan
    times = (header["first_frame"] + np.arange(len(positions))) / rate
    table = np.concatenate([times[:, None], positions.reshape(len(times), -1)], 1)
    markers = make_markers(path, table, [], _labels(group, points.shape[1]), "POINT:LABELS")
    return Markers(markers.times, markers.names, markers.positions, residuals)


def _opened(path: str | Path) -> Any:
    damaged = "not a C3D file, or damaged or cut off within its parameters"
    if not _survives(path):
        raise InputError(path, damaged)
    try:
        import ezc3d

        return ezc3d.c3d(str(path))
    # ezc3d raises whatever its parser met: OSError, RuntimeError, ValueError, IndexError, ...
    except Exception:
        raise InputError(path, damaged) from None


def _survives(path: str | Path) -> bool:
    """Whether ezc3d comes through a file alive.

    It follows a damaged file's lengths wherever they lead, and may take its process along (one of
    60 files with some bytes changed); so the first attempt is another process's.
    """
    attempt = [sys.executable, "-I", "-c", TRIAL, str(path)]
    try:
        done = subprocess.run(attempt, capture_output=True, timeout=LONGEST_S)
    except subprocess.TimeoutExpired:
        return False
    # What it raises is told when it is raised here; below 0 is the signal that ended it.
    return done.returncode >= 0


def left_in_c3d(path: str | Path) -> list[str]:
    """What a file that can be read holds besides its points, in words."""
    file = _opened(path)
    parameters, left = file["parameters"], []
    if count := file["data"]["analogs"].shape[1]:
        left.append(f"{count} analog channels")
    if "EVENT" in parameters and len(parameters["EVENT"].get("TIMES", {}).get("value", ())):
        left.append("events")
    count = file["data"]["points"].shape[1]
    given, kept = _stored_labels(parameters["POINT"], count), _labels(parameters["POINT"], count)
    if given != kept:
        left.append(f"the labels' prefix {given[0].rpartition(':')[0]}:")
    return left


def _declared_frames(content: bytes) -> int:
    """How many frames the header says there are; ezc3d tells only those that it found."""
    processor = content[(content[0] - 1) * 512 + 3]
    first, last = struct.unpack_from(">HH" if processor == _BIG_ENDIAN else "<HH", content, 6)
    return last - first + 1


def _scale(path: str | Path, group: Any) -> float:
    """Metres per unit of the file."""
    units = group["UNITS"]["value"] if "UNITS" in group else []
    unit = str(units[0]).strip() if len(units) else ""
    if unit.lower() not in _UNITS:
        expected = ", ".join(_UNITS)
        raise InputError(path, f"POINT:UNITS: found {unit!r}, expected one of {expected}")
    return _UNITS[unit.lower()]


def _stored_labels(group: Any, count: int) -> list[str]:
    """A name for every point; beyond 255 they go on in LABELS2, LABELS3, ..."""
    keys = ["LABELS", *(f"LABELS{i}" for i in range(2, 2 + count // 255))]
    found = [str(name).strip() for key in keys if key in group for name in group[key]["value"]]
    names = [name or f"point{i}" for i, name in enumerate(found[:count], 1)]
    return names + [f"point{i}" for i in range(len(names) + 1, count + 1)]


def _labels(group: Any, count: int) -> list[str]:
    """The names without a prefix that all share."""
    names = _stored_labels(group, count)
    prefixes = {name.rpartition(":")[0] for name in names if ":" in name}
    short = [name.rpartition(":")[2] for name in names]
    alone = len(prefixes) == 1 and all(short) and len(set(short)) == count
    return short if alone else names


def write_c3d(path: str | Path, markers: Markers) -> None:
    """Write a C3D file in millimetres, as 32-bit numbers, missing points with residual −1.

    The first sample becomes the frame nearest to its time. A point exactly at the origin moves by
    a nanometre, since zeros mean missing.

    Raises:
        InputError: times that are not evenly spaced or begin before 0, or more frames or longer
            names than the format can hold.
        ValueError: shapes or names that do not fit.
    """
    import ezc3d

    times, table = stack_points(markers.times, markers.points(), "\r\n\0", path)
    rate = even_rate(path, times)
    first = round(times[0] * rate)
    if not 0 <= first <= first + len(times) <= MOST_FRAMES:
        problem = f"frames {first} to {first + len(times)} at {rate:g} Hz: C3D holds 0 to"
        raise InputError(path, f"{problem} {MOST_FRAMES}")
    long = [name for name in markers.names if len(name.encode()) > 127]
    if long or len(markers.names) > 255:
        found = f"the name {long[0]!r}" if long else f"{len(markers.names)} markers"
        raise InputError(path, f"{found}: C3D holds 255 markers, names of 127 bytes")
    positions = np.moveaxis(table.reshape(len(times), -1, 3), 2, 0).swapaxes(1, 2) / _MM
    missing = np.asarray(np.isnan(positions).any(0))
    positions = np.where((np.abs(positions) < _SMALLEST_MM).all(0), _SMALLEST_MM, positions)
    residuals, step = _residuals(markers, missing)
    file = ezc3d.c3d()
    group = file["parameters"]["POINT"]
    group["RATE"]["value"], group["UNITS"]["value"] = [rate], ["mm"]
    group["LABELS"]["value"], group["SCALE"]["value"] = list(markers.names), [-step]
    file["data"]["points"] = np.concatenate([positions, np.ones((1, *missing.shape))])
    file["data"]["meta_points"]["residuals"] = residuals[None]
    file["header"]["points"]["first_frame"] = first
    with replacing(path) as beside:
        file.write(str(beside))


def _residuals(markers: Markers, missing: np.ndarray) -> tuple[np.ndarray, float]:
    """Residuals (M, T) in millimetres, −1 where missing, and the step in which they are held."""
    if markers.residuals is None:
        return np.where(missing, -1.0, 0.0), 1.0
    residuals = np.nan_to_num(markers.residuals.T / _MM)
    largest = float(np.where(missing, 0.0, residuals).max(initial=0.0))
    step = max(largest / RESIDUAL_STEPS, _SMALLEST_MM)
    # ezc3d cuts off what is less than a step: half a step more rounds.
    return np.where(missing, -1.0, residuals + step / 2), step
