"""Euler angles over time: continuous, and near where a joint can be.

INPUTS: rotations over time (NumPy, on the host), and a range of each angle.
OUTPUTS: three angles each: of all paths through the triples that make the rotations, the cheapest.

Of a long motion some rotations at a time are in memory, and the angles.
"""

import warnings
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.linalg import solveh_banded
from scipy.spatial.transform import Rotation

from jaxmocap.geometry.rows import Rows, row_blocks

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
# What is in memory at a time: rotations; numbers of steps between triples.
_BLOCK_ROTATIONS = 2**17
_BLOCK_STEPS = 2**18
# Of two paths alike the one that begins as is customary.
_UNUSUAL_COST = 1e-6


class _Places(NamedTuple):
    """Where the angles of J joints belong."""

    middle: np.ndarray  # (J, 1, 3) of their ranges, radians; 0 where there is none
    half: np.ndarray  # (J, 1, 3) half of their ranges; infinite where there is none
    is_free: np.ndarray  # (J, 1, 3) whether there is none
    turns: np.ndarray  # (K, 3) whole turns that are tried

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
        """Both ways (..., J, 2, 3) less than a turn from the middles: triples (..., J, 2 K, 3)."""
        near = self.middle + wrap_angles(ways - self.middle)
        back = np.where(self.is_free, 0.0, np.where(near > self.middle, -1.0, 1.0))
        every = near[..., None, :] + back[..., None, :] * self.turns
        return every.reshape(*ways.shape[:-2], -1, 3)

    def costs(self, triples: np.ndarray) -> np.ndarray:
        """(..., J, N) of each second."""
        away = np.where(self.is_free, 0.0, np.abs(triples - self.middle))
        outside = np.maximum(away - self.half, 0.0)
        return (_OUTSIDE_COST * outside**2 + _MIDDLE_COST * away**2).sum(-1)

    def steps(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Costs (..., J, N, N) of steps between triples (..., J, N, 3)."""
        squares = np.zeros(())
        for k in range(3):
            step = after[..., None, :, k] - before[..., :, None, k]
            if self.is_free[..., k].any():
                step = np.where(self.is_free[..., k, None], wrap_angles(step), step)
            squares = squares + step * step
        return np.minimum(squares, _DEAREST_STEP)


def continuous_euler(
    R: Rows, order: str, ranges: np.ndarray | None = None, times: np.ndarray | None = None
) -> np.ndarray:
    """Angles (T, J, 3), radians, of (T, J, 3, 3) rotations; NaN where those are.

    Every rotation has two triples of angles, and each angle any number of whole turns. Dynamic
    programming finds the path through them that costs least: the squares of its steps, and its
    distances from the ranges, and a little from their middles, over time. An angle with a range is
    always less than a turn from its middle; one without gathers whole turns.

    Where the outer axes fall together (gimbal lock) only the sum or the difference of the outer
    angles is determined: there the first one goes evenly from what it was to what it will be.

    Args:
        R: rotations; some rows at a time are asked for.
        order: intrinsic, capitals, of three different axes (``ZXY``) or with the outer ones the
            same (``YXY``).
        ranges: (J, 3, 2) least and largest angle, radians, or ``FREE``; None is free for all.
        times: (T,) seconds; None is one a second.
    """
    if ranges is None:
        ranges = np.broadcast_to(FREE, (R.shape[1], 3, 2))
    places = _Places.of(np.asarray(ranges, float))
    interval = 1.0 if times is None or len(times) < 2 else float(np.median(np.diff(times)))
    angles = _customary(R, order)
    _take_cheapest(angles, order, places, interval)
    for joint, angle in zip(*np.nonzero(places.is_free[:, 0]), strict=True):
        measured = np.isfinite(angles[:, joint, angle])
        angles[measured, joint, angle] = np.unwrap(angles[measured, joint, angle])
    return angles


def ease_near_lock(angles: np.ndarray, order: str) -> np.ndarray:
    """Make the steps of angles (T, J, 3) past gimbal lock smaller, where a degree of error allows.

    A joint that passes lock a few degrees aside turns its outer angles one against the other by up
    to half a turn within a sample or two, while it hardly moves. As in damped inverse kinematics at
    a singularity, that turn is the least squares of its steps and of the rotation's error.

    Args:
        angles: of ``continuous_euler``, radians, changed in place; NaN where unknown.
        order: as there.

    Returns:
        The angles.
    """
    for joint in range(angles.shape[1]):
        large = (np.abs(np.diff(angles[:, joint, ::2], axis=0)) > _LARGEST_STEP).any(-1)
        if large.any():
            _ease(angles[:, joint], large, order)
    return angles


def _ease(angles: np.ndarray, large: np.ndarray, order: str) -> None:
    """The same of one joint (T, 3), whose steps (T - 1,) are large or not."""
    along = np.cos(angles[:, 1])
    if order[0] != order[2]:
        along = np.sin(angles[:, 1]) * (1.0 if order in "XYZXY" else -1.0)
    # The rotation's error by a turn of the outer angles against each other.
    error = np.sqrt(np.maximum(2 - 2 * np.abs(along), 0.0))
    borders = np.flatnonzero(np.diff(error < _NEAR_LOCK, prepend=False, append=False))
    for first, last in zip(borders[::2], borders[1::2], strict=True):
        if large[max(first - 1, 0) : last].any():
            # One sample more at either side stays as it is.
            part = slice(max(first - 1, 0), last + 1)
            sign = float(np.sign(along[first]))
            angles[part, ::2] += _opposite_turns(angles[part, ::2], sign, error[part])


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


def _take_cheapest(angles: np.ndarray, order: str, places: _Places, interval: float) -> None:
    """Replace customary triples (T, J, 3) by those of the cheapest path; NaN stays."""
    before = places.triples(np.zeros((angles.shape[1], 2, 3)))
    joints, count = np.arange(len(before)), before.shape[1]
    has_begun = np.zeros(len(before), bool)
    total = np.tile(np.repeat([0.0, _UNUSUAL_COST], count // 2), (len(before), 1))
    origins = np.empty((*angles.shape[:2], count), np.int8)
    origins[:] = np.arange(count, dtype=np.int8)
    size = max(1, _BLOCK_STEPS // (3 * len(before) * count**2))
    blocks = [slice(first, first + size) for first in range(0, len(angles), size)]
    for block in blocks:
        ways = _ways(angles[block], order)
        measured = np.isfinite(ways[..., 0, 0])
        now = places.triples(np.where(measured[..., None, None], ways, 0.0))
        costs = interval * places.costs(now)
        # Of each sample the one before it that was measured, the first of which is ``before``.
        every = np.concatenate([before[None], now])
        latest = np.arange(1, len(every))[:, None] * measured
        latest = np.maximum.accumulate(np.concatenate([np.zeros((1, len(before)), int), latest]))
        steps = places.steps(every[latest[:-1], joints], now)
        before = every[latest[-1], joints]
        for i, origin in enumerate(origins[block]):
            total = _step(total, steps[i], costs[i], measured[i], has_begun, origin)
            has_begun |= measured[i]
    last = total.argmin(1)
    for block in reversed(blocks):
        chosen = np.empty(angles[block].shape[:2], int)
        for i in range(len(chosen) - 1, -1, -1):
            chosen[i] = last
            last = origins[block][i, joints, last]
        triples = places.triples(_ways(angles[block], order))
        angles[block] = np.take_along_axis(triples, chosen[..., None, None], 2)[:, :, 0]


def _step(
    total: np.ndarray,
    steps: np.ndarray,
    costs: np.ndarray,
    measured: np.ndarray,
    has_begun: np.ndarray,
    origin: np.ndarray,
) -> np.ndarray:
    """Costs (J, N) of the cheapest paths to the triples of a sample, by those to the ones before.

    Args:
        total: (J, N) before it.
        steps: (J, N, N) to it.
        costs: (J, N) of its triples.
        measured: (J,) whether the sample has them.
        has_begun: (J,) whether one before it has.
        origin: (J, N) where each path comes from, is written where it comes by a step.
    """
    every = total[:, :, None] + steps
    goes_on = measured & has_begun
    if goes_on.all():
        origin[:] = every.argmin(1)
        return every.min(1) + costs
    origin[goes_on] = every[goes_on].argmin(1)
    reached = np.where(goes_on[:, None], every.min(1), total) + costs
    return np.where(measured[:, None], reached, total)


def _ways(angles: np.ndarray, order: str) -> np.ndarray:
    """Both triples (T, J, 2, 3) of customary ones (T, J, 3), these first but for equal axes."""
    same = order[0] == order[2]
    other = wrap_angles(angles * [1, -1, 1] + (np.pi, 0.0 if same else np.pi, np.pi))
    return np.stack((other, angles) if same else (angles, other), 2)


def _customary(R: Rows, order: str) -> np.ndarray:
    """A triple (T, J, 3) of every rotation, as is customary; NaN where unknown."""
    same, angles = order[0] == order[2], np.empty((*R.shape[:2], 3))
    is_locked = np.zeros(R.shape[:2], bool)
    in_lock: list[np.ndarray] = []
    for block in row_blocks(len(angles), _BLOCK_ROTATIONS // max(R.shape[1], 1)):
        part = R[block]
        is_finite = np.isfinite(part.sum((-2, -1)))
        safe = np.where(is_finite[..., None, None], part, np.eye(3)).reshape(-1, 3, 3)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Gimbal lock")
            triples = Rotation.from_matrix(safe).as_euler(order).reshape(*is_finite.shape, 3)
        apart = np.sin(triples[..., 1]) if same else np.cos(triples[..., 1])
        is_locked[block] = is_finite & (np.abs(apart) < LOCK)
        in_lock.append(part[is_locked[block]])
        angles[block] = np.where(is_finite[..., None], triples, np.nan)
    rotations, joints = np.concatenate(in_lock), np.nonzero(is_locked)[1]
    for joint in np.flatnonzero(is_locked.any(0)):
        locked, of_joint = is_locked[:, joint], rotations[joints == joint]
        clear = np.isfinite(angles[:, joint, 0]) & ~locked
        angles[locked, joint] = _in_lock(of_joint, order, angles[:, joint], locked, clear)
    return angles


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


def wrap_angles(angles: np.ndarray) -> np.ndarray:
    """Angles by whole turns between -pi and pi."""
    return angles - 2 * np.pi * np.round(angles / (2 * np.pi))
