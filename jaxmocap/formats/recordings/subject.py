"""The [subject] of a recording: whose body it is.

INPUTS: a table with ``height`` (and ``mass``, ``sex``), or ``static`` (a marker file of the person
standing), ``up`` or ``to_world``, and ``landmarks``; or ``file``, a TOML file of these keys. With
``wrists = true`` the body has rotation of the neck, twist of the forearms and wrists as well; that
is the default where a marker on head or hands measures an orientation.
Beside ``height`` the table ``bones`` may state single bones' ``length`` (metres), ``mass``
(kilograms), ``diameter`` (metres, near and far end) and ``direction`` (in the upright body's axes).
OUTPUTS: a Skeleton scaled to the person; or such a file, which ``jaxmocap scale`` writes.
"""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.body.skeleton import JOINT_CENTRES, LANDMARKS, Skeleton, scale_to_height, with_wrists
from jaxmocap.body.subject import scale_to_landmarks
from jaxmocap.compilation.arrays import on_device
from jaxmocap.formats.files.errors import InputError, comma_list, short_name, short_repr
from jaxmocap.formats.files.toml import TomlTable, read_toml, write_toml
from jaxmocap.formats.time_series.axes import read_axes, to_world
from jaxmocap.formats.time_series.markers import read_markers

_HEIGHT_KEYS = ("height", "mass", "sex", "proportions", "bones")
# Whose bodies ``proportions.toml`` has.
SEXES = ("female", "male")
# Lengths that a bone may have, metres.
LENGTH_RANGE_M = (0.01, 1.0)
# Masses that a bone may have, kilograms.
MASS_RANGE_KG = (0.01, 100.0)
# Landmarks of a static trial that are accepted and measure nothing.
_UNUSED_LANDMARKS = ("pelvis", "head")
_STATIC_KEYS = ("static", "up", "to_world", "landmarks", "mass")
DEFAULT_HEIGHT = 1.75
_SKELETON_FIELDS = {
    "length": "lengths",
    "mass": "masses",
    "diameter": "diameters",
    "direction": "directions",
}


def subject_or_default(top: TomlTable, wrists: bool = False) -> tuple[Skeleton, tuple[str, ...]]:
    """A file's [subject] (see ``read_subject``), or one of the default height with a warning."""
    if "subject" in top:
        return read_subject(top.path, "[subject]", top.entries["subject"], wrists), ()
    warning = f"{top.path}: no [subject], a height of {DEFAULT_HEIGHT} m is assumed"
    skeleton = Skeleton.human(DEFAULT_HEIGHT)
    return with_wrists(skeleton) if wrists else skeleton, (warning,)


def read_subject(path: Path, where: str, table: Any, wrists: bool = False) -> Skeleton:
    """The skeleton of a table, called ``where`` in messages, of the file that its paths start at.

    It has wrists where the table or its file states them, or by ``wrists`` where neither does.
    InputError for a field that is missing, unknown or does not fit.
    """
    keys = ("file", *_HEIGHT_KEYS, *_STATIC_KEYS, "wrists")
    fields = TomlTable(path, where, table, keys)
    usual = fields.flag("wrists", wrists)
    rest = {key: value for key, value in fields.entries.items() if key != "wrists"}
    stated = fields.only_one("file", "height", "static")
    if stated == "file":
        other = TomlTable(path, where, rest, ("file",)).file("file")
        content = read_toml(other)
        if "file" in content:
            raise fields.error("file", f"{other} names yet another file, expected height or static")
        skeleton = read_subject(other, "", content, usual)
        return with_wrists(skeleton) if fields.flag("wrists") else skeleton
    if stated == "height":
        skeleton = _by_height(TomlTable(path, where, rest, _HEIGHT_KEYS))
    else:
        skeleton = _by_static_trial(TomlTable(path, where, rest, _STATIC_KEYS))
    return with_wrists(skeleton) if usual else skeleton


def person_table(path: Path) -> TomlTable:
    """A recording file's [subject], or the file's that it names; empty where there is none."""
    fields = TomlTable(path, "[subject]", read_toml(path).get("subject", {}))
    if "file" not in fields:
        return fields
    other = fields.file("file")
    return TomlTable(other, "", read_toml(other))


def _by_height(fields: TomlTable) -> Skeleton:
    height = fields.number("height")
    mass = fields.number("mass") if "mass" in fields else None
    proportions = stated_proportions(fields)
    try:
        skeleton = Skeleton.human(height, mass, proportions)
    except ValueError as error:
        raise fields.error("", str(error)) from None
    except KeyError as error:
        raise fields.error("proportions", error.args[0]) from None
    where = " ".join(filter(None, [fields.where, "bones"]))
    return _with_bones(skeleton, TomlTable(fields.path, where, fields.entries.get("bones", {})))


def stated_proportions(fields: TomlTable) -> str:
    """By which table of ``proportions.toml`` a [subject]'s lengths follow from its height."""
    if "sex" not in fields:
        return fields.text("proportions") if "proportions" in fields else JOINT_CENTRES
    sex = fields.choice("sex", SEXES)
    if "proportions" in fields:
        raise fields.error("proportions", "found beside sex, expected one of them")
    return sex


def _with_bones(skeleton: Skeleton, bones: TomlTable) -> Skeleton:
    """The skeleton with what is stated of single bones."""
    names = skeleton.tree.bones
    columns = {
        key: np.array(getattr(skeleton, column), float) for key, column in _SKELETON_FIELDS.items()
    }
    for name, entry in bones.entries.items():
        if name not in names:
            raise bones.error(name, f"unknown bone, expected one of {', '.join(names)}")
        stated = TomlTable(bones.path, f"{bones.where} {name}", entry, _SKELETON_FIELDS)
        for key in stated.entries:
            columns[key][names.index(name)] = _bone_value(stated, key)
    parts: dict[str, Any] = {
        column: on_device(columns[key]) for key, column in _SKELETON_FIELDS.items()
    }
    return replace(skeleton, **parts)


def _bone_value(fields: TomlTable, key: str) -> np.ndarray | float:
    """What a table says of one bone."""
    if key in ("length", "mass"):
        is_length = key == "length"
        low, high = LENGTH_RANGE_M if is_length else MASS_RANGE_KG
        return fields.number(key, None, low, high, "metres" if is_length else "kilograms")
    if key == "diameter":
        ends = fields.array(key, [(2,)], "metres at the near and the far end", LENGTH_RANGE_M[1])
        if not (ends > 0).all():
            raise fields.error(key, f"found {ends.tolist()}, expected metres above 0")
        return ends
    along = fields.array(key, [(3,)], "x, y, z")
    if not (norm := float(np.linalg.norm(along))) > 1e-6:
        raise fields.error(key, f"found {along.tolist()}, expected a direction")
    return along / norm


def check_replaceable(path: Path) -> None:
    """InputError where a file that is there is no body: it was not meant to be replaced."""
    if not path.exists():
        return
    try:
        read_subject(path, "", read_toml(path))
    except InputError:
        problem = "is there and is no body that 'jaxmocap scale' writes, expected another name"
        raise InputError(path, problem) from None


def write_subject(
    path: str | Path,
    skeleton: Skeleton,
    height: float,
    comments: Sequence[str] = (),
    sex: str | None = None,
) -> None:
    """Write a body's bones to a file for [subject]; what it leaves open follows from the rest."""
    masses = np.asarray(skeleton.masses, float)
    usual = Skeleton.human(height, proportions=sex or JOINT_CENTRES)
    entries = {}
    for i, name in enumerate(skeleton.tree.bones):
        entry: dict[str, Any] = {"length": round(float(skeleton.lengths[i]), 6)}
        entry["mass"] = round(float(masses[i]), 5)
        entry["diameter"] = [round(float(end), 5) for end in skeleton.diameters[i]]
        if not np.allclose(skeleton.directions[i], usual.directions[i], atol=1e-6):
            entry["direction"] = [round(float(part), 6) for part in skeleton.directions[i]]
        entries[name] = entry
    top: dict[str, Any] = {"height": round(height, 4), "mass": round(float(masses.sum()), 3)}
    if sex is not None:
        top["sex"] = sex
    if skeleton.tree.joints != usual.tree.joints:
        top["wrists"] = True
    title = "# Metres and kilograms; what is not stated of a bone follows from height and mass."
    title = "\n".join([title, *(f"# {line}" for line in comments)])
    write_toml(path, [(title, top), ("[bones]", entries)])


def static_landmarks(fields: TomlTable) -> dict[str, np.ndarray]:
    """Landmark -> (T, 3) of the static trial that a [subject] names, world, metres."""
    path = fields.file("static")
    R_world_file = read_axes(fields)
    markers = read_markers(path).points()
    landmark_table = _landmark_table(fields)
    landmarks: dict[str, np.ndarray] = {}
    taken: dict[str, str] = {}
    for landmark in landmark_table.entries:
        marker = landmark_table.text(landmark)
        if landmark not in _UNUSED_LANDMARKS:
            if marker in taken:
                problem = f"found marker {short_repr(marker)}, which is {taken[marker]} already"
                raise landmark_table.error(landmark, f"{problem}, expected one of its own")
            taken[marker] = landmark
        if marker not in markers:
            raise landmark_table.error(
                landmark,
                f"marker {short_repr(marker)} is not in {path}, found {comma_list(markers)}",
            )
        landmarks[landmark] = to_world(R_world_file, markers[marker])
    return landmarks


def _landmark_table(fields: TomlTable) -> TomlTable:
    """The table of landmarks."""
    return TomlTable(fields.path, "[subject.landmarks]", fields.require("landmarks"), LANDMARKS)


def _by_static_trial(fields: TomlTable) -> Skeleton:
    landmarks, landmark_table = static_landmarks(fields), _landmark_table(fields)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore", RuntimeWarning)
            skeleton = scale_to_landmarks(Skeleton.human(), landmarks)
        if "mass" in fields:
            skeleton = scale_to_height(skeleton, None, fields.number("mass"))
    except ValueError as error:
        raise landmark_table.error("", str(error)) from None
    if (longest := float(np.max(skeleton.lengths))) > LENGTH_RANGE_M[1]:
        problem = f"shows bones of up to {longest:.4g} m, expected at most {LENGTH_RANGE_M[1]:g} m"
        raise landmark_table.error("", f"{short_name(fields.text('static'))} {problem}")
    return skeleton
