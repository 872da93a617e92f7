"""A person's shape by all contours of a recording.

Every frame's pairs depend on its pose and on the shape, both linearly at the estimated pose. A
frame's pose is eliminated from its normal equations (Schur's complement): what it may explain is no
evidence of the shape. The rest adds up over the frames, and is solved with the prior among people.
Shape are the surface's fields and, where asked for, the lengths of the bones.

INPUTS: pairs of frames and their poses; the fields of a surface. OUTPUTS: the surface that suits,
and the skeleton.
"""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from scipy.linalg import block_diag

from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import Pose
from jaxmocap.body.proportions import (
    LENGTHS,
    covariance_among_people,
    scale_skeleton,
    stretch_points,
)
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.subject import rest_joints
from jaxmocap.body.surfaces.surface import Surface, pose_points
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.silhouette.fit.correspond import ContourPairs, pairs_of
from jaxmocap.silhouette.points import linearised_rays
from jaxmocap.silhouette.surfaces.morph import Morph, driver_values, moved_points
from jaxmocap.silhouette.surfaces.swelling import fields_of, swell_surface

# Deviation of a pair, metres, such that a whole recording's pairs count as what they are worth:
# neighbours on a contour err alike, and so does one place of the body in all frames.
DEVIATION_M = 0.15
# Deviation of every degree of freedom about the estimated pose, metres and radians, by one pair's.
FREEDOM = 10.0


@partial(jax.jit, static_argnames="lengths")
def shape_equations(
    skeleton: Skeleton,
    cameras: Camera,
    pose: Pose,
    pairs: ContourPairs,
    moves: Array,
    morph: Morph | None = None,
    lengths: int = 0,
) -> tuple[Array, Array]:
    """A frame's evidence of pose and shape: their Hessian and slope, metres squared.

    Pairs have what robust weighting leaves of their weights, ``moves`` (C * N, 3, P) are of their
    nodes. So many of the ``LENGTHS`` are part of the shape; static.
    """
    if morph is not None and pairs.moves is not None:
        gone = moved_points(pairs.points, pairs.moves, driver_values(morph, pose.angles))
        pairs = pairs._replace(points=gone)
    rays = pairs_of(cameras, pairs._replace(moves=None), 0.0)
    frames = forward(skeleton, pose)
    residuals, rows = linearised_rays(skeleton, frames, rays)
    shares = jnp.asarray(pairs.points.shares)[..., None, None]
    R = jnp.sum(shares * frames.R_world_bone[pairs.points.bones], 1)
    across = jnp.einsum("na,nab->nb", rays.across, R, precision=HIGHEST)
    shape = jnp.einsum("nb,nbp->np", across, moves, precision=HIGHEST)
    both = jnp.concatenate([rows[:, 0], shape], 1)
    if lengths:
        longer = _by_lengths(skeleton, pose, pairs, lengths)
        along = jnp.einsum("na,nal->nl", rays.across, longer, precision=HIGHEST)
        both = jnp.concatenate([both, along], 1)
    weighted = rays.weights[:, None] * both
    H = jnp.matmul(weighted.T, both, precision=HIGHEST)
    return H, jnp.matmul(weighted.T, residuals[:, 0], precision=HIGHEST)


def _by_lengths(skeleton: Skeleton, pose: Pose, pairs: ContourPairs, count: int) -> Array:
    """(N, 3, L) derivatives of the pairs' points, world, by logarithms of the bones' lengths."""

    def placed(logarithms: Array) -> Array:
        points = stretch_points(skeleton, pairs.points, logarithms)
        return pose_points(forward(scale_skeleton(skeleton, logarithms), pose), points)

    return jax.jacfwd(placed)(jnp.zeros(count, skeleton.lengths.dtype))


class ShapeEstimator:
    """Adds up the evidence of a person's shape in the frames of a recording.

    Attributes:
        fields: of the surface.
        amounts: (P + L,) of them that are worn now, metres; then logarithms of lengths.
    """

    def __init__(
        self, surface: Surface, skeleton: Skeleton, unknown: float = 1.0, lengths: bool = False
    ):
        """Begin with a surface, a generic one or a person's own, around a skeleton.

        It may be ``unknown`` times as far off as a generic one; ``lengths`` are found as well or
        not.
        """
        self._generic, self._skeleton = surface, skeleton
        fields = fields_of(surface, rest_joints(skeleton))
        self.fields = replace(fields, deviations=unknown * fields.deviations)
        self._lengths = len(LENGTHS) if lengths else 0
        among_people = np.linalg.inv(covariance_among_people(self._lengths))
        both = block_diag(np.diag(self.fields.deviations**-2.0), among_people)
        self._prior_information = np.asarray(both)
        self.amounts = np.zeros(len(self._prior_information))
        self._forget()

    def _forget(self) -> None:
        count = len(self.amounts)
        self._information, self._slope = np.zeros((count, count)), np.zeros(count)

    def add_frame(
        self,
        skeleton: Skeleton,
        cameras: Camera,
        pose: Pose,
        pairs: ContourPairs,
        morph: Morph | None = None,
    ) -> None:
        """A frame: C cameras (stacked), the pose estimated by its pairs, what goes along."""
        moves = self.fields.moves[pairs.nodes.ravel()]
        self.add_equations(
            *shape_equations(skeleton, cameras, pose, pairs, moves, morph, self._lengths)
        )

    def add_equations(self, H: Array | np.ndarray, slope: Array | np.ndarray) -> None:
        """Normal equations (6 + D + P) of a frame's pose and the shape; the pose is eliminated."""
        H, slope = np.asarray(H, float), np.asarray(slope, float)
        first = len(slope) - len(self.amounts)
        pose = H[:first, :first] + np.eye(first) / FREEDOM**2
        both = np.column_stack([H[:first, first:], slope[:first]])
        explained = H[first:, :first] @ np.linalg.solve(pose, both)
        self._information += H[first:, first:] - explained[:, :-1]
        self._slope += slope[first:] - explained[:, -1]

    def estimate(self) -> tuple[Skeleton, Surface]:
        """What suits all frames added, and people; then those are forgotten."""
        H = self._information / DEVIATION_M**2 + self._prior_information
        slope = self._slope / DEVIATION_M**2 + self._prior_information @ self.amounts
        self.amounts = self.amounts - np.linalg.solve(H, slope)
        self._forget()
        amounts, logarithms = np.split(self.amounts, [len(self.fields.names)])
        surface = swell_surface(self._generic, self.fields, amounts)
        if not self._lengths:
            return self._skeleton, surface
        longer = jnp.asarray(logarithms, self._skeleton.lengths.dtype)
        points = stretch_points(self._skeleton, surface.points, longer)
        return scale_skeleton(self._skeleton, longer), replace(surface, points=points)
