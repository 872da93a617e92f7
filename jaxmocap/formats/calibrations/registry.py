"""Calibrations of other systems made into ours; a format is one line of ``FORMATS``.

INPUTS: a file or a folder of another system; unit, axis and size where it does not state them.
OUTPUTS: a calibration file in our layout: metres, world Z up; sentences about what was assumed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.formats.calibrations import (
    caliscope,
    easymocap,
    freemocap,
    motive,
    opencap,
    qualisys,
    shared_layout,
    vicon,
)
from jaxmocap.formats.calibrations.source import (
    Source,
    SourceCalibration,
    SourceCamera,
    camera_place,
    open_source,
)
from jaxmocap.formats.cameras.calibration import (
    METADATA_SECTION,
    Intrinsics,
    read_lens,
    read_place,
    write_sections,
)
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.short_repr import comma_list, short_repr
from jaxmocap.formats.files.toml import TomlTable, file_name_problem, same_file_name
from jaxmocap.formats.time_series.axes import R_WORLD_OF_UP

METRES_PER_UNIT = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
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


@dataclass(frozen=True)
class CalibrationFormat:
    """A system's format.

    Attributes:
        name: of the system and its file, for users.
        recognises: whether a source is in it, by content.
        read: its cameras; InputError where a field does not fit.
    """

    name: str
    recognises: Callable[[Source], bool]
    read: Callable[[Source], SourceCalibration]


# The first that recognises a source reads it: the layout that several share comes last.
FORMATS = (
    CalibrationFormat("Qualisys (.qca.txt)", qualisys.recognises, qualisys.read),
    CalibrationFormat("Vicon (.xcp)", vicon.recognises, vicon.read),
    CalibrationFormat("Motive (.mcal)", motive.recognises, motive.read),
    CalibrationFormat("OpenCap (.pickle)", opencap.recognises, opencap.read),
    CalibrationFormat("EasyMocap (intri.yml)", easymocap.recognises, easymocap.read),
    CalibrationFormat("Caliscope (.toml)", caliscope.recognises, caliscope.read),
    CalibrationFormat("FreeMoCap (.toml)", freemocap.recognises, freemocap.read),
    CalibrationFormat("anipose or Pose2Sim (.toml), OpenCV (.yml)", shared_layout.recognises,
                      shared_layout.read),
)  # fmt: skip


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
        unit: of the source's lengths, a key of ``METRES_PER_UNIT``; None is what it states, or what
            is usual for its system.
        up: the source's axis that points up, a key of ``R_WORLD_OF_SOURCE_UP``; None is likewise.
        size: width and height of the pictures, where the source does not state them.

    Returns:
        Sentences: the system, its unit and axis, the cameras, what was left out or assumed.

    Raises:
        InputError: no system's, a field of it that does not fit, or an option that contradicts it.
    """
    opened = open_source(source)
    system = next((each for each in FORMATS if each.recognises(opened)), None)
    if system is None:
        names = ", ".join(each.name for each in FORMATS)
        raise InputError(
            source, f"found no calibration that is recognised, expected one of {names}"
        )
    calibration = system.read(opened)
    _check_names(source, calibration)
    _check_options(source, calibration, unit, size)
    in_metres = METRES_PER_UNIT[unit or calibration.unit]
    R_world_source = R_WORLD_OF_SOURCE_UP[up or calibration.up]
    sections = {
        camera.name: _section(source, camera, in_metres, R_world_source, size)
        for camera in calibration.cameras
    }
    if unit is None and not calibration.states_unit:
        _check_distances(source, calibration, in_metres)
    write_sections(target, sections)
    return _sentences(system, calibration, unit, up)


def _check_names(source: Path, calibration: SourceCalibration) -> None:
    """InputError for no camera, or names that sections and files cannot have."""
    cameras = calibration.cameras
    if not cameras:
        raise InputError(source, "found no camera that is calibrated")
    if len(cameras) > MAX_CAMERAS:
        raise InputError(source, f"found {len(cameras)} cameras, expected at most {MAX_CAMERAS}")
    names: dict[str, str] = {}
    for camera in cameras:
        if problem := file_name_problem(camera.name):
            raise InputError(source, f"camera {short_repr(camera.name)}: {problem}")
        if camera.name == METADATA_SECTION:
            raise InputError(source, f"camera {camera.name}: expected another name")
        if (same := same_file_name(camera.name)) in names:
            found = f"found {short_repr(camera.name)} beside {short_repr(names[same])}"
            raise InputError(source, f"{found} as cameras' names, expected each once")
        names[same] = camera.name


def _check_options(
    source: Path, calibration: SourceCalibration, unit: str | None, size: tuple[int, int] | None
) -> None:
    """InputError for an option about what the source states itself."""
    if unit is not None and calibration.states_unit:
        problem = f"--unit does not apply, this system's lengths are in {calibration.unit}"
        raise InputError(source, problem)
    unsized = [camera.name for camera in calibration.cameras if camera.size is None]
    if size is None and unsized:
        problem = f"the pictures' size is missing of {comma_list(unsized)}"
        raise InputError(source, f"{problem} (--size 1920x1080 states it)")
    if size is not None and not unsized:
        raise InputError(source, "--size does not apply, the file states it")


def _section(
    source: Path,
    camera: SourceCamera,
    in_metres: float,
    R_world_source: np.ndarray,
    size: tuple[int, int] | None,
) -> dict:
    """A camera's section; InputError where it is none that our reader takes."""
    distortions = camera.distortions
    if not distortions[8:].any():
        distortions = distortions[:8]
    count = 4 if not distortions[4:].any() else 5 if not distortions[5:].any() else 8
    lens = Intrinsics(
        np.array(size, float) if camera.size is None else camera.size,
        camera.matrix,
        distortions[:count] if len(distortions) <= 8 else distortions,
        camera.fisheye,
    )
    R_cam_world = camera.R_cam_source @ R_world_source.T
    place = {"rotation": R_cam_world, "translation": camera.t_cam_source * in_metres}
    # As lists: messages show them as files do.
    table = {key: each.tolist() if isinstance(each, np.ndarray) else each
             for key, each in (lens.entries() | place).items()}  # fmt: skip
    fields = TomlTable(source, camera_place(camera.name), table)
    lens = read_lens(fields)
    R_cam_world, translation = read_place(fields)
    if abs(lens.matrix[1, 0]) > 0:
        raise fields.error("matrix", f"found {lens.matrix.tolist()}, expected an upper triangle")
    return lens.entries() | {
        "rotation": Rotation.from_matrix(R_cam_world).as_rotvec(),
        "translation": translation,
    }


def _check_distances(source: Path, calibration: SourceCalibration, in_metres: float) -> None:
    """InputError where cameras stand too far from the origin for the unit that was assumed."""
    farthest = max(float(np.linalg.norm(each.t_cam_source)) for each in calibration.cameras)
    if farthest * in_metres > FARTHEST_ASSUMED_M:
        found = f"found a camera {farthest:.0f} {calibration.unit} from the origin"
        raise InputError(source, f"{found}, state the unit (--unit mm)")


def _sentences(
    system: CalibrationFormat, calibration: SourceCalibration, unit: str | None, up: str | None
) -> list[str]:
    axis = (up or calibration.up).replace("minus-", "-")
    sentences = [
        f"read     {system.name}: {unit or calibration.unit}, {axis} up",
        f"cameras  {comma_list(camera.name for camera in calibration.cameras)}",
        *calibration.notes,
    ]
    if unit is None and not calibration.states_unit:
        sentences.append(f"assumed: lengths are in {calibration.unit} (--unit states otherwise)")
    if up is None and calibration.assumed_up:
        sentences.append(f"assumed: {calibration.assumed_up} (--source-up states otherwise)")
        if not any(_is_upright(camera, calibration.up) for camera in calibration.cameras):
            sentences.append("warning: no camera's picture is upright then, is another axis up?")
    return sentences


def _is_upright(camera: SourceCamera, up: str) -> bool:
    """Does what the world has below appear further down in the picture?"""
    up_source = R_WORLD_OF_SOURCE_UP[up][2]
    return float(camera.R_cam_source[1] @ up_source) < -LEAST_UPRIGHT
