"""Calibrations of Caliscope (once pyxy3d): ``camera_array.toml``, or ``config.toml`` before it.

INPUTS: ``[cameras.0]`` or ``[cam_0]`` with size, matrix, distortions, rotation, translation and
Caliscope's own keys. OUTPUTS: its cameras, named cam_0 as Caliscope itself exports them; metres.

As Caliscope reads it (``cameras/camera_array.py``): rotation (a Rodrigues vector, once a matrix)
and translation lead from the world to the camera. A user sets origin and axes by the board and may
flip them, which no file states.
"""

from jaxmocap.formats.calibrations.shared_layout import is_camera, sections_of
from jaxmocap.formats.calibrations.source import Source, SourceCalibration, left_out

_OWN_KEYS = {"rotation_count", "grid_count", "cam_id", "port", "verified_resolutions"}


def read(source: Source) -> SourceCalibration | None:
    """The cameras that are placed and not ignored."""
    prefix, tables = "", source.toml
    if isinstance(cameras := tables.get("cameras"), dict):
        prefix, tables = "cam_", cameras
    tables = {f"{prefix}{key}": each for key, each in tables.items() if is_camera(each)}
    if not any(_OWN_KEYS & set(table) for table in tables.values()):
        return None
    placed = {
        name: table
        for name, table in tables.items()
        if "rotation" in table and "translation" in table and table.get("ignore") is not True
    }
    notes = left_out("not placed, or ignored", [name for name in tables if name not in placed])
    return SourceCalibration(
        sections_of(source, placed), "m", "z", assumed_up="z is up", notes=notes
    )
