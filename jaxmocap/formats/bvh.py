"""BVH: skeletons that move, for animation programs.

INPUTS: a .bvh file of any program; or an Armature. OUTPUTS: the other, in the file's own axes.

What is written here: Y up, facing Z, left towards X, metres (or another unit that is asked for);
the root has the channels Xposition Yposition Zposition Zrotation Xrotation Yrotation, every other
joint the three rotations: R = Rz Rx Ry, degrees. The rest pose, in which all channels are 0, is
that of the armature: ours is a T, arms out to the sides, palms down. The first frame is at 0 s.

A BVH file says nothing of its unit. Without being told, it is read from the body's size: the one
of metres, centimetres and millimetres in which the longest way from root to tip is a person's.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.formats.armature import Armature
from jaxmocap.formats.errors import InputError
from jaxmocap.formats.joint_names import end_of
from jaxmocap.formats.tables import even_rate, parse_rows, read_lines
from jaxmocap.formats.writing import replacing
from jaxmocap.geometry.euler import continuous_euler

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
# From pelvis to finger tips (or toes) an adult measures so much, metres; inches then fit no other.
LONGEST_WAY_M = (1.0, 2.2)
_TOLD = ("m", "cm", "mm")
ORDER = "ZXY"
_POSITIONS = ("Xposition", "Yposition", "Zposition")
_CHANNELS = {f"{axis}{kind}".lower() for axis in "XYZ" for kind in ("position", "rotation")}
# A joint other than the root may have position channels, but not slide by more than this.
SLIDES_M = 1e-3


def write_bvh(path: str | Path, armature: Armature, unit: str = "m") -> None:
    """Write an armature whose axes are those of the file (``axes.UP["y"]`` of the world's).

    Raises:
        InputError: times that are not evenly spaced, or a pose that is unknown: BVH holds neither.
    """
    rate = even_rate(path, armature.times)
    if not armature.known.all():
        missing = int((~armature.known).sum())
        raise InputError(path, f"{missing} samples have no pose, BVH needs one for every frame")
    scale = 1 / METRES[unit]
    # The tip of a limb is an end site, unless it turns itself.
    still = np.abs(armature.rotations - np.eye(3)).max((0, 2, 3)) < 1e-9
    tips = {j for j in armature.ends if still[j] and armature.parents[j] >= 0}
    order: list[int] = []
    lines = ["HIERARCHY", *_joint_lines(armature, 0, tips, scale, order, 0)]
    angles = continuous_euler(armature.rotations[:, order], ORDER)
    values = np.concatenate(
        [armature.positions * scale, np.degrees(angles).reshape(len(angles), -1)], 1
    )
    lines += ["MOTION", f"Frames: {len(values)}", f"Frame Time: {1 / rate:.10f}"]
    lines += [" ".join(row) for row in np.char.mod("%.6f", values.round(6) + 0.0)]
    with replacing(path) as beside:
        beside.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


def _joint_lines(
    armature: Armature, joint: int, tips: set[int], scale: float, order: list[int], depth: int
) -> list[str]:
    """A joint's block; notes in ``order`` which joint's channels come next."""
    order.append(joint)
    children = [j for j, parent in enumerate(armature.parents) if parent == joint]
    kind = "JOINT" if depth else "ROOT"
    rotations = [f"{axis}rotation" for axis in ORDER]
    channels = rotations if depth else [*_POSITIONS, *rotations]
    inner = [f"OFFSET {_numbers(armature.offsets[joint] * scale)}"]
    inner.append(f"CHANNELS {len(channels)} {' '.join(channels)}")
    for child in children:
        if child in tips:
            inner += ["End Site", "{", f"\tOFFSET {_numbers(armature.offsets[child] * scale)}", "}"]
        else:
            inner += _joint_lines(armature, child, tips, scale, order, depth + 1)
    if not children:
        inner += ["End Site", "{", f"\tOFFSET {_numbers(np.zeros(3))}", "}"]
    name = "_".join(armature.names[joint].split())
    return [f"{kind} {name}", "{", *(f"\t{line}" for line in inner), "}"]


def _numbers(values: np.ndarray) -> str:
    # A zero has no sign.
    return " ".join(f"{round(value, 6) + 0.0:.6f}" for value in values)


@dataclass
class _Joint:
    """What stands in a file of one joint; an end site is one without channels."""

    name: str
    parent: int
    offset: list[float] = field(default_factory=list)
    channels: list[str] = field(default_factory=list)


def read_bvh(path: str | Path, unit: str | None = None) -> Armature:
    """Read a BVH file; ends of limbs are called by their joint's name and ``_end``.

    Raises:
        InputError: no such file, the line that is not BVH or is cut off, a joint that slides, or a
            size from which the unit cannot be told.
    """
    lines = read_lines(path)
    joints, start = _hierarchy(path, lines)
    offsets = np.array([joint.offset for joint in joints])
    if unit is None:
        unit = _unit(path, [joint.parent for joint in joints], offsets)
    step, values = _frames(path, lines, start, sum(len(joint.channels) for joint in joints))
    offsets, values_scale = offsets * METRES[unit], METRES[unit]
    R = np.tile(np.eye(3), (len(values), len(joints), 1, 1))
    positions, first = np.zeros((len(values), 3)) + offsets[0], 0
    for j, joint in enumerate(joints):
        columns = values[:, first : (first := first + len(joint.channels))]
        moved = _moved(joint, columns * values_scale, offsets[j])
        R[:, j] = _turns(joint, columns)
        if j == 0:
            positions = moved
        elif len(moved) and np.ptp(moved, axis=0).max() > SLIDES_M:
            raise InputError(path, f"joint {joint.name!r} slides by more than a millimetre")
        else:
            offsets[j] = moved[0]
    offsets[0] = 0.0
    names, parents = tuple(j.name for j in joints), tuple(j.parent for j in joints)
    return Armature(names, parents, offsets, step * np.arange(len(values)), positions, R)


def _moved(joint: _Joint, columns: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """(T, 3) places in the parent's frame: position channels stand in place of the offset."""
    moved = np.tile(offset, (len(columns), 1))
    for i, channel in enumerate(joint.channels):
        if channel.endswith("position"):
            moved[:, "xyz".index(channel[0])] = columns[:, i]
    return moved


def _turns(joint: _Joint, columns: np.ndarray) -> np.ndarray:
    """(T, 3, 3) rotations, of the channels in their order from left to right."""
    turning = [i for i, channel in enumerate(joint.channels) if channel.endswith("rotation")]
    if not turning:
        return np.tile(np.eye(3), (len(columns), 1, 1))
    axes = "".join(joint.channels[i][0] for i in turning).upper()
    return (
        Rotation.from_euler(axes, columns[:, turning], degrees=True).as_matrix().reshape(-1, 3, 3)
    )


def _unit(path: str | Path, parents: list[int], offsets: np.ndarray) -> str:
    """The unit in which the body is as large as a person."""
    ways = np.linalg.norm(offsets, axis=-1)
    ways[0] = 0.0
    for j, parent in enumerate(parents):
        if parent >= 0:
            ways[j] += ways[parent]
    low, high = LONGEST_WAY_M
    fitting = [unit for unit in _TOLD if low <= ways.max() * METRES[unit] <= high]
    if not fitting:
        raise InputError(
            path,
            f"the longest way from root to tip is {ways.max():.4g}, an adult's in none of "
            f"{', '.join(_TOLD)}: say the unit (--unit {', '.join(METRES)})",
        )
    return fitting[0]


def _hierarchy(path: str | Path, lines: list[str]) -> tuple[list[_Joint], int]:
    """The joints, and the number of lines up to and with MOTION."""
    joints: list[_Joint] = []
    open_joints: list[int] = []
    if lines[0].strip().upper() != "HIERARCHY":
        raise InputError(path, f"line 1: found {lines[0][:20]!r}, expected 'HIERARCHY'")
    for number, line in enumerate(lines[1:], 2):
        words = line.split()
        key = words[0].upper() if words else "{"
        if key == "MOTION" and joints and not open_joints:
            _check_joints(path, joints)
            return joints, number
        try:
            _take(joints, open_joints, key, words)
        except (IndexError, ValueError) as error:
            found = " ".join(words)[:40]
            detail = f", {error}" if isinstance(error, _ExpectedError) else ""
            raise InputError(path, f"line {number}: found {found!r}{detail}") from None
    raise InputError(path, f"line {len(lines)}: the file ends within its hierarchy")


class _ExpectedError(ValueError):
    """Says what was expected in a line."""


def _take(joints: list[_Joint], open_joints: list[int], key: str, words: list[str]) -> None:
    """Understand one line of the hierarchy."""
    above = open_joints[-1] if open_joints else -1
    if key in ("ROOT", "JOINT", "END"):
        if (key == "ROOT") != (above < 0) or (key == "ROOT" and joints):
            raise _ExpectedError("expected one root, and joints within it")
        name = " ".join(words[1:]) if key != "END" else end_of(joints[above].name)
        joints.append(_Joint(name, above))
        open_joints.append(len(joints) - 1)
    elif key == "}":
        open_joints.pop()
    elif key == "OFFSET":
        joints[above].offset = [float(word) for word in words[1:]]
        if len(words) != 4 or not np.isfinite(joints[above].offset).all():
            raise _ExpectedError("expected three numbers")
    elif key == "CHANNELS":
        joints[above].channels = [word.lower() for word in words[2:]]
        if int(words[1]) != len(words) - 2 or len(set(joints[above].channels)) != len(words) - 2:
            raise _ExpectedError(f"expected {words[1]} different channels")
        if not set(joints[above].channels) <= _CHANNELS:
            raise _ExpectedError("expected channels such as Xposition or Zrotation")
    elif key != "{":
        raise _ExpectedError("expected JOINT, End Site, OFFSET, CHANNELS or MOTION")


def _check_joints(path: str | Path, joints: list[_Joint]) -> None:
    names = [joint.name for joint in joints]
    for i, joint in enumerate(joints):
        if not joint.offset:
            raise InputError(path, f"joint {joint.name!r} has no OFFSET")
        if joint.name in names[:i]:
            # Only end sites of one joint may be called alike.
            if joint.channels or not joint.name.endswith("_end"):
                raise InputError(path, f"joint {joint.name!r} is named twice")
            joint.name = f"{joint.name}{names[:i].count(joint.name) + 1}"


def _frames(
    path: str | Path, lines: list[str], start: int, columns: int
) -> tuple[float, np.ndarray]:
    """Seconds between frames, and the channels' values (T, C)."""
    if len(lines) < start + 3:
        raise InputError(path, f"line {len(lines)}: the file ends before its first frame")
    head = {}
    for i, key in enumerate(("Frames:", "Frame Time:")):
        text = " ".join(lines[start + i].split())
        try:
            head[key] = float(text.lower().removeprefix(key.lower()))
        except ValueError:
            problem = f"line {start + i + 1}: found {text[:30]!r}, expected '{key}' and a number"
            raise InputError(path, problem) from None
    step = head["Frame Time:"]
    if not 0 < step < np.inf:
        raise InputError(path, f"line {start + 2}: found {step:g}, expected seconds per frame")
    rows = ((i, line.split()) for i, line in enumerate(lines, 1) if i > start + 2)
    values, _ = parse_rows(path, rows, columns)
    if np.isnan(values).any():
        raise InputError(path, "a channel's value is not a number")
    if len(values) < head["Frames:"]:
        problem = f"says {head['Frames:']:g} frames, but the file ends after {len(values)}"
        raise InputError(path, f"line {start + 1}: {problem}")
    return step, values
