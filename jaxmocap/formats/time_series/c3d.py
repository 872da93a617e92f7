"""C3D: the marker files of optical systems, through ezc3d.

INPUTS: a .c3d file, its unit in POINT:UNITS; or Markers.
OUTPUTS: Markers in metres, in the file's own axes; or a .c3d file in millimetres.

A point is missing where its residual is negative or a coordinate is not a number. Times count from
the capture's first frame: a trial cut out of it begins where its header says, or TRIAL where that
is beyond what 16 bits count. Labels lose a prefix that all share (``Derrick:LFHD``). Analog
channels, events, residuals, and angles, forces, moments, powers and scalars in the place of points
are not read.
"""

import json
import os
import struct
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxmocap.formats.files.errors import InputError, comma_list, short_name, short_repr
from jaxmocap.formats.files.reading import open_regular, reader_process, regular_file
from jaxmocap.formats.files.writing import replacing
from jaxmocap.formats.time_series import c3d_process
from jaxmocap.formats.time_series.tables import (
    METRES_PER_UNIT,
    MILLISECOND_S,
    Markers,
    even_rate,
    make_markers,
    stack_points,
)

_UNITS = METRES_PER_UNIT | {"dm": 0.1, "in": 0.0254, "inch": 0.0254, "inches": 0.0254}
# Frames are counted by 16 bits.
MAX_FRAMES = 65535
_BIG_ENDIAN = 86
# What the process that reads may take: seconds,
MAX_READ_S = 60
# and bytes of addresses, some 300 MB of them for Python itself: 65535 frames of 60 markers take
# 840 MB.
MAX_MEMORY_BYTES = 2**31
_METRES_PER_MM = 1e-3
# The smallest distance that is written.
_SMALLEST_MM = 1e-6
_DAMAGED = "not a C3D file, or damaged or cut off within its parameters"
# A file consists of blocks of this size.
_BLOCK_BYTES = 512
# A point is four 32-bit numbers.
_POINT_BYTES = 16
# Of what is left out, so many names are listed.
MOST_NAMED = 5
# Frames per second.
_MAX_RATE_HZ = 1e6
# Where the parameters are at the latest, bytes.
_HEADER_BYTES = 2**17


class _Content(NamedTuple):
    """What ezc3d found: points (3, M, T) in the file's unit, NaN where missing, and counts."""

    points: np.ndarray
    rate: float
    first: int
    frames: int
    unit: str
    labels: list[str]
    others: list[str]
    analog_channels: int
    events: int
    has_residuals: bool


def read_c3d(path: str | Path) -> Markers:
    """Read the points of a C3D file; InputError for a damaged file."""
    declared = _declared_frames(path)
    file = _read(path)
    if not file.points.size:
        raise InputError(path, "found no points")
    count = file.points.shape[2]
    if count < declared:
        raise InputError(path, f"the header states {declared} frames, the file ends after {count}")
    if count < file.frames:
        problem = f"TRIAL states {file.frames} frames, {count} of them can be read"
        raise InputError(path, f"{problem}: export it in parts of at most {MAX_FRAMES}")
    if file.unit.lower() not in _UNITS:
        expected = f"expected one of {', '.join(_UNITS)}"
        raise InputError(path, f"POINT:UNITS: found {short_repr(file.unit)}, {expected}")
    scale = _UNITS[file.unit.lower()]
    if not 0 < file.rate <= _MAX_RATE_HZ:
        problem = f"found {file.rate:g}, expected frames per second, up to {_MAX_RATE_HZ:g}"
        raise InputError(path, f"POINT:RATE: {problem}")
    with np.errstate(over="ignore", invalid="ignore"):
        positions = file.points.transpose(2, 1, 0) * scale
    positions[~np.isfinite(positions).all(-1)] = np.nan
    times = (file.first + np.arange(count)) / file.rate
    table = np.concatenate([times[:, None], positions.reshape(count, -1)], 1)
    markers = make_markers(path, table, [], _labels(file.labels), "POINT:LABELS")
    return replace(markers, left_out=tuple(_left_out(file)))


def _read(path: str | Path) -> _Content:
    """What ezc3d finds, in a process of its own, which a damaged file may take along."""
    regular_file(path)
    arguments = os.path.realpath(path), str(MAX_MEMORY_BYTES)
    command, alone = reader_process(c3d_process.__file__, *arguments)
    try:
        done = subprocess.run(command, capture_output=True, timeout=MAX_READ_S, env=alone)
    except subprocess.TimeoutExpired:
        raise InputError(path, f"not read within {MAX_READ_S} s, too large or damaged") from None
    if done.returncode == c3d_process.EXIT_TOO_LARGE or b"bad_alloc" in done.stderr:
        most = f"{MAX_MEMORY_BYTES / 1e9:.2g} GB of memory"
        raise InputError(path, f"takes more than {most} to read, too large or damaged")
    if done.returncode == c3d_process.EXIT_NO_READER:
        raise InputError(path, "not read: ezc3d cannot be imported (pip install ezc3d)")
    if done.returncode:
        raise InputError(path, _DAMAGED)
    line, _, values = done.stdout.partition(b"\n")
    head = json.loads(line)
    return _Content(np.frombuffer(values, float).reshape(3, *head.pop("shape")), **head)


def _left_out(file: _Content) -> Iterator[str]:
    """What a file holds besides its points, in words."""
    if file.analog_channels:
        yield f"{file.analog_channels} analog channels"
    if file.events:
        yield "events"
    if file.has_residuals:
        yield "the points' residuals"
    if file.others:
        names = comma_list(map(short_name, file.others[:MOST_NAMED]))
        yield f"{len(file.others)} angles, forces and the like, which are no points: {names}"
    if file.labels != _labels(file.labels):
        yield f"the labels' prefix {short_name(file.labels[0].rpartition(':')[0])}:"


def _declared_frames(path: str | Path) -> int:
    """How many frames the header states there are; ezc3d gives only those that it found."""
    with open_regular(path) as file:
        header = file.read(_HEADER_BYTES)
    try:
        processor = header[(header[0] - 1) * _BLOCK_BYTES + 3]
        order = ">HH" if processor == _BIG_ENDIAN else "<HH"
        first, last = struct.unpack_from(order, header, 6)
    except (IndexError, struct.error):
        raise InputError(path, _DAMAGED) from None
    return last - first + 1


def _labels(names: list[str]) -> list[str]:
    """The names without a prefix that all share."""
    prefixes = {name.rpartition(":")[0] for name in names if ":" in name}
    short = [name.rpartition(":")[2] for name in names]
    alone = len(prefixes) == 1 and all(short) and len(set(short)) == len(names)
    return short if alone else names


def write_c3d(path: str | Path, markers: Markers) -> list[str]:
    """Write a C3D file in millimetres, as 32-bit numbers, missing points with residual −1.

    The first sample becomes the frame nearest to its time; a single one by the markers' own rate.
    A sentence where that is more than a millisecond away, or none.

    Raises:
        InputError: times that are not evenly spaced or begin before 0, or more frames or longer
            names than the format can hold.
        ValueError: shapes or names that do not fit.
    """
    import ezc3d

    times, table = stack_points(
        markers.times, markers.points(), "\r\n\0", path, _SMALLEST_MM * _METRES_PER_MM
    )
    is_alone = len(times) == 1
    rate = markers.rate if is_alone and markers.rate else even_rate(path, times)
    first = round(times[0] * rate)
    if not 0 <= first <= first + len(times) <= MAX_FRAMES:
        problem = f"frames {first} to {first + len(times)} at {rate:g} Hz: C3D holds 0 to"
        raise InputError(path, f"{problem} {MAX_FRAMES}")
    long = [name for name in markers.names if len(name.encode()) > 127]
    if long or len(markers.names) > 255:
        excess = f"the name {long[0]!r}" if long else f"{len(markers.names)} markers"
        raise InputError(path, f"{excess}: C3D holds 255 markers, names of 127 bytes")
    places = table[:].reshape(len(times), -1, 3)
    positions = np.moveaxis(places, 2, 0).swapaxes(1, 2) / _METRES_PER_MM
    missing = np.asarray(np.isnan(positions).any(0))
    file = ezc3d.c3d()
    group = file["parameters"]["POINT"]
    group["RATE"]["value"], group["UNITS"]["value"] = [rate], ["mm"]
    group["LABELS"]["value"], group["SCALE"]["value"] = list(markers.names), [-1.0]
    file["data"]["points"] = np.concatenate([positions, np.ones((1, *missing.shape))])
    file["data"]["meta_points"]["residuals"] = np.where(missing, -1.0, 0.0)[None]
    file["header"]["points"]["first_frame"] = first
    frames, points = len(times), len(markers.names)
    with replacing(path, lambda part: _is_complete(part, frames, points)) as temporary:
        file.write(str(temporary))
    if abs(late := first / rate - times[0]) <= MILLISECOND_S:
        return []
    return [f"moved: all times by {late:+.3g} s, since C3D counts frames from 0 s, at {rate:g} Hz"]


def _is_complete(path: Path, frames: int, points: int) -> bool:
    """Whether a file that was written holds its frames: ezc3d says nothing of a full disk."""
    with path.open("rb") as file:
        content = file.read(2 * _BLOCK_BYTES)
    if len(content) < 2 * _BLOCK_BYTES:
        return False
    stored, _, first, last = struct.unpack_from("<HHHH", content, 2)
    # Where the points begin is written at the very end: after the blocks of parameters.
    start, blocks = struct.unpack_from("<H", content, 16)[0], content[_BLOCK_BYTES + 2]
    size = (start - 1) * _BLOCK_BYTES + frames * points * _POINT_BYTES
    counts = stored, last - first + 1, start
    expected = points, frames, content[0] + blocks
    return counts == expected and path.stat().st_size >= size
