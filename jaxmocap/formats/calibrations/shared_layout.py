"""Calibrations in the layout that anipose and Pose2Sim share, with what others make of it.

INPUTS: a .toml file with a section for each camera, or of one camera OpenCV's YAML. OUTPUTS: its
cameras: of anipose and Pose2Sim, of Caliscope and of FreeMoCap, each by what it adds.
"""

from collections.abc import Mapping
from typing import Any

from jaxmocap.formats.calibrations.source import Source, SourceCalibration, left_out
from jaxmocap.formats.cameras.calibration import METADATA_SECTION
from jaxmocap.formats.cameras.opencv_yaml import read_opencv_yaml
from jaxmocap.formats.files.toml import TomlTable

_CALISCOPE_KEYS = {"rotation_count", "grid_count", "cam_id", "port", "verified_resolutions"}
_FREEMOCAP_METADATA = {"charuco_square_size", "charuco_board_object", "path_to_recorded_videos",
                       "groundplane_calibration", "date_time_calibrated"}  # fmt: skip


def is_camera(table: Any) -> bool:
    """Does a table have what every camera has?"""
    return isinstance(table, dict) and "matrix" in table and "size" in table


def sections_of(source: Source, tables: Mapping[str, Any]) -> list[tuple[str, TomlTable]]:
    """The cameras of sections in this layout, all but the metadata."""
    return [
        (name, TomlTable(source.path, f"[{name}]", table))
        for name, table in tables.items()
        if name != METADATA_SECTION
    ]


def read(source: Source) -> SourceCalibration | None:
    """All cameras; metres, Z up, unless a user states otherwise.

    Unit and axes are as whoever calibrated them chose: anipose's lengths are in the board's unit,
    Pose2Sim's are metres.
    """
    tables: Mapping[str, Any] = source.toml
    if any("matrix" in key.lower() for key in source.yaml):
        tables = read_opencv_yaml(source.path)
    elif not any(map(is_camera, tables.values())):
        return None
    cameras = sections_of(source, tables)
    return SourceCalibration(cameras, "m", "z", states_unit=False, assumed_up="z is up")


def read_caliscope(source: Source) -> SourceCalibration | None:
    """The cameras of Caliscope (once pyxy3d) that are placed and not ignored; metres.

    From ``camera_array.toml``, or ``config.toml`` before it: ``[cameras.0]`` or ``[cam_0]`` with
    Caliscope's own keys; named cam_0 as Caliscope itself exports them. As Caliscope reads it
    (``cameras/camera_array.py``), rotation (a Rodrigues vector, once a matrix) and translation lead
    from the world to the camera. A user sets origin and axes by the board and may flip them, which
    no file states.
    """
    prefix, tables = "", source.toml
    if isinstance(cameras := tables.get("cameras"), dict):
        prefix, tables = "cam_", cameras
    tables = {f"{prefix}{key}": each for key, each in tables.items() if is_camera(each)}
    if not any(_CALISCOPE_KEYS & set(table) for table in tables.values()):
        return None
    placed = {
        name: table
        for name, table in tables.items()
        if "rotation" in table and "translation" in table and table.get("ignore") is not True
    }
    notes = left_out("not placed, or ignored", [name for name in tables if name not in placed])
    cameras = sections_of(source, placed)
    return SourceCalibration(cameras, "m", "z", assumed_up="z is up", notes=notes)


def read_freemocap(source: Source) -> SourceCalibration | None:
    """All cameras of FreeMoCap; millimetres, unless a user states otherwise.

    From ``…_camera_calibration.toml``: FreeMoCap's ``[metadata]``, or world_position and
    world_orientation, which repeat translation and rotation. As FreeMoCap writes it
    (``anipose_camera_calibrator.py``), lengths are in the unit of charuco_square_size, for which it
    asks in millimetres. With ``groundplane_calibration = true`` the board lay on the ground, Z up.
    Else the world is the first camera's frame, whose y points down as far as that camera is level.
    """
    metadata = source.toml.get(METADATA_SECTION)
    is_theirs = isinstance(metadata, dict) and bool(_FREEMOCAP_METADATA & set(metadata))
    cameras = [table for table in source.toml.values() if is_camera(table)]
    if not cameras or not (is_theirs or any("world_position" in each for each in cameras)):
        return None
    about = TomlTable(source.path, "[metadata]", {} if metadata is None else metadata)
    notes, square = [], "charuco_square_size"
    if square in about and about.number(square) == 1:
        notes.append(
            f"warning: {square} is 1, FreeMoCap's sign for a size that was not entered "
            "(--unit states the unit of a square's side)"
        )
    on_ground = about.entries.get("groundplane_calibration") is True
    return SourceCalibration(
        sections_of(source, source.toml),
        "mm",
        "z" if on_ground else "minus-y",
        states_unit=False,
        assumed_up="" if on_ground else "the first camera, whose frame is the world, stands level",
        notes=notes,
    )
