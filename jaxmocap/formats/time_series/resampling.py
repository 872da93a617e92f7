"""The same at other times: markers, armatures and motions at an even rate.

INPUTS: Markers, an Armature or a Motion, and times. OUTPUTS: the same kind of thing, linear and
spherical linear interpolation between its samples; missing where one of the two samples is, and
within gaps: spans of time in which a recording holds nothing.

A gap is no motion: nothing is drawn through it. Where a format must say something, the last pose
before it is held, and the first one after it follows at once.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.body.motion import Motion
from jaxmocap.body.orientations import matrices, quaternions
from jaxmocap.body.pose import Pose
from jaxmocap.formats.armatures.armature import Armature
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.time_series.tables import Markers, usual_step
from jaxmocap.geometry.rows import ComputedRows, Index, Rows, row_blocks, take_rows

# Numbers that may come of any recording, and at most: half an hour of a body at 200 Hz is 81
# million, 0.65 GB.
ALWAYS_ALLOWED_NUMBERS = 20_000_000
MAX_NUMBERS = 100_000_000
# Times as many samples as there were.
MAX_GROWTH = 4
# Numbers that are worked on at a time.
BLOCK_NUMBERS = 1_000_000
# Seconds: a hand moves by half a metre in less, so that a straight line would show another motion.
LONGEST_BRIDGED_S = 0.5
# Slow recordings are bridged over so many of their own intervals.
MAX_INTERVALS_BRIDGED = 5


def even_times(
    times: np.ndarray, rate: float, columns: int = 1, path: str | Path = "samples"
) -> np.ndarray:
    """(N,) seconds at a rate, from the first of (T,) to the last, of samples of so many numbers.

    Raises:
        InputError: there would be far more samples than there are, or than memory holds.
    """
    if not 0 < rate < np.inf:
        raise ValueError(f"found a rate of {rate:g}, expected a positive number")
    # A float, since the count may be beyond any integer of NumPy's.
    count = np.floor(float(times[-1] - times[0]) * rate + 1e-6) + 1
    numbers = max(ALWAYS_ALLOWED_NUMBERS, min(MAX_NUMBERS, MAX_GROWTH * len(times) * columns))
    if count > (most := numbers // max(columns, 1)):
        problem = f"{rate:g} samples per second would be {count:.6g} from {times[0]:g} s"
        raise InputError(path, f"{problem} to {times[-1]:g} s, expected at most {most}")
    return times[0] + np.arange(int(count)) / rate


class Interpolation(NamedTuple):
    """The two samples that each of N times lies between, and how far."""

    before: np.ndarray  # (N,) index of the sample before
    after: np.ndarray  # (N,) index of the one after; the same where the time is a sample's own
    fraction: np.ndarray  # (N,) how far it is from the one to the other, 0 to 1
    in_gap: np.ndarray  # (N,) is it within a gap?

    def at(self, rows: Index) -> "Interpolation":
        """Of some of the times."""
        return Interpolation(*(each[rows] for each in self))

    def blocks(self, columns: int) -> Iterator[tuple[slice, "Interpolation"]]:
        """Some times in a row and where they lie, so few that copies take little memory."""
        for rows in row_blocks(len(self.fraction), BLOCK_NUMBERS // max(columns, 1)):
            yield rows, self.at(rows)


def interpolation_at(times: np.ndarray, new_times: np.ndarray) -> Interpolation:
    """How (N,) new times are interpolated among (T,) ascending ones."""
    after = np.clip(np.searchsorted(times, new_times), 0, len(times) - 1)
    before = np.maximum(after - 1, 0)
    step = np.where(after > before, times[after] - times[before], 1.0)
    fraction = np.clip((new_times - times[before]) / step, 0.0, 1.0)
    # At a sample itself its neighbour does not matter, to the rounding of text files.
    before, after = (
        np.where((1 - fraction) * step < 1e-6, after, before),
        np.where(fraction * step < 1e-6, before, after),
    )
    gap_after = np.append(is_gap(times), False)
    return Interpolation(before, after, fraction, gap_after[before] & (before < after))


def resample_markers(markers: Markers, times: np.ndarray) -> Markers:
    """Markers at (N,) other times."""
    at = interpolation_at(markers.times, times)
    orientations = None if markers.orientations is None else slerp(markers.orientations, at)
    return Markers(times, markers.names, lerp(markers.positions, at), orientations=orientations)


def lerp(values: np.ndarray, at: Interpolation) -> np.ndarray:
    """(N, ...) linear interpolation of (T, ...) values; NaN within gaps."""
    values_then = np.empty((len(at.fraction), *values.shape[1:]))
    for block, at_block in at.blocks(values[0].size):
        first, second = values[at_block.before], values[at_block.after]
        fraction = at_block.fraction.reshape(-1, *[1] * (values.ndim - 1))
        values_then[block] = first + fraction * (second - first)
    values_then[at.in_gap] = np.nan
    return values_then


def slerp(R: Rows, at: Interpolation) -> np.ndarray:
    """Spherical linear, (N, ..., 3, 3) of (T, ..., 3, 3); NaN where one is, and within gaps."""
    R_then = np.empty((len(at.fraction), *R.shape[1:]))
    for block, at_block in at.blocks(int(np.prod(R.shape[1:]))):
        ends = R[at_block.before], R[at_block.after]
        is_finite = np.isfinite(sum(each.sum((-2, -1)) for each in ends))[..., None, None]
        first, second = (
            Rotation.from_matrix(np.where(is_finite, each, np.eye(3)).reshape(-1, 3, 3))
            for each in ends
        )
        fractions = np.repeat(at_block.fraction, int(np.prod(R.shape[1:-2], dtype=int)))[:, None]
        way = Rotation.from_rotvec(fractions * (first.inv() * second).as_rotvec())
        between = (first * way).as_matrix().reshape(ends[0].shape)
        R_then[block] = np.where(is_finite, between, np.nan)
    R_then[at.in_gap] = np.nan
    return R_then


def resample_armature(armature: Armature, times: np.ndarray) -> Armature:
    """An armature at (N,) other times."""
    at = interpolation_at(armature.times, times)
    rotations = ComputedRows(
        (len(times), *armature.rotations.shape[1:]),
        lambda rows: slerp(armature.rotations, at.at(rows)),
    )
    positions = lerp(armature.positions, at)
    return replace(armature, times=times, positions=positions, rotations=rotations)


def resample_motion(motion: Motion, times: np.ndarray) -> Motion:
    """A motion at (N,) other times; its report is dropped."""
    poses = _poses_at(motion.poses, interpolation_at(motion.times, times))
    return replace(motion, times=times, poses=poses, report=None)


def bridge_poses(times: np.ndarray, poses: Pose, is_measured: np.ndarray) -> Pose:
    """Poses (T, ...), those without a measurement (T,) between their neighbours that have one.

    However long it takes: what lies between is nearer than the last one.
    """
    measured, missing = np.flatnonzero(is_measured), np.flatnonzero(~is_measured)
    if not len(measured) or not len(missing):
        return poses
    at = interpolation_at(times[measured], times[missing])
    at = at._replace(in_gap=np.zeros(len(missing), bool))
    bridged = jax.tree.map(np.array, poses)
    between = _poses_at(jax.tree.map(lambda part: part[measured], bridged), at)
    for part, new in zip(bridged, between, strict=True):
        part[missing] = new
    return bridged


def _poses_at(poses: Pose, at: Interpolation) -> Pose:
    position, quaternion, angles = (np.asarray(part, float) for part in poses)
    turned = quaternions(slerp(matrices(quaternion), at))
    parts: list[Any] = [lerp(position, at), turned, lerp(angles, at)]
    return Pose(*parts)


def is_gap(times: np.ndarray) -> np.ndarray:
    """(T - 1,) whether what lies between each of (T,) times and the next one is a gap."""
    return np.diff(times) > max(LONGEST_BRIDGED_S, MAX_INTERVALS_BRIDGED * usual_step(times))


def hold_across_gaps(armature: Armature) -> Armature:
    """The samples that have a pose, and the pose before each gap once more at its end."""
    valid_samples = np.flatnonzero(armature.is_valid)
    times = armature.times[valid_samples]
    before = np.flatnonzero(is_gap(times))
    if not len(before) and len(valid_samples) == len(armature.times):
        return armature
    # One interval before the first pose after the gap, as if a sample were there.
    interval = usual_step(times)
    order = np.insert(valid_samples, before + 1, valid_samples[before])
    return replace(
        armature,
        times=np.insert(times, before + 1, times[before + 1] - interval),
        positions=armature.positions[order],
        rotations=take_rows(armature.rotations, order),
    )
