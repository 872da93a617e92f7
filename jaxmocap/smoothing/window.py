"""The newest events of a live run as one small problem: their poses together, the past condensed.

What the silhouettes tell of an event is a quadratic about the pose where it was drawn; while the
event stays near by it holds, and nothing is drawn anew.

INPUTS: events with what is known of them and what the cameras saw.
OUTPUTS: their poses, variances of their landmarks.
"""

from collections.abc import Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Sites, landmarks
from jaxmocap.body.pose import Pose, difference, pack, retract, unpack
from jaxmocap.body.proportions import PROPORTIONS
from jaxmocap.body.skeleton import ELBOWS, LANDMARKS, Skeleton
from jaxmocap.compilation.batches import in_batches
from jaxmocap.compilation.programs import program
from jaxmocap.evidence.residuals import Known
from jaxmocap.evidence.silhouettes import Sight, silhouette_fit
from jaxmocap.evidence.smoothness import REACH, Smoothness, smoothness
from jaxmocap.geometry.cameras import Camera
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.smoothing.levenberg_marquardt import Linearised, Settings, normal_equations
from jaxmocap.smoothing.linearise import frames_fit
from jaxmocap.smoothing.marginal_prior import (
    Improved,
    Past,
    condensed,
    improve,
    leaving,
    weakened,
    window_variances,
)
from jaxmocap.smoothing.settings import SmoothingSettings
from jaxmocap.smoothing.window_events import Drawn, Event, Standing

# Cells over which silhouettes fade.
SOFTNESS = 1.0
# Where a sure first pass has an elbow so far away, metres, a window that starts from it may win,
# by so much cost; tried at most every so many video frames.
RIVAL_M, RIVAL_SPREAD_M, RIVAL_GAIN, RIVAL_EVERY = 0.1, 0.06, 5.0, 2
STEP = Settings(iterations=1, attempts=4, relative=1e-3)
SEVERAL = STEP._replace(iterations=3)
# Events per call, so that they compile once.
EVENTS_A_CALL = 16
# A silhouette's quadratic holds while no landmark moves farther than this, metres: a fraction of a
# cell, over which its borders fade.
NEAR_M = 0.008


class Solved(NamedTuple):
    """Where a solve led.

    Attributes:
        better: the events, linearised about their poses.
        seen: (T, N, N) the sights' share of the Hessian.
    """

    better: Improved
    seen: np.ndarray


@program("quick")
def _differences(poses: Array, origins: Array) -> Array:
    """Tangent vectors (T, 6 + D) from origins to poses, both (T, 7 + D) packed."""
    return difference(unpack(poses), unpack(origins))


@program("quick")
def _landmarks(skeleton: Skeleton, poses: Array) -> Array:
    """(T, L, 3) of packed poses (T, 7 + D)."""
    return jax.vmap(landmarks, (None, 0))(skeleton, unpack(poses))


@program("quick")
def _events_fit(
    skeleton: Skeleton,
    sites: Sites,
    settings: SmoothingSettings,
    poses: Array,
    steps: Array,
    known: Known,
) -> tuple[Array, ...]:
    """Packed poses (T, 7 + D) moved by steps (T, N), and what ``frames_fit`` tells of them."""
    moved, usual = retract(unpack(poses), steps), jnp.zeros(len(PROPORTIONS), steps.dtype)
    found = frames_fit(skeleton, usual, sites, settings, moved, known)
    cost, hessian, gradient, points, jacobian = found
    n = steps.shape[1]
    return pack(moved), cost, hessian[:, :n, :n], gradient[:, :n], points, jacobian[:, :, :n]


@program("full")
def _sight_fit(
    skeleton: Skeleton, camera: Camera, settings: SmoothingSettings, packed: Array, sight: Sight
) -> tuple[Array, Array, Array]:
    """What one camera's silhouettes tell of a packed pose: cost, J^T J (N, N) and J^T r (N,)."""
    pose = unpack(packed)
    usual = jnp.zeros(len(PROPORTIONS), pose.angles.dtype)
    softness = jnp.asarray(SOFTNESS, pose.angles.dtype)
    cost, hessian, gradient = silhouette_fit(skeleton, usual, pose, camera, sight, softness)
    n, weight = 6 + pose.angles.size, 1 / settings.silhouette**2
    return weight * cost, weight * hessian[:n, :n], weight * gradient[:n]


def stacked(poses: Iterable[Pose]) -> np.ndarray:
    """Packed poses (T, 7 + D) of single ones."""
    return np.stack([np.concatenate(pose) for pose in poses])


def offsets(poses: np.ndarray, origins: np.ndarray) -> np.ndarray:
    """Tangent vectors (T, 6 + D) from packed origins to packed poses, float64."""
    return np.asarray(_differences(poses, origins), float)


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
        self.begin()

    def begin(self) -> None:
        """No events, no past."""
        self.events: list[Event] = []
        self._forget()
        self._since_rival = RIVAL_EVERY

    def _forget(self) -> None:
        self._pasts: tuple[Past | None, ...] = (None,) * len(self._weights)
        self._origin: np.ndarray | None = None

    def solve(self) -> Solved:
        """Move all events' poses a step on, or to where the tracker's own opinion leads."""
        solved = self._rival() or self._steps(self._standing(), self._pasts[0], STEP)
        for i, event in enumerate(self.events):
            event.pose = Pose._make(np.split(solved.better.x.poses[i], (3, 7)))
            event.drawn = solved.better.x.drawn[i]
        return solved

    def variances(self, solved: Solved, chosen: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """(F, L, 3) of the landmarks of some events: given all, and without the sights."""
        linear, frames = solved.better.linear, np.array(chosen)
        whole, jacobian = normal_equations(linear, self._prior()), np.asarray(linear.jacobian)
        told, guessed = (
            window_variances(weakened(whole, (1 - weight) * solved.seen), jacobian, past, frames)
            for weight, past in list(zip(self._weights, self._pasts, strict=True))[1:]
        )
        shape = len(chosen), len(LANDMARKS), 3
        return told.reshape(shape), guessed.reshape(shape)

    def drop(self, solved: Solved, count: int) -> list[Event]:
        """Condense the oldest events, at least three being left, and hand them back."""
        if not count:
            return []
        offset = self._offset(solved.better.x)
        gone = leaving(solved.better.linear, self._prior(count + REACH))
        self._pasts = tuple(
            condensed(weakened(gone, (1 - weight) * solved.seen[:count]), past, offset)
            for weight, past in zip(self._weights, self._pasts, strict=True)
        )
        dropped, self.events = self.events[:count], self.events[count:]
        self._origin = solved.better.x.poses[count : count + REACH]
        return dropped

    def _standing(self, which: str = "pose") -> Standing:
        """As the events stand now, or as the tracker found them (``first``)."""
        poses = stacked(getattr(event, which) for event in self.events)
        own = which == "pose"
        drawn = [event.drawn if own else None for event in self.events]
        return Standing(poses, np.zeros((len(drawn), poses.shape[1] - 1)), drawn)

    def _prior(self, count: int | None = None) -> Smoothness:
        """Of the first so many events."""
        times = np.array([event.time for event in self.events[:count]])
        density = float(self._tracker.settings.over_time.acceleration)
        return smoothness(times, np.full(3 * len(LANDMARKS), density))

    def _offset(self, standing: Standing) -> np.ndarray:
        """Of the first two poses from where the past was made."""
        if self._origin is None:
            return np.zeros(0)
        return offsets(standing.poses[:REACH], self._origin).ravel()

    def _steps(self, start: Standing, past: Past | None, settings: Settings) -> Solved:
        """Some steps from where the events stand."""
        improved = improve(
            self._linearised, Standing.moved, self._offset, start, self._prior(), past, settings
        )
        nothing = np.zeros(np.shape(improved.linear.hessian)[1:])
        return Solved(
            improved,
            np.stack([nothing if each is None else each.hessian for each in improved.x.drawn]),
        )

    def _linearised(self, standing: Standing) -> Linearised:
        """All events about their poses."""
        if standing.linear is not None:
            return standing.linear
        tracker, shared = self._tracker, self._tracker.settings.over_time
        parts = zip(*(event.known for event in self.events), strict=True)
        known = Known._make(None if part[0] is None else np.stack(part) for part in parts)
        each = standing.poses, standing.steps.astype(tracker.dtype), known
        found = in_batches(
            lambda *batch: _events_fit(tracker.skeleton, tracker.markers, shared, *batch),
            each,
            EVENTS_A_CALL,
        )
        poses, cost, hessian, gradient, points, jacobian = found
        standing.poses = poses.astype(tracker.dtype)
        standing.steps = np.zeros_like(standing.steps)
        for i, event in enumerate(self.events):
            if event.looks:
                drawn = standing.drawn[i]
                if drawn is None or np.abs(points[i] - drawn.points).max() > NEAR_M:
                    drawn = self._drawn(event, standing.poses[i], points[i])
                price, pull = drawn.here()
                cost[i] += price
                hessian[i] += drawn.hessian
                gradient[i] += pull
                standing.drawn[i] = drawn
        standing.linear = Linearised(cost, hessian, gradient, points, jacobian)
        return standing.linear

    def _drawn(self, event: Event, pose: np.ndarray, points: np.ndarray) -> Drawn:
        """What an event's looks tell about a packed pose with these landmarks."""
        skeleton, settings = self._tracker.skeleton, self._tracker.settings.over_time
        told = [
            _sight_fit(skeleton, self.cameras[camera], settings, pose, seen.sight)
            for camera, seen, _ in event.looks
        ]
        cost, hessian, gradient = (
            np.sum([np.asarray(part, float) for part in parts], 0)
            for parts in zip(*told, strict=True)
        )
        return Drawn(points, float(cost), hessian, gradient, np.zeros(len(gradient)))

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
        own = self._steps(self._standing(), past, STEP)
        rival = self._steps(self._standing("first"), None, SEVERAL)
        believed = 0.0 if past is None else past.cost(self._offset(own.better.x))
        if rival.better.cost > own.better.cost - believed - RIVAL_GAIN:
            return own
        self._forget()
        return rival
