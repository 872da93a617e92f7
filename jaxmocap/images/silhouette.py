"""How well drawn limbs cover what a camera saw of them: soft coverage against a probability.

The coverage of a cell is that of the limb which reaches farthest over it. Its derivative by a limb
needs six numbers only, where its two discs are and how large, so that the normal equations of a
whole body cost little more than its picture.

INPUTS: limbs as discs in cells of a grid, the grid's probabilities and weights.
OUTPUTS: the sum of squares, and its Gauss-Newton terms by the limbs' discs.
"""

from functools import partial
from typing import NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.geometry.outlines import Discs, Touch, touch
from jaxmocap.geometry.rotations import HIGHEST

# Of a limb: near x, y; far x, y; near and far radius.
OUTLINE_NUMBERS = 6


class Grid(NamedTuple):
    """What was seen on S x S cells.

    Attributes:
        probability: (..., S, S) that the cell shows the limbs, 0 to 1.
        weight: (..., S, S) how much the cell tells; 0 where nothing is known.
    """

    probability: Array | np.ndarray
    weight: Array | np.ndarray


def blurred(grid: Grid, softness: float) -> Grid:
    """Grids (V, S, S) seen as softly as they are drawn; on the host.

    What is seen is averaged by weight, and so is the weight.
    """

    def blur(values: np.ndarray) -> np.ndarray:
        way = cv2.BORDER_REPLICATE
        return cv2.GaussianBlur(values, (0, 0), float(softness), borderType=way)

    seen, weight = (np.array(part) for part in grid)
    for p, w in zip(seen, weight, strict=True):
        p[:], w[:] = blur(p * w), blur(w)
    return Grid(seen / np.maximum(weight, 1e-3), weight)


class CoverageFit(NamedTuple):
    """Sum of squared differences over K limbs, about their present places.

    Attributes:
        cost: () r^T r.
        hessian: (K, 6, 6) J^T J; limbs do not share cells, so there is nothing between them.
        gradient: (K, 6) J^T r.
    """

    cost: Array
    hessian: Array
    gradient: Array


def cells(size: int, dtype: jnp.dtype) -> tuple[Array, Array]:
    """Coordinates x and y (S * S,) of a grid's cells, row by row."""
    axis = jnp.arange(size, dtype=dtype)
    y, x = jnp.meshgrid(axis, axis, indexing="ij")
    return x.ravel(), y.ravel()


def frontmost(limbs: Discs, size: int) -> tuple[Array, Touch]:
    """For each of S * S cells: the limb that reaches farthest over it, and how it touches.

    Args:
        limbs: K, in cells.
        size: S.
    """
    x, y = cells(size, limbs.near.dtype)

    def nearer(best: tuple[Array, Touch], limb: tuple[Array, Discs]) -> tuple:
        index, discs = limb
        other = touch(discs, x, y)
        closer = other.distance < best[1].distance
        found = jax.tree.map(partial(jnp.where, closer), other, best[1])
        return (jnp.where(closer, index, best[0]), found), None

    # Limb by limb: picking each cell's limb out of a list takes four times as long.
    nothing, far = jnp.zeros_like(x), jnp.full_like(x, jnp.inf)
    start = jnp.zeros(x.shape, jnp.int32), Touch(nothing, far, nothing, nothing)
    indices = jnp.arange(len(limbs.near), dtype=jnp.int32)
    (nearest, at), _ = jax.lax.scan(nearer, start, (indices, limbs))
    return nearest, at


def coverage_cost(
    limbs: Discs, grid: Grid, softness: Array | float, visible: Array | float = 1.0
) -> Array:
    """The sum of squared weighted differences between coverage and probability.

    Args:
        limbs: K, in cells.
        grid: (S, S).
        softness: cells over which a limb's border fades.
        visible: (S * S,) share of a limb's coverage that nothing hides.
    """
    size = grid.probability.shape[-1]
    x, y = cells(size, limbs.near.dtype)
    each = Discs(*(part[:, None] for part in limbs))
    coverage = jax.nn.sigmoid(-jnp.min(touch(each, x, y).distance, 0) / softness)
    return jnp.sum(_residuals(grid, coverage * visible) ** 2)


def coverage_fit(
    limbs: Discs, grid: Grid, softness: Array | float, visible: Array | float = 1.0
) -> CoverageFit:
    """The same with its Gauss-Newton terms; see ``coverage_cost``."""
    size, count = grid.probability.shape[-1], limbs.near.shape[0]
    nearest, at = frontmost(limbs, size)
    coverage = jax.nn.sigmoid(-at.distance / softness)
    residuals = _residuals(grid, coverage * visible)
    slope = -coverage * (1 - coverage) / softness * visible * grid.weight.ravel()
    near, far = 1 - at.along, at.along
    rows = slope * -jnp.stack(
        [near * at.normal_x, near * at.normal_y, far * at.normal_x, far * at.normal_y, near, far]
    )
    # Sums by limb as products with 0 and 1: a scatter is many times slower.
    owner = (jnp.arange(count, dtype=jnp.int32)[:, None] == nearest).astype(rows.dtype)
    squares = (rows[:, None] * rows[None]).reshape(OUTLINE_NUMBERS**2, -1)
    hessian = jnp.matmul(owner, squares.T, precision=HIGHEST)
    gradient = jnp.matmul(owner, (rows * residuals).T, precision=HIGHEST)
    return CoverageFit(
        jnp.sum(residuals**2),
        hessian.reshape(count, OUTLINE_NUMBERS, OUTLINE_NUMBERS),
        gradient,
    )


def _residuals(grid: Grid, coverage: Array) -> Array:
    return (coverage - grid.probability.ravel()) * grid.weight.ravel()
