"""NPZ: a Motion as NumPy arrays, readable without this package and without pickle.

INPUTS: a Motion; or a .npz file that was written here.
OUTPUTS: a .npz file whose arrays are named ``times``, ``pose.position``, ``skeleton.lengths``,
``tree.bones``, ``report.landmarks_std`` and so on; or the Motion.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from jaxmocap.body.model_files import HUMAN, bodies, joints_of_models, read_model
from jaxmocap.body.motion import SAMPLED, Motion, Report, Run, near_origin
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS, Skeleton, joint_columns, load_skeleton
from jaxmocap.body.tree import ROOT_DOF, Tree
from jaxmocap.compilation.arrays import on_device
from jaxmocap.formats.files.arrays import INTEGERS, NAMES, TEXT, ArraySpec, NpzArrays
from jaxmocap.formats.files.errors import InputError, comma_list, short_repr
from jaxmocap.formats.files.json_text import parse_json
from jaxmocap.formats.files.writing import replacing
from jaxmocap.formats.time_series.tables import FARTHEST_M, check_times

VERSION = 2
_STAGE_PREFIX = "milliseconds."

# Beyond these no number is a person's: metres of a bone, kilograms, radians, seconds.
_LONGEST_M = 10.0
_HEAVIEST_KG = 1e4
_LARGEST_RAD = 1e6
_LATEST_S = 1e12
# Quaternions and axes may differ from length 1 by this: single precision, rounded a few times.
_UNIT_TOLERANCE = 1e-3
# Characters of the statuses of all samples together.
_MAX_STATUS_CHARACTERS = 2**25
# Characters of the settings.
_MAX_SETTINGS_CHARACTERS = 2**22
# A default of the settings -> what JSON has for such; None is of a text that may be missing.
_JSON_KINDS = {
    dict: (dict, "a JSON table"),
    tuple: (list, "a JSON list"),
    int: (int, "a whole number"),
    str: (str, "a text"),
    type(None): (str, "a text"),
}

# What a file holds of the skeleton; the rest follows from the joints' names.
_BODY_SPECS = {
    "skeleton.lengths": ArraySpec(("B",), low=0, high=_LONGEST_M),
    "skeleton.directions": ArraySpec(("B", 3), low=-1 - _UNIT_TOLERANCE, high=1 + _UNIT_TOLERANCE),
    "skeleton.masses": ArraySpec(("B",), low=0, high=_HEAVIEST_KG),
    "skeleton.centres": ArraySpec(("B",), low=-1, high=2),
    "skeleton.diameters": ArraySpec(("B", 2), low=0, high=_LONGEST_M),
    "skeleton.axes": ArraySpec(("D", 3), low=-1 - _UNIT_TOLERANCE, high=1 + _UNIT_TOLERANCE),
    "skeleton.limits": ArraySpec(("D", 2), low=-_LARGEST_RAD, high=_LARGEST_RAD),
    "skeleton.costs": ArraySpec(("C",), low=0, high=1e9),
    "skeleton.relaxed": ArraySpec(("D",), low=-_LARGEST_RAD, high=_LARGEST_RAD),
}
# And of its tree.
_TREE_SPECS = {
    "tree.bones": ArraySpec(("B",), NAMES),
    "tree.parents": ArraySpec(("B",), INTEGERS),
    "tree.joints": ArraySpec(("D",), NAMES),
    "tree.dof_bones": ArraySpec(("D",), INTEGERS),
}
_POSE_SPECS = {
    "times": ArraySpec(("T",), low=-_LATEST_S, high=_LATEST_S),
    "pose.position": ArraySpec(("T", 3), low=-FARTHEST_M, high=FARTHEST_M, allow_nan=True),
    "pose.quaternion": ArraySpec(
        ("T", 4), low=-1 - _UNIT_TOLERANCE, high=1 + _UNIT_TOLERANCE, allow_nan=True
    ),
    "pose.angles": ArraySpec(("T", "D"), low=-_LARGEST_RAD, high=_LARGEST_RAD, allow_nan=True),
}
# What the report has of each sample, where there is any.
_reported = partial(ArraySpec, low=-1e9, high=1e9, allow_nan=True, allow_infinity=True)
_REPORT_SPECS = {
    "report.markers": ArraySpec(("M",), NAMES),
    "report.marker_errors": _reported(("T", "M")),
    "report.arm_costs": _reported(("T", 2)),
    "report.swivels": _reported(("T", 2), low=-_LARGEST_RAD, high=_LARGEST_RAD),
    "report.landmarks_std": _reported(("T", len(LANDMARKS), 3)),
    "report.from_prior": ArraySpec(("T", len(LANDMARKS)), low=0, high=1, allow_nan=True),
    "report.statuses": ArraySpec((), TEXT, max_characters=_MAX_STATUS_CHARACTERS),
    "report.settings": ArraySpec((), TEXT, max_characters=_MAX_SETTINGS_CHARACTERS),
}
_MILLISECONDS_SPEC = ArraySpec(("*",), low=-1e12, high=1e12, allow_nan=True)


def save_motion(path: str | Path, motion: Motion) -> None:
    """Write a motion with its skeleton and report."""
    tree, skeleton = motion.skeleton.tree, motion.skeleton
    arrays: dict[str, Any] = {"version": VERSION, "times": np.asarray(motion.times, float)}
    arrays |= {f"pose.{name}": part for name, part in motion.poses._asdict().items()}
    arrays["pose.position"] = motion.positions_world
    for part, specs in ((skeleton, _BODY_SPECS), (tree, _TREE_SPECS)):
        arrays |= {name: getattr(part, name.partition(".")[2]) for name in specs}
    if (report := motion.report) is not None:
        arrays |= {f"report.{name}": getattr(report, name) for name in SAMPLED}
        arrays |= {f"{_STAGE_PREFIX}{stage}": times for stage, times in report.milliseconds.items()}
        arrays["report.markers"] = np.array(report.markers, str)
        arrays["report.statuses"] = _statuses_text(report.statuses)
        # Arrays as lists; what else JSON has no word for as text.
        arrays["report.settings"] = json.dumps(
            report.run.as_dict(),
            default=lambda value: value.tolist() if hasattr(value, "tolist") else str(value),
        )
    with replacing(path) as temporary, temporary.open("wb") as file:
        plain = {name: np.asarray(value) for name, value in arrays.items()}
        np.savez_compressed(file, **plain)  # type: ignore[arg-type]


def load_motion(path: str | Path) -> Motion:
    """Read a motion, every array checked; InputError for none, or one that contradicts itself."""
    file = NpzArrays(path)
    if "version" not in file.names:
        raise InputError(path, f"version: found none, expected {VERSION}")
    version = int(file.read({"version": ArraySpec((), INTEGERS)})["version"])
    if version != VERSION:
        raise InputError(path, f"version: found {version}, expected {VERSION}")
    skeleton = _skeleton(file)
    poses = file.read(_POSE_SPECS)
    times = np.asarray(poses["times"], float)
    if not len(times):
        raise InputError(path, "times: found no sample, expected at least one")
    check_times(path, times, "sample")
    _check_units(path, "pose.quaternion", poses["pose.quaternion"])
    parts: list[Any] = [poses[f"pose.{name}"] for name in Pose._fields]
    report = _report(file, len(times)) if "report.markers" in file.names else None
    return near_origin(Motion(skeleton, times, Pose(*parts), report))


def _skeleton(file: NpzArrays) -> Skeleton:
    """The bones of one of our bodies, with any of the joints that our files have."""
    arrays = file.read(_TREE_SPECS)
    tree = Tree(**{name.partition(".")[2]: tuple(array.tolist()) for name, array in arrays.items()})
    trees = _trees_by_bones()
    ours = trees.get(tree.bones, trees[Skeleton.human().tree.bones])
    for name, names, expected in (
        ("tree.bones", tree.bones, ours.bones),
        ("tree.parents", tree.parents, ours.parents),
    ):
        if names != expected:
            problem = (
                f"found {comma_list(map(str, names))}, expected {', '.join(map(str, expected))}"
            )
            raise InputError(file.path, f"{name}: {problem}")
    rows = joints_of_models()
    _check_joints(file.path, tree, {joint: row["bone"] for joint, row in rows.items()})
    body = file.read(_BODY_SPECS)
    _check_body(file.path, body)
    parts = joint_columns([rows[joint] for joint in tree.joints], read_model(HUMAN).root)
    parts |= {name.partition(".")[2]: on_device(array) for name, array in body.items()}
    searched = tuple(rows[joint].get("limb", "") for joint in tree.joints)
    return Skeleton(tree=replace(tree, segments=ours.segments, searched=searched), **parts)


@cache
def _trees_by_bones() -> dict[tuple[str, ...], Tree]:
    """Bones -> the tree of one of our bodies that has them."""
    trees = [load_skeleton(name).tree for name in bodies()]
    return {tree.bones: tree for tree in trees}


def _check_joints(path: str | Path, tree: Tree, carriers: dict[str, str]) -> None:
    """InputError where a joint is none of ours, there twice, or turns another bone."""
    for i, (joint, bone) in enumerate(zip(tree.joints, tree.dof_bones, strict=True)):
        if joint not in carriers or joint in tree.joints[:i]:
            problem = "is there twice" if joint in carriers else "is no joint of ours"
            raise InputError(path, f"tree.joints: {short_repr(joint)} {problem}")
        expected = tree.bones.index(carriers[joint])
        if bone != expected:
            problem = f"found bone {bone} for {joint}, expected {expected}"
            raise InputError(path, f"tree.dof_bones: {problem} ({carriers[joint]})")


def _check_body(path: str | Path, body: dict[str, np.ndarray]) -> None:
    for name in ("skeleton.directions", "skeleton.axes"):
        _check_units(path, name, body[name])
    if not (body["skeleton.lengths"] > 0).all():
        raise InputError(path, "skeleton.lengths: found 0, expected metres above 0")
    count, expected = len(body["skeleton.costs"]), ROOT_DOF + len(body["skeleton.axes"])
    if count != expected:
        raise InputError(path, f"skeleton.costs: found {count} numbers, expected {expected}")
    low, high = body["skeleton.limits"].T
    if (low > high).any():
        i = int((low > high).argmax())
        problem = f"found {low[i]:g} to {high[i]:g}, expected the smaller angle first"
        raise InputError(path, f"skeleton.limits[{i}]: {problem}")


def _check_units(path: str | Path, name: str, vectors: np.ndarray) -> None:
    """InputError unless every vector (N, K) that is not NaN is of length 1."""
    lengths = np.linalg.norm(vectors, axis=-1)
    is_off = np.abs(lengths - 1) > _UNIT_TOLERANCE
    if is_off.any():
        i = int(is_off.argmax())
        raise InputError(path, f"{name}[{i}]: found length {lengths[i]:.4g}, expected 1")


def _report(file: NpzArrays, count: int) -> Report:
    """The report on so many samples: errors, costs, standard deviations, statuses."""
    arrays = file.read(_REPORT_SPECS)
    stages = [name for name in file.names if name.startswith(_STAGE_PREFIX)]
    spent = file.read(dict.fromkeys(stages, _MILLISECONDS_SPEC))
    for name in stages:
        if not name.isprintable() or name == _STAGE_PREFIX:
            problem = f"{short_repr(name)}: expected a stage's name after the point"
            raise InputError(file.path, problem)
    statuses = _statuses(file.path, str(arrays["report.statuses"]), count)
    return Report(
        markers=tuple(arrays["report.markers"].tolist()),
        **{name: arrays[f"report.{name}"] for name in SAMPLED},
        statuses=statuses,
        milliseconds={name.removeprefix(_STAGE_PREFIX): array for name, array in spent.items()},
        run=_run(file.path, str(arrays["report.settings"])),
    )


def _run(path: str | Path, text: str) -> Run:
    """The entries that a ``Run`` has; earlier versions wrote others, too."""
    stated = parse_json(path, text, _MAX_SETTINGS_CHARACTERS, allow_nan=True)
    _check_kind(path, "report.settings", stated, {})
    run = {}
    for name, usual in vars(Run()).items():
        if name in stated:
            _check_kind(path, f"report.settings.{name}", value := stated[name], usual)
            run[name] = tuple(value) if isinstance(value, list) else value
    return Run(**run)


def _check_kind(path: str | Path, name: str, value: object, usual: object) -> None:
    """InputError where what a JSON text has is of another kind than usual."""
    kind, expected = _JSON_KINDS[type(usual)]
    if not isinstance(value, kind):
        raise InputError(path, f"{name}: found {short_repr(value)}, expected {expected}")


def _statuses_text(statuses: Sequence[tuple[str, ...]]) -> str:
    """JSON of each sample's sentences, or of the number of the first sample that has the same.

    Every sample's own would be 100 MB for an hour's.
    """
    first: dict[tuple[str, ...], int] = {}
    numbers = [first.setdefault(each, i) for i, each in enumerate(statuses)]
    return json.dumps([statuses[n] if n == i else n for i, n in enumerate(numbers)])


def _statuses(path: str | Path, text: str, count: int) -> tuple[tuple[str, ...], ...]:
    """The sentences of each sample."""
    entries = parse_json(path, text, _MAX_STATUS_CHARACTERS)
    if not isinstance(entries, list) or len(entries) != count:
        raise InputError(path, f"report.statuses: expected a JSON list of {count} entries")
    statuses: list[tuple[str, ...]] = []
    for i, entry in enumerate(entries):
        if isinstance(entry, list) and all(isinstance(sentence, str) for sentence in entry):
            statuses.append(tuple(entry))
        elif type(entry) is int and 0 <= entry < i:
            statuses.append(statuses[entry])
        else:
            expected = "expected sentences, or the number of a sample before"
            raise InputError(path, f"report.statuses[{i}]: found {short_repr(entry)}, {expected}")
    return tuple(statuses)
