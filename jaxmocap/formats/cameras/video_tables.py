"""Every [[video]] of a file, with its camera out of [calibration].

INPUTS: a recording's file, or a live run's. OUTPUTS: tables and Cameras.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxmocap.formats.cameras.calibration import camera_of, check_one_kind, read_sections
from jaxmocap.formats.files.short_repr import short_repr
from jaxmocap.formats.files.toml import TomlTable, same_file_name
from jaxmocap.geometry.cameras import Camera

VideoTable = tuple[TomlTable, str, Camera]


def read_video_tables(
    top: TomlTable, keys: Sequence[str], most: int, origin_world: np.ndarray | None = None
) -> tuple[Path | None, list[VideoTable]]:
    """The calibration file, and each video's table, name of its camera, and camera.

    Args:
        top: the whole file.
        keys: of a table.
        most: how many there may be.
        origin_world: (3,) metres, subtracted from the cameras' positions; None: zero.

    Raises:
        InputError: a camera that is missing or does not fit, or two whose files would be called the
            same.
    """
    tables = top.entries.get("video", [])
    if not isinstance(tables, list):
        raise top.error("[video]", "found one table, expected [[video]] in double brackets")
    if not tables:
        return None, []
    if "calibration" not in top:
        raise top.error("", "[calibration] is missing, which every [[video]] needs")
    calibration = TomlTable(top.path, "[calibration]", top.entries["calibration"], ("file",))
    file = calibration.file("file")
    if len(tables) > most:
        raise top.error("[[video]]", f"found {len(tables)}, expected at most {most}")
    sections, videos, earlier = read_sections(file), [], {}
    for i, table in enumerate(tables, 1):
        fields = TomlTable(top.path, f"[[video]] number {i}", table, keys)
        name = fields.file_name("camera")
        # Some file systems take large and small letters for the same.
        if (same := same_file_name(name)) in earlier:
            problem = f"found {short_repr(name)} beside {short_repr(earlier[same])}"
            raise fields.error("camera", f"{problem}, expected another camera")
        earlier[same] = name
        videos.append((fields, name, camera_of(file, sections, name, origin_world)))
    check_one_kind(top, {name: camera for _, name, camera in videos})
    return file, videos
