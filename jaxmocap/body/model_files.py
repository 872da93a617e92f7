"""The files that say what a body is like: bones, joints, landmarks.

INPUTS: a name in ``body/data``, or the path of a file of the same form; ``human.toml`` says what
each column means. OUTPUTS: rows as dicts.

A file may take bones or joints from others (``bones_of``, ``joints_of``) and add its own.
"""

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

HUMAN = "human.toml"
_PROPORTIONS = "proportions.toml"
# Joints that a full set of markers determines beyond those of ``HUMAN``.
MARKED = "markers.toml"


@dataclass(frozen=True)
class ModelFile:
    """What a body's file says."""

    bones: list[dict]  # rows, parents before children
    joints: list[dict]  # rows, proximal to distal
    root: dict  # of the virtual root


# The file is kept, not its arrays: those would outlive a trace or a change of precision.
@cache
def read_model(name: str | Path) -> ModelFile:
    """Read a body's file.

    Raises:
        FileNotFoundError: no such file in ``body/data``, nor at that path.
    """
    data = _data(name)
    own = data.get("bone", [])
    if "bones_of" not in data:
        return ModelFile(own, joint_rows(name), data["root"])
    source = read_model(_beside(name, data["bones_of"]))
    return ModelFile([*source.bones, *own], joint_rows(name), data.get("root", source.root))


@cache
def joint_rows(name: str | Path) -> list[dict]:
    """The joints alone: of a body, or of a file that only adds joints to bodies.

    First those that it takes from other files, all or some, then its own.
    """
    data, taken = _data(name), []
    for source in data.get("joints_of", []):
        rows = {row["name"]: row for row in joint_rows(_beside(name, source["file"]))}
        taken += [rows[joint] for joint in source.get("names", rows)]
    return taken + data.get("joint", [])


def landmark_rows_of(name: str | Path) -> list[dict]:
    """The landmarks of a body's file."""
    return _data(name)["landmark"]


def surface_rows_of(name: str | Path) -> list[dict]:
    """The patches of the surface that a body has, and how far up; none where it has them all."""
    return _data(name).get("surface", [])


@cache
def proportions_of(name: str) -> dict:
    """A body's lengths over its stature, by the name of their table in ``proportions.toml``.

    Raises:
        KeyError: no such table; the message lists them.
    """
    data = _data(_PROPORTIONS)
    names = [key for key in data if "lengths" in data[key]]
    if name not in names:
        raise KeyError(f"found {name!r}, expected one of {', '.join(names)}")
    return data[name]


def mass_fractions() -> dict[str, float]:
    """Part -> its share of the body's mass."""
    return _data(_PROPORTIONS)["masses"]


def habits_of(name: str) -> dict:
    """What people do, by the name of a file in ``body/data``."""
    return _data(name)


@cache
def bodies() -> tuple[str, ...]:
    """Names of the files in ``body/data`` that are bodies."""
    names = sorted(
        file.name
        for file in resources.files("jaxmocap.body").joinpath("data").iterdir()
        if file.name.endswith(".toml")
    )
    return tuple(name for name in names if {"bone", "bones_of"} & set(_data(name)))


@cache
def joints_of_models() -> dict[str, dict]:
    """Joint -> its row, of all files in ``body/data``."""
    names = [*bodies(), MARKED, "wrists.toml"]
    return {row["name"]: row for name in names for row in joint_rows(name)}


def _beside(name: str | Path, other: str) -> str | Path:
    """A file that another names: beside it, or else ours."""
    there = Path(name).parent / other
    return there if isinstance(name, Path) and there.exists() else other


def _data(name: str | Path) -> dict:
    """What a file holds."""
    if isinstance(name, Path):
        return tomllib.loads(name.read_text(encoding="utf-8"))
    text = resources.files("jaxmocap.body").joinpath("data", name).read_text(encoding="utf-8")
    return tomllib.loads(text)
