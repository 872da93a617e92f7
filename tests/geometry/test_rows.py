"""Rows of long arrays, some at a time."""

import numpy as np
import pytest

from jaxmocap.compilation.batches import GatheredRows
from jaxmocap.geometry.rows import ComputedRows, map_rows, row_blocks, take_rows

NUMBERS = np.arange(20.0).reshape(10, 2)


@pytest.fixture
def squares():
    return ComputedRows((10, 2), lambda rows: NUMBERS[rows] ** 2)


@pytest.mark.parametrize("rows", [slice(None), slice(3, 5), np.array([7, 1]), NUMBERS[:, 0] > 9, 4])
def test_computed_rows_are_those_of_the_array(squares, rows):
    np.testing.assert_array_equal(squares[rows], (NUMBERS**2)[rows])
    np.testing.assert_array_equal(map_rows(squares, np.sqrt)[rows], NUMBERS[rows])


def test_rows_are_taken_in_any_order(squares):
    order = np.array([9, 0, 0, 3])
    found = take_rows(squares, order)
    assert found.shape == (4, 2)
    np.testing.assert_array_equal(found[1:], (NUMBERS**2)[order][1:])


def test_rows_that_are_gathered_end_with_the_last(squares):
    gathered = GatheredRows(10)
    for rows in row_blocks(12, 4):
        rows = np.minimum(np.arange(rows.start, rows.stop), 9)
        gathered.put(rows[0], {"a": squares[rows], "b": (rows.astype(np.float32),)})
    np.testing.assert_array_equal(gathered.tree["a"], NUMBERS**2)
    assert gathered.tree["b"][0].tolist() == list(range(10))
    assert gathered.tree["b"][0].dtype == np.float32


@pytest.mark.parametrize(("count", "size"), [(10, 3), (9, 3), (1, 5), (0, 3), (4, 0)])
def test_blocks_are_all_rows_in_order_and_one_at_least(count, size):
    blocks = list(row_blocks(count, size))
    assert blocks
    assert [i for block in blocks for i in range(count)[block]] == list(range(count))
