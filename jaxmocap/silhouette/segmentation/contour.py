"""Contours: points on the zero level of Φ, below a pixel, with outward normals.

Where Φ changes its sign between two neighbouring cells, linear interpolation gives a point. Of all
of them a static number is taken, evenly over the canvas's rows with a jitter within each share, so
that no limb is left out by a stride that happens to fit.

INPUTS: Φ (V, S, S) and log-ratios on canvases, and where these lie in the images.
OUTPUTS: Contours, in image pixels.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.images.regions import Region
from jaxmocap.images.sampling import look_up

# Where the contrast is taken, cells to either side.
ASIDE = 2.0
# An irrational step: where within its share of the crossings a point lies.
GOLDEN = 0.6180339887498949


class Contours(NamedTuple):
    """N points on the silhouette in each of V images."""

    points_xy: Array  # (V, N, 2) pixels
    normals: Array  # (V, N, 2) unit vectors, out of the person
    contrast: Array  # (V, N) 0 to 1: how clearly its two sides differ in the image
    valid: Array  # (V, N) bool; false where there is no point, or only the image's border


@partial(jax.jit, static_argnames="count")
def contours(
    phi: Array, log_ratio: Array, inside: Array, region: Region, count: int, most: float = 3.0
) -> Contours:
    """The zero levels of V canvases, ``count`` points each; all but the region are (V, S, S).

    ``inside`` is the share of each cell within the image; log-ratios were cut off at ``most``.
    """
    one = partial(_one, count=count, most=most)
    return jax.vmap(one)(phi, log_ratio, jnp.asarray(inside), Region(*map(jnp.asarray, region)))


def _one(
    phi: Array, log_ratio: Array, inside: Array, region: Region, count: int, most: float
) -> Contours:
    chosen, total = _crossings(phi, count)
    origin, scale = jnp.asarray(region.origin), jnp.asarray(region.scale)
    row, column, downward = chosen
    here, there = phi[row, column], phi[row + downward, column + 1 - downward]
    share = here / jnp.where(here == there, 1.0, here - there)
    down = downward.astype(phi.dtype)
    y = row.astype(phi.dtype) + share * down
    x = column.astype(phi.dtype) + share * (1 - down)
    slope_x = (_sample_values(phi, x + 1, y) - _sample_values(phi, x - 1, y)) / 2
    slope_y = (_sample_values(phi, x, y + 1) - _sample_values(phi, x, y - 1)) / 2
    steepness = jnp.sqrt(slope_x**2 + slope_y**2 + 1e-12)
    out_x, out_y = -slope_x / steepness, -slope_y / steepness
    jump = _sample_values(log_ratio, x - ASIDE * out_x, y - ASIDE * out_y)
    jump -= _sample_values(log_ratio, x + ASIDE * out_x, y + ASIDE * out_y)
    within = _sample_values(inside, x + ASIDE * out_x, y + ASIDE * out_y) > 0.99
    cells = jnp.stack([x, y], -1)
    return Contours(
        origin + (cells + 0.5) * scale,
        jnp.stack([out_x, out_y], -1),
        jnp.clip(jump / (2 * most), 0.0, 1.0),
        (jnp.arange(count) < total) & within,
    )


def _crossings(phi: Array, count: int) -> tuple[tuple[Array, Array, Array], Array]:
    """Row, column and direction (N,) (1: down, 0: right) of some sign changes; and of how many."""
    positive = phi > 0
    across = jnp.pad(positive[:, :-1] != positive[:, 1:], ((0, 0), (0, 1)))
    down = jnp.pad(positive[:-1] != positive[1:], ((0, 1), (0, 0)))
    both = jnp.concatenate([across, down], 1).astype(jnp.int32)
    by_row = jnp.sum(both, 1)
    ends = jnp.cumsum(by_row)
    total = ends[-1]
    step = jnp.maximum(total.astype(phi.dtype) / count, 1.0)
    numbers = np.arange(count, dtype=np.float32)
    jitter = jnp.where(step > 1, jnp.asarray(numbers * np.float32(GOLDEN) % 1), 0.5)
    rank = jnp.floor((jnp.asarray(numbers) + jitter) * step)
    rank = jnp.minimum(rank.astype(jnp.int32), total - 1)
    row = jnp.minimum(jnp.searchsorted(ends, rank, side="right"), len(phi) - 1)
    within_row = rank - (ends - by_row)[row]
    reached = jnp.cumsum(both[row], 1) > within_row[:, None]
    place = jnp.argmax(reached, 1)
    size = phi.shape[1]
    return (row, place % size, (place >= size).astype(row.dtype)), total


def _sample_values(values: Array, x: Array, y: Array) -> Array:
    """Values (S, S) between cells at places (N,); beyond the border they are replicated."""
    return look_up(values[None], jnp.zeros((), jnp.int32), x, y)
