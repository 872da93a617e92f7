"""Euler angles over time: continuous, and near where a joint can be.

INPUTS: rotations over time (NumPy, on the host), and a range of each angle.
OUTPUTS: three angles each: of all paths through the triples that make the rotations, the cheapest.
"""

import warnings
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.linalg import solveh_banded
from scipy.spatial.transform import Rotation

# Outer axes nearer to each other than this, radians, turn as one.
LOCK = 1e-6
# The range of an angle that may gather whole turns.
FREE = (-np.inf, np.inf)
# What a second costs, of an angle outside of its range by a radian, and of one a radian from the
# middle of its range. A step costs its square, at most that of two angles by half a turn. So an arm
# that reaches beyond its range for a moment does not jump, and a path that has drifted is left.
_OUTSIDE_COST = 4.0
_MIDDLE_COST = 0.01
_DEAREST_STEP = 2 * np.pi**2
# A larger step of an outer angle, radians, is spread over samples nearer to gimbal lock than
# ``_NEAR_LOCK`` where the rotation's error by it stays below ``_MOST_ERROR``. A degree of error
# weighs as much as a step of twenty.
_LARGEST_STEP = np.radians(60)
_NEAR_LOCK = np.radians(15)
_MOST_ERROR = np.radians(1)
_STEP_FOR_ERROR = 20.0
_IN_LOCK = 1e-3
# Of two paths alike the one that begins as is customary.
_UNUSUAL_COST = 1e-6


class _Places(NamedTuple):
    """Where the angles of J joints belong.

    Attributes:
        middle: (J, 1, 3) of their ranges, radians; 0 where there is none.
        half: (J, 1, 3) half of their ranges; infinite where there is none.
        is_free: (J, 1, 3) whether there is none.
        turns: (K, 3) whole turns that are tried.
    """

    middle: np.ndarray
    half: np.ndarray
    is_free: np.ndarray
    turns: np.ndarray

    @classmethod
    def of(cls, ranges: np.ndarray) -> "_Places":
        """By (J, 3, 2) radians."""
        ranges = ranges[:, None]
        is_free = np.asarray(np.isinf(ranges).any(-1))
        least, most = np.moveaxis(np.where(is_free[..., None], 0.0, ranges), -1, 0)
        middle, half = (least + most) / 2, np.where(is_free, np.inf, (most - least) / 2)
        tried = [
            (0.0,) if free else (0.0, 2 * np.pi) for free in np.atleast_1d(is_free.all((0, 1)))
        ]
        return cls(middle, half, is_free, np.array(list(product(*tried))))

    def triples(self, ways: np.ndarray) -> np.ndarray:
        """Both ways (J, 2, 3) less than a turn from the middles: triples (J, 2 K, 3)."""
        near = self.middle + wrapped(ways - self.middle)
        back = np.where(self.is_free, 0.0, np.where(near > self.middle, -1.0, 1.0))
        return (near[:, :, None] + back[:, :, None] * self.turns).reshape(len(ways), -1, 3)

    def costs(self, triples: np.ndarray) -> np.ndarray:
        """(J, N) of each second."""
        away = np.where(self.is_free, 0.0, np.abs(triples - self.middle))
        outside = np.maximum(away - self.half, 0.0)
        return (_OUTSIDE_COST * outside**2 + _MIDDLE_COST * away**2).sum(-1)

    def steps(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Costs (J, N, N) of steps between triples (J, N, 3)."""
        step = after[:, None] - before[:, :, None]
        if self.is_free.any():
            step = np.where(self.is_free[:, None], wrapped(step), step)
        return np.minimum((step * step).sum(-1), _DEAREST_STEP)


def continuous_euler(
    R: np.ndarray,
    order: str,
    ranges: np.ndarray | None = None,
    times: np.ndarray | None = None,
) -> np.ndarray:
    """Angles (T, J, 3), radians, of (T, J, 3, 3) rotations; NaN where those are.

    Every rotation has two triples of angles, and each angle any number of whole turns. Dynamic
    programming finds the path through them that costs least: the squares of its steps, and its
    distances from the ranges, and a little from their middles, over time. An angle with a range is
    always less than a turn from its middle; one without gathers whole turns.

    Where the outer axes fall together (gimbal lock) only the sum or the difference of the outer
    angles is determined: there the first one goes evenly from what it was to what it will be.

    Args:
        R: rotations.
        order: intrinsic, capitals, of three different axes (``ZXY``) or with the outer ones the
            same (``YXY``).
        ranges: (J, 3, 2) least and largest angle, radians, or ``FREE``; None is free for all.
        times: (T,) seconds; None is one a second.
    """
    ways = _ways(R, order)
    if ranges is None:
        ranges = np.broadcast_to(FREE, (R.shape[1], 3, 2))
    places = _Places.of(np.asarray(ranges, float))
    interval = 1.0 if times is None or len(times) < 2 else float(np.median(np.diff(times)))
    angles = _cheapest(ways, places, interval)
    for joint, angle in zip(*np.nonzero(places.is_free[:, 0]), strict=True):
        measured = np.isfinite(angles[:, joint, angle])
        angles[measured, joint, angle] = np.unwrap(angles[measured, joint, angle])
    return angles


def eased_near_lock(angles: np.ndarray, order: str) -> np.ndarray:
    """Angles (T, J, 3) with smaller steps past gimbal lock, where a degree of error allows that.

    A joint that passes lock a few degrees aside turns its outer angles one against the other by up
    to half a turn within a sample or two, while it hardly moves. As in damped inverse kinematics at
    a singularity, that turn is the least squares of its steps and of the rotation's error.

    Args:
        angles: of ``continuous_euler``, radians; NaN where unknown.
        order: as there.
    """
    eased = angles.copy()
    along = np.cos(angles[..., 1])
    if order[0] != order[2]:
        along = np.sin(angles[..., 1]) * (1.0 if order in "XYZXY" else -1.0)
    # The rotation's error by a turn of the outer angles against each other.
    error = np.sqrt(np.maximum(2 - 2 * np.abs(along), 0.0))
    large = (np.abs(np.diff(angles[..., ::2], axis=0)) > _LARGEST_STEP).any(-1)
    for joint in np.flatnonzero(large.any(0)):
        is_near = error[:, joint] < _NEAR_LOCK
        borders = np.flatnonzero(np.diff(is_near, prepend=False, append=False))
        for first, last in zip(borders[::2], borders[1::2], strict=True):
            if large[max(first - 1, 0) : last, joint].any():
                # One sample more at either side stays as it is.
                part = slice(max(first - 1, 0), last + 1)
                outer, sign = angles[part, joint, ::2], np.sign(along[first, joint])
                eased[part, joint, ::2] += _opposite_turns(outer, sign, error[part, joint])
    return eased


def _opposite_turns(outer: np.ndarray, sign: float, error: np.ndarray) -> np.ndarray:
    """What to add to outer angles (T, 2) near lock; 0 at the ends, and where the error forbids.

    Args:
        outer: radians.
        sign: 1 where both axes point the same way, -1 where opposite ways.
        error: (T,) radians of the rotation by each radian of the turns.
    """
    is_end = ~(error < _NEAR_LOCK)
    damping = 1 / _STEP_FOR_ERROR**2
    pull = damping * np.nan_to_num(np.diff(outer[:, 0]) - sign * np.diff(outer[:, 1])) / 2
    bands = np.full((2, len(outer)), -damping)
    bands[1] = np.where(is_end, 1e6, np.maximum(error, _IN_LOCK) ** 2 + 2 * damping)
    turn = solveh_banded(bands, np.append(pull, 0.0) - np.append(0.0, pull))
    turn = np.where(is_end | (np.abs(turn * error).max() > _MOST_ERROR), 0.0, turn)
    return turn[:, None] * [1.0, -sign]


def _cheapest(ways: np.ndarray, places: _Places, interval: float) -> np.ndarray:
    """The path (T, J, 3) through both ways (T, J, 2, 3); NaN where they are."""
    is_measured = np.isfinite(ways[..., 0, 0])
    before = places.triples(np.zeros(ways.shape[1:]))
    has_begun = np.zeros(len(before), bool)
    count = before.shape[1]
    total = np.tile(np.repeat([0.0, _UNUSUAL_COST], count // 2), (len(before), 1))
    origins = np.empty((len(ways), len(before), count), np.int8)
    stay = np.arange(count, dtype=np.int8)
    for i, measured in enumerate(is_measured):
        if not measured.any():
            origins[i] = stay
            continue
        now = places.triples(np.where(measured[:, None, None], ways[i], 0.0))
        every = total[:, :, None] + places.steps(before, now)
        goes_on = measured & has_begun
        origin = np.where(goes_on[:, None], every.argmin(1), stay)
        reached = np.where(goes_on[:, None], every.min(1), total) + interval * places.costs(now)
        origins[i] = origin
        total = np.where(measured[:, None], reached, total)
        before = np.where(measured[:, None, None], now, before)
        has_begun |= measured
    return _traced(ways, places, total.argmin(1), origins)


def _traced(ways: np.ndarray, places: _Places, last: np.ndarray, origins: np.ndarray) -> np.ndarray:
    """The path (T, J, 3) that ends at the triples (J,), by where each came from (T, J, N)."""
    angles = np.empty((*ways.shape[:2], 3))
    joints = np.arange(len(last))
    for i in range(len(ways) - 1, -1, -1):
        angles[i] = places.triples(ways[i])[joints, last]
        last = origins[i, joints, last]
    return angles


def _ways(R: np.ndarray, order: str) -> np.ndarray:
    """Both triples (T, J, 2, 3) of every rotation, the customary one first; NaN where unknown."""
    same = order[0] == order[2]
    is_finite = np.isfinite(R.sum((-2, -1)))
    safe = np.where(is_finite[..., None, None], R, np.eye(3)).reshape(-1, 3, 3)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Gimbal lock")
        angles = Rotation.from_matrix(safe).as_euler(order).reshape(*is_finite.shape, 3)
    apart = np.sin(angles[..., 1]) if same else np.cos(angles[..., 1])
    is_locked = is_finite & (np.abs(apart) < LOCK)
    for joint in np.flatnonzero(is_locked.any(0)):
        locked, clear = is_locked[:, joint], is_finite[:, joint] & ~is_locked[:, joint]
        angles[locked, joint] = _in_lock(R[locked, joint], order, angles[:, joint], locked, clear)
    other = wrapped(angles * [1, -1, 1] + (np.pi, 0.0 if same else np.pi, np.pi))
    ways = np.stack((other, angles) if same else (angles, other), 2)
    return np.where(is_finite[..., None, None], ways, np.nan)


def _in_lock(
    R: np.ndarray, order: str, angles: np.ndarray, locked: np.ndarray, clear: np.ndarray
) -> np.ndarray:
    """Angles (L, 3) of the locked rotations (L, 3, 3) among a joint's (T, 3).

    The first goes evenly between those that are clear, by half turns: either way is then even.
    """
    samples, firsts = np.flatnonzero(clear), np.unwrap(2 * angles[clear, 0]) / 2
    among = np.interp(np.flatnonzero(locked), samples, firsts) if len(samples) else 0.0
    outer = np.stack([np.broadcast_to(among, len(R)), angles[locked, 1]], -1)
    rest = Rotation.from_euler(order[:2], outer).inv() * Rotation.from_matrix(R)
    return np.column_stack([outer, rest.as_rotvec()[:, "XYZ".index(order[2])]])


def wrapped(angles: np.ndarray) -> np.ndarray:
    """Angles by whole turns between -pi and pi."""
    return angles - 2 * np.pi * np.round(angles / (2 * np.pi))
