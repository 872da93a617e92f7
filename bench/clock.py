"""Time and memory: what starts up, what repeats, what stays.

A time is taken twice over: by the wall's clock, which users wait by, and by the processor's, which
stands still while the machine does something else. Ratios are of the latter, taken in turn: they
hold on a busy machine too. On one core, alone, the two clocks agree.

INPUTS: functions. OUTPUTS: milliseconds, MiB.
"""

import gc
import resource
from collections.abc import Callable, Mapping
from time import perf_counter, process_time
from typing import Any, NamedTuple

import jax
import numpy as np

from bench.metrics import Metric
from jaxmocap.compilation.clock import Clock


class Span(NamedTuple):
    """Milliseconds by the wall's clock, and by the processor's, all threads together."""

    wall: float
    busy: float


class Stopwatch:
    """Running since it was made."""

    def __init__(self):
        self._wall, self._busy = perf_counter(), process_time()

    def read(self) -> Span:
        """Since the start."""
        return Span(1e3 * (perf_counter() - self._wall), 1e3 * (process_time() - self._busy))


class BusyClock(Clock):
    """The tracker's clock for its stages, which keeps Spans as well.

    Attributes:
        spans: of the present step's stages.
    """

    def __init__(self):
        super().__init__()
        self.spans: dict[str, Span] = {}

    def timed(self, stage: str, function: Callable, *arguments: Any, among: int = 1) -> Any:
        """What a function returns, once it is there; its Span is kept, of each of so many."""
        span, result = timed(function, *arguments)
        self.spans[stage] = Span(span.wall / among, span.busy / among)
        self.milliseconds.setdefault(stage, []).append(span.wall / among)
        return result


def timed(function: Callable, *arguments) -> tuple[Span, Any]:
    """Until the result is there, and the result."""
    watch = Stopwatch()
    result = jax.block_until_ready(function(*arguments))
    return watch.read(), result


def interleaved(
    functions: Mapping[str, Callable[[], Any]], rounds: int, warm: int = 2
) -> dict[str, np.ndarray]:
    """Spans (rounds, 2) of each function, taken in turn."""
    spent: dict[str, list[Span]] = {name: [] for name in functions}
    for turn in range(warm + rounds):
        for name, function in functions.items():
            span, _ = timed(function)
            if turn >= warm:
                spent[name].append(span)
    return {name: np.array(spans) for name, spans in spent.items()}


def start_up(name: str, jitted: Any, *arguments) -> list[Metric]:
    """What a jitted function costs before it runs: trace, lower and compile, first call.

    Compiled programs that an earlier run has kept are read; tracing is never kept.
    """
    tracing, traced = timed(jitted.trace, *arguments)
    compiling, _ = timed(lambda: traced.lower().compile())
    calling, _ = timed(jitted, *arguments)
    parts = {"trace": tracing, "compile": compiling, "first call after it": calling}
    return [
        Metric(f"{name}, {part}", span.wall / 1e3, "s", tolerance=0.5)
        for part, span in parts.items()
    ]


def ratio(one: np.ndarray, other: np.ndarray) -> float:
    """Of Spans (N, 2) and (M, 2): median over median of the processor's time."""
    return float(np.median(one[:, 1]) / np.median(other[:, 1]))


def settle_garbage() -> None:
    """Collect what tracing left, and never look at it again: a pass over it takes milliseconds."""
    gc.collect()
    gc.freeze()


def peak_mib() -> float:
    """Most memory that the process has held so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
