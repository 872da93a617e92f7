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
PROPORTIONS = "proportions.toml"
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
    data = data_of(name)
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
    data, taken = data_of(name), []
    for source in data.get("joints_of", []):
        rows = {row["name"]: row for row in joint_rows(_beside(name, source["file"]))}
        taken += [rows[joint] for joint in source.get("names", rows)]
    return taken + data.get("joint", [])


@cache
def proportions_of(name: str) -> dict:
    """A body's lengths over its stature, by the name of their table in ``proportions.toml``.

    Raises:
        KeyError: no such table; the message lists them.
    """
    data = data_of(PROPORTIONS)
    names = [key for key in data if "lengths" in data[key]]
    if name not in names:
        raise KeyError(f"found {name!r}, expected one of {', '.join(names)}")
    return data[name]


@cache
def bodies() -> tuple[str, ...]:
    """Names of the files in ``body/data`` that are bodies."""
    names = sorted(
        file.name
        for file in resources.files("jaxmocap.body").joinpath("data").iterdir()
        if file.name.endswith(".toml")
    )
    return tuple(name for name in names if {"bone", "bones_of"} & set(data_of(name)))


@cache
def joints_of_models() -> dict[str, dict]:
    """Joint -> its row, of all files in ``body/data``."""
    names = [*bodies(), MARKED, "wrists.toml"]
    return {row["name"]: row for name in names for row in joint_rows(name)}


def _beside(name: str | Path, other: str) -> str | Path:
    """A file that another names: beside it, or else ours."""
    there = Path(name).parent / other
    return there if isinstance(name, Path) and there.exists() else other


def data_of(name: str | Path) -> dict:
    """All that a file in ``body/data``, or at a path, holds: tables and rows by their names."""
    here = resources.files("jaxmocap.body").joinpath("data")
    file = name if isinstance(name, Path) else here.joinpath(name)
    return tomllib.loads(file.read_text(encoding="utf-8"))
