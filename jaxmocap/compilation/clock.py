"""How long the stages of a computation take.

INPUTS: functions that are called. OUTPUTS: milliseconds of each stage.
"""

from collections.abc import Callable
from time import perf_counter
from typing import Any

import jax


class Clock:
    """Milliseconds of stages, call by call; each stage belongs to one thread.

    Attributes:
        milliseconds: stage -> times.
    """

    def __init__(self, runs: bool = True):
        """A clock that does not run only calls."""
        self.milliseconds: dict[str, list[float]] = {}
        self._runs = runs

    def time_stage(self, stage: str, function: Callable, *arguments: Any, among: int = 1) -> Any:
        """What a function returns, once it is there; its time is kept, of each of so many."""
        if not self._runs:
            return function(*arguments)
        began = perf_counter()
        result = jax.block_until_ready(function(*arguments))
        self.keep(stage, began, among)
        return result

    def keep(self, stage: str, began: float, among: int = 1) -> float:
        """Keep the time since ``began``, of each of so many; the time now."""
        now = perf_counter()
        self.milliseconds.setdefault(stage, []).append(1e3 * (now - began) / among)
        return now
