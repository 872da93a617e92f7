"""MOT: joint angles over time, in the file format of OpenSim's motions.

INPUTS: a Motion; or a .mot (or .sto) file and the skeleton it is of.
OUTPUTS: a .mot file of hinges or of ISB's angles; or its columns, or a Motion.

A file of hinges has the pelvis' place (``pelvis_tx``, ``_ty``, ``_tz``: metres, world, Z up),
its turns (``pelvis_yaw`` about the world's vertical, then ``pelvis_pitch`` about its own left axis,
then ``pelvis_roll`` about its own forward axis) and every joint's angle by its name, in degrees,
without jumps at ±180°. Bones are not in it. A file of ISB's angles has those of ``body.isb``, from
which no motion can be read; those of OpenSim's model are in ``formats.opensim``.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.body.motion import Motion, near_origin
from jaxmocap.body.orientations import matrices
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.formats.files.errors import InputError, comma_list, short_name
from jaxmocap.formats.files.reading import numbered_lines
from jaxmocap.formats.files.writing import write_lines
from jaxmocap.formats.time_series.isb import isb_angles
from jaxmocap.formats.time_series.tables import (
    check_names,
    check_times,
    declared_count,
    parse_rows,
    row_texts,
)
from jaxmocap.geometry.euler import FREE, continuous_euler
from jaxmocap.geometry.rows import ComputedRows, Index, Rows, row_blocks

TRANSLATION_COLUMNS = ("pelvis_tx", "pelvis_ty", "pelvis_tz")
ROTATION_COLUMNS = ("pelvis_yaw", "pelvis_pitch", "pelvis_roll")
_EULER_ORDER = "ZYX"
_MOST_HEADER_LINES = 1000
# Between two samples; no joint goes so far.
LARGEST_STEP_DEG = 60


def write_mot(path: str | Path, motion: Motion) -> list[str]:
    """Write the angles of a motion; NaN where a pose is unknown. Returns ``write_table``'s."""
    names = (*TRANSLATION_COLUMNS, *ROTATION_COLUMNS, *motion.skeleton.tree.joints)
    _, quaternion, angles = map(np.asarray, motion.poses)
    positions, count = motion.positions_world, len(motion.times)

    ranges = np.radians([(FREE, (-90, 90), FREE)])
    R_world_pelvis = ComputedRows(
        (count, 1, 3, 3), lambda rows: matrices(quaternion[rows].astype(float))[:, None]
    )
    turns = continuous_euler(R_world_pelvis, _EULER_ORDER, ranges, motion.times)[:, 0]

    def table(rows: Index) -> np.ndarray:
        degrees = np.degrees(np.concatenate([turns[rows], angles[rows].astype(float)], 1))
        return np.concatenate([positions[rows], degrees], 1)

    return write_table(Path(path), motion.times, names, ComputedRows((count, len(names)), table))


def write_isb(path: str | Path, motion: Motion) -> list[str]:
    """Write ISB's angles, NaN where a pose is unknown. Returns ``write_table``'s."""
    angles = isb_angles(motion)

    def table(rows: Index) -> np.ndarray:
        return np.degrees(np.stack([angle[rows] for angle in angles.values()], 1))

    shape = len(motion.times), len(angles)
    return write_table(Path(path), motion.times, tuple(angles), ComputedRows(shape, table))


def write_table(path: Path, times: np.ndarray, names: Sequence[str], table: Rows) -> list[str]:
    """Write columns (T, C), degrees but for places; a sentence where an angle jumps, or none."""
    head = [path.stem, "version=1", f"nRows={len(times)}", f"nColumns={len(names) + 1}"]
    lines = [*head, "inDegrees=yes", "endheader", "\t".join(["time", *names])]
    rows = zip(times, row_texts(table, "\t", decimals=8, nan="NaN"), strict=True)
    write_lines(path, lines, (f"{time:.9f}\t{row}" for time, row in rows))
    is_angle = np.array([_is_angle(name) for name in names])
    largest, at, column, count = 0.0, 0, 0, 0
    for rows in row_blocks(len(times)):
        block = table[slice(max(rows.start - 1, 0), rows.stop)]
        steps = np.where(is_angle, np.nan_to_num(np.abs(np.diff(block, axis=0))), 0.0)
        count += int((steps > LARGEST_STEP_DEG).sum())
        if steps.size and steps.max() > largest:
            largest = float(steps.max())
            row, column = divmod(int(steps.argmax()), len(names))
            at = max(rows.start - 1, 0) + row
    if not count:
        return []
    return [
        f"{names[column]} steps by {largest:.0f}° from {times[at]:.2f} to {times[at + 1]:.2f} s, "
        f"the largest of {count} above {LARGEST_STEP_DEG}°"
    ]


def read_mot(path: str | Path) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times (T,), seconds, and columns (T,): radians; metres of ``_tx``, ``_ty``, ``_tz``."""
    lines = numbered_lines(path)
    header, end = _header(path, lines)
    names = next(lines, (0, ""))[1].split()
    if len(names) < 2 or names[0].lower() != "time":
        raise InputError(path, f"line {end + 1}: found no 'time' and names of columns")
    check_names(path, names, f"line {end + 1}", "column")
    table, numbers = parse_rows(path, ((i, line.split()) for i, line in lines), len(names))
    check_times(path, table[:, 0], "line", numbers)
    count = declared_count(declared := header.get("nrows", ""))
    if count is not None and count > len(table):
        problem = f"nRows is {short_name(declared)}, but the file ends after {len(table)}"
        raise InputError(path, problem)
    columns = dict(zip(names[1:], table[:, 1:].T, strict=True))
    if header["indegrees"] == "yes":
        columns = {name: np.radians(column) if _is_angle(name) else column
                   for name, column in columns.items()}  # fmt: skip
    return table[:, 0], columns


def _header(path: str | Path, lines: Iterator[tuple[int, str]]) -> tuple[dict[str, str], int]:
    """What stands above 'endheader', in small letters, and that line's number."""
    header = {}
    for number, line in islice(lines, _MOST_HEADER_LINES):
        text = line.strip().lower()
        if text == "endheader":
            if header.get("indegrees") not in ("yes", "no"):
                raise InputError(path, "the header states neither inDegrees=yes nor inDegrees=no")
            return header, number
        key, equals, value = text.partition("=")
        header |= {key: value} if equals else {}
    raise InputError(path, "found no line 'endheader', which ends a MOT file's header")


def _is_angle(name: str) -> bool:
    return not name.endswith(("_tx", "_ty", "_tz"))


def motion_from_angles(
    path: str | Path, times: np.ndarray, columns: Mapping[str, np.ndarray], skeleton: Skeleton
) -> Motion:
    """The motion of a skeleton in a file by ``write_mot``; InputError where a column is missing."""
    names = (*TRANSLATION_COLUMNS, *ROTATION_COLUMNS, *skeleton.tree.joints)
    missing = [name for name in names if name not in columns]
    if missing:
        for column, content in (("pelvis_list", "OpenSim's coordinates"),
                                ("pelvis_tilt", "ISB's angles")):  # fmt: skip
            if column in columns:
                raise InputError(path, f"holds {content}, which hinges cannot be read from")
        raise InputError(path, f"no column {missing[0]!r}, found {comma_list(columns)}")
    table = np.stack([columns[name] for name in names], 1)
    is_finite = np.isfinite(table.sum(-1))
    R_world_pelvis = Rotation.from_euler(
        _EULER_ORDER, np.where(is_finite[:, None], table[:, 3:6], 0.0)
    )
    turned = np.where(is_finite[:, None], R_world_pelvis.as_quat(scalar_first=True), np.nan)
    parts: list[Any] = [table[:, :3], turned, table[:, 6:]]
    return near_origin(Motion(skeleton, times, Pose(*parts)))
