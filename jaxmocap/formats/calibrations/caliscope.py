"""Calibrations of Caliscope (once pyxy3d): ``camera_array.toml``, or ``config.toml`` before it.

INPUTS: ``[cameras.0]`` or ``[cam_0]`` with size, matrix, distortions, rotation, translation and
Caliscope's own keys. OUTPUTS: its cameras, named cam_0 as Caliscope itself exports them; metres.

As Caliscope reads it (``cameras/camera_array.py``): rotation (a Rodrigues vector, once a matrix)
and translation lead from the world to the camera. A user sets origin and axes by the board and may
flip them, which no file states.
"""

from collections.abc import Mapping
from typing import Any

from jaxmocap.formats.calibrations.shared_layout import is_camera, read_sections
from jaxmocap.formats.calibrations.source import Source, SourceCalibration
from jaxmocap.formats.files.short_repr import comma_list

_OWN_KEYS = {"rotation_count", "grid_count", "cam_id", "port", "verified_resolutions"}


def recognises(source: Source) -> bool:
    """Is it a .toml file with Caliscope's own keys?"""
    return any(_OWN_KEYS & set(table) for table in _tables(source).values())


def _tables(source: Source) -> dict[str, Mapping[str, Any]]:
    """The cameras' tables, by their names."""
    tables = source.toml or {}
    if isinstance(cameras := tables.get("cameras"), dict):
        return {f"cam_{key}": each for key, each in cameras.items() if is_camera(each)}
    return {key: each for key, each in tables.items() if is_camera(each)}


def read(source: Source) -> SourceCalibration:
    """The cameras that are placed and not ignored.

    Raises:
        InputError: a field that is missing or does not fit.
    """
    tables = _tables(source)
    placed = {
        name: table
        for name, table in tables.items()
        if "rotation" in table and "translation" in table and table.get("ignore") is not True
    }
    left_out = [name for name in tables if name not in placed]
    notes = (f"left out: not placed, or ignored: {comma_list(left_out)}",) if left_out else ()
    return SourceCalibration(
        read_sections(source, placed, "metres"), "m", "z", assumed_up="z is up", notes=notes
    )
