"""What one frame's pose answers for besides the sights: markers, joints, ground, what is usual.

INPUTS: a skeleton, a pose, what is known of the frame. OUTPUTS: whitened residuals.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import (
    Frames,
    Sites,
    forward,
    jacobian,
    landmark_sites,
    site_positions,
)
from jaxmocap.body.mass import bone_centres, centre_of_gravity
from jaxmocap.body.pose import Pose, beyond_limits
from jaxmocap.body.proportions import scaled
from jaxmocap.body.skeleton import ELBOWS, ROOT_DOF, Skeleton, landmark_rows
from jaxmocap.evidence.keypoints import Lines, line_residuals
from jaxmocap.geometry.rotations import HIGHEST, hat, quaternion_to_matrix
from jaxmocap.smoothing.settings import SmoothingSettings

GROUND = ("ankle_l", "ankle_r")
# Whose middle is the middle of the base of support.
BASE = (*GROUND, "toe_l", "toe_r")
# Parts of a leg whose markers hold a foot.
FEET = ("shank", "foot")
# Of both elbows, where no hypothesis puts them anywhere.
NO_GOALS = np.full((2, 3), np.nan)
# Where no marker holds the feet, the markers' pose faces so many times less surely.
UNFOOTED = 3.0


class Known(NamedTuple):
    """What is known of one frame besides its sights.

    Attributes:
        targets: (M, 3) markers, world, metres; NaN where missing.
        up: (2,) horizontal part of the pelvis' upright in the markers' pose.
        facing: (3,) unit and horizontal, where the markers' pose faces.
        ankles: (2, 3) of the markers' pose, world, metres.
        feet: () 1 where no marker holds the feet, so that the ground must, else 0.
        goals: (2, 3) where a hypothesis puts the elbows, world, metres; NaN where none does.
        lines: of sight of the cameras that come with key points; None where none does.
    """

    targets: Array | np.ndarray
    up: Array | np.ndarray
    facing: Array | np.ndarray
    ankles: Array | np.ndarray
    feet: Array | np.ndarray
    goals: Array | np.ndarray
    lines: Lines | None = None


class Placed(NamedTuple):
    """The body as a pose puts it: all that a frame's residuals look at.

    Attributes:
        marked: (M, 3) points on bones where markers sit, world, metres.
        landmarks: (L, 3) world, metres.
        R_world_pelvis: (3, 3).
        gravity: (3,) centre of gravity, world, metres.
        angles: (D,) radians.
    """

    marked: Array
    landmarks: Array
    R_world_pelvis: Array
    gravity: Array
    angles: Array


def residuals(
    skeleton: Skeleton, markers: Sites, settings: SmoothingSettings, pose: Pose, known: Known
) -> Array:
    """All whitened residuals (R,) of one frame but its sights'."""
    placed = _placed(skeleton, markers, forward(skeleton, pose), pose)
    return _answers(skeleton, settings, known, placed)


def linearised_residuals(
    skeleton: Skeleton,
    proportions: Array,
    markers: Sites,
    settings: SmoothingSettings,
    pose: Pose,
    known: Known,
) -> tuple[Array, Array, Array, Array]:
    """Residuals (R,), their derivative (R, N), landmarks (3 L,) and theirs (3 L, N).

    By the pose's tangent vector and the proportions: N = 6 + D + P. The body's points by the
    geometric Jacobian, the few numbers that residuals make of them forwards.

    Args:
        skeleton: unscaled.
        proportions: (P,) of ``scaled``.
        markers: M points on bones.
        settings: of the smoothing.
        pose: of the person.
        known: of the frame.
    """

    def resized(logarithms: Array) -> Placed:
        person = scaled(skeleton, logarithms)
        return _placed(person, markers, forward(person, pose), pose)

    person = scaled(skeleton, proportions)
    frames = forward(person, pose)
    placed = _placed(person, markers, frames, pose)
    by_pose, by_size = _by_pose(person, markers, frames, placed), jax.jacfwd(resized)(proportions)
    by = jax.tree.map(lambda *parts: jnp.concatenate(parts, -1), by_pose, by_size)

    def answers(there: Placed) -> Array:
        return _answers(person, settings, known, there)

    r, push = jax.linearize(answers, placed)
    J = jax.vmap(push, -1, -1)(by)
    return r, J, placed.landmarks.ravel(), by.landmarks.reshape(-1, J.shape[-1])


def _placed(skeleton: Skeleton, markers: Sites, frames: Frames, pose: Pose) -> Placed:
    return Placed(
        site_positions(skeleton, frames, markers),
        site_positions(skeleton, frames, landmark_sites(skeleton)),
        quaternion_to_matrix(pose.quaternion),
        centre_of_gravity(skeleton, frames),
        pose.angles,
    )


def _by_pose(skeleton: Skeleton, markers: Sites, frames: Frames, placed: Placed) -> Placed:
    """Derivatives (..., 6 + D) of what is placed, by the tangent vector of ``retract``."""
    dofs, dtype = placed.angles.size, placed.angles.dtype
    turning = jnp.einsum(
        "kij,jl->ilk", hat(jnp.eye(3, dtype=dtype)), placed.R_world_pelvis, precision=HIGHEST
    )
    return Placed(
        jacobian(skeleton, frames, markers.bones, placed.marked),
        jacobian(skeleton, frames, landmark_sites(skeleton).bones, placed.landmarks),
        jnp.pad(turning, ((0, 0), (0, 0), (3, dofs))),
        _by_gravity(skeleton, frames),
        jnp.eye(dofs, ROOT_DOF + dofs, ROOT_DOF, dtype),
    )


def _by_gravity(skeleton: Skeleton, frames: Frames) -> Array:
    """Derivative (3, 6 + D) of the centre of gravity."""
    bones = np.arange(len(skeleton.tree.bones))
    by_bone = jacobian(skeleton, frames, bones, bone_centres(skeleton, frames))
    weights = skeleton.masses / jnp.sum(skeleton.masses)
    return jnp.einsum("b,bij->ij", weights, by_bone, precision=HIGHEST)


def _answers(
    skeleton: Skeleton, settings: SmoothingSettings, known: Known, placed: Placed
) -> Array:
    """The residuals (R,) of a body that is placed."""
    ankles, feet = (placed.landmarks[landmark_rows(names)] for names in (GROUND, BASE))
    R = placed.R_world_pelvis
    turned = jnp.cross(R[:, 0], known.facing)[2]
    facing = settings.facing * (1 + (UNFOOTED - 1) * known.feet)
    ground = jnp.stack([settings.footing, settings.footing, settings.ground])
    parts = [
        _off(placed.marked, known.targets) / settings.marker,
        (R[:2, 2] - (1 - known.feet) * known.up) / settings.lean,
        turned / facing,
        (placed.angles - skeleton.relaxed) / (settings.ease * skeleton.usual_deviations),
        beyond_limits(skeleton.limits, placed.angles) / settings.limit,
        known.feet * (ankles - known.ankles) / ground,
        known.feet * (placed.gravity - jnp.mean(feet, 0))[:2] / settings.balance,
        _off(placed.landmarks[ELBOWS], known.goals) / settings.goal,
    ]
    if known.lines is not None:
        parts.append(line_residuals(placed.landmarks, known.lines, settings.keypoints))
    return jnp.concatenate([part.ravel() for part in parts])


def _off(points: Array, targets: Array | np.ndarray) -> Array:
    """Points less their targets; 0 where there is none."""
    there = jnp.isfinite(targets)
    return jnp.where(there, points - jnp.where(there, targets, 0.0), 0.0)


def feet_free(skeleton: Skeleton, markers: Sites) -> float:
    """1 where no marker holds the feet, else 0."""
    return float(not np.isin(markers.bones, skeleton.tree.bones_in(*FEET)).any())
