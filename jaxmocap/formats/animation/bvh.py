"""BVH out: skeletons that move, for animation programs.

INPUTS: an Armature, its axes those of the file. OUTPUTS: a .bvh file.

Y up, facing Z, left towards X, metres (or another unit that is asked for); the root has the
channels Xposition Yposition Zposition Zrotation Xrotation Yrotation, every other joint the three
rotations: R = Rz Rx Ry, degrees. The rest pose, in which all channels are 0, is that of the
armature: ours is a T, arms out to the sides, palms down. The first frame is at 0 s.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from jaxmocap.formats.armatures.armature import MAX_DEPTH, Armature, BeyondFormatError
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.writing import write_lines
from jaxmocap.formats.time_series.tables import (
    SHORTEST_STEP_S,
    UNITS,
    even_rate,
    row_texts,
)
from jaxmocap.geometry.euler import continuous_euler
from jaxmocap.geometry.rows import ComputedRows, Index

EULER_ORDER = "ZXY"
_POSITIONS = ("Xposition", "Yposition", "Zposition")
# Seconds per frame, at most.
LONGEST_STEP_S = 1e4


def write_bvh(path: str | Path, armature: Armature, unit: str = "m") -> None:
    """Write an armature whose axes are those of the file: Y up (``axes.R_WORLD_OF_UP``).

    Raises:
        InputError: times that are not evenly spaced, or a pose that is unknown: BVH holds neither.
        BeyondFormatError: joints too deep below one another, or a rate that no file has.
    """
    rate = even_rate(path, armature.times)
    if not armature.is_valid.all():
        missing = int((~armature.is_valid).sum())
        raise InputError(path, f"{missing} samples have no pose, BVH needs one for every frame")
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
    path: str | Path, armature: Armature, tips: set[int], scale: float, order: list[int]
) -> Iterator[str]:
    """The blocks of all joints; appends to ``order`` whose channels come next."""
    children: list[list[int]] = [[] for _ in armature.parents]
    for joint, parent in enumerate(armature.parents):
        if parent >= 0:
            children[parent].append(joint)
    # Joints that are open, the innermost last, and which of their children come next.
    around = [iter([0])]
    while around:
        joint, depth = next(around[-1], None), len(around) - 1
        indent = "\t" * depth
        if joint is None:
            around.pop()
            # After the root nothing is open any more.
            yield from ["\t" * (depth - 1) + "}"] if around else []
            continue
        if depth >= MAX_DEPTH:
            problem = f"joints hang more than {MAX_DEPTH} deep below one another"
            raise BeyondFormatError(path, problem)
        if joint in tips:
            yield from _end_lines(indent, armature.offsets[joint] * scale)
            continue
        order.append(joint)
        rotations = [f"{axis}rotation" for axis in EULER_ORDER]
        channels = rotations if depth else [*_POSITIONS, *rotations]
        yield f"{indent}{'JOINT' if depth else 'ROOT'} {'_'.join(armature.names[joint].split())}"
        yield f"{indent}{{"
        yield f"{indent}\tOFFSET {_numbers(armature.offsets[joint] * scale)}"
        yield f"{indent}\tCHANNELS {len(channels)} {' '.join(channels)}"
        if not children[joint]:
            yield from _end_lines(f"{indent}\t", np.zeros(3))
        around.append(iter(children[joint]))


def _end_lines(indent: str, offset: np.ndarray) -> list[str]:
    """The block of an end site."""
    return [f"{indent}{line}" for line in ("End Site", "{", f"\tOFFSET {_numbers(offset)}", "}")]


def _numbers(values: np.ndarray) -> str:
    # A zero has no sign.
    return " ".join(f"{round(value, 6) + 0.0:.6f}" for value in values)
