"""Calibrations of other systems made into ours; a system is one line of ``SYSTEMS``.

INPUTS: a file or a folder of another system; unit, axis and size where it does not state them.
OUTPUTS: a calibration file in our layout: metres, world Z up; sentences about what was assumed.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.formats.calibrations import easymocap, motive, opencap, qualisys, shared_layout, vicon
from jaxmocap.formats.calibrations.source import Source, SourceCalibration, open_source
from jaxmocap.formats.cameras.calibration import (
    METADATA_SECTION,
    check_replaceable,
    read_lens,
    read_place,
    shortest,
    write_sections,
)
from jaxmocap.formats.files.errors import InputError, comma_list, short_repr
from jaxmocap.formats.files.toml import TomlTable, file_name_problem, same_file_name
from jaxmocap.formats.time_series.axes import R_WORLD_OF_UP
from jaxmocap.formats.time_series.tables import FARTHEST_M, UNITS

UNIT_NAMES = {"m": "metres", "cm": "centimetres", "mm": "millimetres", "in": "inches"}
# "minus-y" is what Pose2Sim does with OpenCap's: world = (-x, -z, -y).
R_WORLD_OF_SOURCE_UP = R_WORLD_OF_UP | {
    "x": np.eye(3)[[1, 2, 0]],
    "minus-x": -np.eye(3)[[2, 1, 0]],
    "minus-y": -np.eye(3)[[0, 2, 1]],
    "minus-z": np.diag([1.0, -1.0, -1.0]),
}
# Metres: cameras of one room stand nearer to its origin, so a unit that was assumed is wrong.
FARTHEST_ASSUMED_M = 200.0
MAX_CAMERAS = 1000
# Cosine between the picture's downward axis and the world's, of a camera that looks steeply down.
LEAST_UPRIGHT = 0.2
# Name of a system and its file -> what reads it: None where a file is not the system's. The first
# that is reads it: the layout that several share comes last.
SYSTEMS: dict[str, Callable[[Source], SourceCalibration | None]] = {
    "Qualisys (.qca.txt)": qualisys.read,
    "Vicon (.xcp)": vicon.read,
    "Motive (.mcal)": motive.read,
    "OpenCap (.pickle)": opencap.read,
    "EasyMocap (intri.yml)": easymocap.read,
    "Caliscope (.toml)": shared_layout.read_caliscope,
    "FreeMoCap (.toml)": shared_layout.read_freemocap,
    "anipose or Pose2Sim (.toml), OpenCV (.yml)": shared_layout.read,
}


def convert_calibration(
    source: Path,
    target: Path,
    unit: str | None = None,
    up: str | None = None,
    size: tuple[int, int] | None = None,
) -> list[str]:
    """Make a calibration of another system into ours.

    Args:
        source: file or folder; which system's is found by its content.
        target: the .toml file.
        unit: of the source's lengths, a key of ``UNITS``; None is what it states, or what
            is usual for its system.
        up: the source's axis that points up, a key of ``R_WORLD_OF_SOURCE_UP``; None is likewise.
        size: width and height of the pictures, where the source does not state them.

    Returns:
        Sentences: the system, its unit and axis, the cameras, what was left out or assumed.

    Raises:
        InputError: no system's, a field of it that does not fit, an option that contradicts it, or
            the target is there and no calibration.
    """
    check_replaceable(Path(target))
    opened = open_source(source)
    read = ((name, reader(opened)) for name, reader in SYSTEMS.items())
    system, calibration = next(
        ((name, calibration) for name, calibration in read if calibration is not None), ("", None)
    )
    if calibration is None:
        names = ", ".join(SYSTEMS)
        problem = f"found no calibration that is recognised, expected one of {names}"
        raise InputError(source, problem)
    _check_names(source, [name for name, _ in calibration.cameras])
    _check_options(source, calibration, unit, size)
    its_unit, axis = unit or calibration.unit, up or calibration.up
    sections = {name: _section(fields, its_unit, R_WORLD_OF_SOURCE_UP[axis], size)
                for name, fields in calibration.cameras}  # fmt: skip
    assumed = []
    if unit is None and not calibration.states_unit:
        farthest = max(float(np.linalg.norm(each["translation"])) for each in sections.values())
        if farthest > FARTHEST_ASSUMED_M:
            distance = f"{farthest / UNITS[its_unit]:.0f} {its_unit}"
            found = f"found a camera {distance} from the origin"
            raise InputError(source, f"{found}, state the unit (--unit mm)")
        assumed.append(f"assumed: lengths are in {calibration.unit} (--unit states otherwise)")
    if up is None and calibration.assumed_up:
        assumed.append(f"assumed: {calibration.assumed_up} (--source-up states otherwise)")
        rotations = Rotation.from_rotvec([each["rotation"] for each in sections.values()])
        # Upright is where what the world has below appears further down in the picture.
        if not (rotations.as_matrix()[:, 1, 2] < -LEAST_UPRIGHT).any():
            assumed.append("warning: no camera's picture is upright then, is another axis up?")
    write_sections(target, sections)
    return [
        f"read     {system}: {its_unit}, {axis.replace('minus-', '-')} up",
        f"cameras  {comma_list(sections)}",
        *calibration.notes,
        *assumed,
    ]


def _check_names(source: Path, names: Sequence[str]) -> None:
    """InputError for no camera, or names that sections and files cannot have."""
    if not names:
        raise InputError(source, "found no camera that is calibrated")
    if len(names) > MAX_CAMERAS:
        raise InputError(source, f"found {len(names)} cameras, expected at most {MAX_CAMERAS}")
    taken: dict[str, str] = {}
    for name in names:
        if problem := file_name_problem(name):
            raise InputError(source, f"camera {short_repr(name)}: {problem}")
        if name == METADATA_SECTION:
            raise InputError(source, f"camera {name}: expected another name")
        if (same := same_file_name(name)) in taken:
            found = f"found {short_repr(name)} beside {short_repr(taken[same])}"
            raise InputError(source, f"{found} as cameras' names, expected each once")
        taken[same] = name


def _check_options(
    source: Path, calibration: SourceCalibration, unit: str | None, size: tuple[int, int] | None
) -> None:
    """InputError for an option about what the source states itself."""
    if unit is not None and calibration.states_unit:
        problem = f"--unit does not apply, this system's lengths are in {calibration.unit}"
        raise InputError(source, problem)
    unsized = [
        name for name, fields in calibration.cameras if "matrix" in fields and "size" not in fields
    ]
    if size is None and unsized:
        problem = f"the pictures' size is missing of {comma_list(unsized)}"
        raise InputError(source, f"{problem} (--size 1920x1080 states it)")
    if size is not None and not unsized:
        raise InputError(source, "--size does not apply, the file states it")


def _section(
    fields: TomlTable, unit: str, R_world_source: np.ndarray, size: tuple[int, int] | None
) -> dict[str, Any]:
    """A camera's section in metres and our axes; InputError where a field of it does not fit."""
    if size is not None and "size" not in fields:
        fields = TomlTable(fields.path, fields.where, fields.entries | {"size": size})
    in_metres = UNITS[unit]
    lens = read_lens(fields)
    R_cam_source, translation = read_place(fields, UNIT_NAMES[unit], FARTHEST_M / in_metres)
    return replace(lens, distortions=shortest(lens.distortions)).entries() | {
        "rotation": Rotation.from_matrix(R_cam_source @ R_world_source.T).as_rotvec(),
        "translation": translation * in_metres,
    }
