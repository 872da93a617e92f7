"""Where the time of a frame goes in the silhouette tracker, stage by stage.

INPUTS: a tracker at work. OUTPUTS: milliseconds of each stage of each frame.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from time import perf_counter
from unittest.mock import patch

import jax

from jaxmocap.capture import footage
from jaxmocap.silhouette import tracker
from jaxmocap.silhouette.fit import cycles
from jaxmocap.silhouette.segmentation import outlines
from jaxmocap.silhouette.surfaces import rim

# Stage -> whose attributes do its work, in the order of a frame. ``decode`` is what a frame waits
# for the decoders, which work ahead on threads of their own.
STAGES: dict[str, tuple[tuple[object, str], ...]] = {
    "decode": ((footage.ForwardReader, "at"),),
    "predict": ((tracker, "predicted_pose"),),
    "rim": ((rim.RimFinder, "find"),),
    "canvases": ((outlines, "canvas"), (outlines, "silhouette_distance")),
    "segmentation": ((outlines, "segment"),),
    "sharpening": ((outlines, "_sharpened"),),
    "contours": ((outlines, "contours"),),
    "matching": ((cycles, "matched_pairs"),),
    "edges": ((cycles, "inner_edge_pairs"),),
    "fit": ((cycles, "fit"),),
    "hypotheses": ((tracker, "recover_limbs"),),
}
REST, WHOLE_FRAME = "the rest", "whole frame"


class StageClock:
    """Adds up what the stages of one frame take, frame after frame.

    A stage that calls another one does not count what that one takes.

    Attributes:
        frames: stage -> milliseconds, one dictionary a frame; the rest and the whole too.
    """

    def __init__(self):
        self.frames: list[dict[str, float]] = []
        self._now: dict[str, float] = {}

    def timed(self, stage: str, function: Callable) -> Callable:
        """The function, whose times count for a stage; it returns when its result is there."""

        def run(*arguments, **named):
            began, before = perf_counter(), sum(self._now.values())
            result = jax.block_until_ready(function(*arguments, **named))
            others = sum(self._now.values()) - before
            spent = 1e3 * (perf_counter() - began) - others
            self._now[stage] = self._now.get(stage, 0.0) + spent
            return result

        return run

    def step(self, function: Callable) -> Callable:
        """The tracker's step, whose end is the frame's."""

        def run(*arguments, **named):
            waited = self._now.get("decode", 0.0)
            began = perf_counter()
            result = function(*arguments, **named)
            spent = 1e3 * (perf_counter() - began)
            rest = spent - (sum(self._now.values()) - waited)
            self.frames.append({**self._now, REST: rest, WHOLE_FRAME: spent + waited})
            self._now = {}
            return result

        return run


@contextmanager
def stages_timed() -> Iterator[StageClock]:
    """Within, every silhouette tracker's stages are timed; waiting for them takes a little more."""
    clock = StageClock()
    with ExitStack() as patches:
        for stage, workers in STAGES.items():
            for owner, name in workers:
                timed = clock.timed(stage, getattr(owner, name))
                patches.enter_context(patch.object(owner, name, timed))
        step = clock.step(tracker.SilhouetteTracker.step)
        patches.enter_context(patch.object(tracker.SilhouetteTracker, "step", step))
        yield clock
