"""Points over the area of projected limbs, so that a sum over pixels becomes a sum over few points.

An integral over a hull of two discs is that over its middle, between the tangents' ends, and over
both round ends. The points move with the hull: the sum's derivative is the integral's, which is one
along the outline.

INPUTS: hulls, as in ``outlines``. OUTPUTS: points with the area that each stands for.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.geometry.outlines import hull_axes

# Points of a half disc, x along the axis: their means and mean squares are the half disc's. None
# lies on the axis, from where the outline's nearest place leaps as the point moves.
END_POINTS = np.array([[0.1600, 0.5700], [0.1600, -0.5700], [0.6888, 0.4187], [0.6888, -0.4187]])


class Areas(NamedTuple):
    """Points over hulls, by components: the K points of each come first."""

    x: Array  # (K, ...)
    y: Array  # (K, ...)
    weights: Array  # (K, ...) the area that each point stands for, in the plane's unit squared


def area_points(x: Array, y: Array, radii: Array, along: int, across: int) -> Areas:
    """``along * across`` points over each hull's middle, and four over either round end.

    Args:
        x: (2, ...) of the discs' centres, near and far.
        y: (2, ...).
        radii: (2, ...), of as many axes.
        along: points along the axis.
        across: points from side to side; an even number, so that none lies on the axis.
    """
    u_x, u_y, length, sine = hull_axes(x, y, radii)
    cosine = jnp.sqrt(1 - sine**2)

    def placed(row: Array, ahead: Array, aside: Array) -> tuple[Array, Array]:
        """Places (...) ahead and aside of the centre at a share of the axis."""
        centre = [(1 - row) * ends[0] + row * ends[1] for ends in (x, y)]
        return centre[0] + ahead * u_x - aside * u_y, centre[1] + ahead * u_y + aside * u_x

    def column(values: np.ndarray) -> Array:
        return jnp.asarray(values, x.dtype).reshape(-1, *(1,) * (x.ndim - 1))

    grid = np.meshgrid((np.arange(along) + 0.5) / along, (np.arange(across) + 0.5) / across)
    row, side = column(grid[0]), column(2 * grid[1] - 1)
    radius = (1 - row) * radii[0] + row * radii[1]
    middle = placed(row, radius * sine, radius * side * cosine)
    share = 2 * length * radius * cosine**3 / (along * across)
    parts = [(*middle, jnp.broadcast_to(share, middle[0].shape))]
    for end, way in ((0, -1), (1, 1)):
        # The round end begins where the tangents touch: there its chord crosses the axis.
        chord = way * sine
        ahead = chord + (1 - chord) * column(END_POINTS[:, 0])
        aside = jnp.sqrt(1 - jnp.maximum(chord, 0) ** 2) * column(END_POINTS[:, 1])
        r = radii[end]
        place = placed(jnp.asarray(float(end), x.dtype), way * r * ahead, r * aside)
        area = r**2 * (jnp.arccos(chord) - chord * cosine)
        parts.append((*place, jnp.broadcast_to(area / len(END_POINTS), place[0].shape)))
    return Areas(*(jnp.concatenate(part) for part in zip(*parts, strict=True)))
