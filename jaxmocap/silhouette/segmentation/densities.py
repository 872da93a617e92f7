"""How likely a region's pixels are: histograms, a known background, normals about local means.

INPUTS: colours on a canvas, how far each cell belongs to a region. OUTPUTS: densities, per grey
level or cubic grey level.
"""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

# Bins of a histogram of grey levels.
GREYS = 64
# Bins of each of three channels in a joint histogram.
LEVELS = 16
# Deviations of the Gaussian kernels that smooth either, bins.
GREY_BLUR = 1.5
COLOUR_BLUR = 0.5
# Every colour has this share of the even distribution: what was never seen is not impossible.
EVEN_SHARE = 1e-3
# OpenCV's weights of blue, green and red.
LUMINANCE = (0.114, 0.587, 0.299)
# Histograms are counted on one cell in so many of one row in so many.
COUNT_STRIDE = 2
# Share of the background that lies in shadow.
SHADED_SHARE = 0.05
# Light that is left there, at least.
DARKEST_SHADOW = 0.6
# Exponents of a normal density are cut off here, so that it stays above 0.
LARGEST_EXPONENT = 60.0


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
    smoothed = counts @ jnp.asarray(_kernel(GREYS, GREY_BLUR))
    return _share(smoothed) * (GREYS / 256)


def colour_density(counts: Array) -> Array:
    """Counts (V, LEVELS³) as densities per cubic grey level, smoothed along each channel."""
    kernel = jnp.asarray(_kernel(LEVELS, COLOUR_BLUR))
    cube = counts.reshape(-1, LEVELS, LEVELS, LEVELS)
    smoothed = jnp.einsum("vabc,ai,bj,ck->vijk", cube, kernel, kernel, kernel)
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
    """Density (V, S, S), per cubic grey level, of colours (V, 3, S, S) before the background.

    The background is lit or in shadow: normal about its colour; or, in shadow, evenly on the way
    from there towards black as far as ``DARKEST_SHADOW``, and normal across it, as
    ``images.foreground`` has it on the host.
    """
    squared, product = jnp.sum(background * background, 1) + 1, jnp.sum(colour * background, 1)
    colour_squared = jnp.sum(colour * colour, 1)
    lit = jnp.clip(product / squared, DARKEST_SHADOW, 1)
    across = colour_squared - lit * (2 * product - lit * squared)
    away = colour_squared - 2 * product + squared
    precision = 0.5 / noise**2
    planar = precision / jnp.pi
    plain = jnp.exp(-jnp.minimum(away * precision, LARGEST_EXPONENT))
    plain = planar * jnp.sqrt(planar) * plain
    length = (1 - DARKEST_SHADOW) * jnp.sqrt(squared)
    shaded = planar / length * jnp.exp(-jnp.minimum(across * precision, LARGEST_EXPONENT))
    return (1 - SHADED_SHARE) * plain + SHADED_SHARE * shaded


@lru_cache
def _kernel(bins: int, sigma: float) -> np.ndarray:
    """(bins, bins) Gaussian smoothing of a histogram; what would leave it stays in it."""
    i = np.arange(bins)
    kernel = np.exp(-0.5 * ((i[:, None] - i) / sigma) ** 2)
    return (kernel / kernel.sum(1, keepdims=True)).astype(np.float32)
