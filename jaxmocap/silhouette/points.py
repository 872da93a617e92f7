"""Points of the body's surface on rays of the cameras: the rows of section 3.2's system.

INPUTS: a Skeleton and its Frames, points fixed to bones, lines in the world (metres).
OUTPUTS: how far the points are off their lines, and how that changes with the pose.

A point on a kinematic chain is moved by exp(theta xi) exp(theta_1 xi_1) ... exp(theta_n xi_n), the
joints being screws without pitch. Its derivative by a joint's angle at the present pose is that
joint's screw, carried along (4.21), applied to the point: the column of the geometric Jacobian.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Frames, jacobian
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.surface import BodyPoints, carry_by_bones, pose_points
from jaxmocap.geometry.cameras import Camera, pixel_rays
from jaxmocap.geometry.lines import Lines, camera_lines, perpendiculars
from jaxmocap.geometry.rotations import HIGHEST, cross


class PointRays(NamedTuple):
    """N points and the rays that they should lie on, of any number of cameras.

    Where the ray belongs to a contour, its point is measured across the contour and not along it:
    ``across`` is the contour's normal in space and ``along_weights`` the other direction's weights.
    With weights of 1 this is the incidence of (3.11), whatever ``across``.
    """

    points: BodyPoints
    lines: Lines  # in the world, (N)
    across: Array  # (N, 3) unit vectors at right angles to their lines
    weights: Array  # (N,) 0 where there is no pair, whatever the other fields then hold
    along_weights: Array  # (N,) from 0 to 1
    # (N, 3, S) of the points by drivers of 1, metres in their bones' frames, see ``morph``; None
    # where nothing drives them.
    moves: Array | np.ndarray | None = None


def contour_rays(camera: Camera, pixels_xy: Array, normals: Array) -> tuple[Lines, Array]:
    """Rays through a contour's pixels (N, 2), and (N, 3) its unit normals (N, 2) in space.

    Points on the ray's plane along the contour all project onto its tangent.
    """
    lines = camera_lines(camera, pixels_xy)
    beside = pixel_rays(camera, pixels_xy + normals) - lines.directions
    along = jnp.sum(beside * lines.directions, -1, keepdims=True) * lines.directions
    across = beside - along
    squared = jnp.sum(across**2, -1, keepdims=True)
    is_measured = squared > 0
    return lines, jnp.where(
        is_measured, across / jnp.sqrt(jnp.where(is_measured, squared, 1.0)), 0.0
    )


def point_jacobian(skeleton: Skeleton, frames: Frames, points: BodyPoints) -> Array:
    """Derivatives (N, 3, 6 + D) of the posed points by the tangent vector of ``retract``."""
    alone, shares = carry_by_bones(frames, points), jnp.asarray(points.shares)
    total = jnp.zeros(())
    for k in range(alone.shape[1]):
        J = jacobian(skeleton, frames, points.bones[:, k], alone[:, k])
        total = total + shares[:, k, None, None] * J
    return total


def driver_point_jacobian(frames: Frames, points: BodyPoints, moves: Array | np.ndarray) -> Array:
    """Derivatives (N, 3, S) of the posed points by the drivers of their moves (N, 3, S)."""
    shares = jnp.asarray(points.shares)[..., None, None]
    R = jnp.sum(shares * frames.R_world_bone[points.bones], 1)
    return jnp.einsum("nab,nbs->nas", R, jnp.asarray(moves), precision=HIGHEST)


def linearised_rays(skeleton: Skeleton, frames: Frames, pairs: PointRays) -> tuple[Array, Array]:
    """The system of (3.12) for all pairs: residuals (N, 2), metres, and their (N, 2, 6 + D + S).

    x x n - m has three rows of rank two; here are its two components at right angles to the ray,
    across the contour and along it, unweighted but for the grip. Pairs of no weight give 0.
    The last S columns are by what drives the points, where anything does.
    """
    real = pairs.weights > 0
    along = cross(pairs.lines.directions, pairs.across)
    ways = jnp.stack([pairs.across, pairs.along_weights[:, None] * along], 1)
    ways = jnp.where(real[:, None, None], ways, 0.0)
    lines = Lines(*(jnp.where(real[:, None], part, 0.0) for part in pairs.lines))
    off = perpendiculars(lines, pose_points(frames, pairs.points))
    J = point_jacobian(skeleton, frames, pairs.points)
    residuals = ways[..., 0] * off[:, None, 0]
    rows = ways[..., 0, None] * J[:, None, 0]
    for axis in (1, 2):
        residuals = residuals + ways[..., axis] * off[:, None, axis]
        rows = rows + ways[..., axis, None] * J[:, None, axis]
    if pairs.moves is not None:
        driven = driver_point_jacobian(frames, pairs.points, pairs.moves)
        across = jnp.sum(ways[..., None] * driven[:, None], -2)
        rows = jnp.concatenate([rows, across], -1)
    return residuals, rows
