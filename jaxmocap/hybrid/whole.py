"""A whole recording in two scans: the tracker's own steps, without leaving the device in between.

    solve_all    markers at all events -> poses, and the regions where they put the arms
    observe_all  the frames in these regions (host)
    refine_all   poses + what was seen, event by event -> refined poses

``solve`` reads its own last pose alone, so all regions are known before any image is looked at.
Many recordings go side by side by ``jax.vmap`` over ``solved_over_time`` and
``refined_over_time``, whatever differs between them along a new first axis.

INPUTS: a tracker, its state, markers at E events, frames. OUTPUTS: what its steps would find.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.geometry.cameras import Camera
from jaxmocap.hybrid.observe import Observation
from jaxmocap.hybrid.search import Belief
from jaxmocap.hybrid.settings import Settings
from jaxmocap.hybrid.stance import Stance
from jaxmocap.hybrid.tracker import HybridTracker, Solved, State, StepReport
from jaxmocap.images.regions import Region


class Views(NamedTuple):
    """What C cameras saw at E events, each picture kept once.

    Attributes:
        fields: (F + 1, C, 2, K, S, S) of the F events with an image; the first is of nothing.
        seen: (F + 1, C, 2) whether there is an image.
        which: (E,) which of them an event looks at; 0 for none.
    """

    fields: Array | np.ndarray
    seen: Array | np.ndarray
    which: Array | np.ndarray


class WholeTracker:
    """A ``HybridTracker`` over recordings that are there as a whole.

    Attributes:
        tracker: whose steps are taken.
        solve_all: jitted ``solved_over_time``.
        refine_all: jitted ``refined_over_time``.
    """

    def __init__(self, tracker: HybridTracker):
        """Prepare for a tracker; both functions trace once for a number of events."""
        self.tracker = tracker
        self.solve_all = jax.jit(self.solved_over_time)
        self.refine_all = jax.jit(self.refined_over_time)

    def run(
        self,
        state: State,
        times: np.ndarray,
        markers_world: np.ndarray,
        images: Sequence[Sequence[np.ndarray | None] | None] | None = None,
    ) -> tuple[State, Pose, StepReport]:
        """All events, from a state.

        Args:
            state: before the first, as ``HybridTracker.init`` makes it.
            times: (E,) seconds since the first sample.
            markers_world: (E, M, 3) metres; NaN where missing.
            images: of each event a BGR or grey uint8 frame per camera, as for ``step``.

        Returns:
            The state after the last, the refined poses (E, ...) and reports (E, ...).
        """
        own = self.tracker
        shared = own.skeleton, own.cameras, own.settings
        markers = np.asarray(markers_world, own.dtype)
        (pose, stance), solved = self.solve_all(*shared, (state.pose, state.stance), markers)
        views = None if solved.region is None else self.observe_all(images, solved.region)
        now = np.asarray(times, own.dtype)
        belief, poses, reports = self.refine_all(
            *shared, own.factors, solved, markers, views, state.belief, now
        )
        return State(pose, stance, belief), poses, reports

    def solved_over_time(
        self,
        skeleton: Skeleton,
        cameras: Camera | None,
        settings: Settings,
        start: tuple[Pose, Stance],
        markers: Array,
    ) -> tuple[tuple[Pose, Stance], Solved]:
        """``solve`` at all events: (E, M, 3) markers to the last pose and stance, and all results.

        Args:
            skeleton: of the person, as the tracker has it.
            cameras: C, stacked, or None.
            settings: of the tracker.
            start: pose and stance before the first event.
            markers: (E, M, 3) world, metres; NaN where missing.
        """

        def one(last: tuple[Pose, Stance], targets: Array) -> tuple[tuple[Pose, Stance], Solved]:
            solved = self.tracker.solve(skeleton, cameras, settings, *last, targets)
            return (solved.ik.pose, solved.ik.stance), solved

        return jax.lax.scan(one, start, markers)

    def refined_over_time(
        self,
        skeleton: Skeleton,
        cameras: Camera | None,
        settings: Settings,
        factors: Array,
        solved: Solved,
        markers: Array,
        views: Views | None,
        belief: Belief,
        times: Array,
    ) -> tuple[Belief, Pose, StepReport]:
        """``refine`` at all events: the last belief, the refined poses and the reports (E, ...).

        Args:
            skeleton: of the person, as the tracker has it.
            cameras: C, stacked, or None.
            settings: of the tracker.
            factors: of the tracker.
            solved: (E, ...) of ``solved_over_time``.
            markers: (E, M, 3) as there.
            views: what the cameras saw; None without cameras.
            belief: before the first event.
            times: (E,) seconds since the first sample.
        """

        def one(last: Belief, event: tuple) -> tuple[Belief, tuple[Pose, StepReport]]:
            own, targets, which, time = event
            seen = None
            if views is not None:
                fields, there = jnp.asarray(views.fields), jnp.asarray(views.seen)
                seen = Observation(own.region, fields[which], there[which])
            args = skeleton, cameras, settings, factors, own, targets, seen, last, time
            last, pose, report = self.tracker.refine(*args)
            return last, (pose, report)

        which = None if views is None else views.which
        belief, (poses, reports) = jax.lax.scan(one, belief, (solved, markers, which, times))
        return belief, poses, reports

    def observe_all(
        self,
        images: Sequence[Sequence[np.ndarray | None] | None] | None,
        regions: Region,
    ) -> Views:
        """The image chain over all events that have an image, in order: it remembers thresholds.

        Args:
            images: of each of E events a frame per camera; None where there is none.
            regions: (E, C, 2) where to look.
        """
        observer, host = self.tracker.observer.fresh(), jax.device_get(regions)
        events = len(host.scale)
        look = images if images is not None else [None] * events
        nothing = observer.observe(None, jax.tree.map(lambda part: part[0], host))
        found, which = [nothing], np.zeros(events, np.int32)
        for event, frames in enumerate(look):
            if frames is not None and any(frame is not None for frame in frames):
                region = jax.tree.map(lambda part, e=event: part[e], host)
                which[event] = len(found)
                found.append(observer.observe(frames, region))
        fields, seen = (
            np.stack([np.asarray(getattr(each, name)) for each in found])
            for name in ("fields", "seen")
        )
        return Views(fields, seen, which)
