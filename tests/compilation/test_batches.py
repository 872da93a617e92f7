"""Functions over batches of one size, and what they hold in memory meanwhile."""

import tracemalloc

import numpy as np
import pytest

from jaxmocap.compilation.batches import in_batches
from jaxmocap.smoothing.linearise import two_workers

COUNT, WIDTH, SIZE = 5000, 200, 64


@pytest.mark.parametrize("beside", [False, True])
def test_batches_are_joined_in_order_and_never_in_memory_twice(beside):
    rows = np.arange(COUNT, dtype=np.float32)
    shapes = set()

    def wide(numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        shapes.add(numbers.shape)
        return np.repeat(numbers[:, None], WIDTH, 1), -numbers

    with two_workers() as workers:
        tracemalloc.start()
        every, negative = in_batches(wide, (rows,), SIZE, workers if beside else None)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert shapes == {(SIZE,)}
    assert every.dtype == negative.dtype == np.float64
    np.testing.assert_array_equal(every, np.repeat(rows[:, None], WIDTH, 1))
    np.testing.assert_array_equal(negative, -rows)
    # Of the batches themselves some may wait beside the result.
    assert most < 1.5 * every.nbytes
