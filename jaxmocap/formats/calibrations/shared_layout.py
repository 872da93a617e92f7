"""Calibrations in the layout that anipose and Pose2Sim share, or of one camera in OpenCV's YAML.

INPUTS: a .toml file with a section for each camera, or a .yml file. OUTPUTS: its cameras, their
unit and axes as whoever calibrated them chose: anipose's lengths are in the board's unit,
Pose2Sim's are metres.
"""

from collections.abc import Mapping
from typing import Any

from jaxmocap.formats.calibrations.source import Source, SourceCalibration
from jaxmocap.formats.cameras.calibration import METADATA_SECTION
from jaxmocap.formats.cameras.opencv_yaml import read_opencv_yaml
from jaxmocap.formats.files.toml import TomlTable


def is_camera(table: Any) -> bool:
    """Does a table have what every camera has?"""
    return isinstance(table, dict) and "matrix" in table and "size" in table


def read(source: Source) -> SourceCalibration | None:
    """All cameras; metres, Z up, unless a user states otherwise."""
    tables: Mapping[str, Any] = source.toml
    if any("matrix" in key.lower() for key in source.yaml):
        tables = read_opencv_yaml(source.path)
    elif not any(map(is_camera, tables.values())):
        return None
    cameras = sections_of(source, tables)
    return SourceCalibration(cameras, "m", "z", states_unit=False, assumed_up="z is up")


def sections_of(source: Source, tables: Mapping[str, Any]) -> list[tuple[str, TomlTable]]:
    """The cameras of sections in this layout, all but the metadata."""
    return [
        (name, TomlTable(source.path, f"[{name}]", table))
        for name, table in tables.items()
        if name != METADATA_SECTION
    ]
