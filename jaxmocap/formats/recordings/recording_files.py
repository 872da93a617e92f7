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
from contextlib import suppress
from pathlib import Path
from typing import Any

from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.toml import read_toml
from jaxmocap.formats.recordings.keypoint_files import json_files


def input_files(path: str | Path) -> list[Path]:
    """A recording's file, and all regular or missing ones that it names; InputError for no TOML."""
    path = Path(path)
    content = read_toml(path)
    folder, subject = path.parent, _table(content.get("subject"))
    files = {path}
    named = [_table(content.get("markers")).get("file")]
    named += [_table(content.get("calibration")).get("file"), subject.get("static")]
    if isinstance(videos := content.get("video"), list):
        named += [
            _table(video).get(key)
            for video in videos
            for key in ("file", "background", "keypoints")
        ]
    for text in named:
        files |= _files(folder, text)
    for own in _files(folder, subject.get("file")):
        files.add(own)
        with suppress(InputError):
            files |= _files(own.parent, read_toml(own).get("static"))
    return sorted(files)


def _table(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _files(folder: Path, text: Any) -> set[Path]:
    """The files that a text stands for; none where it is no text, or of no regular file."""
    if not isinstance(text, str) or not text:
        return set()
    path = folder / text
    if os.path.isdir(path):
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
