"""What is usual of a posture: joints near their relaxed angles, a pelvis upright and facing ahead.

INPUTS: a posed body, where the markers' own pose leans and faces. OUTPUTS: whitened residuals.
"""

from typing import ClassVar, Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import forward
from jaxmocap.body.mass import augmented_bodies
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, difference, relaxed_pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.compilation.settings import settings, static, traced
from jaxmocap.evidence.terms import Measurements, PosedBody, Term
from jaxmocap.geometry.rotations import HIGHEST

# Where no marker holds the feet, the markers' pose faces so many times less surely.
UNMARKED_FACING = 3.0


@settings
class RelaxedPosture(Term):
    """Joints at ease."""

    errors_last: ClassVar[bool] = True
    ease: Array = traced(1.0, "of joints about the relaxed pose, as a multiple of what is usual")

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(D,)."""
        skeleton = model.skeleton
        away = body.pose.angles - skeleton.relaxed
        return away / (self.ease * skeleton.usual_deviations)


@settings
class Pelvis(Term):
    """The pelvis as the markers' own pose has it.

    Measured ``upright`` (2,), the horizontal part of its z axis there, and ``facing`` (3,), unit
    and horizontal.
    """

    errors_last: ClassVar[bool] = True
    lean: Array = traced(
        0.1,
        "of its upright about that of the markers' pose, radians; about the vertical where no "
        "marker holds the feet",
    )
    facing: Array = traced(
        0.1, "of where it faces, radians; thrice that where no marker holds the feet"
    )

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(3,)."""
        R, unmarked = body.R_world_pelvis, model.no_foot_is_marked
        upright = R[:2, 2] if unmarked else R[:2, 2] - measured["upright"]
        turn = jnp.cross(R[:, 0], measured["facing"])[2:]
        facing = self.facing * (UNMARKED_FACING if unmarked else 1.0)
        return jnp.concatenate([upright / self.lean, turn / facing])


# Every joint has this share of the effort at least: some bear no weight, and are relaxed too.
LEAST_SHARE = 1e-3


@settings
class EasyPosture(Term):
    """The secondary task, equation (9), as what it minimises; measured ``centre``, a pose.

    Joints are relaxed by their share of the effort m_i h_i in the relaxed pose, in weighted
    coordinates; the pelvis is upright. Where nothing else determines the pelvis, it is at the
    centre.
    """

    relaxation: Array = traced(0.9, "gain of (9)")
    uprightness: Array = traced(0.1, "gain of the pull of the pelvis to the upright")
    shift: Array = traced(1.0, "of the pelvis about the centre, metres")
    turn: Array = traced(1.0, "of its orientation, radians")
    augmented_body: Literal["distal", "proximal"] = static("distal", "of (9)")

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(6 + D + 2,)."""
        skeleton, pose, centre = model.skeleton, body.pose, measured["centre"]
        frames = forward(skeleton, relaxed_pose(skeleton))
        bodies = augmented_bodies(skeleton, frames, self.augmented_body == "proximal")
        effort = bodies.masses * bodies.arms
        share = effort / jnp.sum(effort) + LEAST_SHARE
        costs = skeleton.costs
        away = (pose.angles - skeleton.relaxed) * costs[ROOT_DOF:]
        upright = body.R_world_pelvis[:2, 2] * costs[3:5]
        moved = difference(pose._replace(angles=centre.angles), centre)[:ROOT_DOF]
        return jnp.concatenate(
            [
                moved[:3] / self.shift,
                moved[3:] / self.turn,
                away * jnp.sqrt(2 * self.relaxation * share),
                upright * jnp.sqrt(self.uprightness),
            ]
        )


@settings
class NearPose(Term):
    """A pose near another one, its pelvis near the vertical; measured ``centre``, a pose."""

    shift: Array = traced(0.1, "of the pelvis about the centre, metres")
    turn: Array = traced(0.3, "of its orientation, radians")
    lean: Array = traced(0.15, "of the pelvis from the vertical, radians")
    spine: Array = traced(0.1, "of each of its joints about the centre, radians")
    neck: Array = traced(0.4, "the same")
    arm: Array = traced(1.0, "the same")
    leg: Array = traced(0.4, "the same")

    def deviations(self, skeleton: Skeleton) -> Array:
        """(6 + D,) about the centre, metres and radians."""
        groups = {"spine": self.spine, "head": self.neck, "leg": self.leg}
        # Arms, shoulders, and what else a body has.
        joints = [groups.get(group, self.arm) for group in skeleton.tree.groups_of_joints]
        return jnp.stack([self.shift] * 3 + [self.turn] * 3 + joints)

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(6 + D + 2,)."""
        moved = difference(body.pose, measured["centre"])
        deviations = self.deviations(model.skeleton)
        return jnp.concatenate([moved / deviations, body.R_world_pelvis[:2, 2] / self.lean])


class EstimatedPose(NamedTuple):
    """A pose that something else estimated, and how surely, as a quadratic about it.

    Attributes:
        pose: that was estimated.
        root: (N, N) whose root^T root is the Hessian of half the cost, by the tangent vector from
            the pose.
        offset: (N,) whose root^T offset is half the cost's derivative at the pose.
    """

    pose: Pose
    root: Array | np.ndarray
    offset: Array | np.ndarray


@settings
class NearEstimate(Term):
    """A pose as something else estimated it; measured ``estimate``, an ``EstimatedPose``."""

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(N,), N = 6 + D."""
        estimate = measured["estimate"]
        off = difference(body.pose, estimate.pose)
        return jnp.matmul(estimate.root, off, precision=HIGHEST) + estimate.offset
