"""NPZ: a Motion as NumPy arrays, readable without this package and without pickle.

INPUTS: a Motion; or a .npz file that was written here.
OUTPUTS: a .npz file whose arrays are named ``times``, ``pose.position``, ``skeleton.lengths``,
``tree.bones``, ``report.confidence`` and so on; or the Motion.
"""

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxmocap.body.motion import Motion, Report
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton, Tree
from jaxmocap.formats.errors import InputError
from jaxmocap.formats.writing import replacing

VERSION = 2
_SKELETON = tuple(field.name for field in fields(Skeleton) if field.name != "tree")
_REPORT = ("marker_errors", "arm_costs", "swivels", "confidence", "landmarks_std", "from_prior")


def save_motion(path: str | Path, motion: Motion) -> None:
    """Write a motion with its skeleton and report."""
    tree, skeleton = motion.skeleton.tree, motion.skeleton
    arrays: dict[str, Any] = {"version": VERSION, "times": np.asarray(motion.times, float)}
    arrays |= {f"pose.{name}": part for name, part in motion.poses._asdict().items()}
    arrays |= {f"skeleton.{name}": getattr(skeleton, name) for name in _SKELETON}
    arrays |= {"tree.bones": tree.bones, "tree.parents": tree.parents}
    arrays |= {"tree.joints": tree.joints, "tree.dof_bones": tree.dof_bones}
    if (report := motion.report) is not None:
        arrays |= {f"report.{name}": getattr(report, name) for name in _REPORT}
        arrays |= {f"milliseconds.{stage}": times for stage, times in report.milliseconds.items()}
        arrays["report.markers"] = np.array(report.markers, str)
        arrays["report.statuses"] = json.dumps(report.statuses)
        arrays["report.settings"] = json.dumps(report.settings, default=_plain)
    with replacing(path) as beside, beside.open("wb") as file:
        plain = {name: np.asarray(value) for name, value in arrays.items()}
        np.savez_compressed(file, **plain)  # type: ignore[arg-type]


def _plain(value: Any) -> Any:
    """Arrays as lists; what else JSON has no word for as text."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def load_motion(path: str | Path) -> Motion:
    """Read a motion.

    Raises:
        InputError: no such file, or not a motion.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = dict(file)
    except FileNotFoundError:
        raise InputError(path, "no such file") from None
    except Exception:  # a broken archive raises any of a dozen, zlib's and tokenize's among them
        raise InputError(path, "not an .npz file, or cut off") from None
    if int(arrays.get("version", 0)) != VERSION:
        found = arrays.get("version", "none")
        raise InputError(path, f"version: found {found}, expected {VERSION}")
    try:
        skeleton = _skeleton(arrays)
        poses = Pose(*(arrays[f"pose.{name}"] for name in Pose._fields))
        report = _report(arrays) if "report.markers" in arrays else None
    except KeyError as error:
        raise InputError(path, f"the array {error} is missing") from None
    return Motion(skeleton, arrays["times"], poses, report)


def _skeleton(arrays: dict[str, np.ndarray]) -> Skeleton:
    tree = Tree(*(tuple(arrays[f"tree.{field.name}"].tolist()) for field in fields(Tree)))
    parts = {name: jnp.asarray(arrays[f"skeleton.{name}"], float) for name in _SKELETON}
    return Skeleton(tree=tree, **parts)


def _report(arrays: dict[str, np.ndarray]) -> Report:
    stages = {name: array for name, array in arrays.items() if name.startswith("milliseconds.")}
    return Report(
        markers=tuple(arrays["report.markers"].tolist()),
        **{name: arrays[f"report.{name}"] for name in _REPORT},
        statuses=tuple(tuple(said) for said in json.loads(str(arrays["report.statuses"]))),
        milliseconds={name.partition(".")[2]: array for name, array in stages.items()},
        settings=json.loads(str(arrays["report.settings"])),
    )
