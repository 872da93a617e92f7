"""How long the stages of a step take, and how far a long run has come.

INPUTS: a tracker; numbers of steps. OUTPUTS: a tracker whose stages are timed; progress bars.
"""

import copy
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter

import jax
from tqdm import tqdm

from jaxmocap.hybrid.tracker import HybridTracker

# Called with the steps done and their total.
Progress = Callable[[int, int], None]


class Clock:
    """Milliseconds of the stages of the present step.

    Attributes:
        spent: stage -> milliseconds.
    """

    def __init__(self):
        self.spent: dict[str, float] = {}

    def timed(self, stage: str, function: Callable) -> Callable:
        """The function with its time recorded; it returns when its result is there."""

        def keep(began: float) -> None:
            self.spent[stage] = 1e3 * (perf_counter() - began)

        return _timed(function, keep)


class Tally:
    """Milliseconds of stages, call by call; each stage belongs to one thread.

    Attributes:
        milliseconds: stage -> times.
    """

    def __init__(self):
        self.milliseconds: dict[str, list[float]] = {}

    def keep(self, stage: str, began: float, among: int = 1) -> float:
        """Keep the time since ``began``, of each of so many; the time now."""
        now = perf_counter()
        self.milliseconds.setdefault(stage, []).append(1e3 * (now - began) / among)
        return now

    def timed(self, stage: str, function: Callable, among: int = 1) -> Callable:
        """The function with its times recorded; it returns when its result is there."""
        return _timed(function, lambda began: self.keep(stage, began, among))


def _timed(function: Callable, keep: Callable[[float], object]) -> Callable:
    """The function; once its result is there ``keep`` is called with the time that it began."""

    def run(*arguments):
        began = perf_counter()
        result = jax.block_until_ready(function(*arguments))
        keep(began)
        return result

    return run


def timed_stages(tracker: HybridTracker, clock: Clock) -> HybridTracker:
    """The same tracker, compiled parts shared, with timed stages and an image chain of its own.

    The image chain remembers thresholds from frame to frame; a new recording starts afresh.
    """
    observer = tracker.observer.fresh()
    observer.observe = clock.timed("observe", observer.observe)
    timed = copy.copy(tracker)
    vars(timed).update(
        observer=observer,
        solve=clock.timed("solve", tracker.solve),
        refine=clock.timed("refine", tracker.refine),
    )
    return timed


@contextmanager
def progress_bar(label: str, progress: Progress | bool | None) -> Iterator[Progress]:
    """What to call with the steps done: the caller's own, a bar on stderr for True, or nothing."""
    if progress is not True:
        yield progress or (lambda done, total: None)
        return
    with tqdm(desc=label, leave=True) as bar:

        def show(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield show
