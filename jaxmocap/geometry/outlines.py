"""Outline and signed distance of projected limbs.

A limb is a sphere-swept cone. Seen by a camera, its two end spheres are two discs on the plane
z = 1, and the limb is their convex hull: two tangent lines and two arcs.

INPUTS: centres (camera frame, metres) and radii of the two spheres.
OUTPUTS: discs on the plane z = 1, outline points with the length that each stands for, signed
distances to the hull.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.geometry.cameras import NEAREST_M, normalise


class Discs(NamedTuple):
    """Two discs whose convex hull is a limb, on a plane (unitless at z = 1, or pixels)."""

    near: Array  # (..., 2) centre at the joint
    far: Array  # (..., 2) centre at the far end
    radii: Array  # (..., 2) of the two


def project_limb(near_cam: Array, far_cam: Array, radii: Array) -> Discs:
    """Discs on the plane z = 1 of spheres at (..., 3) camera points with (..., 2) radii, metres."""
    depths = jnp.stack([near_cam[..., 2], far_cam[..., 2]], -1)
    return Discs(normalise(near_cam), normalise(far_cam), radii / jnp.maximum(depths, NEAREST_M))


class Pieces(NamedTuple):
    """Both sides of the hull, or both ends' arcs, by components: the K points of each come first.

    Arrays of two are slow to work through, and those of the hulls are long. So a thousand hulls of
    a moment are a thousand numbers side by side.
    """

    x: Array  # (2, K, ...) of the points
    y: Array  # (2, K, ...)
    weights: Array  # (2, 1, ...) the length of outline that each point stands for
    normal_x: Array  # (2, 1, ...) or (2, K, ...) unit, outwards
    normal_y: Array  # the same


def outline_pieces(
    x: Array, y: Array, radii: Array, along: int, around: int, open_ends: Array
) -> tuple[Pieces, Pieces]:
    """The hulls' sides, left and right of the axis, and their arcs, near and far.

    An arc whose end is closed (0 in ``open_ends``; another limb goes on there) counts only as far
    as the limb points at the camera, when the arcs are all that is left of the outline.

    Args:
        x: (2, ...) of the discs' centres, near and far.
        y: (2, ...).
        radii: (2, ...), of as many axes.
        along: points on each side.
        around: points on each arc.
        open_ends: (2, ...) of as many axes, 1 where the near or far end is free, else 0.
    """

    def rows(values: Array | np.ndarray) -> Array:
        """(K) or (2, K) numbers against hulls of any shape."""
        shape = (*values.shape, *(1,) * (x.ndim - 1))
        return jnp.asarray(values, x.dtype).reshape(shape)

    u_x, u_y, distance, sine = hull_axes(x, y, radii)
    cosine = jnp.sqrt(1 - sine**2)
    aside = rows(np.array([[1.0], [-1.0]])) * cosine
    n_x, n_y = sine * u_x - aside * u_y, sine * u_y + aside * u_x
    t = rows((np.arange(along) + 0.5) / along)
    sides = Pieces(
        (1 - t) * (x[0] + radii[0] * n_x) + t * (x[1] + radii[1] * n_x),
        (1 - t) * (y[0] + radii[0] * n_y) + t * (y[1] + radii[1] * n_y),
        jnp.broadcast_to(distance * cosine / along, n_x.shape),
        n_x,
        n_y,
    )
    # The far arc spans the directions within pi/2 - taper of the axis, the near one the rest.
    half = jnp.arccos(sine)
    span = jnp.stack([jnp.pi - half, half])[:, None]
    nested = jnp.clip(1 - distance / (radii[0] + radii[1]), 0.0, 1.0)
    angle = rows((np.arange(around) + 0.5) / around * 2 - 1) * span
    # A single point of an arc lies on the axis.
    c, s = (jnp.cos(angle), jnp.sin(angle)) if around > 1 else (1.0, 0.0)
    way = rows(np.array([[-1.0], [1.0]]))
    n_x, n_y = way * (c * u_x - s * u_y), way * (c * u_y + s * u_x)
    r = radii[:, None]
    share = open_ends + (1 - open_ends) * nested
    weights = share[:, None] * 2 * span * r / around
    return sides, Pieces(x[:, None] + r * n_x, y[:, None] + r * n_y, weights, n_x, n_y)


def hull_axes(
    x: Array | Sequence[Array], y: Array | Sequence[Array], radii: Array | Sequence[Array]
) -> tuple[Array, Array, Array, Array]:
    """Of hulls: unit vectors from near to far, by components; lengths; sines of the tapers.

    By two discs' (...) centres and radii; smooth when end-on.
    """
    ahead_x, ahead_y = x[1] - x[0], y[1] - y[0]
    squared = ahead_x**2 + ahead_y**2
    end_on = squared < 1e-12
    length = jnp.sqrt(jnp.where(end_on, 1e-12, squared))
    u_x = jnp.where(end_on, 1.0, ahead_x / length)
    u_y = jnp.where(end_on, 0.0, ahead_y / length)
    # One disc within the other has no tangents: the hull is the larger disc alone.
    sine = jnp.clip((radii[0] - radii[1]) / length, -0.999, 0.999)
    return u_x, u_y, jnp.sqrt(squared + 1e-12), sine


class Touch(NamedTuple):
    """Where the hull's outline is nearest to points: on the circle about one place of its axis."""

    along: Array  # (...) fraction of the axis, 0 at the near disc
    distance: Array  # (...) to the outline, negative inside
    normal_x: Array  # (...) of the unit vector from the axis' place to the point
    normal_y: Array  # (...)


class Swept(NamedTuple):
    """What touching a limb takes; once for all points, since a raster has thousands of them."""

    x: Array  # (...) centre of the near disc
    y: Array  # (...)
    axis_x: Array  # (...) of the unit vector from there to the far disc
    axis_y: Array  # (...)
    length: Array  # (...) of the axis
    per_length: Array  # (...) 1 / length
    lag: Array  # (...) by how much of the axis a touch stays behind for each unit aside of it
    # (...) where on the axis touches begin, a fraction: 0; end-on that of the larger disc.
    first: Array
    last: Array  # (...) where they end: 1; end-on likewise
    radius: Array  # (...) of the near disc
    gap: Array  # (...) by which it is larger than the far one's


def swept(discs: Discs) -> Swept:
    """Limbs (...) ready to be touched."""
    x, y = ((discs.near[..., i], discs.far[..., i]) for i in (0, 1))
    radii = discs.radii[..., 0], discs.radii[..., 1]
    u_x, u_y, length, sine = hull_axes(x, y, radii)
    gap = radii[0] - radii[1]
    # End-on, the larger disc holds the other and is the hull.
    end_on = length <= jnp.abs(gap)
    first, last = (
        jnp.asarray(end, length.dtype) for end in (end_on & (gap <= 0), ~(end_on & (gap > 0)))
    )
    lag = sine / jnp.sqrt(1 - sine**2) / length
    return Swept(x[0], y[0], u_x, u_y, length, 1 / length, lag, first, last, radii[0], gap)


def touch(discs: Discs, x: Array, y: Array) -> Touch:
    """The hull as the union of the discs along its axis, and the one nearest to each point.

    By the envelope theorem the distance's derivative by a disc is that of the touching circle: for
    its centre ``-(1 - along) normal`` and ``-along normal``, for its radius ``-(1 - along)`` and
    ``-along``, at the near and the far end.

    Args:
        discs: limbs, of a batch that broadcasts against the points.
        x: (...) of the points; by components, since a sum over an axis of two is a slow loop of
            its own over a raster.
        y: (...).
    """
    return touch_swept(swept(discs), x, y)


def touch_swept(limb: Swept, x: Array, y: Array) -> Touch:
    """The same of limbs that are ready for it."""
    right, down = x - limb.x, y - limb.y
    ahead = right * limb.axis_x + down * limb.axis_y
    aside = jnp.abs(down * limb.axis_x - right * limb.axis_y)
    along = jnp.clip(ahead * limb.per_length - aside * limb.lag, limb.first, limb.last)
    there = along * limb.length
    away_x, away_y = right - there * limb.axis_x, down - there * limb.axis_y
    away = jnp.sqrt(jnp.maximum(away_x**2 + away_y**2, 1e-12))
    distance = away - (limb.radius - along * limb.gap)
    return Touch(along, distance, away_x / away, away_y / away)


def depth_along(at: Touch, near: Array, far: Array) -> Array:
    """Depths (...) of the axis where it is touched, given those of its ends."""
    return (1 - at.along) * near + at.along * far


def signed_distance(discs: Discs, points: Array) -> Array:
    """Distance of (..., 2) points to the hull's outline, negative inside."""
    return touch(discs, points[..., 0], points[..., 1]).distance
