"""Banded systems against dense ones."""

import tracemalloc

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from jaxmocap.evidence.smoothness import smoothness
from jaxmocap.solvers import banded


@st.composite
def systems(draw) -> tuple[np.ndarray, np.ndarray]:
    """Block rows of a positive definite banded matrix, and the matrix."""
    frames, size = draw(st.integers(1, 7)), draw(st.integers(1, 4))
    reach = draw(st.integers(0, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**20)))
    blocks = rng.normal(size=(frames, reach + 1, size, size))
    lower = np.zeros((frames + reach, size, frames, size))
    for t in range(frames):
        for k in range(reach + 1):
            lower[t + k, :, t] = blocks[t, k]
    lower = lower.reshape((frames + reach) * size, frames * size)
    matrix = lower.T @ lower + np.eye(frames * size)
    tiled = matrix.reshape(frames, size, frames, size)
    rows = np.zeros((frames, size, reach + 1, size))
    for t in range(frames):
        for k in range(min(reach + 1, frames - t)):
            rows[t, :, k] = tiled[t, :, t + k]
    return rows.reshape(frames, size, -1), matrix


@given(systems())
def test_packed_columns_are_the_matrix_from_its_diagonal_down(system):
    rows, matrix = system
    columns = banded.pack_band(rows)
    for i, column in enumerate(columns):
        below = matrix[i:, i][: len(column)]
        np.testing.assert_array_equal(column[: len(below)], below)


@given(systems())
def test_unpacking_undoes_packing(system):
    rows, _ = system
    size = rows.shape[1]
    back = banded.unpack_band(banded.pack_band(rows), len(rows))
    rows[:, :, :size] = np.triu(rows[:, :, :size])
    np.testing.assert_array_equal(back, rows)


@given(systems(), st.integers(0, 3))
def test_banded_solutions_and_inverse_blocks_are_the_dense_ones(system, sides):
    rows, matrix = system
    frames, size, _ = rows.shape
    ridge = np.linspace(0, 1, frames * size).reshape(frames, size)
    factor = banded.factorise(rows, ridge)
    inverse = np.linalg.inv(matrix + np.diag(ridge.ravel()))
    right = np.random.default_rng(0).normal(size=(frames, size, sides))
    expected = inverse @ right.reshape(frames * size, sides)
    np.testing.assert_allclose(
        banded.solve_factored(factor, right).reshape(expected.shape), expected, rtol=1e-9, atol=1e-9
    )
    tiled = inverse.reshape(frames, size, frames, size)
    blocks = banded.inverse_blocks(factor)
    np.testing.assert_allclose(blocks, np.einsum("titj->tij", tiled), rtol=1e-9, atol=1e-9)


def test_inverse_blocks_stay_exact_over_long_stiff_trajectories():
    rng = np.random.default_rng(0)
    frames, size, points = 300, 5, 9
    jacobian = rng.normal(size=(points, size)) + 0.3 * rng.normal(size=(frames, points, size))
    prior = smoothness(np.arange(frames) / 240, np.full(points, 0.5))
    rows = prior.block_rows(jacobian)
    rows[:, :, :size] += 100 * np.eye(size)
    factor = banded.factorise(rows)
    blocks = banded.inverse_blocks(factor)
    for frame in (0, 100, 200, 299):
        unit = np.zeros((frames, size, size))
        unit[frame] = np.eye(size)
        expected = banded.solve_factored(factor, unit)[frame]
        np.testing.assert_allclose(blocks[frame], expected, rtol=1e-6, atol=1e-9)


def test_inverse_blocks_of_a_long_trajectory_take_little_more_than_themselves():
    frames, size, reach = 2000, 12, 2
    rows = np.zeros((frames, size, (reach + 1) * size))
    rows[:, :, :size] = np.eye(size)
    factor = banded.factorise(rows)
    tracemalloc.start()
    blocks = banded.inverse_blocks(factor)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_allclose(blocks, np.broadcast_to(np.eye(size), blocks.shape))
    assert most < 1.5 * blocks.nbytes
