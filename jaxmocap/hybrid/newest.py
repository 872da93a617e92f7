"""The newest events of a live run as one small problem: their poses together, the past condensed.

INPUTS: events with what is known of them and what the cameras saw.
OUTPUTS: their poses, variances of their landmarks.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.body.kinematics import landmarks
from jaxmocap.body.pose import Pose, difference, retract
from jaxmocap.body.proportions import PROPORTIONS
from jaxmocap.body.skeleton import ELBOWS, LANDMARKS
from jaxmocap.hybrid.batches import in_batches
from jaxmocap.hybrid.residuals import Known
from jaxmocap.hybrid.running_appearance import Seen
from jaxmocap.hybrid.silhouette import weighed
from jaxmocap.hybrid.smoothing import frames_fit, sights_fit
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.solvers.smoothness import REACH, Smoothness, smoothness
from jaxmocap.solvers.trajectory import Linearised, Settings
from jaxmocap.solvers.window import Improved, Past, condensed, improve, window_variances

# Cells over which silhouettes fade.
SOFTNESS = 1.0
# Where a sure first pass has an elbow so far away, metres, a window that starts from it may win,
# by so much cost; tried at most every so many video frames.
RIVAL_M, RIVAL_SPREAD_M, RIVAL_GAIN, RIVAL_EVERY = 0.1, 0.06, 5.0, 2
STEP = Settings(iterations=1, attempts=4, relative=1e-3)
SEVERAL = STEP._replace(iterations=3)
# Events per call, so that they compile once.
EVENTS_A_CALL = 8


@dataclass
class Event:
    """One step of the tracker, while it can still change.

    Attributes:
        number: of it, counted from 0.
        time: seconds.
        known: what is known of it besides its sights.
        pose: as it is now.
        first: as the tracker found it.
        spread: (2,) the tracker's, of the elbows, metres.
        looks: camera, what it saw, width and height of its frame.
        learned: whether the looks were learned from.
    """

    number: int
    time: float
    known: Known
    pose: Pose
    first: Pose
    spread: np.ndarray
    looks: list[tuple[int, Seen, tuple[int, int]]]
    learned: bool = False


class Solved(NamedTuple):
    """Where a solve led.

    Attributes:
        better: poses, and the events linearised about them.
        seen: (T, N, N) the sights' share of the Hessian.
    """

    better: Improved
    seen: np.ndarray

    def linear(self, weight: float) -> Linearised:
        """The events with sights of that weight; the gradient stays as it is."""
        linear = self.better.linear
        hessian = np.asarray(linear.hessian) - (1 - weight) * self.seen
        return linear._replace(hessian=hessian)


_retracted = jax.jit(jax.vmap(retract))
_differences = jax.jit(jax.vmap(difference))
_landmarks = jax.jit(jax.vmap(landmarks, (None, 0)))


def stacked(poses: list[Pose]) -> Pose:
    """Poses (T, ...) of single ones."""
    return jax.tree.map(lambda *parts: np.stack(parts), *poses)


def offsets(poses: list[Pose], origins: list[Pose]) -> np.ndarray:
    """Tangent vectors (T, 6 + D) from origins to poses, float64."""
    return np.asarray(_differences(stacked(poses), stacked(origins)), float)


class Newest:
    """A window over the newest events.

    Attributes:
        events: in order of time; what is appended takes part in the next solve.
    """

    def __init__(self, tracker: HybridTracker):
        """Prepare for a tracker with cameras."""
        assert tracker.cameras is not None
        self._tracker = tracker
        count = tracker.cameras.matrix.shape[0]
        self.cameras = [
            jax.tree.map(lambda part, c=c: part[c], tracker.cameras) for c in range(count)
        ]
        # Of the sights, in what poses follow from; and, for deviations, with cells that err alike,
        # and blindly.
        self._weights = (1.0, 1 / float(tracker.settings.over_time.redundancy), 0.0)
        self._pool = ThreadPoolExecutor(2, thread_name_prefix="newest")
        self.begin()

    def begin(self) -> None:
        """No events, no past."""
        self.events: list[Event] = []
        self._forget()
        self._since_rival = RIVAL_EVERY

    def _forget(self) -> None:
        self._pasts: tuple[Past | None, ...] = (None,) * len(self._weights)
        self._origin: list[Pose] | None = None

    def solve(self) -> Solved:
        """Move all events' poses a step on, or to where the tracker's own opinion leads."""
        solved = self._rival() or self._steps(self._poses(), self._pasts[0], STEP)
        for i, event in enumerate(self.events):
            event.pose = jax.tree.map(lambda part, i=i: part[i], solved.better.x)
        return solved

    def variances(self, solved: Solved, chosen: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """(F, L, 3) of the landmarks of some events: given all, and without the sights."""
        told, guessed = (
            window_variances(solved.linear(weight), self._prior(), past, np.array(chosen))
            for weight, past in list(zip(self._weights, self._pasts, strict=True))[1:]
        )
        shape = len(chosen), len(LANDMARKS), 3
        return told.reshape(shape), guessed.reshape(shape)

    def drop(self, solved: Solved, count: int) -> list[Event]:
        """Condense the oldest events, at least three being left, and hand them back."""
        linears = [solved.linear(weight) for weight in self._weights]
        dropped = []
        for _ in range(count):
            offset, prior = self._offset(self._poses()), self._prior(REACH + 1)
            self._pasts = tuple(
                condensed(linear, prior, past, offset)
                for linear, past in zip(linears, self._pasts, strict=True)
            )
            linears = [
                Linearised(*(np.asarray(part)[1:] for part in linear[:5])) for linear in linears
            ]
            dropped.append(self.events.pop(0))
            self._origin = [event.pose for event in self.events[:REACH]]
        return dropped

    def _poses(self, which: str = "pose") -> Pose:
        """(T, ...) as they are now, or as the tracker found them (``first``)."""
        return stacked([getattr(event, which) for event in self.events])

    def _prior(self, count: int | None = None) -> Smoothness:
        """Of the first so many events."""
        times = np.array([event.time for event in self.events[:count]])
        density = float(self._tracker.settings.over_time.acceleration)
        return smoothness(times, np.full(3 * len(LANDMARKS), density))

    def _offset(self, poses: Pose) -> np.ndarray:
        """Of the first two poses from where the past was made."""
        if self._origin is None:
            return np.zeros(0)
        first = [jax.tree.map(lambda part, i=i: part[i], poses) for i in range(REACH)]
        return offsets(first, self._origin).ravel()

    def _steps(self, start: Pose, past: Past | None, settings: Settings) -> Solved:
        """Some steps from poses (T, ...)."""
        parts: list[tuple[Linearised, np.ndarray]] = []

        def linearise(poses: Pose) -> Linearised:
            parts.append(self._linearised(poses))
            return parts[-1][0]

        better = improve(linearise, self._moved, self._offset, start, self._prior(), past, settings)
        return Solved(better, next(seen for linear, seen in parts if linear is better.linear))

    def _moved(self, poses: Pose, steps: np.ndarray) -> Pose:
        dtype = self._tracker.dtype
        moved = in_batches(_retracted, (poses, steps.astype(dtype)), EVENTS_A_CALL)
        return jax.tree.unflatten(jax.tree.structure(poses), [part.astype(dtype) for part in moved])

    def _linearised(self, poses: Pose) -> tuple[Linearised, np.ndarray]:
        """All events about their poses, and the sights' share of the Hessian."""
        tracker, over_time = self._tracker, self._tracker.settings.over_time
        usual = jnp.zeros(len(PROPORTIONS), tracker.dtype)
        known = jax.tree.map(lambda *parts: np.stack(parts), *(e.known for e in self.events))
        fit = partial(frames_fit, tracker.skeleton, usual, tracker.markers, over_time)
        found = in_batches(fit, (poses, known), EVENTS_A_CALL, self._pool)
        cost, hessian, gradient, points, jacobian = found
        size = hessian.shape[1] - len(PROPORTIONS)
        seen = np.zeros((len(cost), size, size))
        looks = [(i, *look[:2]) for i, e in enumerate(self.events) for look in e.looks]
        if looks:
            rows, cameras, sights = zip(*looks, strict=True)
            rows = np.array(rows)
            each = (
                jax.tree.map(lambda part: part[rows], poses),
                jax.tree.map(lambda *parts: np.stack(parts), *(self.cameras[c] for c in cameras)),
                weighed(
                    jax.tree.map(lambda *parts: np.stack(parts), *(s.sight for s in sights)),
                    over_time,
                ),
            )
            fit = partial(sights_fit, tracker.skeleton, usual, jnp.asarray(SOFTNESS, float))
            told = in_batches(fit, each, 1, self._pool)
            weight = 1 / float(over_time.silhouette) ** 2
            np.add.at(cost, rows, weight * told[0])
            np.add.at(seen, rows, weight * told[1][:, :size, :size])
            np.add.at(gradient, rows, weight * told[2][:, : gradient.shape[1]])
        own = hessian[:, :size, :size] + seen
        return Linearised(cost, own, gradient[:, :size], points, jacobian[:, :, :size]), seen

    def _rival(self) -> Solved | None:
        """The better of two: the window as it is, and one that starts from the tracker's poses.

        None where the tracker has no other opinion, or was asked a moment ago.
        """
        self._since_rival += bool(self.events[-1].looks)
        newest = self.events[-1]
        both = stacked([newest.pose, newest.first])
        points = np.asarray(_landmarks(self._tracker.skeleton, both))[:, ELBOWS]
        apart = np.linalg.norm(points[0] - points[1], axis=-1)
        other = ((apart > RIVAL_M) & (newest.spread < RIVAL_SPREAD_M)).any()
        if not newest.looks or not other or self._since_rival < RIVAL_EVERY:
            return None
        self._since_rival, past = 0, self._pasts[0]
        own = self._steps(self._poses(), past, SEVERAL)
        rival = self._steps(self._poses("first"), None, SEVERAL)
        believed = 0.0 if past is None else past.cost(self._offset(own.better.x))
        if rival.better.cost > own.better.cost - believed - RIVAL_GAIN:
            return own
        self._forget()
        return rival
