"""The [[video]] of a recording: which files, taken by which cameras.

INPUTS: a recording's TOML file, or a live run's, with [[video]] and [calibration].
OUTPUTS: a VideoSource of each, with its camera; or tables and Cameras.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.formats.cameras.calibration import camera_of, read_sections
from jaxmocap.formats.files.errors import comma_list, short_repr
from jaxmocap.formats.files.toml import TomlTable, same_file_name
from jaxmocap.formats.recordings.keypoint_files import LARGEST_FRAME_NUMBER
from jaxmocap.formats.recordings.keypoint_models import MODELS
from jaxmocap.formats.recordings.keypoints import Detections
from jaxmocap.formats.time_series.tables import LATEST_S
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.lenses import FISHEYE

# Cameras of one recording.
MAX_VIDEOS = 100
# What [[video]] may say of 2-D detections.
_KEYPOINT_KEYS = ("keypoints", "keypoints_model", "keypoints_first")


@dataclass(frozen=True)
class VideoSource:
    """One video and the camera that took it.

    Attributes:
        camera_name: of the camera.
        camera: its calibration.
        path: of the video file; None where the frames are in memory.
        offset: seconds to add to video time to get marker time.
        keypoints: folder (or file) of 2-D detections, what was read from it already, or None.
        keypoints_model: whose points they are, or None to infer it from them.
        keypoints_first: number that they give the video's first frame, or None to infer it.
        frames: video times (F,) in seconds and images (F, H, W, 3) BGR uint8, or None.
        background: image file of what the camera sees without the person, or None.
    """

    camera_name: str
    camera: Camera
    path: Path | None = None
    offset: float = 0.0
    keypoints: Path | Detections | None = None
    keypoints_model: str | None = None
    keypoints_first: int | None = None
    frames: tuple[np.ndarray, Sequence[np.ndarray] | np.ndarray] | None = None
    background: Path | None = None


def read_videos(top: TomlTable, origin_world: np.ndarray | None = None) -> tuple[VideoSource, ...]:
    """The videos of a recording's file; see ``read_video_tables``."""
    keys = ("file", "camera", "offset", "background", *_KEYPOINT_KEYS)
    return tuple(
        VideoSource(
            camera_name=name,
            camera=camera,
            path=fields.file("file"),
            offset=fields.number("offset", 0.0, -LATEST_S, LATEST_S),
            background=fields.file("background") if "background" in fields else None,
            **_keypoints(fields),
        )
        for fields, name, camera in read_video_tables(top, keys, MAX_VIDEOS, origin_world)[1]
    )


def _keypoints(fields: TomlTable) -> dict[str, Any]:
    """Where a video's 2-D detections are, and how to read them."""
    stated: dict[str, Any] = {}
    for key in _KEYPOINT_KEYS:
        if key in fields and "keypoints" not in fields:
            raise fields.error(key, "found without 'keypoints', which it is about")
    if "keypoints" in fields:
        is_file = fields.text("keypoints").lower().endswith(".json")
        stated["keypoints"] = fields.file("keypoints", folder=not is_file)
    if "keypoints_model" in fields:
        stated["keypoints_model"] = fields.choice("keypoints_model", MODELS)
    if "keypoints_first" in fields:
        limit = LARGEST_FRAME_NUMBER
        stated["keypoints_first"] = fields.integer("keypoints_first", -limit, limit)
    return stated


def read_video_tables(
    top: TomlTable, keys: Sequence[str], most: int, origin_world: np.ndarray | None = None
) -> tuple[Path | None, list[tuple[TomlTable, str, Camera]]]:
    """The calibration file; of ``most`` videos at most, its table, camera's name and camera.

    ``origin_world`` (3,), metres, is subtracted from the cameras' positions.

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
    fisheyes = [name for _, name, camera in videos if camera.lens == FISHEYE]
    others = [name for _, name, camera in videos if camera.lens != FISHEYE]
    if fisheyes and others:
        problem = f"found fisheye lenses ({comma_list(fisheyes)}) beside ordinary ones"
        raise top.error("[[video]]", f"{problem} ({comma_list(others)}), expected one kind")
    return file, videos
