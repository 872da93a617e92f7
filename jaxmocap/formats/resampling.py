"""The same at other times: markers and armatures at an even rate.

INPUTS: Markers or an Armature, times or a rate. OUTPUTS: the same kind of thing, straight lines
and shortest turns between its samples; missing where one of the two samples is.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

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
    first, second = markers.positions[at.before], markers.positions[at.after]
    return Markers(times, markers.names, first + at.part[:, None, None] * (second - first))


def resampled(armature: Armature, times: np.ndarray) -> Armature:
    """An armature at (N,) other times."""
    at = between(armature.times, times)
    known = armature.known[at.before] & armature.known[at.after]
    safe = np.where(armature.known[:, None, None, None], armature.rotations, np.eye(3))
    shape = (len(times), len(armature.names), 3, 3)
    start = Rotation.from_matrix(safe[at.before].reshape(-1, 3, 3))
    end = Rotation.from_matrix(safe[at.after].reshape(-1, 3, 3))
    share = np.repeat(at.part, len(armature.names))[:, None]
    R = (start * Rotation.from_rotvec(share * (start.inv() * end).as_rotvec())).as_matrix()
    first, second = armature.positions[at.before], armature.positions[at.after]
    return replace(
        armature,
        times=times,
        positions=first + at.part[:, None] * (second - first),
        rotations=np.where(known[:, None, None, None], R.reshape(shape), np.nan),
    )
