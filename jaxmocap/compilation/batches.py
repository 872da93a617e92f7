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

    each = _beside(of_batch, _batches(count, size), workers)
    # Filled as they come: in parts and joined, all of it would be in memory twice.
    joined: list[np.ndarray] = []
    for i, parts in enumerate(each):
        first = i * size
        joined = joined or [np.empty((count, *part.shape[1:])) for part in parts]
        for every, some in zip(joined, parts, strict=True):
            every[first : first + size] = some[: count - first]
    return joined


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


def _batches(count: int, size: int) -> Iterator[np.ndarray]:
    for first in range(0, count, size):
        yield np.minimum(np.arange(first, first + size), count - 1)
