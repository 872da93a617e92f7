"""The newest events of a live run as one small problem: their poses, and a marginal prior.

All events are linearised once a solve, which is then one linear problem. What the silhouettes of an
event cost is a quadratic about the pose where they were drawn; while the event stays near by,
nothing is drawn again.

INPUTS: events with what was measured. OUTPUTS: their poses, variances of their landmarks.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, unpack
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.compilation.batches import in_batches
from jaxmocap.compilation.programs import program
from jaxmocap.evidence.silhouettes import SilhouetteGrids, Silhouettes, silhouette_fit
from jaxmocap.evidence.smoothness import REACH
from jaxmocap.evidence.terms import Measurements, Term
from jaxmocap.geometry.cameras import Camera
from jaxmocap.smoothing.linearise import frames_fit
from jaxmocap.smoothing.settings import LASTING_HZ, SmoothingSettings, mean_step, weighed_by_time
from jaxmocap.smoothing.window.arm_search import search_arms, with_arm_there
from jaxmocap.smoothing.window.equations import (
    LinearEvent,
    MarginalPrior,
    SilhouetteQuadratic,
    WindowEquations,
    window_equations,
)
from jaxmocap.smoothing.window.events import WindowEvent, moved

# Cells over which silhouettes fade.
SOFTNESS = 0.8
# The arms are searched for at one video frame in so many. A window that starts where the search has
# an elbow is tried where that is so far away, metres, and costs so much less; it makes so many
# steps, and must cost as much less in the end.
SEARCH_EVERY = 4
RIVAL_M = 0.1
RIVAL_GAIN = 5.0
RIVAL_STEPS = 3
# Share of the events' own curvature that holds them back. So many times as much, and again, where a
# step goes so far that the derivatives misplace a landmark by more than this, metres: else windows
# that late frames left far off diverge.
DAMPING, DAMPED_MORE, DAMPINGS = 1e-3, 5.0, 6
TRUSTED_M = 0.2
# Most steps of a solve; one is enough where the derivatives misplace no landmark by more, metres.
MOST_STEPS = 3
LINEAR_M = 0.005
# Events per call, so that they compile once.
EVENTS_A_CALL = 4
# Terms are weighed again where the time between events has changed by this share.
RATE_CHANGED = 0.2
# A silhouette's quadratic holds while no landmark moves farther than this, metres: about half a
# cell, over which its borders fade.
NEAR_M = 0.012


@program("quick")
def _events_fit(
    terms: tuple[Term, ...], model: Model, poses: Array, measured: Measurements
) -> tuple[Array, ...]:
    """``FramesFit`` of packed poses (T, 7 + D)."""
    stated = jnp.zeros(0, poses.dtype)
    return tuple(frames_fit(terms, model, stated, unpack(poses), measured))


@program("full")
def _silhouettes_fit(
    skeleton: Skeleton,
    camera: Camera,
    settings: Silhouettes,
    packed: Array,
    grids: SilhouetteGrids,
) -> tuple[Array, Array, Array]:
    """What one camera's silhouettes cost at a packed pose, J^T J (N, N) and J^T r (N,)."""
    softness = jnp.asarray(SOFTNESS, packed.dtype)
    fit = silhouette_fit(skeleton, None, unpack(packed), camera, grids, softness)
    weight = 1 / settings.deviation**2
    cost, hessian, gradient = (weight * part for part in fit)
    return cost, hessian, gradient


def stacked(poses: Iterable[Pose]) -> np.ndarray:
    """Packed poses (T, 7 + D) of single ones."""
    return np.stack([np.concatenate(pose) for pose in poses])


class Window:
    """The newest events, solved together again and again.

    Attributes:
        events: in order of time; what is appended takes part in the next solve.
        cameras: of the model, one by one.
        arms_spread: (2, 3, 3) how far arms may be elsewhere, see ``ArmSearch``; of the last search.
    """

    def __init__(self, model: Model, settings: SmoothingSettings):
        """Prepare for a model with cameras."""
        self._model, self._settings = model, settings
        # Between events, seconds, and the terms weighed by it.
        self._weighed: tuple[float, tuple[Term, ...]] = (1 / LASTING_HZ, settings.terms)
        # Frames look at no camera: one crossing less for each of its arrays.
        self._blind = replace(model, cameras=None)
        self.cameras = [model.camera(index) for index in range(model.camera_count)]
        # What of the silhouettes counts in deviations: cells that err alike count once; and none.
        self._shares = (1 / float(settings.silhouettes.redundancy), 0.0)
        self.begin()

    def begin(self) -> None:
        """No events, no marginal prior."""
        self.events: list[WindowEvent] = []
        self._forget()
        self._since_search = 0
        self.arms_spread = np.zeros((2, 3, 3))

    def _forget(self) -> None:
        self._marginal: MarginalPrior | None = None
        # Of deviations: a marginal prior each, and events that left since it was made.
        self._sure: tuple[MarginalPrior | None, ...] = (None,) * len(self._shares)
        self._left: list[tuple[float, LinearEvent]] = []

    def solve(self) -> WindowEquations:
        """Move all events' poses to where they cost least; the equations that say so."""
        self._linearise()
        # The motion prior ties three events; fewer stay where they are expected.
        if len(self.events) <= REACH:
            return self._equations()
        equations = self._rival() or self._equations()
        for _ in range(MOST_STEPS - 1):
            if self._move(equations) < LINEAR_M:
                return equations
            self._linearise()
            equations = self._equations()
        self._move(equations)
        return equations

    def variances(self, chosen: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """(F, L, 3) of the landmarks of some events: given all, and without the silhouettes."""
        left, now = len(self._left), [(e.time, _linear(e)) for e in self.events]
        times, events = zip(*self._left, *now, strict=True)
        equations = [
            window_equations(events, np.array(times), self._acceleration, prior, share)
            for share, prior in zip(self._shares, self._sure, strict=True)
        ]
        rows, shape = [left + i for i in chosen], (len(chosen), len(LANDMARKS), 3)
        given_all, without = (each.variances(rows).reshape(shape) for each in equations)
        if left:
            self._sure = tuple(each.condensed(left) for each in equations)
            self._left = []
        return given_all, without

    def drop(self, equations: WindowEquations, count: int) -> list[WindowEvent]:
        """Condense the oldest events, at least three being left, and hand them back."""
        if not count:
            return []
        self._marginal = equations.condensed(count)
        dropped, self.events = self.events[:count], self.events[count:]
        self._left += [(event.time, _linear(event)) for event in dropped]
        return dropped

    @property
    def _acceleration(self) -> float:
        return float(self._settings.acceleration)

    def _equations(self) -> WindowEquations:
        """About the events' poses as they were linearised."""
        events = [_linear(event) for event in self.events]
        times = np.array([event.time for event in self.events])
        return window_equations(events, times, self._acceleration, self._marginal)

    def _linearise(self) -> None:
        """All events about their present poses, and the marginal prior with them.

        What is no longer near where it was drawn is drawn again.

        All of them: derivatives that were taken at poses which are no motion would contradict one
        another, and the motion prior would make evidence of that.
        """
        linear = self._linear_events(self.events, stacked(event.pose for event in self.events))
        steps = [event.step for event in self.events[:REACH]]
        if self._marginal is not None:
            self._marginal = self._marginal.about(np.stack(steps))
        for event, new in zip(self.events, linear, strict=True):
            drawn = event.linear and event.linear.silhouettes_about(event.step)
            if drawn is None or np.abs(new.points - drawn.points).max() > NEAR_M:
                drawn = self._drawn(event, new.pose, new.points)
            new.silhouettes = drawn
            event.linear, event.step = new, np.zeros_like(new.gradient)

    def _linear_events(self, events: Sequence[WindowEvent], poses: np.ndarray) -> list[LinearEvent]:
        """Events about packed poses (T, 7 + D), without their silhouettes."""
        measured = jax.tree.map(lambda *parts: np.stack(parts), *(e.measured for e in events))
        terms = self._terms()
        parts = in_batches(
            lambda *batch: _events_fit(terms, self._blind, *batch),
            (poses, measured),
            EVENTS_A_CALL,
        )
        return [LinearEvent(*each) for each in zip(poses, *parts, strict=True)]

    def _terms(self) -> tuple[Term, ...]:
        """Those of the settings, weighed by how far the window's events are apart."""
        if len(self.events) > REACH:
            times = np.array([event.time for event in self.events])
            step = mean_step(times)
            if abs(step / self._weighed[0] - 1) > RATE_CHANGED:
                self._weighed = step, weighed_by_time(self._settings, times).terms
        return self._weighed[1]

    def _drawn(
        self, event: WindowEvent, pose: np.ndarray, points: np.ndarray
    ) -> SilhouetteQuadratic | None:
        """What an event's silhouettes cost about a packed pose with these landmarks."""
        if not event.frames:
            return None
        skeleton, settings = self._model.skeleton, self._settings.silhouettes
        each = [
            _silhouettes_fit(skeleton, self.cameras[camera], settings, pose, frame.grids)
            for camera, frame, _ in event.frames
        ]
        cost, hessian, gradient = (
            np.sum([np.asarray(part, float) for part in parts], 0)
            for parts in zip(*each, strict=True)
        )
        return SilhouetteQuadratic(points, float(cost), hessian, gradient, 0 * gradient)

    def _move(self, equations: WindowEquations) -> float:
        """All events by the equations' steps, as far as the derivatives are to be trusted.

        Returns:
            By how much they misplace any landmark, metres.
        """
        misplaced = np.inf
        for more in range(DAMPINGS):
            steps = equations.steps(DAMPING * DAMPED_MORE**more)
            misplaced = self._move_by(steps)
            if misplaced < TRUSTED_M:
                break
        return misplaced

    def _move_by(self, steps: np.ndarray) -> float:
        """All events by steps (T, N); by how much the derivatives misplace any landmark, metres."""
        origins = np.stack([_linear(event).pose for event in self.events])
        poses, points = moved(self._model.skeleton, origins, steps)
        for event, pose, step in zip(self.events, poses, steps, strict=True):
            event.pose, event.step = unpack(pose), step
        expected = [_linear(e).points_at(step) for e, step in zip(self.events, steps, strict=True)]
        return float(np.abs(points - np.stack(expected)).max())

    def _rival(self) -> WindowEquations | None:
        """The equations of a window with an arm where the search has it, where that costs less.

        None where there was no search, or nothing to be tried.
        """
        newest = self.events[-1]
        self._since_search += bool(newest.frames)
        if not newest.frames or self._since_search < SEARCH_EVERY:
            return None
        self._since_search = 0
        found = search_arms(self._model, self._settings, self.cameras, newest)
        self.arms_spread = found.spread
        # Even where it is not tried: a live run compiles all of this before anybody is there.
        there = with_arm_there(self._model, stacked(each.pose for each in self.events), found)
        if found.gain < RIVAL_GAIN or found.away < RIVAL_M:
            return None
        own, rival = self._equations(), self._from(there)
        for _ in range(RIVAL_STEPS - 1):
            origins = np.stack([event.pose for event in rival.events])
            rival = self._from(moved(self._model.skeleton, origins, rival.steps(DAMPING))[0])
        # What a marginal prior says of its own window is no price of the other one.
        if rival.cost(rival.steps(DAMPING)) > own.cost(own.steps(DAMPING)) - RIVAL_GAIN:
            return own
        self._forget()
        for event, linear in zip(self.events, rival.events, strict=True):
            event.linear = linear
        return rival

    def _from(self, poses: np.ndarray) -> WindowEquations:
        """All events about other packed poses (T, 7 + D), without a marginal prior."""
        linear = self._linear_events(self.events, poses)
        for event, each in zip(self.events, linear, strict=True):
            each.silhouettes = self._drawn(event, each.pose, each.points)
        times = np.array([event.time for event in self.events])
        return window_equations(linear, times, self._acceleration, None)


def _linear(event: WindowEvent) -> LinearEvent:
    assert event.linear is not None
    return event.linear
