"""Armatures: trees of joints that rotate, as animation files hold them.

INPUTS: what a BVH or glTF file holds, or a Motion by way of ``body_armature``.
OUTPUTS: an Armature, in other axes; where its joints are.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from jaxmocap.formats.files.errors import InputError
from jaxmocap.geometry.rows import Rows, map_rows, row_blocks, take_rows

# What a file may hold: joints (fingers and faces take some hundred), and their depth in the tree.
MAX_JOINTS = 2000
MAX_DEPTH = 200
# Rotations, joints times samples: half an hour of 25 joints at 200 Hz is 9 million.
MAX_ROTATIONS = 10_000_000
# Rotations that are worked on at a time.
BLOCK_ROTATIONS = 250_000


class BeyondFormatError(InputError):
    """A format cannot hold a motion, which others can."""


@dataclass(frozen=True)
class Armature:
    """J joints over T samples, in a file's axes or in the world's."""

    names: tuple[str, ...]  # Of the joints, parents before children. Ends of limbs are joints too.
    # Index of each one's parent; −1 for the first, the root, and for it only.
    parents: tuple[int, ...]
    offsets: np.ndarray  # (J, 3) metres, from the parent's joint in the rest pose; the root's is 0
    times: np.ndarray  # (T,) seconds, ascending
    positions: np.ndarray  # (T, 3) of the root, metres; NaN where the pose is unknown
    # (T, J, 3, 3) of each joint in its parent's frame, the root's in the file's; identity in the
    # rest pose; NaN where the pose is unknown. Of a motion of ours some rows at a time are
    # computed.
    rotations: Rows
    # (J, 2) of the flesh from the parent's joint to this one, at both ends, metres; or None where
    # it is not specified.
    radii: np.ndarray | None = None

    @property
    def ends(self) -> tuple[int, ...]:
        """Joints that carry no other."""
        return tuple(j for j in range(len(self.names)) if j not in self.parents)

    @cached_property
    def is_valid(self) -> np.ndarray:
        """(T,) whether the pose is complete."""
        is_finite = [np.isfinite(self.rotations[rows].sum((1, 2, 3))) for rows in self.blocks()]
        return np.isfinite(self.positions.sum(-1)) & np.concatenate(is_finite)

    @cached_property
    def largest_turns(self) -> np.ndarray:
        """(J,) by how much each joint's rotation differs from the identity, at most; or NaN."""
        largest = np.zeros(len(self.names))
        for rows in self.blocks():
            part = np.abs(self.rotations[rows] - np.eye(3)).max((-2, -1))
            largest = np.maximum(largest, part.max(0, initial=0.0))
        return largest

    def blocks(self) -> Iterator[slice]:
        """Samples in a row, so few that of a long motion no second copy is in memory."""
        return row_blocks(len(self.times), BLOCK_ROTATIONS // len(self.names))


def joint_positions(armature: Armature) -> np.ndarray:
    """Positions (T, J, 3) of all joints, metres."""
    points = np.repeat(armature.positions[:, None], len(armature.names), 1)
    for block in armature.blocks():
        R = np.array(armature.rotations[block])
        for j, parent in enumerate(armature.parents):
            if parent >= 0:
                points[block, j] = points[block, parent] + R[:, parent] @ armature.offsets[j]
                R[:, j] = R[:, parent] @ R[:, j]
    return points


def rotated_armature(armature: Armature, R_new_old: np.ndarray) -> Armature:
    """The armature in other axes."""
    return replace(
        armature,
        offsets=armature.offsets @ R_new_old.T,
        positions=armature.positions @ R_new_old.T,
        rotations=map_rows(armature.rotations, lambda R: R_new_old @ R @ R_new_old.T),
    )


def fill_from_nearest(armature: Armature, path: str | Path) -> Armature:
    """Missing poses by the nearest complete sample's; InputError about ``path`` without any."""
    valid_samples = np.flatnonzero(armature.is_valid)
    if not len(valid_samples):
        raise InputError(path, "every sample's pose is missing")
    if len(valid_samples) == len(armature.times):
        return armature
    times = armature.times[valid_samples]
    # Halfway between two of them the later one is as near.
    halfway = (times[1:] + times[:-1]) / 2
    nearest = valid_samples[np.searchsorted(halfway, armature.times, "right")]
    return replace(
        armature,
        positions=armature.positions[nearest],
        rotations=take_rows(armature.rotations, nearest),
    )
