"""BVH: skeletons that move, as animation programs read and write them.

INPUTS: a .bvh file of any program; or an Armature, its axes those of the file.
OUTPUTS: an Armature in the file's own axes, metres; or a .bvh file.

A BVH file states no unit. Where the user states none, it is inferred from the body's size: the one
of metres, centimetres and millimetres in which the longest way from root to tip is a person's.

What is written is Y up, facing Z, left towards X, metres (or another unit that is asked for); the
root has the channels Xposition Yposition Zposition Zrotation Xrotation Yrotation, every other joint
the three rotations: R = Rz Rx Ry, degrees. The rest pose, in which all channels are 0, is that of
the armature: ours is a T, arms out to the sides, palms down. The first frame is at 0 s.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.formats.armatures.armature import (
    MAX_DEPTH,
    MAX_JOINTS,
    MAX_ROTATIONS,
    Armature,
    BeyondFormatError,
)
from jaxmocap.formats.armatures.joint_names import end_of
from jaxmocap.formats.files.errors import InputError, short_name, short_repr
from jaxmocap.formats.files.reading import numbered_lines
from jaxmocap.formats.files.writing import write_lines
from jaxmocap.formats.time_series.tables import (
    FARTHEST_M,
    LARGEST_NUMBER,
    MAX_NAME_CHARACTERS,
    SHORTEST_STEP_S,
    UNITS,
    declared_count,
    even_rate,
    parse_rows,
    row_texts,
)
from jaxmocap.geometry.euler import continuous_euler
from jaxmocap.geometry.rows import ComputedRows, Index

EULER_ORDER = "ZXY"
_POSITIONS = ("Xposition", "Yposition", "Zposition")
# Seconds per frame, at most.
LONGEST_STEP_S = 1e4
# From pelvis to finger tips (or toes) an adult measures so much, metres; inches then fit no other.
ROOT_TO_TIP_M = (1.0, 2.2)
# Units that are inferred.
_INFERRED_UNITS = ("m", "cm", "mm")
_CHANNELS = {f"{axis}{kind}".lower() for axis in "XYZ" for kind in ("position", "rotation")}
# A joint other than the root may have position channels, but not slide by more than this.
MAX_SLIDE_M = 1e-3
_MAX_HIERARCHY_LINES = 100_000


@dataclass
class _Joint:
    """What stands in a file of one joint; an end site is one without channels."""

    name: str
    parent: int
    offset: list[float] = field(default_factory=list)
    channels: list[str] = field(default_factory=list)


def read_bvh(path: str | Path, unit: str | None = None) -> Armature:
    """Read a BVH file; ends of limbs are called ``JOINT_end``. InputError names the bad line."""
    lines = numbered_lines(path)
    joints = _hierarchy(path, lines)
    offsets = np.array([joint.offset for joint in joints])
    if unit is None:
        unit = _inferred_unit(path, [joint.parent for joint in joints], offsets)
    step, values = _frames(path, lines, joints)
    offsets, values_scale = offsets * UNITS[unit], UNITS[unit]
    _check_extent(path, offsets)
    R = np.tile(np.eye(3), (len(values), len(joints), 1, 1))
    positions, first = np.zeros((len(values), 3)) + offsets[0], 0
    for j, joint in enumerate(joints):
        columns = values[:, first : (first := first + len(joint.channels))]
        local_positions = _local_positions(joint, columns * values_scale, offsets[j])
        R[:, j] = _local_rotations(joint, columns)
        if j == 0:
            positions = local_positions
        elif len(local_positions) and np.ptp(local_positions, axis=0).max() > MAX_SLIDE_M:
            problem = f"joint {short_repr(joint.name)} slides by more than a millimetre"
            raise InputError(path, problem)
        else:
            offsets[j] = local_positions[0]
    _check_extent(path, positions)
    offsets[0] = 0.0
    names, parents = tuple(j.name for j in joints), tuple(j.parent for j in joints)
    return Armature(names, parents, offsets, step * np.arange(len(values)), positions, R)


def _check_extent(path: str | Path, points: np.ndarray) -> None:
    """InputError where one of (N, 3) points, metres, is nowhere on earth."""
    if (farthest := np.abs(points).max()) > FARTHEST_M:
        expected = f"expected places within {FARTHEST_M:g} m"
        raise InputError(path, f"found a place {farthest:g} m away, {expected}")


def _local_positions(joint: _Joint, columns: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """(T, 3) places in the parent's frame: position channels stand in place of the offset."""
    positions = np.tile(offset, (len(columns), 1))
    for i, channel in enumerate(joint.channels):
        if channel.endswith("position"):
            positions[:, "xyz".index(channel[0])] = columns[:, i]
    return positions


def _local_rotations(joint: _Joint, columns: np.ndarray) -> np.ndarray:
    """(T, 3, 3) rotations, of the channels in their order from left to right."""
    rotating = [i for i, channel in enumerate(joint.channels) if channel.endswith("rotation")]
    if not rotating:
        return np.tile(np.eye(3), (len(columns), 1, 1))
    axes = "".join(joint.channels[i][0] for i in rotating).upper()
    return (
        Rotation.from_euler(axes, columns[:, rotating], degrees=True).as_matrix().reshape(-1, 3, 3)
    )


def _inferred_unit(path: str | Path, parents: list[int], offsets: np.ndarray) -> str:
    """The unit in which the body is as large as a person, from where it branches first."""
    distances = np.linalg.norm(offsets, axis=-1)
    distances[0] = 0.0
    for j, parent in enumerate(parents):
        if parent >= 0:
            distances[j] += distances[parent]
    # A root on the floor below the hips is no part of the body.
    branching = next((j for j in range(len(parents)) if parents.count(j) > 1), 0)
    distances -= distances[branching]
    low, high = ROOT_TO_TIP_M
    fitting = [unit for unit in _INFERRED_UNITS if low <= distances.max() * UNITS[unit] <= high]
    if not fitting:
        raise InputError(
            path,
            f"the longest way from root to tip is {distances.max():.4g}, an adult's in none of "
            f"{', '.join(_INFERRED_UNITS)}: state the unit (jaxmocap convert --unit "
            f"{', '.join(UNITS)})",
        )
    return fitting[0]


def _hierarchy(path: str | Path, lines: Iterator[tuple[int, str]]) -> list[_Joint]:
    """The joints; ``lines`` then go on behind the line MOTION."""
    joints: list[_Joint] = []
    open_joints: list[int] = []
    number, first = next(lines)
    if first.strip().upper() != "HIERARCHY":
        raise InputError(path, f"line 1: found {first[:20]!r}, expected 'HIERARCHY'")
    for number, line in islice(lines, _MAX_HIERARCHY_LINES):
        words = line.split()
        key = words[0].upper() if words else "{"
        if key == "MOTION" and joints and not open_joints:
            _check_joints(path, joints)
            return joints
        try:
            _parse_line(joints, open_joints, key, words)
        except (IndexError, ValueError) as error:
            text = short_repr(" ".join(words)[:40])
            detail = f", {error}" if isinstance(error, _ExpectedError) else ""
            raise InputError(path, f"line {number}: found {text}{detail}") from None
    raise InputError(path, f"line {number}: the file ends within its hierarchy")


class _ExpectedError(ValueError):
    """What was expected in a line."""


def _parse_line(joints: list[_Joint], open_joints: list[int], key: str, words: list[str]) -> None:
    """Parse one line of the hierarchy."""
    above = open_joints[-1] if open_joints else -1
    if key in ("OFFSET", "CHANNELS") and above < 0:
        raise _ExpectedError("expected it within a joint")
    if key in ("ROOT", "JOINT", "END"):
        if (key == "ROOT") != (above < 0) or (key == "ROOT" and joints):
            raise _ExpectedError("expected one root, and joints within it")
        if len(joints) >= MAX_JOINTS or len(open_joints) >= MAX_DEPTH:
            most = f"at most {MAX_JOINTS} joints, {MAX_DEPTH} deep below one another"
            raise _ExpectedError(f"expected {most}")
        name = " ".join(words[1:]) if key != "END" else end_of(joints[above].name)
        if key != "END" and not (name.isprintable() and len(name) <= MAX_NAME_CHARACTERS):
            expected = f"expected a name that prints, of at most {MAX_NAME_CHARACTERS} characters"
            raise _ExpectedError(expected)
        joints.append(_Joint(name, above))
        open_joints.append(len(joints) - 1)
    elif key == "}":
        open_joints.pop()
    elif key == "OFFSET":
        offset = [float(word) for word in words[1:]]
        if joints[above].offset or len(offset) != 3 or not (np.abs(offset) <= LARGEST_NUMBER).all():
            raise _ExpectedError("expected three numbers, once for each joint")
        joints[above].offset = offset
    elif key == "CHANNELS":
        channels = [word.lower() for word in words[2:]]
        if joints[above].channels:
            raise _ExpectedError("expected CHANNELS once for each joint")
        if declared_count(words[1]) != len(channels) or len(set(channels)) != len(channels):
            raise _ExpectedError(f"expected {short_name(words[1])} different channels")
        if not set(channels) <= _CHANNELS:
            raise _ExpectedError("expected channels such as Xposition or Zrotation")
        joints[above].channels = channels
    elif key != "{":
        raise _ExpectedError("expected JOINT, End Site, OFFSET, CHANNELS or MOTION")


def _check_joints(path: str | Path, joints: list[_Joint]) -> None:
    names = [joint.name for joint in joints]
    for i, joint in enumerate(joints):
        if not joint.offset:
            raise InputError(path, f"joint {short_repr(joint.name)} has no OFFSET")
        if joint.name in names[:i]:
            # Only end sites of one joint may be called alike.
            if joint.channels or not joint.name.endswith("_end"):
                raise InputError(path, f"joint {short_repr(joint.name)} is named twice")
            joint.name = f"{joint.name}{names[:i].count(joint.name) + 1}"


def _frames(
    path: str | Path, lines: Iterator[tuple[int, str]], joints: list[_Joint]
) -> tuple[float, np.ndarray]:
    """Seconds between frames, and the channels' values (T, C)."""
    line, frames = _header_number(path, lines, "Frames:")
    if not (0 <= frames <= LARGEST_NUMBER and frames == int(frames)):
        raise InputError(path, f"line {line}: found {frames:g}, expected how many frames")
    time_line, step = _header_number(path, lines, "Frame Time:")
    if not SHORTEST_STEP_S <= step <= LONGEST_STEP_S:
        expected = f"expected seconds per frame, {SHORTEST_STEP_S:g} to {LONGEST_STEP_S:g}"
        raise InputError(path, f"line {time_line}: found {step:g}, {expected}")
    rows = ((number, line.split()) for number, line in lines)
    columns = sum(len(joint.channels) for joint in joints)
    values, _ = parse_rows(path, rows, columns, MAX_ROTATIONS // len(joints) * columns)
    if np.isnan(values).any():
        raise InputError(path, "a channel's value is not a number")
    if len(values) < frames:
        problem = f"states {frames:g} frames, but the file ends after {len(values)}"
        raise InputError(path, f"line {line}: {problem}")
    return step, values


def _header_number(
    path: str | Path, lines: Iterator[tuple[int, str]], key: str
) -> tuple[int, float]:
    """The next line's number, and the number that follows the key in it."""
    for line, text in lines:
        if words := " ".join(text.split()):
            try:
                return line, float(words.lower().removeprefix(key.lower()))
            except ValueError:
                problem = f"found {short_repr(words)}, expected '{key}' and a number"
                raise InputError(path, f"line {line}: {problem}") from None
    raise InputError(path, "the file ends before its first frame")


def write_bvh(path: str | Path, armature: Armature, unit: str = "m") -> None:
    """Write an armature whose poses are complete, in the axes of the file: Y up.

    InputError for uneven times; BeyondFormatError for joints too deep, or a rate of no file.
    """
    rate = even_rate(path, armature.times)
    if not SHORTEST_STEP_S <= 1 / rate <= LONGEST_STEP_S:
        raise BeyondFormatError(path, f"BVH holds no {rate:g} frames per second")
    scale = 1 / UNITS[unit]
    # The tip of a limb is an end site, unless it turns itself.
    tips = {j for j in armature.ends
            if armature.parents[j] >= 0 and armature.largest_turns[j] < 1e-9}  # fmt: skip
    order: list[int] = []
    lines = ["HIERARCHY", *_joint_lines(path, armature, tips, scale, order)]
    lines += ["MOTION", f"Frames: {len(armature.times)}", f"Frame Time: {1 / rate:.10f}"]
    write_lines(path, lines, _rows(armature, order, scale))


def _rows(armature: Armature, order: list[int], scale: float) -> Iterator[str]:
    """The channels of every frame."""
    count = len(armature.times)
    R = ComputedRows((count, len(order), 3, 3), lambda rows: armature.rotations[rows][:, order])
    angles = continuous_euler(R, EULER_ORDER)

    def table(rows: Index) -> np.ndarray:
        degrees = np.degrees(angles[rows]).reshape(-1, 3 * len(order))
        values = np.concatenate([armature.positions[rows] * scale, degrees], 1)
        # A zero has no sign.
        return values.round(6) + 0.0

    yield from row_texts(ComputedRows((count, 3 + 3 * len(order)), table), " ")


def _joint_lines(
    path: str | Path,
    armature: Armature,
    tips: set[int],
    scale: float,
    order: list[int],
    joint: int = 0,
    depth: int = 0,
) -> Iterator[str]:
    """The block of a joint and of all below it; appends to ``order`` whose channels come next."""
    if depth >= MAX_DEPTH:
        problem = f"joints hang more than {MAX_DEPTH} deep below one another"
        raise BeyondFormatError(path, problem)
    indent, offset = "\t" * depth, armature.offsets[joint] * scale
    if joint in tips:
        yield from _end_lines(indent, offset)
        return
    order.append(joint)
    rotations = [f"{axis}rotation" for axis in EULER_ORDER]
    channels = rotations if depth else [*_POSITIONS, *rotations]
    yield f"{indent}{'JOINT' if depth else 'ROOT'} {'_'.join(armature.names[joint].split())}"
    yield f"{indent}{{"
    yield f"{indent}\tOFFSET {_numbers(offset)}"
    yield f"{indent}\tCHANNELS {len(channels)} {' '.join(channels)}"
    children = [child for child, parent in enumerate(armature.parents) if parent == joint]
    for child in children:
        yield from _joint_lines(path, armature, tips, scale, order, child, depth + 1)
    if not children:
        yield from _end_lines(f"{indent}\t", np.zeros(3))
    yield f"{indent}}}"


def _end_lines(indent: str, offset: np.ndarray) -> list[str]:
    """The block of an end site."""
    return [f"{indent}{line}" for line in ("End Site", "{", f"\tOFFSET {_numbers(offset)}", "}")]


def _numbers(values: np.ndarray) -> str:
    # A zero has no sign.
    return " ".join(f"{round(value, 6) + 0.0:.6f}" for value in values)
