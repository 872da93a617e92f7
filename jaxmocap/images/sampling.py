"""Bilinear look-up of fields.

INPUTS: fields (C, H, W), channels and coordinates (x right, y down). OUTPUTS: values.
"""

import jax.numpy as jnp
from jax import Array


def look_up(fields: Array, channels: Array, points_x: Array, points_y: Array) -> Array:
    """Values (...) of (C, H, W) fields at points (...) of channels, which may be broadcast.

    Bilinear; outside, the border's value. Differentiable by the points.
    """
    _, height, width = fields.shape
    x = jnp.clip(points_x, 0, width - 1.001)
    y = jnp.clip(points_y, 0, height - 1.001)
    x0, y0 = jnp.floor(x), jnp.floor(y)
    fx, fy = x - x0, y - y0
    corner = (channels * height + y0.astype(jnp.int32)) * width + x0.astype(jnp.int32)
    # Never out of bounds: nothing need be asked at every look-up.
    flat = fields.ravel().at
    at, next_to, below, across = (
        flat[corner + step].get(mode="promise_in_bounds", wrap_negative_indices=False)
        for step in (0, 1, width, width + 1)
    )
    top = at * (1 - fx) + next_to * fx
    bottom = below * (1 - fx) + across * fx
    return top * (1 - fy) + bottom * fy
