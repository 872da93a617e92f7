"""Symmetric positive definite systems whose blocks reach a few frames on, in float64 on the host.

T frames of N unknowns each. The matrix is kept as its upper block rows (T, N, (r + 1) N): row t
holds the blocks (t, t), (t, t + 1) to (t, t + r) side by side; what reaches past the last frame is
ignored.

INPUTS: block rows, right-hand sides. OUTPUTS: solutions, blocks of the inverse.
"""

from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import as_strided
from scipy.linalg import cho_solve_banded, cholesky_banded

# Frames that are packed at a time: what the processor's cache holds.
FRAMES = 32
# LinAlgError, which ``factorise`` raises, by a name of ours.
NotPositiveDefinite = np.linalg.LinAlgError


class Factor(NamedTuple):
    """A Cholesky factor L of a banded matrix."""

    columns: np.ndarray  # (T * N, (r + 1) N) column i of L from its diagonal entry downwards
    frames: int  # T


def pack_band(rows: np.ndarray) -> np.ndarray:
    """The columns (T * N, (r + 1) N), from the diagonal down, of (T, N, (r + 1) N) block rows.

    Entry k of column i is the matrix's (i + k, i): LAPACK's lower band storage, transposed.
    """
    frames, size, width = rows.shape
    columns, padded = np.empty(rows.shape), np.zeros((min(frames, FRAMES), size, width + size))
    frame, row, column = padded.strides
    # Row b from its column b on.
    shifted = as_strided(padded, (len(padded), size, width), (frame, row + column, column))
    for first in range(0, frames, FRAMES):
        some = rows[first : first + FRAMES]
        padded[: len(some), :, :width] = some
        columns[first : first + FRAMES] = shifted[: len(some)]
    return columns.reshape(frames * size, width)


def unpack_band(columns: np.ndarray, frames: int) -> np.ndarray:
    """Block rows (T, N, (r + 1) N) of the upper triangle whose ``columns`` those are.

    The diagonal blocks have their upper triangles only.
    """
    width = columns.shape[1]
    size = len(columns) // frames
    padded = np.zeros((frames, size, width + size))
    padded[(slice(None), *_diagonals(size, width))] = columns.reshape(frames, size, width)
    return padded[:, :, :width]


def factorise(rows: np.ndarray, ridge: np.ndarray | float = 0.0) -> Factor:
    """The Cholesky factor of block rows (T, N, (r + 1) N) with ``ridge`` (T, N) on the diagonal.

    Raises:
        NotPositiveDefinite: where there is none.
    """
    columns = pack_band(rows)
    columns[:, 0] += np.broadcast_to(ridge, rows.shape[:2]).ravel()
    # The transposed view is in Fortran's order, so that LAPACK works in place.
    band = cholesky_banded(columns.T, overwrite_ab=True, lower=True, check_finite=False)
    return Factor(band.T, len(rows))


def solve_factored(factor: Factor, right: np.ndarray) -> np.ndarray:
    """Solutions (T, N, K) of K right-hand sides (T, N, K)."""
    if not right.size:
        return np.zeros(right.shape)
    flat = np.array(right.reshape(len(factor.columns), -1), order="F")
    band = (factor.columns.T, True)
    return cho_solve_banded(band, flat, overwrite_b=True, check_finite=False).reshape(right.shape)


def inverse_blocks(factor: Factor) -> np.ndarray:
    """Diagonal blocks (T, N, N) of the inverse, from the last frame to the first (Takahashi).

    Given what follows it, a frame is U times the next r frames plus noise that is independent of
    them; each block is a sum of positive parts, so that no variance can turn negative.
    """
    width = factor.columns.shape[1]
    size = len(factor.columns) // factor.frames
    blocks, reach = np.zeros((factor.frames, size, size)), width - size
    # Of a frame and what follows it.
    joint = np.zeros((width, width))
    for last in range(factor.frames, 0, -FRAMES):
        some = range(max(0, last - FRAMES), last)
        upper = unpack_band(factor.columns[some.start * size : last * size], len(some))
        own = np.linalg.inv(upper[:, :, :size])
        U, noise = own @ upper[:, :, size:], own @ own.swapaxes(1, 2)
        for frame in reversed(some):
            row = frame - some.start
            joint[size:, size:] = joint[:reach, :reach].copy()
            across = -U[row] @ joint[size:, size:]
            own_block = noise[row] - across @ U[row].T
            # What rounding leaves unsymmetric would grow threefold from frame to frame.
            blocks[frame] = joint[:size, :size] = (own_block + own_block.T) / 2
            joint[:size, size:], joint[size:, :size] = across, across.T
    return blocks


def _diagonals(size: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices (N, width) into a block row: row b from column b on."""
    row = np.arange(size)[:, None]
    return np.broadcast_to(row, (size, width)), row + np.arange(width)
