"""Lines of space in Pluecker form (second paper, section 3.1.1): pixels become rays in the world.

INPUTS: points and directions, or pixels of a Camera; world, metres.
OUTPUTS: lines (n, m), and how far points are from them.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxmocap.geometry.cameras import Camera, pixel_rays
from jaxmocap.geometry.rotations import cross


class Lines(NamedTuple):
    """Lines, unique up to sign."""

    directions: Array  # (..., 3) n, of length 1
    moments: Array  # (..., 3) m = x x n for any point x on the line, metres


def lines_through(points: Array, directions: Array) -> Lines:
    """Lines through points (..., 3) along unit directions (..., 3)."""
    return Lines(directions, cross(points, directions))


def camera_lines(camera: Camera, pixels_xy: Array) -> Lines:
    """The rays in the world that pixels (..., 2) see; the lens' distortion is undone."""
    directions = pixel_rays(camera, pixels_xy)
    return lines_through(jnp.broadcast_to(camera.position_world, directions.shape), directions)


def incidence(lines: Lines, points: Array) -> Array:
    """The residual x x n - m (..., 3), metres: 0 for a point on its line, equation (3.2).

    Elsewhere the perpendicular from the line to the point, turned by a quarter about the line.
    """
    return cross(points, lines.directions) - lines.moments


def perpendiculars(lines: Lines, points: Array) -> Array:
    """From each line to its point (..., 3), at right angles to the line, metres."""
    return cross(lines.directions, incidence(lines, points))
