"""What people do who walk: where they face, where their elbows, pelvis and feet are.

Head and hands leave that open. Walkers face where they walk. Their elbows follow from where the
hands are, pelvis and feet from how hands swing and the head sways: linear-Gaussian, by
``body/data/walking.toml``. All of it fades out where somebody stands, walks backwards or lifts the
hands.

    head, hands -> Walk -> features -> places, and how sure they are

INPUTS: a model, a first pass by the markers. OUTPUTS: measurements.
"""

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from jaxmocap.body.arms import SIDES
from jaxmocap.body.model import Model
from jaxmocap.body.model_files import data_of
from jaxmocap.body.motion import landmarks_over_time
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import landmark_rows
from jaxmocap.body.subject import skeleton_stature
from jaxmocap.evidence.markers import are_present
from jaxmocap.evidence.posture import Usual
from jaxmocap.geometry.rows import ComputedRows, Index, row_blocks
from jaxmocap.smoothing.facing import average_over_time, unit

# Standard deviations of averages over time, seconds: of the way, of where walkers face,
WAY_S, FACING_S = 0.25, 0.2
# of the head's sway about its way, and of how fast they walk: who only leans far does not for long.
SWAY_S, SMOOTH_S, SPEED_S = 0.5, 0.05, 0.5
# The way counts so many times what the hands show.
WAY_COUNTS = 3.0
# It counts from here on and in full from there on, statures a second. Six people walked at 0.6 to
# 1.1; somebody who balances on one leg sways at 0.45.
SLOW, BRISK = 0.45, 0.6
# What walkers do fades out between these: people who run do otherwise.
HURRIED, RUNNING = 1.3, 1.7
# Half of it is left where hands are so many deviations from their usual place.
UNUSUAL = 3.5


class Habit(NamedTuple):
    """Where a landmark is about the crown: ahead, to its own side, up; in statures."""

    constant: np.ndarray  # (3,)
    slopes: np.ndarray  # (F, 3) by features
    deviations: np.ndarray  # (3,) of people who were left out; infinite where nothing is usual


class Habits(NamedTuple):
    """What walkers do."""

    elbow: Habit  # by its own hand's place (3)
    ankle: Habit  # by ``Walk.swing`` (5) of its side
    pelvis: Habit  # by that of the left
    hand: np.ndarray  # (2, 3) where hands usually are about the crown, and by how much that varies


@cache
def usual_habits() -> Habits:
    """Those of ``body/data/walking.toml``."""
    table = data_of("walking.toml")
    elbow, ankle, pelvis = (
        Habit(**{key: np.array(table[name][key]) for key in Habit._fields})
        for name in ("elbow", "ankle", "pelvis")
    )
    hand = np.array([table["hand"]["place"], table["hand"]["deviations"]])
    return Habits(elbow, ankle, pelvis, hand)


class Walk(NamedTuple):
    """A walker's head and hands over time, for either side as its own."""

    ahead: np.ndarray  # (T, 2) unit, where the walker faces
    goes: np.ndarray  # (T,) from 0, whoever stands, to 1, whoever walks ahead
    # (2, T, 3) of the left, of the right, about the crown: ahead, to its side, up; statures.
    hands: np.ndarray
    # (2, T, 5) for either side: how far its hand is ahead of the other, both hands ahead, both
    # hands to its side, the head's sway to its side, and how fast that grows.
    swing: np.ndarray

    @property
    def axes(self) -> np.ndarray:
        """(T, 3, 3) from the world to the walker: ahead, left, up."""
        return _level_axes(self.ahead)

    @classmethod
    def of(
        cls,
        times: np.ndarray,
        ahead: np.ndarray,
        crown: np.ndarray,
        wrists: Sequence[np.ndarray],
        stature: float,
    ) -> "Walk":
        """A walk by its markers.

        Args:
            times: (T,) seconds, two or more.
            ahead: (T, 2) unit, where the hands show that ahead is.
            crown: (T, 3) world, metres.
            wrists: left and right, likewise.
            stature: metres.
        """
        velocity = np.gradient(crown[:, :2], times, axis=0) / stature
        along = unit(average_over_time(velocity, times, WAY_S))
        fast = np.linalg.norm(average_over_time(velocity, times, SPEED_S), axis=-1)
        # Whoever walks backwards or sideways faces elsewhere.
        goes = np.clip((fast - SLOW) / (BRISK - SLOW), 0, 1)
        goes = goes * np.clip(2 * np.sum(ahead * along, -1), 0, 1)
        turned = ahead + WAY_COUNTS * goes[:, None] * along
        ahead = unit(average_over_time(turned, times, FACING_S))
        goes = goes * np.clip((RUNNING - fast) / (RUNNING - HURRIED), 0, 1)
        R = _level_axes(ahead)
        local = [np.einsum("tij,tj->ti", R, wrist - crown) / stature for wrist in wrists]
        path = crown[:, :2] / stature
        path = average_over_time(path, times, SMOOTH_S) - average_over_time(path, times, SWAY_S)
        sway = np.sum(path * R[:, 1, :2], -1)
        each = [
            _of_side(own * mirror, other * mirror, mirror[1] * sway, times)
            for own, other, mirror in zip(local, local[::-1], MIRRORS, strict=True)
        ]
        hands, swing = (np.stack(part) for part in zip(*each, strict=True))
        return cls(ahead, goes, hands, swing)

    def rows(self, rows: Index) -> "Walk":
        """Some of its moments."""
        return Walk(self.ahead[rows], self.goes[rows], self.hands[:, rows], self.swing[:, rows])


def _level_axes(ahead: np.ndarray) -> np.ndarray:
    """Rotations (T, 3, 3) whose rows are ahead, left, up, by (T, 2) ahead."""
    x, y = ahead.T
    zero, one = np.zeros_like(x), np.ones_like(x)
    return np.stack([x, y, zero, -y, x, zero, zero, zero, one], -1).reshape(-1, 3, 3)


# To the left is to its own side of the left, and the other way round.
MIRRORS = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, 1.0]])


def _of_side(
    own: np.ndarray, other: np.ndarray, sway: np.ndarray, times: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    both = (own + other) / 2
    swing = (own - other)[:, 0], both[:, 0], both[:, 1], sway, np.gradient(sway, times)
    return own, np.stack(swing, -1)


def walkers_measurements(
    model: Model,
    times: np.ndarray,
    markers_world: np.ndarray,
    poses: Pose,
    ahead: np.ndarray,
    habits: Habits,
) -> tuple[dict[str, Any], float]:
    """Measured ``facing`` and ``usual`` of T events, and of how many events they are.

    Nothing, of none, where nobody walks, or head or hands have no marker.

    Args:
        model: of the person and M markers.
        times: (T,) seconds.
        markers_world: (T, M, 3) metres; NaN where missing.
        poses: (T, ...) by the markers alone.
        ahead: (T, 3) where these face.
        habits: of walkers.
    """
    there = _has_markers(model, markers_world)
    if not there.any() or len(times) < 2:
        return {}, 0.0
    rows = landmark_rows(("vertex", "wrist_l", "wrist_r"))
    points = landmarks_over_time(model.skeleton, poses, rows).astype(float)
    crown, *wrists = points.swapaxes(0, 1)
    stature = skeleton_stature(model.skeleton)
    walk = Walk.of(times, np.asarray(ahead, float)[:, :2], crown, wrists, stature)
    if not walk.goes.any():
        return {}, 0.0
    off = np.sum(((walk.hands - habits.hand[0]) / habits.hand[1]) ** 2, -1)
    elbows = there * walk.goes * 0.5 ** (off / UNUSUAL**2)
    trunk = elbows.min(0)
    legs = trunk * float(model.no_foot_is_marked)
    each = [
        *((habits.elbow, MIRRORS[i], elbows[i]) for i in range(2)),
        *((habits.ankle, MIRRORS[i], legs) for i in range(2)),
        (habits.pelvis, MIRRORS[0], trunk),
    ]
    usual = Usual(
        _usual_places(walk, crown, stature, [one[:2] for one in each], model.dtype),
        _usual_roots(walk.ahead, stature, each, model.dtype),
    )
    facing = walk.axes[:, 0].astype(model.dtype)
    return {"facing": facing, "usual": usual}, float(trunk.sum())


def _usual_places(
    walk: Walk,
    crown: np.ndarray,
    stature: float,
    each: Sequence[tuple[Habit, np.ndarray]],
    dtype: Any,
) -> np.ndarray:
    """(T, K, 3) where they usually are, by their habits and mirrors."""
    places = np.empty((len(crown), len(each), 3), dtype)
    for block in row_blocks(len(crown)):
        some = walk.rows(block)
        features = *some.hands, *some.swing, some.swing[0]
        for k, ((habit, mirror), own) in enumerate(zip(each, features, strict=True)):
            local = (habit.constant + own @ habit.slopes) * mirror * stature
            there = np.einsum("tji,tj->ti", some.axes, local)
            places[block, k] = crown[block] + there
    return places


def _usual_roots(
    ahead: np.ndarray,
    stature: float,
    each: Sequence[tuple[Habit, np.ndarray, np.ndarray]],
    dtype: Any,
) -> ComputedRows:
    """(T, K, 3, 3), by habits, mirrors and weights (T,): computed where they are asked for."""
    # Infinite deviations leave nothing.
    spreads = [(habit.deviations * stature)[:, None] for habit, _, _ in each]

    def of_rows(rows: Index) -> np.ndarray:
        R = _level_axes(ahead[rows])
        weights = (weight[rows] for _, _, weight in each)
        roots = [R / own * w[:, None, None] for own, w in zip(spreads, weights, strict=True)]
        return np.stack(roots, 1).astype(dtype)

    return ComputedRows((len(ahead), len(each), 3, 3), of_rows)


def _has_markers(model: Model, markers_world: np.ndarray) -> np.ndarray:
    """(2, T) whether markers show the head and the left hand, the right hand."""
    tree, present = model.skeleton.tree, np.asarray(are_present(markers_world))

    def shown(*parts: str, side: str | None = None) -> np.ndarray:
        on = np.isin(np.asarray(model.markers.bones), tree.bones_in(*parts, side=side))
        return np.asarray(present[:, on].any(-1))

    return np.stack([shown("head") & shown("forearm", "hand", side=side) for side in SIDES])
