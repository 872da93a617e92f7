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


def look_up_smoothly(fields: Array, turns: Array, points_x: Array, points_y: Array) -> Array:
    """Values (...) of (C, H, W) fields, whose slope is continuous in all of points and turns.

    By quadratic B-splines over the pixels, and from one channel to the next by a cubic, around:
    what is minimised has its minimum where the slope vanishes, and not in a kink.

    Args:
        fields: (C, H, W); channel c is of turns around c + 0.5.
        turns: (...) from 0 to C; C is 0 again.
        points_x: (...) coordinates; from the second pixel outwards, the value there.
        points_y: (...) likewise.
    """
    count, height, width = fields.shape
    (x0, x_shares), (y0, y_shares) = (
        _three_shares(jnp.clip(points, 1, size - 2.001))
        for points, size in ((points_x, width), (points_y, height))
    )
    before = jnp.floor(turns - 0.5)
    f = turns - 0.5 - before
    after = f * f * (3 - 2 * f)
    channels = jnp.mod(jnp.stack([before, before + 1]).astype(jnp.int32), count)
    rows, columns = (jnp.stack([first, first + 1, first + 2]) for first in (y0, x0))
    corners = (channels[:, None, None] * height + rows[:, None]) * width + columns
    by_channel = jnp.stack([1 - after, after])
    shares = by_channel[:, None, None] * y_shares[:, None] * x_shares
    # All at one go: unrolled, each of eighteen look-ups is differentiated by itself.
    values = fields.ravel().at[corners].get(mode="promise_in_bounds", wrap_negative_indices=False)
    return jnp.sum(shares * values, (0, 1, 2))


def _three_shares(points: Array) -> tuple[Array, Array]:
    """The first of three pixels (...) around points (...), and a quadratic B-spline's shares."""
    middle = jnp.floor(points + 0.5)
    f = points - middle
    shares = jnp.stack([(0.5 - f) ** 2 / 2, 0.75 - f**2, (0.5 + f) ** 2 / 2])
    return middle.astype(jnp.int32) - 1, shares
