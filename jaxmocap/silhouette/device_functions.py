"""What a step of the silhouette tracker computes on the device; each function traces once.

INPUTS: poses, pairs of the rim and contours. OUTPUTS: a predicted pose, a solved one, a velocity.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.pose import Pose, difference, retract
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.compilation.programs import Program, program
from jaxmocap.geometry.cameras import Camera
from jaxmocap.silhouette.fit.correspond import pairs_of
from jaxmocap.silhouette.points import BodyPoints
from jaxmocap.silhouette.pose import PoseResult, PoseSettings, Prior, TermEvidence, solve_pose
from jaxmocap.silhouette.surfaces.morph import Morph, without_followers


class ContourPairs(NamedTuple):
    """Pairs of a cycle, C cameras with N each: see ``Matches``.

    Attributes:
        points: C * N of the body.
        pixels_xy: (C, N, 2).
        normals: (C, N, 2).
        weights: (C, N), 0 for no pair.
        moves: (C * N, 3, S) of the points by drivers, see ``morph``; None without any.
        along_weight: of all pairs along the contour, by that across.
    """

    points: BodyPoints
    pixels_xy: Array | np.ndarray
    normals: Array | np.ndarray
    weights: Array | np.ndarray
    moves: Array | np.ndarray | None = None
    along_weight: Array | float = 0.0


@program("full")
def predicted_pose(skeleton: Skeleton, pose: Pose, velocity: Array, ahead: Array) -> Pose:
    """A pose (..., ) moved on by a velocity (6 + D,) for so many seconds, within the limits."""
    moved = retract(pose, velocity * ahead)
    low, high = skeleton.limits[:, 0], skeleton.limits[:, 1]
    return moved._replace(angles=jnp.clip(moved.angles, low, high))


free_pose = Program(without_followers, "free_pose", effort="full")


@program("full")
def fit(
    skeleton: Skeleton,
    cameras: Camera,
    pose: Pose,
    pairs: ContourPairs,
    settings: PoseSettings,
    prior: Prior,
    beside: TermEvidence | None = None,
    morph: Morph | None = None,
) -> PoseResult:
    """The pose that brings the rims' points to the contours' rays; see ``solve_pose``."""
    pixels_xy, normals, weights = (jnp.asarray(part) for part in pairs[1:4])
    along_weight, moves = pairs.along_weight, pairs.moves
    rays = pairs_of(cameras, pairs.points, pixels_xy, normals, weights, along_weight, moves)
    return solve_pose(skeleton, pose, rays, settings, prior, beside=beside, morph=morph)


@program("full")
def velocity_between(before: Pose, now: Pose, between: Array) -> Array:
    """(6 + D,) metres and radians per second from one pose to another, seconds later."""
    return difference(now, before) / between
