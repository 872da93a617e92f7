"""A tracker's steps over a whole recording: two scans, without leaving the device in between.

    solve_all    markers of many events -> poses, and the regions where they put the arms
    (the frames are looked at in these regions, on the host)
    refine_all   poses + what was seen, event by event -> refined poses

``solve`` reads its own last pose alone, so regions are known before any image is looked at. Many
recordings go side by side by ``jax.vmap`` over ``solved_over_time`` and ``refined_over_time``,
whatever differs between them along a new first axis.

INPUTS: a tracker's ``solve`` and ``refine``, markers at E events, views. OUTPUTS: what its steps
would find.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.compilation.programs import Program
from jaxmocap.geometry.cameras import Camera
from jaxmocap.hybrid.elbow_search import Belief
from jaxmocap.hybrid.feet import Stance
from jaxmocap.hybrid.observe import Observation
from jaxmocap.hybrid.settings import Settings

# Events of a scan: few enough that their pictures take little memory, and that the next chunk can
# be solved while this one is looked at.
EVENTS = 32


class Views(NamedTuple):
    """What C cameras saw at some events, each picture kept once.

    Attributes:
        fields: (F + 1, C, 2, K, S, S) of F events with an image; the first is of nothing.
        seen: (F + 1, C, 2) whether there is an image.
        which: (E,) which of them an event looks at; 0 for none.
    """

    fields: Array | np.ndarray
    seen: Array | np.ndarray
    which: Array | np.ndarray

    @classmethod
    def of(cls, nothing: Observation, each: Sequence[Observation | None]) -> "Views":
        """Of E events, with room for as many pictures, so that the shapes are always the same.

        Args:
            nothing: what an event without an image looks at.
            each: what was seen at each event; None without an image.
        """
        fields = np.zeros((len(each) + 1, *np.shape(nothing.fields)), np.float32)
        seen = np.zeros((len(each) + 1, *np.shape(nothing.seen)), bool)
        fields[0], which, count = nothing.fields, np.zeros(len(each), np.int32), 0
        for event, found in enumerate(each):
            if found is not None:
                count += 1
                fields[count], seen[count], which[event] = found.fields, found.seen, count
        return cls(fields, seen, which)


def solved_over_time(
    solve: Callable,
    skeleton: Skeleton,
    cameras: Camera | None,
    settings: Settings,
    start: tuple[Pose, Stance],
    markers: Array,
) -> tuple:
    """``solve`` at all events: (E, M, 3) markers to the last pose and stance, and all results.

    Args:
        solve: of a ``HybridTracker``.
        skeleton: of the person, as the tracker has it.
        cameras: C, stacked, or None.
        settings: of the tracker.
        start: pose and stance before the first event.
        markers: (E, M, 3) world, metres; NaN where missing.
    """

    def one(last: tuple[Pose, Stance], targets: Array) -> tuple:
        solved = solve(skeleton, cameras, settings, *last, targets)
        return (solved.ik.pose, solved.ik.stance), solved

    return jax.lax.scan(one, start, markers)


def refined_over_time(
    refine: Callable,
    skeleton: Skeleton,
    cameras: Camera | None,
    settings: Settings,
    factors: Array,
    solved: Any,
    markers: Array,
    views: Views | None,
    belief: Belief,
    times: Array,
) -> tuple:
    """``refine`` at all events: the last belief, and the refined poses and reports (E, ...).

    Args:
        refine: of a ``HybridTracker``.
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

    def one(last: Belief, event: tuple) -> tuple:
        own, targets, which, time = event
        seen = None
        if views is not None:
            fields, there = jnp.asarray(views.fields), jnp.asarray(views.seen)
            seen = Observation(own.region, fields[which], there[which])
        last, pose, report = refine(
            skeleton, cameras, settings, factors, own, targets, seen, last, time
        )
        return last, (pose, report)

    which = None if views is None else views.which
    return jax.lax.scan(one, belief, (solved, markers, which, times))


class Scans:
    """Both scans of a tracker, compiled once for their shapes, beside the calling thread.

    Attributes:
        solve_all: ``solved_over_time`` of the tracker.
        refine_all: ``refined_over_time`` of the tracker.
    """

    def __init__(self, solve_all: Program, refine_all: Program):
        """Nothing is compiled yet."""
        self.solve_all, self.refine_all = solve_all, refine_all
        self._compiling: tuple[Callable, Callable] | None = None

    def compiling(
        self, solve_like: Sequence, refine_like: Callable[[Any], Sequence]
    ) -> tuple[Callable[[], Callable], Callable[[], Callable]]:
        """What waits for either, for ever the same shapes.

        Args:
            solve_like: arguments of ``solve_all``, or what has their shapes.
            refine_like: arguments of ``refine_all``, from what ``solve_all`` finds.
        """
        if self._compiling is None:
            # Only the compiler runs beside: what is traced belongs to this thread's precision.
            solve = self.solve_all.beside(*solve_like)
            _, solved = self.solve_all.shapes(*solve_like)
            self._compiling = solve, self.refine_all.beside(*refine_like(solved))
        return self._compiling
