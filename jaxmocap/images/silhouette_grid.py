"""How well drawn limbs cover what a camera saw of them: soft coverage against a probability.

The coverage of a cell is that of the limb which reaches farthest over it. Its derivative by a limb
needs six numbers only, where its two discs are and how large, so that the normal equations of a
whole body cost little more than its picture.

INPUTS: limbs as discs in cells of a grid, the grid's probabilities and weights.
OUTPUTS: the sum of squares, and its Gauss-Newton terms by the limbs' discs.
"""

from typing import NamedTuple

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.compilation.arrays import Numbers, namespace
from jaxmocap.geometry.outlines import Discs, Swept, Touch, swept, touch_swept
from jaxmocap.geometry.rotations import HIGHEST

# Of a limb: near x, y; far x, y; near and far radius.
OUTLINE_NUMBERS = 6
# Limbs that are numbered by as many bits as are there anyway; of more the number takes more bits.
FEW_LIMBS = 32


class Grid(NamedTuple):
    """A measured silhouette on S x S cells."""

    probability: Array | np.ndarray  # (..., S, S) that the cell shows the limbs, 0 to 1
    weight: Array | np.ndarray  # (..., S, S) how much the cell counts; 0 where nothing was measured


def blur_grid(grid: Grid, softness: float) -> Grid:
    """Grids (V, S, S) blurred as softly as the body is drawn; on the host.

    The probability is averaged by weight, and so is the weight.
    """

    def blur(values: np.ndarray) -> np.ndarray:
        way = cv2.BORDER_REPLICATE
        return cv2.GaussianBlur(values, (0, 0), float(softness), borderType=way)

    probability, weight = (np.array(part) for part in grid)
    for p, w in zip(probability, weight, strict=True):
        p[:], w[:] = blur(p * w), blur(w)
    return Grid(probability / np.maximum(weight, 1e-3), weight)


def halve_grid(grid: Grid) -> Grid:
    """Grids (..., S, S) of half as many cells to a side; each counts as the four that it was."""
    of = namespace(grid.weight)

    def mean(values: Array | np.ndarray) -> Numbers:
        *batch, size, _ = values.shape
        return of.reshape(values, (*batch, size // 2, 2, size // 2, 2)).mean((-3, -1))

    weight = mean(grid.weight)
    probability = mean(grid.probability * grid.weight) / of.maximum(weight, 1e-3)
    return Grid(probability, 2 * weight)


class CoverageFit(NamedTuple):
    """Sum of squared differences over K limbs, about their present places."""

    cost: Array  # () r^T r
    hessian: Array  # (K, 6, 6) J^T J; limbs do not share cells, so there is nothing between them
    gradient: Array  # (K, 6) J^T r


def cells(size: int, dtype: jnp.dtype) -> tuple[Array, Array]:
    """Coordinates x and y (S * S,) of a grid's cells, row by row."""
    axis = jnp.arange(size, dtype=dtype)
    y, x = jnp.meshgrid(axis, axis, indexing="ij")
    return x.ravel(), y.ravel()


def distances(limbs: Discs, size: int) -> Array:
    """From S * S cells to the outlines of K limbs, (K, S * S) cells, negative inside.

    In their last bits, which no picture shows, stands the limb's number, so that a minimum over
    limbs gives its limb as well: many times faster than looking for it.
    """
    x, y = cells(size, limbs.near.dtype)
    away = touch_swept(Swept(*(part[:, None] for part in swept(limbs))), x, y).distance
    integer, last = _numbering(away)
    limb = jnp.arange(len(away), dtype=integer)[:, None]
    bits = jax.lax.bitcast_convert_type(jax.lax.stop_gradient(away), integer)
    return jax.lax.bitcast_convert_type((bits & ~last) | limb, away.dtype)


def _numbering(away: Array) -> tuple[jnp.dtype, int]:
    bits = (max(FEW_LIMBS, len(away)) - 1).bit_length()
    return jnp.dtype(f"int{8 * away.dtype.itemsize}"), (1 << bits) - 1


def frontmost(limbs: Discs, size: int) -> tuple[Array, Touch]:
    """For each of S * S cells: the limb that reaches farthest over it, and how it touches.

    Args:
        limbs: K, in cells.
        size: S.
    """
    away = distances(limbs, size)
    integer, last = _numbering(away)
    bits = jax.lax.bitcast_convert_type(jnp.min(away, 0), integer)
    nearest = (bits & last).astype(jnp.int32)
    each = jnp.stack(swept(limbs))
    own = each.at[:, nearest].get(mode="promise_in_bounds", wrap_negative_indices=False)
    return nearest, touch_swept(Swept(*own), *cells(size, away.dtype))


def coverage_fit(
    limbs: Discs, grid: Grid, softness: Array | float, visible: Array | float = 1.0
) -> CoverageFit:
    """The sum of squared weighted differences between coverage and probability, and its terms.

    Args:
        limbs: K, in cells.
        grid: (S, S).
        softness: cells over which a limb's border fades.
        visible: (S * S,) share of a limb's coverage that nothing hides.
    """
    nearest, at = frontmost(limbs, grid.probability.shape[-1])
    coverage = jax.nn.sigmoid(-at.distance / softness)
    residuals = (coverage * visible - grid.probability.ravel()) * grid.weight.ravel()
    slope = -coverage * (1 - coverage) / softness * visible * grid.weight.ravel()
    squared, pull = slope**2, slope * residuals
    x, y, far = at.normal_x, at.normal_y, at.along
    # A cell's row is -slope times (x, y, 1), once by how near it is to the near disc and once by
    # how near to the far one: few of the products are different, as x^2 + y^2 is 1.
    of_two = [squared * each for each in (x * x, x * y, x, y)] + [squared]
    of_one = [-pull * each for each in (x, y)] + [-pull]
    sums = [each * power for each in of_two for power in (1.0, far, far**2)]
    sums += [each * power for each in of_one for power in (1.0, far)]
    # Sums by limb as products with 0 and 1: a scatter is many times slower.
    owner = jnp.arange(len(limbs.near), dtype=nearest.dtype)[:, None] == nearest
    by_limb = jnp.matmul(jnp.stack(sums), owner.astype(far.dtype).T, precision=HIGHEST).T
    of_two, of_one = (jnp.asarray(each, far.dtype) for each in (OF_TWO, OF_ONE))
    hessian = jnp.matmul(by_limb[:, :15], of_two, precision=HIGHEST)
    gradient = jnp.matmul(by_limb[:, 15:], of_one, precision=HIGHEST)
    shape = -1, OUTLINE_NUMBERS, OUTLINE_NUMBERS
    return CoverageFit(jnp.sum(residuals**2), hessian.reshape(shape), gradient)


def _expansion() -> tuple[np.ndarray, np.ndarray]:
    """What Hessians (15, 6 * 6) and gradients (6, 6) are made of, of the sums in ``coverage_fit``.

    A limb's number moves a cell's row along x, y or 1, by 1 - far or by far.
    """
    numbers = [(0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (2, 1)]
    shares = np.array([[1, -1], [0, 1]])
    x, y, one, xx, xy = np.eye(5)[[2, 3, 4, 0, 1]]
    products = [[xx, xy, x], [xy, one - xx, y], [x, y, one]]
    of_two, of_one = np.zeros((15, 6, 6)), np.zeros((6, 6))
    for i, (a, near) in enumerate(numbers):
        of_one[:, i] = np.outer(np.eye(3)[a], shares[near]).ravel()
        for j, (b, far) in enumerate(numbers):
            powers = np.convolve(shares[near], shares[far])
            of_two[:, i, j] = np.outer(products[a][b], powers).ravel()
    return of_two.reshape(15, -1), of_one


OF_TWO, OF_ONE = _expansion()
