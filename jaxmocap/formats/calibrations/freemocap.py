"""Calibrations of FreeMoCap: ``…_camera_calibration.toml``.

INPUTS: anipose's layout, with FreeMoCap's ``[metadata]`` or world_position and world_orientation.
OUTPUTS: its cameras.

As FreeMoCap writes it (``anipose_camera_calibrator.py``): lengths are in the unit of
charuco_square_size, for which it asks in millimetres. With ``groundplane_calibration = true`` the
board lay on the ground, Z up. Else the world is the first camera's frame, whose y points down as
far as that camera is level. world_position and world_orientation repeat translation and rotation.
"""

from jaxmocap.formats.calibrations.shared_layout import is_camera, sections_of
from jaxmocap.formats.calibrations.source import Source, SourceCalibration
from jaxmocap.formats.cameras.calibration import METADATA_SECTION
from jaxmocap.formats.files.toml import TomlTable

_METADATA = {"charuco_square_size", "charuco_board_object", "path_to_recorded_videos",
             "groundplane_calibration", "date_time_calibrated"}  # fmt: skip
_SQUARE = "charuco_square_size"


def read(source: Source) -> SourceCalibration | None:
    """All cameras; millimetres, unless a user states otherwise."""
    metadata = source.toml.get(METADATA_SECTION)
    is_theirs = isinstance(metadata, dict) and bool(_METADATA & set(metadata))
    cameras = [table for table in source.toml.values() if is_camera(table)]
    if not cameras or not (is_theirs or any("world_position" in each for each in cameras)):
        return None
    about = TomlTable(source.path, "[metadata]", {} if metadata is None else metadata)
    notes = []
    if _SQUARE in about and about.number(_SQUARE) == 1:
        notes.append(
            f"warning: {_SQUARE} is 1, FreeMoCap's sign for a size that was not entered "
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
