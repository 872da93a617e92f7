"""Arrays over time of which some rows at a time are in memory.

INPUTS: a function that computes rows, or rows. OUTPUTS: what is asked for like an array; arrays.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import jax
import numpy as np

Index = slice | np.ndarray
# Rows of text and of angles that are worked on at a time.
BLOCK_ROWS = 4096


class Rows(Protocol):
    """An array (T, ...), or what stands for it: rows are asked for by a slice, or by indices."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the array."""
        ...

    def __getitem__(self, rows: Any, /) -> np.ndarray:
        """Some of its rows."""
        ...


@dataclass(frozen=True)
class ComputedRows:
    """An array (T, ...) whose rows are computed whenever they are asked for."""

    shape: tuple[int, ...]  # of the array
    compute: Callable[[Index], np.ndarray]  # slice or indices of rows -> these rows

    def __getitem__(self, rows: Index | int) -> np.ndarray:
        """Some of its rows, or one."""
        if isinstance(rows, int):
            return self.compute(np.array([rows]))[0]
        return self.compute(rows)


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
            self.tree = jax.tree.map(self._room_for, part)
        for every, some in zip(jax.tree.leaves(self.tree), jax.tree.leaves(part), strict=True):
            every[first : first + len(some)] = some[: self._count - first]

    def _room_for(self, part: np.ndarray) -> np.ndarray:
        return np.empty((self._count, *part.shape[1:]), part.dtype)


def map_rows(rows: Rows, function: Callable[[np.ndarray], np.ndarray]) -> ComputedRows:
    """What a function makes of rows (N, ...), of as many and as large ones."""
    return ComputedRows(rows.shape, lambda which: function(rows[which]))


def take_rows(rows: Rows, order: np.ndarray) -> ComputedRows:
    """The rows of these indices (N,)."""
    return ComputedRows((len(order), *rows.shape[1:]), lambda which: rows[order[which]])


def row_blocks(count: int, size: int | None = None) -> Iterator[slice]:
    """Rows in a row, so many at a time or ``BLOCK_ROWS``; at least one block."""
    size = BLOCK_ROWS if size is None else max(size, 1)
    for first in range(0, max(count, 1), size):
        yield slice(first, min(first + size, count))
