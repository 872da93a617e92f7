"""Smoothing while it happens: each pose waits for two more video frames, and no longer.

The same residuals as over a whole recording, over the newest frames alone; what earlier ones told
is condensed (``solvers.window``). What changes behind a pose that was given out fades in, so that
the track does not jump (``solvers.fading``).

    tracker = HybridTracker(skeleton, camera)
    state, smoother = tracker.init(markers), FixedLagSmoother(tracker)
    for time, markers, image in ...:  # NaN and None where there is nothing new
        state, pose, report = tracker.step(state, time, markers, [image])
        for given in smoother.step(time, markers, [image], pose, report):
            ...  # given.number, given.time, given.pose, given.deviations
    last = smoother.flush()

INPUTS: what the tracker's steps had and found. OUTPUTS: their poses, a little later.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from threadpoolctl import ThreadpoolController

from jaxmocap.body.kinematics import forward, landmark_sites, site_positions
from jaxmocap.body.pose import Pose, difference, pack, retract, unpack
from jaxmocap.body.skeleton import ROOT_DOF, Skeleton
from jaxmocap.compilation.programs import program
from jaxmocap.evidence.appearance.running import RunningAppearance, Seen
from jaxmocap.evidence.residuals import GROUND, NO_GOALS, Known, feet_free
from jaxmocap.evidence.silhouettes import weighed
from jaxmocap.geometry.rotations import quaternion_to_matrix
from jaxmocap.hybrid.tracker import HybridTracker, StepReport
from jaxmocap.smoothing.fading import Fading
from jaxmocap.smoothing.uncertainty import trusted
from jaxmocap.smoothing.window import SOFTNESS, Event, Newest, Solved, offsets, stacked

# A pose is given out once so many later video frames were seen, and so many seconds later at most.
DELAY_FRAMES, DELAY_S = 2, 0.1
# Video frames that stay in the window, and for how long; events that wait for the next frame.
KEPT_FRAMES, KEPT_S, MOST_WAITING = 3, 0.2, 6
# Time constant with which corrections fade in, seconds.
FADE_S = 0.07
# Over so many seconds the markers' facing is averaged: a person turns more slowly than it errs.
TURNING_S = 0.35
# Events farther apart are no motion.
LONGEST_GAP_S = 0.25
# Velocities are told from events at least so far apart, seconds.
BASELINE_S = 0.005


class Given(NamedTuple):
    """A pose that stays as it is.

    Attributes:
        number: of its event, counted from 0.
        time: of its event, seconds.
        pose: smoothed.
        deviations: (L, 3) standard deviations of the landmarks' coordinates, world, metres.
        from_prior: (L,) 1 where markers and video leave a landmark almost as uncertain as it is
            without them, else 0.
    """

    number: int
    time: float
    pose: Pose
    deviations: np.ndarray
    from_prior: np.ndarray


@program("quick")
def _retract(packed: Array, step: Array) -> Array:
    """A packed pose (7 + D,) moved by a tangent vector."""
    return pack(retract(unpack(packed), step))


@program("quick")
def _expected(skeleton: Skeleton, packed: Array) -> Array:
    """The last pose moved as the markers' pose moved; where that faces and leans; its ankles.

    One vector in and one out: a crossing costs by the number of arrays.

    Args:
        skeleton: D degrees of freedom.
        packed: (3, 7 + D) the last pose, the markers' pose there, and their pose now.

    Returns:
        The packed pose; the horizontal parts of x and z of the markers' pelvis; (2, 3) raveled.
    """
    last, before, alone = (unpack(each) for each in packed)
    ankles = site_positions(skeleton, forward(skeleton, alone), landmark_sites(skeleton, GROUND))
    moved = retract(last, difference(alone, before))
    R = quaternion_to_matrix(alone.quaternion)
    return jnp.concatenate([pack(moved), R[:2, 0], R[:2, 2], ankles.ravel()])


class FixedLagSmoother:
    """Smooths one person's poses, at most ``DELAY_FRAMES`` video frames behind the tracker.

    Attributes:
        tracker: whose poses are smoothed; its person, cameras, markers and settings.
    """

    def __init__(self, tracker: HybridTracker):
        """Prepare for a tracker with cameras; knows nothing of the room yet."""
        if tracker.cameras is None:
            raise ValueError("FixedLagSmoother needs a tracker with at least one camera")
        self.tracker = tracker
        self._newest = Newest(tracker)
        free = feet_free(tracker.skeleton, tracker.markers)
        self._views = [
            RunningAppearance(tracker.skeleton, camera, free > 0) for camera in self._newest.cameras
        ]
        self._feet_free = np.asarray(free, tracker.dtype)
        self._no_goals = NO_GOALS.astype(tracker.dtype)
        self._blas = ThreadpoolController()
        self._count = self._given = 0
        self._begin()

    def _begin(self) -> None:
        """No events, no past; the room and the person's colours stay known."""
        self._newest.begin()
        self._alone: Pose | None = None
        self._ahead: np.ndarray | None = None
        self._fading: Fading | None = None
        # Number, time and pose of the event given out last, and of one beside it.
        self._remembered: list[tuple[int, float, Pose]] = []
        self._waiting = 0

    def step(
        self,
        time: float,
        markers_world: np.ndarray | Array,
        images: Sequence[np.ndarray | None] | None,
        pose: Pose,
        report: StepReport,
    ) -> list[Given]:
        """One step of the tracker.

        Args:
            time: as the tracker had it, later than the last one.
            markers_world: (M, 3) metres; NaN where missing. Markers that were only extrapolated to
                this time are better left out.
            images: a BGR (for colours to tell) or grey uint8 frame per camera, None where there is
                no new one.
            pose: that it found.
            report: and what it told.

        Returns:
            What is final now: of no event, or of some, in order.
        """
        given: list[Given] = []
        lost = bool(report.placed) or (
            bool(self._newest.events) and time - self._newest.events[-1].time > LONGEST_GAP_S
        )
        if self._newest.events and lost:
            given += self.flush()
        self._newest.events.append(self._event(time, markers_world, images, pose, report))
        self._waiting = 0 if self._newest.events[-1].looks else self._waiting + 1
        if self._waiting in range(1, MOST_WAITING):
            return given
        self._waiting = 0
        return given + self._settle(final=False)

    def flush(self) -> list[Given]:
        """The poses that still wait, as they are; the next step begins a new motion."""
        given = self._settle(final=True) if self._newest.events else []
        self._begin()
        return given

    def _event(
        self,
        time: float,
        markers_world: np.ndarray | Array,
        images: Sequence[np.ndarray | None] | None,
        pose: Pose,
        report: StepReport,
    ) -> Event:
        """A step with the pose that is expected there, and what the cameras saw about it."""
        dtype = self.tracker.dtype
        first, alone = (
            Pose._make(np.asarray(part, dtype) for part in each) for each in (pose, report.pose)
        )
        last = self._newest.events[-1] if self._newest.events else None
        before = alone if last is None or self._alone is None else self._alone
        three = [np.concatenate(each) for each in (last.pose if last else first, before, alone)]
        told = np.asarray(_expected(self.tracker.skeleton, np.stack(three)))
        there = Pose._make(np.split(told[:-10], (3, 7)))
        ahead, up, ankles = np.split(told[-10:], (2, 4))
        self._alone = alone
        facing = self._facing(ahead, 0.0 if last is None else time - last.time)
        targets, facing = np.asarray(markers_world, dtype), facing.astype(dtype)
        known = Known(targets, up, facing, ankles.reshape(2, 3), self._feet_free, self._no_goals)
        looks = [
            (camera, self._seen(view, image, there), (image.shape[1], image.shape[0]))
            for camera, (view, image) in enumerate(zip(self._views, images or (), strict=False))
            if image is not None
        ]
        self._count += 1
        spread = np.asarray(report.spread, float)
        return Event(self._count - 1, float(time), known, there, first, spread, looks)

    def _seen(self, view: RunningAppearance, image: np.ndarray, pose: Pose) -> Seen:
        """What a camera saw about a pose, counting as the settings say."""
        seen = view.see(image, pose, SOFTNESS)
        return seen._replace(sight=weighed(seen.sight, self.tracker.settings.over_time))

    def _facing(self, ahead: np.ndarray, elapsed: float) -> np.ndarray:
        """Where the markers' pose has faced of late, (3,) unit and horizontal."""
        of_late = np.asarray(ahead, float) if self._ahead is None else self._ahead
        of_late = of_late + (1 - np.exp(-elapsed / TURNING_S)) * (ahead - of_late)
        self._ahead = of_late
        return np.append(of_late / max(float(np.linalg.norm(of_late)), 1e-9), 0.0)

    def _settle(self, final: bool) -> list[Given]:
        """Solve the window, give out what has waited long enough, forget and learn."""
        # Band matrices are narrow: BLAS's threads would only wait for one another.
        with self._blas.limit(limits=1, user_api="blas"):
            solved = self._newest.solve()
            given = self._give(solved, final)
            self._shorten(solved)
        self._learn()
        return given

    def _give(self, solved: Solved, final: bool) -> list[Given]:
        """What has waited long enough, and all of it in the end."""
        events = self._newest.events
        ready = [i for i in self._due(final) if events[i].number >= self._given]
        if not ready:
            return []
        mismatch = float(self.tracker.settings.over_time.mismatch)
        trust = trusted(*self._newest.variances(solved, ready), mismatch)
        self._correct()
        given = [
            Given(event.number, event.time, self._faded(event), *each)
            for event, *each in zip([events[i] for i in ready], *trust, strict=True)
        ]
        self._remember(ready[-1])
        self._given = given[-1].number + 1
        return given

    def _due(self, final: bool) -> list[int]:
        """Which events of the window have waited long enough."""
        events, later, due = self._newest.events, 0, []
        for i in reversed(range(len(events))):
            waited = events[-1].time - events[i].time
            if final or later >= DELAY_FRAMES or waited >= DELAY_S:
                due.append(i)
            later += bool(events[i].looks)
        return due[::-1]

    def _correct(self) -> None:
        """Carry on what the track has moved by behind what was given out last."""
        now = {event.number: event.pose for event in self._newest.events}
        known = [old for old in self._remembered if old[0] in now]
        if self._fading is None or len(known) < 2:
            return
        (_, time, _), (_, beside, _) = known
        ours = stacked(now[number] for number, *_ in known)
        here, there = offsets(stacked(pose for *_, pose in known), ours)
        self._fading = self._fading.corrected(here, (there - here) / (beside - time))

    def _faded(self, event: Event) -> Pose:
        """An event's pose, and what is left of corrections."""
        if self._fading is None:
            nothing = np.zeros(ROOT_DOF + len(event.pose.angles))
            self._fading = Fading(nothing, nothing, event.time)
        self._fading = self._fading.at(event.time, FADE_S)
        offset = self._fading.offset.astype(self.tracker.dtype)
        moved = np.asarray(_retract(np.concatenate(event.pose), offset))
        return Pose._make(np.split(moved, (3, 7)))

    def _remember(self, last: int) -> None:
        """The event given out last and one beside it, as they are now."""
        events = self._newest.events
        here = events[last]
        beside = [*events[last + 1 :], *reversed(events[:last])]
        far = [event for event in beside if abs(event.time - here.time) >= BASELINE_S]
        self._remembered = [(e.number, e.time, e.pose) for e in (here, *far[:1])]

    def _shorten(self, solved: Solved) -> None:
        """Condense the oldest events: the newest few video frames stay, and what still waits."""
        events, count = self._newest.events, 0
        while len(events) - count > 3 and events[count].number < self._given - 1:
            frames = sum(bool(event.looks) for event in events[count:])
            if frames <= KEPT_FRAMES and events[-1].time - events[count].time < KEPT_S:
                break
            count += 1
        for event in self._newest.drop(solved, count):
            self._learn_from(event)

    def _learn(self) -> None:
        """Learn from frames whose poses are known as well as they ever will be."""
        for event in self._newest.events:
            if event.number < self._given:
                self._learn_from(event)

    def _learn_from(self, event: Event) -> None:
        if not event.learned:
            for camera, seen, size in event.looks:
                self._views[camera].learn(seen, size, event.pose)
        event.learned = True
