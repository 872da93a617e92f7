"""Arrays between host and device that compile nothing.

JAX compiles a program for each shape of what it converts, or works through step by step, outside
of a traced function: some ten milliseconds of every start each.

INPUTS: numbers on the host, or arrays of either kind. OUTPUTS: arrays on the device; the module
whose functions work on an array; results of batches of one size; several arrays as one.
"""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

# NumPy's on the host, a JAX array in a program.
Numbers = Any
# Batches that are computed before the first of them is taken, at most.
WAITING = 8


def on_device(values: Any, dtype: Any = float) -> Array:
    """Numbers, or NumPy arrays, as an array of JAX; ``float`` is JAX's own precision."""
    dtype = jax.dtypes.canonicalize_dtype(dtype)
    return jnp.asarray(np.asarray(values, dtype), dtype)


def namespace(array: Numbers) -> ModuleType:
    """NumPy on the host, ``jax.numpy`` of what is JAX's or traced."""
    return jnp if isinstance(array, jax.Array) else np


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


def packed(tree: Any) -> Array:
    """All numbers of a pytree, leaf after leaf."""
    return jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(tree)])


def unpacked(vector: np.ndarray, shapes: Any) -> Any:
    """The pytree of a packed vector.

    Args:
        vector: on the host.
        shapes: the pytree with a ``jax.ShapeDtypeStruct`` or an array for each leaf.
    """
    leaves, structure = jax.tree.flatten(shapes)
    ends = np.cumsum([int(np.prod(leaf.shape)) for leaf in leaves])
    parts = np.split(vector, ends[:-1])
    each = [part.reshape(leaf.shape) for part, leaf in zip(parts, leaves, strict=True)]
    return jax.tree.unflatten(structure, each)
