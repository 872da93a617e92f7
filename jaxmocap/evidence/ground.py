"""The ground: feet that no marker holds stand on it.

INPUTS: a posed body; ankles of the markers' pose, or the floor at z = 0. OUTPUTS: whitened
residuals.
"""

from math import asin
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.model import SIDES, Model
from jaxmocap.body.skeleton import landmark_rows
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.compilation.settings import settings, traced
from jaxmocap.evidence.posture import SOFT, excess, length
from jaxmocap.evidence.terms import Measurements, PosedBody, Term
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.solvers.robust import shorten_residuals

ANKLES = landmark_rows(("ankle_l", "ankle_r"))
KNEES = landmark_rows(("knee_l", "knee_r"))
# Sines of how far a shank leans over a flat foot: 40 degrees ahead, 25 back. Chosen, no source.
FARTHEST_AHEAD, FARTHEST_BACK = 0.64, -0.42
# A foot whose ankle is off its height on the ground by so much, metres, is hardly flat.
LIFTED_M = 0.04
# The floor gives way by about so much, metres.
SOFT_M = 0.005


@settings
class Ground(Term):
    """Feet on the ground; measured ``ankles`` (2, 3) of the markers' pose, world, metres."""

    errors_last: ClassVar[bool] = True
    needs: ClassVar[tuple[str, ...]] = ("ankles",)
    height: Array = traced(0.05, "of the height of ankles that no marker holds, metres")
    place: Array = traced(1.0, "of their place on the ground about the markers' pose's, metres")

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(2, 3); none where a marker holds a foot."""
        if not model.no_foot_is_marked:
            return jnp.zeros(0, body.landmarks.dtype)
        deviations = jnp.stack([self.place, self.place, self.height])
        return (body.landmarks[ANKLES] - measured.ankles) / deviations


@settings
class AnkleRange(Term):
    """Shanks over feet on the ground lean no farther than ankles let them.

    Measured ``ankles`` (2, 3) of the markers' pose, world, metres. A foot that is lifted, if only
    by its heel, lets its shank lean.
    """

    errors_last: ClassVar[bool] = True
    needs: ClassVar[tuple[str, ...]] = ("ankles",)
    beyond: Array = traced(
        0.1, "of how far a shank leans beyond what the ankle of a flat foot allows, radians"
    )

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(2, 2) ahead and back; none where a marker holds a foot."""
        if not model.no_foot_is_marked:
            return jnp.zeros(0, body.landmarks.dtype)
        knees, ankles = body.landmarks[KNEES], body.landmarks[ANKLES]
        shanks, ahead = knees - ankles, body.R_world_pelvis[:2, 0]
        lean = jnp.sum(shanks[:, :2] * ahead, -1) / (length(shanks) * length(ahead))
        beyond = excess(jnp.stack([lean - FARTHEST_AHEAD, FARTHEST_BACK - lean], -1))
        lifted = (ankles[:, 2:] - measured.ankles[:, 2:]) / LIFTED_M
        return beyond / (self.beyond * (1 + lifted**2))


@settings
class KneesOverFeet(Term):
    """``AnkleRange`` ahead of feet that stand, by the angles of hips and knees, with formulas.

    How the pelvis leans is left out, so that it leans a little instead. Silent for a body without
    joints ``hip_flexion`` and ``knee_flexion``.
    """

    beyond: Array = traced(
        0.2, "of how far a shank leans beyond what the ankle of a flat foot allows, radians"
    )

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(2,); none where a marker holds a foot."""
        return excess(self._lean(model, body)[0]) / self.beyond

    def jacobian(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(2, 6 + D)."""
        lean, by_pose = self._lean(model, body)
        slope = (1 + lean / jnp.sqrt(lean**2 + SOFT**2)) / 2
        return slope[:, None] / self.beyond * by_pose

    def curvature(
        self, model: Model, body: PosedBody, measured: Measurements, weights: Array
    ) -> Array:
        """(6 + D, 6 + D)."""
        lean, by_pose = self._lean(model, body)
        bend = SOFT**2 / (lean**2 + SOFT**2) ** 1.5 / 2
        bent = (weights * bend / self.beyond)[:, None] * by_pose
        return jnp.matmul(by_pose.T, bent, precision=HIGHEST)

    def _lean(self, model: Model, body: PosedBody) -> tuple[Array, Array]:
        """(2,) radians beyond the farthest lean, and their derivative (2, 6 + D)."""
        joints, dtype = model.skeleton.tree.joints, body.pose.angles.dtype
        sides = SIDES if model.no_foot_is_marked else ()
        pairs = [(f"knee_flexion_{side}", f"hip_flexion_{side}") for side in sides]
        pairs = [pair for pair in pairs if set(pair) <= set(joints)]
        by_pose = np.zeros((len(pairs), ROOT_DOF + len(joints)))
        for row, (knee, hip) in zip(by_pose, pairs, strict=True):
            row[ROOT_DOF + joints.index(knee)], row[ROOT_DOF + joints.index(hip)] = 1, -1
        rows = jnp.asarray(by_pose, dtype)
        lean = jnp.matmul(rows[:, ROOT_DOF:], body.pose.angles, precision=HIGHEST)
        return lean - asin(FARTHEST_AHEAD), rows


@settings
class FeetOnFloor(Term):
    """The floor, z = 0: no landmark lies below it, and the lower foot stands on it.

    Unless that is far off (Student's t): somebody jumps, or lies.
    """

    errors_last: ClassVar[bool] = True
    height: Array = traced(0.03, "of the lower foot above the floor, metres")
    ankle: Array = traced(0.07, "height of the ankle of a foot on the floor, metres")

    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """(1 + L,)."""
        heights = body.landmarks[:, 2]
        standing = (jnp.min(heights[ANKLES]) - self.ankle)[None] / self.height
        # A smooth minimum of height and 0.
        below = (heights - jnp.sqrt(heights**2 + SOFT_M**2)) / 2
        return jnp.concatenate([shorten_residuals(standing), below / self.height])
