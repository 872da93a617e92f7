"""What is usual of a posture: joints near their relaxed angles, a pelvis upright and facing ahead.

INPUTS: a posed body, where the markers' own pose leans and faces. OUTPUTS: whitened residuals.
"""

from typing import Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import Frames
from jaxmocap.body.mass import augmented_bodies
from jaxmocap.body.model import SIDES, Model
from jaxmocap.body.pose import Pose, difference
from jaxmocap.body.skeleton import Skeleton, landmark_rows
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.compilation.settings import settings, static, traced
from jaxmocap.evidence.terms import Measurements, PosedBody, Term
from jaxmocap.geometry.rotations import HIGHEST, cross, quaternion_multiply
from jaxmocap.solvers.robust import shorten_residuals

# Where no marker holds the feet, the markers' pose faces so many times less surely.
UNMARKED_FACING = 3.0


# Landmarks that usually are somewhere, in this order.
USUAL = ("elbow_l", "elbow_r", "ankle_l", "ankle_r", "pelvis")
USUAL_ROWS = landmark_rows(USUAL)
TRUNK_AND_LEGS = landmark_rows(
    ("pelvis", "neck", "hip_l", "hip_r", "knee_l", "knee_r", "ankle_l", "ankle_r")
)
# People who bend their legs may bow: the sine of the trunk's lean is up to so many times the share
# by which legs are shortened.
BOW = 1.8
# Its ends are as soft as this.
SOFT = 0.02
# Of two knees the straighter one counts, softly where they differ by less, radians.
ROUND_RAD = 0.3
# What is shorter has no direction, metres.
NOWHERE_M = 1e-6
# Who bends both knees bends the hips along.
HIP_JOINTS, KNEE_JOINTS = (
    tuple(f"{joint}_flexion_{side}" for side in SIDES) for joint in ("hip", "knee")
)
# Groups whose joints bear the body.
BEARING = ("spine", "head", "hip", "leg")


@settings
class RelaxedPosture(Term):
    """Joints at ease."""

    errors_last: ClassVar[bool] = True
    ease: Array = traced(
        1.0, "of arms' joints about the relaxed pose, as a multiple of what is usual"
    )
    bearing: Array = traced(1.0, "the same of joints that bear the body: of trunk, neck and legs")
    hips: float = static(
        0.0, "hips bend along by so many times what both knees bend beyond ease", (0, 2)
    )

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(D,)."""
        skeleton = model.skeleton
        away = self._beyond_knees(skeleton, body.pose.angles - skeleton.relaxed)
        bear = np.isin(skeleton.tree.groups_of_joints, BEARING)
        ease = jnp.where(bear, self.bearing, self.ease)
        return away / (ease * skeleton.usual_deviations)

    def _beyond_knees(self, skeleton: Skeleton, away: Array) -> Array:
        """Angles (D,) off the relaxed ones, those of hips off what knees have them bend along."""
        if not self.hips or not {*HIP_JOINTS, *KNEE_JOINTS} <= set(skeleton.tree.joints):
            return away
        hips, knees = (
            np.array([skeleton.tree.joint(name) for name in pair])
            for pair in (HIP_JOINTS, KNEE_JOINTS)
        )
        left, right = away[knees]
        both = left - excess(left - right, ROUND_RAD) + ROUND_RAD / 2
        return away.at[hips].add(-self.hips * both)


@settings
class MostlyRelaxedPosture(RelaxedPosture):
    """Most joints near ease, a few far from it: each by Student's t.

    For what determines little: somebody who stands is straight, whatever the arms do.
    """

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(D,)."""
        return shorten_residuals(super().residual(model, body, measured)[:, None])[:, 0]


@settings
class Pelvis(Term):
    """The pelvis as the markers' own pose has it.

    Measured ``upright`` (2,), the horizontal part of its z axis there, and ``facing`` (3,), unit
    and horizontal. Where no marker holds a foot, the trunk is upright, or bowed over bent legs.
    """

    errors_last: ClassVar[bool] = True
    needs: ClassVar[tuple[str, ...]] = ("upright", "facing")
    lean: Array = traced(
        0.1,
        "of its upright about that of the markers' pose, radians; where no marker holds the feet, "
        "of the trunk beyond the vertical and what legs so bent let it bow to",
    )
    facing: Array = traced(
        0.1, "of where it faces, radians; thrice that where no marker holds the feet"
    )

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(3,), or (4,) where no marker holds a foot."""
        R, unmarked = body.R_world_pelvis, model.no_foot_is_marked
        turn = cross(R[:, 0], measured.facing)[2:]
        facing = self.facing * (UNMARKED_FACING if unmarked else 1.0)
        upright = R[:2, 2] - measured.upright
        upright = self._off_upright(body) if unmarked else upright / self.lean
        return jnp.concatenate([upright, turn / facing])

    def _off_upright(self, body: PosedBody) -> Array:
        """(3,) of the trunk: back of the vertical, ahead of where it bows to, and aside."""
        points = body.landmarks[TRUNK_AND_LEGS]
        hips, knees, ankles = points[2:].reshape(3, 2, 3)
        stretched = length(hips - knees) + length(knees - ankles)
        bent = jnp.mean(1 - length(hips - ankles) / stretched)
        trunk = points[1] - points[0]
        ahead = body.R_world_pelvis[:2, 0]
        ahead, trunk = ahead / length(ahead), trunk[:2] / length(trunk)
        lean, aside = jnp.sum(trunk * ahead), ahead[0] * trunk[1] - ahead[1] * trunk[0]
        others = jnp.stack([excess(lean - BOW * bent), aside])
        back = -excess(-lean)[None] / self.lean
        return jnp.concatenate([back, shorten_residuals((others / self.lean)[:, None])[:, 0]])


def excess(values: Array, soft: float = SOFT) -> Array:
    """What is above 0, softly: about 0 within as much."""
    return (values + jnp.sqrt(values**2 + soft**2)) / 2


def length(vectors: Array) -> Array:
    """(...) of vectors (..., N); it has a derivative at 0 as well."""
    return jnp.sqrt(jnp.sum(vectors**2, -1) + NOWHERE_M**2)


# Every joint has this share of the effort at least: some bear no weight, and are relaxed too.
LEAST_SHARE = 1e-3
# What is not remembered is about where it began by so much, metres and radians.
FORGOTTEN, FORGOTTEN_JOINTS = 1.0, 1e3


class LastPose(NamedTuple):
    """Where the body was before."""

    pose: Pose  # there
    effort: Array  # (D,) ``effort_shares`` there
    remembered: Array | bool  # () whether what no marker determines stays near it


def effort_shares(
    skeleton: Skeleton, frames: Frames, augmented_body: Literal["distal", "proximal"]
) -> Array:
    """Shares (D,) of joints of the effort m_i h_i of (9)."""
    bodies = augmented_bodies(skeleton, frames, augmented_body == "proximal")
    effort = bodies.masses * bodies.arms
    return effort / jnp.sum(effort)


@settings
class EasyPosture(Term):
    """The secondary task, equation (9), as what it minimises, about the last pose.

    Measured ``last``, a ``LastPose``. Joints are relaxed by their share of its effort, in weighted
    coordinates; the pelvis is upright. A joint that no marker determines goes there sample by
    sample.
    """

    needs: ClassVar[tuple[str, ...]] = ("last",)
    relaxation: Array = traced(0.9, "gain of (9)")
    uprightness: Array = traced(0.1, "gain of the pull of the pelvis to the upright")
    memory: Array = traced(
        0.5, "of a degree of freedom about the last sample's pose, weighted radians"
    )

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(6 + 2 + D,), less what no pose changes."""
        pose, last = body.pose, measured.last
        near = self._nearness(model, last)
        moved = (pose.position - last.pose.position) * near[:3]
        turned = 2 * _turn(pose, last.pose)[1:] * near[3:ROOT_DOF]
        lean = body.R_world_pelvis[:2, 2] * self._righting(model)
        # Two quadratics in one angle are one.
        centre, weights = self._ease(model, last, near[ROOT_DOF:])
        return jnp.concatenate([moved, turned, lean, (pose.angles - centre) * weights])

    def jacobian(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(6 + 2 + D, 6 + D)."""
        pose, last = body.pose, measured.last
        near, turn = self._nearness(model, last), _turn(pose, last.pose)
        eye = np.eye(3, dtype=turn.dtype)
        turned = near[3:ROOT_DOF, None] * (turn[0] * eye + cross(eye, turn[1:]).T)
        lean = cross(eye, body.R_world_pelvis[:, 2]).T[:2] * self._righting(model)[:, None]
        _, weights = self._ease(model, last, near[ROOT_DOF:])
        return jax.scipy.linalg.block_diag(
            jnp.diag(near[:3]), jnp.concatenate([turned, lean]), jnp.diag(weights)
        )

    def curvature(
        self, model: Model, body: PosedBody, measured: Measurements, weights: Array
    ) -> Array:
        """(6 + D, 6 + D)."""
        pose, last = body.pose, measured.last
        turned = weights[3:ROOT_DOF] * self._nearness(model, last)[3:ROOT_DOF]
        lean = jnp.pad(weights[ROOT_DOF : ROOT_DOF + 2] * self._righting(model), (0, 1))
        up, eye = body.R_world_pelvis[:, 2], np.eye(3, dtype=weights.dtype)
        both = jnp.outer(lean, up)
        away = jnp.sum(turned * _turn(pose, last.pose)[1:]) / 2 + jnp.sum(lean * up)
        N = model.skeleton.costs.size
        bent = (both + both.T) / 2 - away * eye
        return jnp.zeros((N, N), bent.dtype).at[3:ROOT_DOF, 3:ROOT_DOF].set(bent)

    def _nearness(self, model: Model, last: LastPose) -> Array:
        """(6 + D,) by which a way from the last pose counts."""
        costs = model.skeleton.costs
        forgotten = jnp.full_like(costs, 1 / FORGOTTEN_JOINTS).at[:ROOT_DOF].set(1 / FORGOTTEN)
        return jnp.where(jnp.asarray(last.remembered), costs / self.memory, forgotten)

    def _righting(self, model: Model) -> Array:
        """(2,) by which a lean of the pelvis counts."""
        return model.skeleton.costs[3:5] * jnp.sqrt(self.uprightness)

    def _ease(self, model: Model, last: LastPose, near: Array) -> tuple[Array, Array]:
        """Angles (D,) between the last ones and the relaxed, and by which those off them count."""
        shares = last.effort + LEAST_SHARE
        easing = model.skeleton.costs[ROOT_DOF:] ** 2 * 2 * self.relaxation * shares
        total = near**2 + easing
        towards = easing / total * (model.skeleton.relaxed - last.pose.angles)
        return last.pose.angles + towards, jnp.sqrt(total)


def _turn(pose: Pose, origin: Pose) -> Array:
    """Quaternion (4,) that turns the pelvis of ``origin`` to that of ``pose``, the shorter way."""
    back = origin.quaternion * jnp.asarray([1, -1, -1, -1], origin.quaternion.dtype)
    turn = quaternion_multiply(pose.quaternion, back)
    return jnp.where(turn[0] < 0, -turn, turn)


@settings
class NearPose(Term):
    """A pose near another one, its pelvis near the vertical; measured ``centre``, a pose."""

    needs: ClassVar[tuple[str, ...]] = ("centre",)
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
        moved = difference(body.pose, measured.centre)
        deviations = self.deviations(model.skeleton)
        return jnp.concatenate([moved / deviations, body.R_world_pelvis[:2, 2] / self.lean])


class EstimatedPose(NamedTuple):
    """A pose that something else estimated, and how surely, as a quadratic about it."""

    pose: Pose
    # (N, N) whose root^T root is the Hessian of half the cost, by the tangent vector from the pose.
    root: Array | np.ndarray
    offset: Array | np.ndarray  # (N,) whose root^T offset is half the cost's derivative at the pose


@settings
class NearEstimate(Term):
    """A pose as something else estimated it; measured ``estimate``, an ``EstimatedPose``."""

    needs: ClassVar[tuple[str, ...]] = ("estimate",)

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(N,), N = 6 + D."""
        estimate = measured.estimate
        off = difference(body.pose, estimate.pose)
        return jnp.matmul(estimate.root, off, precision=HIGHEST) + estimate.offset


@settings
class UsualPlaces(Term):
    """Landmarks where people usually have them; measured ``usual``, ``Usual`` of one moment."""

    errors_last: ClassVar[bool] = True
    spread: Array = traced(1.0, "of landmarks about their usual places, as a multiple of people's")

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(K, 3); none where nothing is usual."""
        if measured.usual is None:
            return jnp.zeros(0, body.landmarks.dtype)
        usual = measured.usual
        away = body.landmarks[USUAL_ROWS] - usual.places
        return jnp.einsum("kij,kj->ki", usual.roots, away, precision=HIGHEST) / self.spread


class Usual(NamedTuple):
    """Where ``USUAL`` landmarks usually are."""

    places: Array | np.ndarray  # (..., K, 3) world, metres
    roots: Any  # (..., K, 3, 3) that whiten what is off them; 0 where nothing is usual
