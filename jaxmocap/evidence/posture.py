"""What is usual of a posture: joints near their relaxed angles, a pelvis upright and facing ahead.

INPUTS: a posed body, where the markers' own pose leans and faces. OUTPUTS: whitened residuals.
"""

from functools import partial
from typing import ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import forward
from jaxmocap.body.mass import augmented_bodies
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, difference, relaxed_pose, retract
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.compilation.settings import settings, traced
from jaxmocap.evidence.terms import Measurements, PosedBody, Term
from jaxmocap.geometry.rotations import HIGHEST, quaternion_to_matrix

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


def effort_shares(skeleton: Skeleton, augmented_body: Literal["distal", "proximal"]) -> Array:
    """Shares (D,) of joints of the effort m_i h_i of (9) in the relaxed pose."""
    frames = forward(skeleton, relaxed_pose(skeleton))
    bodies = augmented_bodies(skeleton, frames, augmented_body == "proximal")
    effort = bodies.masses * bodies.arms
    return effort / jnp.sum(effort) + LEAST_SHARE


@settings
class EasyPosture(Term):
    """The secondary task, equation (9), as what it minimises.

    Measured ``centre``, a pose, and ``effort`` (D,), ``effort_shares``. Joints are relaxed by their
    share of the effort, in weighted coordinates; the pelvis is upright. Where nothing else
    determines the pelvis, it is at the centre.
    """

    relaxation: Array = traced(0.9, "gain of (9)")
    uprightness: Array = traced(0.1, "gain of the pull of the pelvis to the upright")
    shift: Array = traced(1.0, "of the pelvis about the centre, metres")
    turn: Array = traced(1.0, "of its orientation, radians")

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(6 + D + 2,)."""
        skeleton, pose, centre = model.skeleton, body.pose, measured["centre"]
        moved = (pose.position - centre.position) / self.shift
        turned = self._turned(model, pose, measured, jnp.zeros_like(moved))
        away = (pose.angles - skeleton.relaxed) * self._easing(model, measured)
        return jnp.concatenate([moved, turned, away])

    def jacobian(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(6 + D + 2, 6 + D)."""
        pose = body.pose
        eye, still = jnp.eye(3, dtype=pose.angles.dtype), jnp.zeros_like(pose.position)
        turned = jax.jacfwd(partial(self._turned, model, pose, measured))(still)
        easing = jnp.diag(self._easing(model, measured))
        return jax.scipy.linalg.block_diag(eye / self.shift, turned, easing)

    def curvature(
        self, model: Model, body: PosedBody, measured: Measurements, weights: Array
    ) -> Array:
        """(6 + D, 6 + D)."""
        pose = body.pose

        def turned(step: Array) -> Array:
            return jnp.vdot(weights[3:8], self._turned(model, pose, measured, step))

        bent = jax.jacfwd(jax.jacfwd(turned))(jnp.zeros_like(pose.position))
        size = ROOT_DOF + pose.angles.size
        return jnp.zeros((size, size), bent.dtype).at[3:ROOT_DOF, 3:ROOT_DOF].set(bent)

    def _turned(self, model: Model, pose: Pose, measured: Measurements, step: Array) -> Array:
        """(5,) turn from the centre and lean from the upright, a rotation vector (3,) on."""
        here = pose._replace(angles=pose.angles[:0])
        there = retract(here, jnp.concatenate([jnp.zeros_like(step), step]))
        turn = difference(there, measured["centre"]._replace(angles=here.angles))[3:]
        lean = quaternion_to_matrix(there.quaternion)[:2, 2] * model.skeleton.costs[3:5]
        return jnp.concatenate([turn / self.turn, lean * jnp.sqrt(self.uprightness)])

    def _easing(self, model: Model, measured: Measurements) -> Array:
        """(D,) by which an angle off the relaxed one counts."""
        costs = model.skeleton.costs[ROOT_DOF:]
        return costs * jnp.sqrt(2 * self.relaxation * measured["effort"])


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
