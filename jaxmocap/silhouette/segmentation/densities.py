"""How likely a region's pixels are: histograms, a learned background, normals about local means.

INPUTS: colours on a canvas, how far each cell belongs to a region. OUTPUTS: densities, per grey
level or cubic grey level.
"""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.images.colours import LEVELS, lit_or_shaded_density

# Bins of a histogram of grey levels.
GREYS = 64
# Deviations of the Gaussian kernels that smooth either, bins.
GREY_BLUR = 1.5
COLOUR_BLUR = 0.5
# Every colour has this share of the even distribution: what was never observed is not impossible.
EVEN_SHARE = 1e-3
# OpenCV's weights of blue, green and red.
LUMINANCE = (0.114, 0.587, 0.299)
# Histograms are counted on one cell in so many of one row in so many.
COUNT_STRIDE = 2


def grey_bins(colour: Array) -> Array:
    """Histogram bin (...) of BGR colours (V, 3, S, S)."""
    blue, green, red = (share * colour[:, i] for i, share in enumerate(LUMINANCE))
    return ((blue + green + red) * (GREYS / 256)).astype(jnp.int32)


def joint_bins(colour: Array) -> Array:
    """Joint histogram bin (...) of BGR colours (V, 3, S, S)."""
    levels = (colour * (LEVELS / 256)).astype(jnp.int32)
    return (levels[:, 0] * LEVELS + levels[:, 1]) * LEVELS + levels[:, 2]


def histogram_counts(bins: Array, weights: Array, count: int) -> Array:
    """Histograms (V, count), not smoothed, of weighted bins (V, S, S)."""

    def one(bins: Array, weights: Array) -> Array:
        return jnp.zeros(count, weights.dtype).at[bins.ravel()].add(weights.ravel())

    return jax.vmap(one)(
        bins[:, ::COUNT_STRIDE, ::COUNT_STRIDE], weights[:, ::COUNT_STRIDE, ::COUNT_STRIDE]
    )


def grey_density(counts: Array) -> Array:
    """Counts (V, GREYS) as densities per grey level, smoothed."""
    smoothed = jnp.matmul(counts, jnp.asarray(_kernel(GREYS, GREY_BLUR)), precision=HIGHEST)
    return _share(smoothed) * (GREYS / 256)


def colour_density(counts: Array) -> Array:
    """Counts (V, LEVELS³) as densities per cubic grey level, smoothed along each channel."""
    kernel = jnp.asarray(_kernel(LEVELS, COLOUR_BLUR))
    cube = counts.reshape(-1, LEVELS, LEVELS, LEVELS)
    each = (cube, kernel, kernel, kernel)
    smoothed = jnp.einsum("vabc,ai,bj,ck->vijk", *each, precision=HIGHEST)
    return _share(smoothed.reshape(counts.shape)) * (LEVELS / 256) ** 3


def _share(smoothed: Array) -> Array:
    total = jnp.sum(smoothed, -1, keepdims=True)
    bins = smoothed.shape[-1]
    share = jnp.where(total > 0, smoothed / jnp.where(total > 0, total, 1.0), 1 / bins)
    return (1 - EVEN_SHARE) * share + EVEN_SHARE / bins


def lookup(density: Array, bins: Array) -> Array:
    """Density (V, B) of the bin of every cell (V, S, S)."""
    return jax.vmap(lambda table, places: table[places])(density, bins)


def background_density(colour: Array, background: Array, noise: Array) -> Array:
    """``lit_or_shaded_density`` (V, S, S) of colours (V, 3, S, S) before a background's."""
    pairs = (colour, colour), (colour, background), (background, background)
    squared, product, expected = (jnp.sum(a * b, 1) for a, b in pairs)
    return lit_or_shaded_density(squared, product, expected, noise, jnp.exp)


@lru_cache
def _kernel(bins: int, sigma: float) -> np.ndarray:
    """(bins, bins) Gaussian smoothing of a histogram; what would leave it stays in it."""
    i = np.arange(bins)
    kernel = np.exp(-0.5 * ((i[:, None] - i) / sigma) ** 2)
    return (kernel / kernel.sum(1, keepdims=True)).astype(np.float32)
