"""The [subject] of a recording: whose body it is.

INPUTS: a table with ``height`` (and ``mass``), or ``static`` (a marker file of the person
standing), ``up`` or ``to_world``, and ``landmarks``; or ``file``, a TOML file of these keys. With
``wrists = true`` the body has rotation of the neck, twist of the forearms and wrists as well.
OUTPUTS: a Skeleton scaled to the person.
"""

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.body.subject import scale_to_height, scale_to_landmarks
from jaxmocap.body.wrists import with_wrists
from jaxmocap.formats.axes import read_axes, to_world
from jaxmocap.formats.markers import read_markers
from jaxmocap.formats.toml import Fields, read_toml

_HEIGHT_KEYS = ("height", "mass")
_STATIC_KEYS = ("static", "up", "to_world", "landmarks", "mass")
DEFAULT_HEIGHT = 1.75


def read_subject(path: Path, where: str, table: Any) -> Skeleton:
    """The skeleton of a [subject] table.

    Args:
        path: the file that holds the table; paths in it are relative to it.
        where: how to call the table in messages.
        table: the table.

    Raises:
        InputError: a field that is missing, unknown or does not fit.
    """
    fields = Fields(path, where, table, ("file", "height", *_STATIC_KEYS, "wrists"))
    wrists = fields.table.get("wrists", False)
    if not isinstance(wrists, bool):
        raise fields.error("wrists", f"found {wrists!r}, expected true or false")
    if "wrists" in fields:
        rest = {key: value for key, value in fields.table.items() if key != "wrists"}
        skeleton = read_subject(path, where, rest)
        return with_wrists(skeleton) if wrists else skeleton
    chosen = [key for key in ("file", "height", "static") if key in fields]
    if len(chosen) != 1:
        found = " and ".join(chosen) or "none"
        raise fields.error("", f"found {found}, expected one of file, height, static")
    if chosen == ["height"]:
        return _by_height(Fields(path, where, table, _HEIGHT_KEYS))
    if chosen == ["static"]:
        return _by_static_trial(Fields(path, where, table, _STATIC_KEYS))
    other = Fields(path, where, table, ("file",)).file("file")
    content = read_toml(other)
    if "file" in content:
        raise fields.error("file", f"{other} names yet another file, expected height or static")
    return read_subject(other, "", content)


def _by_height(fields: Fields) -> Skeleton:
    height = fields.number("height")
    mass = fields.number("mass") if "mass" in fields else None
    try:
        return Skeleton.human(height, mass)
    except ValueError as error:
        raise fields.error("", str(error)) from None


def _by_static_trial(fields: Fields) -> Skeleton:
    path = fields.file("static")
    R_world_file = read_axes(fields)
    markers = read_markers(path).points()
    named = Fields(fields.path, "[subject.landmarks]", fields.required("landmarks"), LANDMARKS)
    landmarks = {}
    for landmark in named.table:
        marker = named.text(landmark)
        if marker not in markers:
            raise named.error(
                landmark, f"marker {marker!r} is not in {path}, found {', '.join(markers)}"
            )
        landmarks[landmark] = to_world(R_world_file, markers[marker])
    try:
        # Landmarks that are never seen together show as lengths that are not numbers.
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore", RuntimeWarning)
            skeleton = scale_to_landmarks(Skeleton.human(), landmarks)
        if "mass" in fields:
            skeleton = scale_to_height(skeleton, None, fields.number("mass"))
    except ValueError as error:
        raise named.error("", str(error)) from None
    if not (np.isfinite(skeleton.lengths).all() and np.isfinite(skeleton.directions).all()):
        raise named.error("", f"{path} shows neck, hips and shoulders in no common frame")
    return skeleton
