"""Markers beside silhouettes: a point on a bone is where its marker was measured.

Further rows of the system of section 3.2: where a contour's pixel tells of a point that it lies on
a ray, a marker tells all three of its coordinates, to within a deviation of its own.

INPUTS: Sites on bones, positions in the world (metres), NaN where a marker is missing.
OUTPUTS: normal equations to add to those of the rays.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Frames, Sites
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.surfaces.surface import BodyPoints, posed
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.silhouette.points import point_jacobian


class MarkerRows(NamedTuple):
    """M markers.

    Attributes:
        points: of the body, where they sit.
        positions_world: (M, 3) metres; NaN where one is missing.
        deviations: (M,) metres.
    """

    points: BodyPoints
    positions_world: Array | np.ndarray
    deviations: Array | np.ndarray


def points_at(skeleton: Skeleton, sites: Sites) -> BodyPoints:
    """Sites as points that one bone each carries."""
    along = (sites.at * skeleton.lengths[sites.bones])[:, None] * skeleton.directions[sites.bones]
    places = (along + sites.offsets)[:, None]
    return BodyPoints(sites.bones[:, None], places, jnp.ones_like(places[..., 0]))


def marker_equations(skeleton: Skeleton, frames: Frames, rows: MarkerRows) -> tuple[Array, Array]:
    """Hessian (6 + D, 6 + D) and slope (6 + D,) of half their squares in deviations.

    Markers are believed however far they are: what is wrong with them is to be found before.
    """
    positions = jnp.asarray(rows.positions_world)
    there = jnp.isfinite(positions).all(-1)
    off = posed(frames, rows.points) - jnp.where(there[:, None], positions, 0.0)
    sure = jnp.where(there, 1 / jnp.asarray(rows.deviations), 0.0)[:, None]
    J = point_jacobian(skeleton, frames, rows.points) * sure[..., None]
    J = J.reshape(-1, J.shape[-1])
    information = jnp.matmul(J.T, J, precision=HIGHEST)
    return information, jnp.matmul(J.T, (off * sure).ravel(), precision=HIGHEST)
