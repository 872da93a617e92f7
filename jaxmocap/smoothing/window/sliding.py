"""The newest events of a live run as one small problem: their poses, and a marginal prior.

What the silhouettes of an event cost is a quadratic about the pose where they were drawn; while the
event stays near by it holds, and nothing is drawn again.

INPUTS: events with what was measured. OUTPUTS: their poses, variances of their landmarks.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import landmarks
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, difference, pack, retract, unpack
from jaxmocap.body.skeleton import ELBOWS, LANDMARKS, Skeleton
from jaxmocap.compilation.batches import in_batches
from jaxmocap.compilation.programs import program
from jaxmocap.evidence.silhouettes import SilhouetteGrids, Silhouettes, silhouette_fit
from jaxmocap.evidence.smoothness import REACH, Smoothness, smoothness
from jaxmocap.evidence.terms import Measurements, Term
from jaxmocap.geometry.cameras import Camera
from jaxmocap.smoothing.levenberg_marquardt import (
    Linearised,
    Marginal,
    Solution,
    SolverSettings,
    leaving,
    minimise,
    normal_equations,
)
from jaxmocap.smoothing.linearise import frames_fit
from jaxmocap.smoothing.marginal_prior import MarginalPrior, condensed, weakened, window_variances
from jaxmocap.smoothing.settings import SmoothingSettings
from jaxmocap.smoothing.window.events import SilhouetteQuadratic, WindowEvent, WindowState

# Cells over which silhouettes fade.
SOFTNESS = 1.0
# A window that starts from the tracker's own poses is tried where that has an elbow so far away,
RIVAL_M = 0.1
# and is so sure of it, metres; it must cost so much less;
RIVAL_DEVIATION_M = 0.06
RIVAL_GAIN = 5.0
# and no more often than every so many video frames.
RIVAL_EVERY = 2
# One step for each event. The marginal prior's cost has an unknown constant: no share of it counts.
ONE_STEP = SolverSettings(iterations=1, attempts=4, growth=1000.0, relative=0.0, step=0.0)
RIVAL_STEPS = ONE_STEP._replace(iterations=3)
# Events per call, so that they compile once.
EVENTS_A_CALL = 16
# A silhouette's quadratic holds while no landmark moves farther than this, metres: a fraction of a
# cell, over which its borders fade.
NEAR_M = 0.008


class SolvedWindow(NamedTuple):
    """Where a solve led.

    Attributes:
        solution: the events, linearised about their poses.
        silhouettes: (T, N, N) the silhouettes' share of the Hessian.
    """

    solution: Solution
    silhouettes: np.ndarray


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
    terms: tuple[Term, ...], model: Model, poses: Array, steps: Array, measured: Measurements
) -> tuple[Array, ...]:
    """Packed poses (T, 7 + D) moved by steps (T, N), and their ``FramesFit``."""
    moved, stated = retract(unpack(poses), steps), jnp.zeros(0, steps.dtype)
    return pack(moved), *frames_fit(terms, model, stated, moved, measured)


@program("full")
def _silhouettes_fit(
    skeleton: Skeleton,
    camera: Camera,
    settings: Silhouettes,
    packed: Array,
    grids: SilhouetteGrids,
) -> tuple[Array, Array, Array]:
    """What one camera's silhouettes cost at a packed pose, J^T J (N, N) and J^T r (N,)."""
    pose = unpack(packed)
    stated = jnp.zeros(0, pose.angles.dtype)
    softness = jnp.asarray(SOFTNESS, pose.angles.dtype)
    cost, hessian, gradient = silhouette_fit(skeleton, stated, pose, camera, grids, softness)
    n, weight = 6 + pose.angles.size, 1 / settings.deviation**2
    return weight * cost, weight * hessian[:n, :n], weight * gradient[:n]


def stacked(poses: Iterable[Pose]) -> np.ndarray:
    """Packed poses (T, 7 + D) of single ones."""
    return np.stack([np.concatenate(pose) for pose in poses])


def offsets(poses: np.ndarray, origins: np.ndarray) -> np.ndarray:
    """Tangent vectors (T, 6 + D) from packed origins to packed poses, float64."""
    return np.asarray(_differences(poses, origins), float)


class Window:
    """The newest events, solved together again and again.

    Attributes:
        events: in order of time; what is appended takes part in the next solve.
        cameras: of the model, one by one.
    """

    def __init__(self, model: Model, settings: SmoothingSettings):
        """Prepare for a model with cameras."""
        self._model, self._settings = model, settings
        # Frames look at no camera: one crossing less for each of its arrays.
        self._blind = replace(model, cameras=None)
        self.cameras = [model.camera(index) for index in range(model.camera_count)]
        # Of the silhouettes, in what poses follow from; and, for deviations, with cells that err
        # alike, and without any.
        self._weights = (1.0, 1 / float(settings.silhouettes.redundancy), 0.0)
        self.begin()

    def begin(self) -> None:
        """No events, no marginal prior."""
        self.events: list[WindowEvent] = []
        self._forget()
        self._since_rival = RIVAL_EVERY

    def _forget(self) -> None:
        self._priors: tuple[MarginalPrior | None, ...] = (None,) * len(self._weights)
        self._origin: np.ndarray | None = None

    def solve(self) -> SolvedWindow:
        """Move all events' poses a step on, or to where the tracker's own opinion leads."""
        solved = self._rival() or self._steps(self._state(), self._priors[0], ONE_STEP)
        for i, event in enumerate(self.events):
            event.pose = unpack(solved.solution.x.poses[i])
            event.quadratic = solved.solution.x.quadratics[i]
        return solved

    def variances(self, solved: SolvedWindow, chosen: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """(F, L, 3) of the landmarks of some events: given all, and without the silhouettes."""
        linear, frames = solved.solution.linear, np.array(chosen)
        equations = normal_equations(linear, self._motion_prior())
        jacobian, share = np.asarray(linear.jacobian), solved.silhouettes
        given_all, without = (
            window_variances(weakened(equations, (1 - weight) * share), jacobian, prior, frames)
            for weight, prior in list(zip(self._weights, self._priors, strict=True))[1:]
        )
        shape = len(chosen), len(LANDMARKS), 3
        return given_all.reshape(shape), without.reshape(shape)

    def drop(self, solved: SolvedWindow, count: int) -> list[WindowEvent]:
        """Condense the oldest events, at least three being left, and hand them back."""
        if not count:
            return []
        offset = self._offset(solved.solution.x)
        gone = leaving(solved.solution.linear, self._motion_prior(count + REACH))
        self._priors = tuple(
            condensed(weakened(gone, (1 - weight) * solved.silhouettes[:count]), prior, offset)
            for weight, prior in zip(self._weights, self._priors, strict=True)
        )
        dropped, self.events = self.events[:count], self.events[count:]
        self._origin = solved.solution.x.poses[count : count + REACH]
        return dropped

    def _state(self, which: str = "pose") -> WindowState:
        """The events as they are now, or as the tracker found them (``first``)."""
        poses = stacked(getattr(event, which) for event in self.events)
        own = which == "pose"
        quadratics = [event.quadratic if own else None for event in self.events]
        return WindowState(poses, np.zeros((len(quadratics), poses.shape[1] - 1)), quadratics)

    def _motion_prior(self, count: int | None = None) -> Smoothness:
        """Of the first so many events."""
        times = np.array([event.time for event in self.events[:count]])
        density = float(self._settings.acceleration)
        return smoothness(times, np.full(3 * len(LANDMARKS), density))

    def _offset(self, state: WindowState) -> np.ndarray:
        """Of the first two poses from where the marginal prior was made."""
        if self._origin is None:
            return np.zeros(0)
        return offsets(state.poses[:REACH], self._origin).ravel()

    def _steps(
        self, start: WindowState, prior: MarginalPrior | None, settings: SolverSettings
    ) -> SolvedWindow:
        """Some steps from where the events are."""
        marginal = None if prior is None else Marginal(prior, self._offset)
        solution = minimise(
            self._linearised, WindowState.moved, start, self._motion_prior(), settings, marginal
        )
        nothing = np.zeros(np.shape(solution.linear.hessian)[1:])
        each = [nothing if own is None else own.hessian for own in solution.x.quadratics]
        return SolvedWindow(solution, np.stack(each))

    def _linearised(self, state: WindowState) -> Linearised:
        """All events about their poses."""
        if state.linear is not None:
            return state.linear
        dtype, settings = self._model.dtype, self._settings
        measured = jax.tree.map(
            lambda *parts: np.stack(parts), *(event.measured for event in self.events)
        )
        result = in_batches(
            lambda *batch: _events_fit(settings.terms, self._blind, *batch),
            (state.poses, state.steps.astype(dtype), measured),
            EVENTS_A_CALL,
        )
        poses, cost, hessian, gradient, points, jacobian = result
        state.poses = poses.astype(dtype)
        state.steps = np.zeros_like(state.steps)
        for i, event in enumerate(self.events):
            if event.frames:
                quadratic = state.quadratics[i]
                if quadratic is None or np.abs(points[i] - quadratic.points).max() > NEAR_M:
                    quadratic = self._drawn(event, state.poses[i], points[i])
                price, pull = quadratic.here()
                cost[i] += price
                hessian[i] += quadratic.hessian
                gradient[i] += pull
                state.quadratics[i] = quadratic
        state.linear = Linearised(cost, hessian, gradient, points, jacobian)
        return state.linear

    def _drawn(
        self, event: WindowEvent, pose: np.ndarray, points: np.ndarray
    ) -> SilhouetteQuadratic:
        """What an event's silhouettes cost about a packed pose with these landmarks."""
        skeleton, settings = self._model.skeleton, self._settings.silhouettes
        each = [
            _silhouettes_fit(skeleton, self.cameras[camera], settings, pose, frame.grids)
            for camera, frame, _ in event.frames
        ]
        cost, hessian, gradient = (
            np.sum([np.asarray(part, float) for part in parts], 0)
            for parts in zip(*each, strict=True)
        )
        return SilhouetteQuadratic(points, float(cost), hessian, gradient, np.zeros(len(gradient)))

    def _rival(self) -> SolvedWindow | None:
        """The better of two: the window as it is, and one that starts from the tracker's poses.

        None where the tracker has no other opinion, or was asked a moment ago.
        """
        newest = self.events[-1]
        self._since_rival += bool(newest.frames)
        both = stacked([newest.pose, newest.first])
        points = np.asarray(_landmarks(self._model.skeleton, both))[:, ELBOWS]
        apart = np.linalg.norm(points[0] - points[1], axis=-1)
        other = ((apart > RIVAL_M) & (newest.elbow_deviations < RIVAL_DEVIATION_M)).any()
        if not newest.frames or not other or self._since_rival < RIVAL_EVERY:
            return None
        self._since_rival, prior = 0, self._priors[0]
        own = self._steps(self._state(), prior, ONE_STEP)
        rival = self._steps(self._state("first"), None, RIVAL_STEPS)
        priors_cost = 0.0 if prior is None else prior.cost(self._offset(own.solution.x))
        if rival.solution.cost > own.solution.cost - priors_cost - RIVAL_GAIN:
            return own
        self._forget()
        return rival
