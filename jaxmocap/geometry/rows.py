"""Arrays over time of which some rows at a time are in memory.

INPUTS: a function that computes rows, or rows. OUTPUTS: what is asked for like an array; arrays.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

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
