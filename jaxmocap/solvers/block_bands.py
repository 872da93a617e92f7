"""Symmetric block-banded systems on the device: T frames of N unknowns, each tied to the next two.

The same systems as ``banded`` solves on the host, inside jit and vmap, and differentiable by the
right-hand side: two frames make one block of a block-tridiagonal Cholesky factor, found by a scan.

INPUTS: blocks, a right-hand side. OUTPUTS: the solution.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jax.scipy.linalg import solve_triangular

from jaxmocap.solvers.sdls import HIGHEST


class BlockBands(NamedTuple):
    """The upper blocks of a symmetric matrix.

    Attributes:
        own: (T, N, N) of a frame with itself.
        next: (T, N, N) with the frame after it; the last is not read.
        second: (T, N, N) with the one after that; the last two are not read.
    """

    own: Array
    next: Array
    second: Array


def solve_block_banded(matrix: BlockBands, right: Array) -> Array:
    """The x (T, N) with ``matrix x = right``; not finite where the matrix is not positive definite.

    Args:
        matrix: positive definite.
        right: (T, N).
    """
    diagonal, across = _in_pairs(matrix)
    size, pairs = right.shape, len(diagonal)
    halves = jnp.zeros((2 * pairs, size[1]), right.dtype).at[: size[0]].set(right)

    def eliminate(carry: tuple[Array, Array], block: tuple) -> tuple[tuple[Array, Array], tuple]:
        left, carried = carry
        own, beyond, value = block
        L = jnp.linalg.cholesky(own - jnp.matmul(left.T, left, precision=HIGHEST))
        W = solve_triangular(L, beyond, lower=True)
        y = solve_triangular(L, value - carried, lower=True)
        return (W, jnp.matmul(W.T, y, precision=HIGHEST)), (L, W, y)

    def substitute(x: Array, block: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        L, W, y = block
        x = solve_triangular(L, y - jnp.matmul(W, x, precision=HIGHEST), lower=True, trans=1)
        return x, x

    values = halves.reshape(pairs, -1)
    nothing = jnp.zeros_like(values[0])
    first = jnp.zeros_like(diagonal[0]), nothing
    _, factor = jax.lax.scan(eliminate, first, (diagonal, across, values))
    _, solution = jax.lax.scan(substitute, nothing, factor, reverse=True)
    return solution.reshape(halves.shape)[: size[0]]


def _in_pairs(matrix: BlockBands) -> tuple[Array, Array]:
    """Blocks (P, 2N, 2N) of pairs of frames with themselves and with the next pair.

    A frame that fills up the last pair is tied to nothing.
    """
    frames, size = matrix.own.shape[:2]
    pairs, eye = (frames + 1) // 2, jnp.eye(size, dtype=matrix.own.dtype)
    spare = 2 * pairs - frames
    row = jnp.arange(frames)[:, None, None]
    after = jnp.where(row < frames - 1, matrix.next, 0.0)
    beyond = jnp.where(row < frames - 2, matrix.second, 0.0)
    own = jnp.concatenate([matrix.own, jnp.broadcast_to(eye, (spare, size, size))])
    after, beyond = (
        jnp.concatenate([part, jnp.zeros((spare, size, size), part.dtype)])
        for part in (after, beyond)
    )
    diagonal = jnp.block([[own[0::2], after[0::2]], [after[0::2].swapaxes(1, 2), own[1::2]]])
    across = jnp.block([[beyond[0::2], jnp.zeros_like(beyond[0::2])], [after[1::2], beyond[1::2]]])
    return diagonal, across
