"""The same at other times: markers, armatures and motions at an even rate.

INPUTS: Markers, an Armature or a Motion, and times. OUTPUTS: the same kind of thing, straight lines
and shortest turns between its samples; missing where one of the two samples is.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from jaxmocap.body.motion import Motion
from jaxmocap.body.pose import Pose
from jaxmocap.formats.armature import Armature
from jaxmocap.formats.tables import Markers


def even_times(times: np.ndarray, rate: float) -> np.ndarray:
    """Evenly spaced times, seconds, from the first of (T,) to the last at most."""
    count = int(np.floor((times[-1] - times[0]) * rate + 1e-6)) + 1
    return times[0] + np.arange(count) / rate


class Between(NamedTuple):
    """Which two samples each of N times lies between.

    Attributes:
        before: (N,) index of the sample before.
        after: (N,) index of the one after; the same where the time is a sample's own.
        part: (N,) how far it is from the one to the other, 0 to 1.
    """

    before: np.ndarray
    after: np.ndarray
    part: np.ndarray


def between(times: np.ndarray, wanted: np.ndarray) -> Between:
    """Where (N,) wanted times lie among (T,) ascending ones."""
    after = np.clip(np.searchsorted(times, wanted), 0, len(times) - 1)
    before = np.maximum(after - 1, 0)
    step = np.where(after > before, times[after] - times[before], 1.0)
    part = np.clip((wanted - times[before]) / step, 0.0, 1.0)
    # At a sample itself its neighbour does not matter, to the rounding of text files.
    before, after = (
        np.where((1 - part) * step < 1e-6, after, before),
        np.where(part * step < 1e-6, before, after),
    )
    return Between(before, after, part)


def resampled_markers(markers: Markers, times: np.ndarray) -> Markers:
    """Markers at (N,) other times; their residuals are let go."""
    at = between(markers.times, times)
    turns = None if markers.turns is None else shortest(markers.turns, at)
    return Markers(times, markers.names, straight(markers.positions, at), turns=turns)


def straight(values: np.ndarray, at: Between) -> np.ndarray:
    """(N, ...) values on the straight lines between (T, ...)."""
    first, second = values[at.before], values[at.after]
    return first + at.part.reshape(-1, *[1] * (values.ndim - 1)) * (second - first)


def shortest(R: np.ndarray, at: Between) -> np.ndarray:
    """(N, ..., 3, 3) rotations on the shortest turns between (T, ..., 3, 3); NaN where one is."""
    known = np.isfinite(R.sum((-2, -1), keepdims=True))
    safe = np.where(known, R, np.eye(3))
    first = Rotation.from_matrix(safe[at.before].reshape(-1, 3, 3))
    turn = (first.inv() * Rotation.from_matrix(safe[at.after].reshape(-1, 3, 3))).as_rotvec()
    share = np.repeat(at.part, int(np.prod(R.shape[1:-2], dtype=int)))[:, None]
    found = (first * Rotation.from_rotvec(share * turn)).as_matrix().reshape(-1, *R.shape[1:])
    return np.where(known[at.before] & known[at.after], found, np.nan)


def resampled(armature: Armature, times: np.ndarray) -> Armature:
    """An armature at (N,) other times."""
    at = between(armature.times, times)
    positions, rotations = straight(armature.positions, at), shortest(armature.rotations, at)
    return replace(armature, times=times, positions=positions, rotations=rotations)


def resampled_motion(motion: Motion, times: np.ndarray) -> Motion:
    """A motion at (N,) other times; its report is let go."""
    at = between(motion.times, times)
    position, quaternion, angles = (np.asarray(part, float) for part in motion.poses)
    known = np.isfinite(quaternion.sum(-1, keepdims=True))
    safe = np.where(known, quaternion, [1.0, 0, 0, 0])
    R = np.where(known[..., None], Rotation.from_quat(safe, scalar_first=True).as_matrix(), np.nan)
    R_then = shortest(R, at)
    known = np.isfinite(R_then.sum((-2, -1)))[:, None]
    turned = Rotation.from_matrix(np.where(known[..., None], R_then, np.eye(3)))
    quaternion = np.where(known, turned.as_quat(scalar_first=True), np.nan)
    parts: list[Any] = [straight(position, at), quaternion, straight(angles, at)]
    return Motion(motion.skeleton, times, Pose(*parts))
