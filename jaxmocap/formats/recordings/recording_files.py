"""Which files a recording is made of.

INPUTS: a recording's TOML file.
OUTPUTS: itself and the files that its fields name: markers, videos, backgrounds, key points,
calibration, subject and static trial. None of them is opened but the two TOML files.

Only fields for files are read, and only regular files count: a folder of key
points stands for the .json files in it, a device or a pipe for nothing. What is not there is listed
all the same, so that whoever opens it can say so.
"""

import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.toml import is_folder, read_toml
from jaxmocap.formats.recordings.keypoint_files import json_files

_VIDEO_FILE_KEYS = ("file", "background", "keypoints")


def input_files(path: str | Path) -> list[Path]:
    """A recording's file and all regular files that it names, or that are not there, by path.

    Raises:
        InputError: the recording's file itself is missing or not TOML.
    """
    path = Path(path)
    content = read_toml(path)
    folder, subject = path.parent, _table(content.get("subject"))
    files = {path}
    for text in _named_files(content):
        files |= _files(folder, text)
    for own in _files(folder, subject.get("file")):
        files |= {own} | _files(own.parent, _content(own).get("static"))
    return sorted(files)


def _named_files(content: dict[str, Any]) -> Iterator[Any]:
    """What the fields for files say, but for the subject's own file."""
    yield _table(content.get("markers")).get("file")
    yield _table(content.get("calibration")).get("file")
    yield _table(content.get("subject")).get("static")
    videos = content.get("video")
    for video in videos if isinstance(videos, list) else []:
        yield from (_table(video).get(key) for key in _VIDEO_FILE_KEYS)


def _table(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _content(path: Path) -> dict[str, Any]:
    try:
        return read_toml(path)
    except InputError:
        return {}


def _files(folder: Path, text: Any) -> set[Path]:
    """The files that a text stands for; none where it is no text, or of no regular file."""
    if not isinstance(text, str) or not text:
        return set()
    path = folder / text
    if is_folder(path):
        try:
            return set(json_files(path))
        except InputError:
            return set()
    try:
        return {path} if stat.S_ISREG(os.stat(path).st_mode) else set()
    except FileNotFoundError:
        return {path}
    except (OSError, ValueError):
        # A name that no file has.
        return set()
