"""A recording gone through step by step, as it would come in live.

    solve, observe, refine at every event; the smoother behind gives out what is some frames old

INPUTS: a Plan, a tracker, readers of its videos. OUTPUTS: Passed.
"""

from collections.abc import Callable, Sequence
from time import perf_counter

import jax
import numpy as np

from jaxmocap.capture.footage import ForwardReader
from jaxmocap.hybrid.first_state import settled
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.pipelines.progress import Clock, timed_stages
from jaxmocap.pipelines.tracking import warnings
from jaxmocap.pipelines.tracking.events import Plan
from jaxmocap.pipelines.tracking.first_pass import Passed
from jaxmocap.smoothing.fixed_lag import FixedLagSmoother, Given


def stepped(
    plan: Plan,
    tracker: HybridTracker,
    readers: Sequence[ForwardReader],
    smoother: FixedLagSmoother | None,
    show: Callable[[int, int], None],
) -> Passed:
    """Step through the events.

    Args:
        plan: the events.
        tracker: that takes the steps.
        readers: of its cameras' videos.
        smoother: behind the tracker.
        show: called with the events done and their total.
    """
    clock, count = Clock(), len(plan.times)
    timed, line = timed_stages(tracker, clock), plan.timeline
    given: list[Given] = []
    steps, said, milliseconds = [], [], {}
    began = perf_counter()
    state = settled(tracker, plan.markers_world[0])
    for event, time in enumerate(plan.times):
        began = perf_counter() if event else began
        frames, markers = line.frame_index[event], plan.markers_world[event]
        images = [reader.at(i) for reader, i in zip(readers, frames, strict=True)]
        clock.spent = {"decode": 1e3 * (perf_counter() - began)}
        state, pose, report = timed.step(state, time, markers, images)
        # A quarter of the time of jax.device_get, and the state stays where it is wanted next.
        pose, report = jax.tree.map(np.asarray, (pose, report))
        if smoother is not None:
            # Between the samples markers are extrapolated, which the smoother does better.
            there = markers if line.sample_index[event] >= 0 else np.nan * markers
            given += clock.timed("smooth", smoother.step)(time, there, images, pose, report)
        spent = _stages(clock.spent, 1e3 * (perf_counter() - began), not event, images)
        for stage, taken in spent.items():
            milliseconds.setdefault(stage, []).append(taken)
        steps.append((pose, report))
        said.append([*warnings.of_step(report), *plan.about_images(event, images)])
        show(event + 1, count)
    given += smoother.flush() if smoother else []
    refined, reports = jax.tree.map(lambda *parts: np.stack(parts), *steps)
    return Passed(plan, refined, reports, said, milliseconds, given)


def _stages(
    spent: dict[str, float], total: float, first: bool, images: Sequence[np.ndarray | None]
) -> dict[str, float]:
    """The stages that an event's times belong to."""
    if first:
        return {"first_call": total}
    if any(image is not None for image in images):
        return spent | {"frame": total}
    return {"solve": spent["solve"], "carry": spent["refine"], "sample": total}
