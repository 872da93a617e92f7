"""Bilinear look-up of fields.

INPUTS: fields (C, H, W), channels and coordinates (x right, y down). OUTPUTS: values.
"""

import jax.numpy as jnp
from jax import Array


def bilinear(fields: Array, channels: Array, points_xy: Array) -> Array:
    """Values (...) of (C, H, W) fields at (..., 2) points of the (...) channels.

    Outside, the border's value. Differentiable by the points; the derivative is that of the
    bilinear patch.
    """
    _, height, width = fields.shape
    x = jnp.clip(points_xy[..., 0], 0, width - 1.001)
    y = jnp.clip(points_xy[..., 1], 0, height - 1.001)
    x0, y0 = jnp.floor(x), jnp.floor(y)
    fx, fy = x - x0, y - y0
    corner = (channels * height + y0.astype(jnp.int32)) * width + x0.astype(jnp.int32)
    flat = fields.ravel()
    top = flat[corner] * (1 - fx) + flat[corner + 1] * fx
    bottom = flat[corner + width] * (1 - fx) + flat[corner + width + 1] * fx
    return top * (1 - fy) + bottom * fy
