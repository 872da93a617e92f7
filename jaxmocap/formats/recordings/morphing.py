"""What goes along with a body's joints, as a TOML file (second paper, 4.2).

INPUTS: a .toml file like ``body/data/shoulder.toml``: rows of joints that follow and of swellings,
both for either side; and [[transition]] rows with ``to``, a surface's .npz file, as written.
OUTPUTS: a Morphing.
"""

from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.body.surfaces.morphing import WEIGHTINGS, Driver, Morphing, Transition, morphing_of
from jaxmocap.body.surfaces.surface import Patch
from jaxmocap.body.tree import Tree
from jaxmocap.formats.files.errors import comma_list, short_repr
from jaxmocap.formats.files.toml import TomlTable, read_toml
from jaxmocap.formats.recordings.surface import load_surface

STEERED = ("steered_by", "weighting")
KEYS = {
    "joint": ("name", "gain", *STEERED),
    "swelling": ("patch", "gain", "centre", "radii", "direction", *STEERED),
    "transition": ("to", "patches", *STEERED),
}
# Radians, and metres, by a driver of 1.
LARGEST_GAIN = {"joint": np.pi, "swelling": 0.3}


def read_morphing(path: str | Path, tree: Tree, patches: tuple[Patch, ...]) -> Morphing:
    """Read what goes along with a body's joints and its surface's patches.

    Raises:
        InputError: no such file, a field that is missing or of another kind, a joint or a patch
            that the body does not have, a joint that drives and follows, or a surface of other
            patches.
    """
    data = TomlTable(Path(path), "", read_toml(path), tuple(KEYS))
    rows = {kind: _rows(data, kind) for kind in KEYS}
    if not any(rows.values()):
        raise data.error("", f"nothing goes along, expected [[{']], [['.join(KEYS)}]]")
    names = tuple(patch.name for patch in patches)
    for row in rows["joint"]:
        row.number("gain", None, -LARGEST_GAIN["joint"], LARGEST_GAIN["joint"])
        _check_joints(row, tree, [row.text("name")], sided=True)
        _check_driver(row, tree, sided=True)
    for row in rows["swelling"]:
        _check_swelling(row, names)
        _check_driver(row, tree, sided=True)
    morphing = morphing_of({kind: [row.entries for row in rows[kind]] for kind in KEYS})
    moves = tuple(_transition(row, tree, patches) for row in rows["transition"])
    morphing = Morphing(morphing.followers, morphing.swellings, moves)
    follow = {each.joint for each in morphing.followers}
    if both := follow & {joint for driver in morphing.drivers for joint in driver.joints}:
        raise data.error("", f"{min(both)} drives and follows, expected one of the two")
    return morphing


def _rows(data: TomlTable, kind: str) -> list[TomlTable]:
    """The rows of one kind, their keys checked."""
    rows = data.entries.get(kind, [])
    if not isinstance(rows, list):
        raise data.error(kind, f"found {short_repr(rows)}, expected [[{kind}]]")
    return [TomlTable(data.path, f"{kind} {k}", row, KEYS[kind]) for k, row in enumerate(rows, 1)]


def _check_joints(row: TomlTable, tree: Tree, names: list[str], sided: bool) -> None:
    """InputError where the body has no such joint; ``sided`` where names stand for both sides."""
    valid = tree.joints
    if sided:
        left = [name.removesuffix("_l") for name in valid if name.endswith("_l")]
        valid = tuple(name for name in left if f"{name}_r" in tree.joints)
    for name in names:
        if name not in valid:
            raise row.error("", f"no joint {short_repr(name)}, expected of {comma_list(valid)}")


def _check_driver(row: TomlTable, tree: Tree, sided: bool) -> Driver:
    """What steers a row, as it is written."""
    names: Any = row.require("steered_by")
    if not (isinstance(names, list) and len(names) in (1, 2) and set(map(type, names)) == {str}):
        raise row.error("steered_by", f"found {short_repr(names)}, expected one or two joints")
    _check_joints(row, tree, names, sided)
    weighting = "linear"
    if "weighting" in row:
        weighting = row.choice("weighting", WEIGHTINGS, f"of {comma_list(WEIGHTINGS)}")
    return Driver(tuple(names), weighting)


def _check_swelling(row: TomlTable, patches: tuple[str, ...]) -> None:
    """InputError unless it is a place of the surface."""
    limbs = tuple(dict.fromkeys(name.removesuffix("_l").removesuffix("_r") for name in patches))
    row.choice("patch", limbs, f"of {comma_list(limbs)}")
    row.number("gain", None, -LARGEST_GAIN["swelling"], LARGEST_GAIN["swelling"])
    row.array("centre", [(2,)], "degrees around and share of the way along", 360.0)
    radii = row.array("radii", [(2,)], "degrees around and share of the way along", 360.0)
    if radii.min() <= 0:
        raise row.error("radii", f"found {short_repr(radii.tolist())}, expected both above 0")
    if "direction" in row:
        row.array("direction", [(3,)], "three numbers: ahead, left, up", 1e3)


def _transition(row: TomlTable, tree: Tree, patches: tuple[Patch, ...]) -> Transition:
    """Another surface, which must correspond to the body's own."""
    driver, file = _check_driver(row, tree, sided=False), row.file("to")
    to = load_surface(file, tree)
    if to.patches != patches:
        ours = comma_list(f"{p.name} {p.along} x {p.around}" for p in patches)
        raise row.error("to", f"{file.name} has other patches, expected node for node {ours}")
    names = [patch.name for patch in patches]
    chosen: Any = row.entries.get("patches", [])
    if not isinstance(chosen, list) or any(name not in names for name in chosen):
        expected = f"expected of {comma_list(names)}"
        raise row.error("patches", f"found {short_repr(chosen)}, {expected}")
    return Transition(driver, to, tuple(chosen))
