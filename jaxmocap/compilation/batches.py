"""Jitted functions of batches of one size over any number of entries, so that they compile once.

INPUTS: stacked entries. OUTPUTS: stacked results, float64.
"""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

# Batches that are computed before the first of them is taken, at most.
WAITING = 8


class GatheredRows:
    """A tree of arrays (N, ...) that is filled some rows at a time: none is in memory twice.

    Attributes:
        tree: of the arrays; None before the first rows.
    """

    def __init__(self, count: int):
        """Of so many rows."""
        self._count = count
        self.tree: Any = None

    def put(self, first: int, part: Any) -> None:
        """Rows from that one on, of which those beyond the last are left out."""
        if self.tree is None:
            room = lambda some: np.empty((self._count, *some.shape[1:]), some.dtype)  # noqa: E731
            self.tree = jax.tree.map(room, part)
        for every, some in zip(jax.tree.leaves(self.tree), jax.tree.leaves(part), strict=True):
            every[first : first + len(some)] = some[: self._count - first]


def in_batches(
    call: Callable, stacked: tuple[Any, ...], size: int, workers: ThreadPoolExecutor | None = None
) -> list[np.ndarray]:
    """``call`` over batches of one size, of which the last is filled up with its last entry.

    Without workers one after the other in the caller's thread, to which JAX's precision belongs.
    """
    count = len(jax.tree.leaves(stacked)[0])

    def of_batch(rows: np.ndarray) -> list[np.ndarray]:
        result = call(*jax.tree.map(lambda part: np.asarray(part)[rows], stacked))
        return [np.asarray(part, np.float64) for part in jax.tree.leaves(result)]

    firsts, gathered = range(0, count, size), GatheredRows(count)
    batches = (np.minimum(np.arange(first, first + size), count - 1) for first in firsts)
    for first, parts in zip(firsts, _beside(of_batch, batches, workers), strict=True):
        gathered.put(first, parts)
    return gathered.tree or []


def _beside(
    call: Callable, batches: Iterator[np.ndarray], workers: ThreadPoolExecutor | None
) -> Iterator[list[np.ndarray]]:
    """Results in order; few of them wait to be taken."""
    if workers is None:
        yield from map(call, batches)
        return
    waiting = deque[Future]()
    for rows in batches:
        waiting.append(workers.submit(call, rows))
        if len(waiting) > WAITING:
            yield waiting.popleft().result()
    yield from (each.result() for each in waiting)
