"""Calibrations in the layout that anipose and Pose2Sim share, or of one camera in OpenCV's YAML.

INPUTS: a .toml file with a section for each camera, or a .yml file. OUTPUTS: its cameras, their
unit and axes as whoever calibrated them chose: anipose's lengths are in the board's unit,
Pose2Sim's are metres.
"""

from collections.abc import Mapping
from typing import Any

from jaxmocap.formats.calibrations.source import (
    Source,
    SourceCalibration,
    SourceCamera,
)
from jaxmocap.formats.cameras.calibration import METADATA_SECTION, read_lens, read_place
from jaxmocap.formats.cameras.opencv_yaml import read_opencv_yaml
from jaxmocap.formats.files.toml import TomlTable


def recognises(source: Source) -> bool:
    """Is any table of it a camera's?"""
    if source.yaml is not None:
        return any("matrix" in key.lower() for key in source.yaml)
    return any(is_camera(table) for table in (source.toml or {}).values())


def is_camera(table: Any) -> bool:
    """Does a table have what every camera has?"""
    return isinstance(table, dict) and "matrix" in table and "size" in table


def read(source: Source) -> SourceCalibration:
    """All cameras; metres, Z up, unless a user states otherwise.

    Raises:
        InputError: a field that is missing or does not fit.
    """
    tables = source.toml if source.toml is not None else read_opencv_yaml(source.path)
    return SourceCalibration(
        read_sections(source, tables, "metres"), "m", "z", states_unit=False, assumed_up="z is up"
    )


def read_sections(source: Source, tables: Mapping[str, Any], unit: str) -> tuple[SourceCamera, ...]:
    """The cameras of sections in this layout.

    Args:
        source: whose they are, for messages.
        tables: section -> its fields; that of the metadata is passed over.
        unit: of their translations, for messages.

    Raises:
        InputError: a field that is missing or does not fit.
    """
    cameras = []
    for name, table in tables.items():
        if name == METADATA_SECTION:
            continue
        fields = TomlTable(source.path, f"[{name}]", table)
        lens = read_lens(fields)
        place = read_place(fields, unit)
        cameras.append(
            SourceCamera(name, lens.matrix, lens.distortions, *place, lens.size, lens.fisheye)
        )
    return tuple(cameras)
