"""What a term of evidence is, and how the residuals of several are found and linearised together.

A term is one file: a settings record with ``residual``. Solvers and smoothers take a tuple of terms
and know none by name. A new one needs its file, and one line in the settings of whoever uses it.

INPUTS: terms, a Model, a pose, what was measured. OUTPUTS: whitened residuals, their derivatives.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.custom_derivatives import SymbolicZero

from jaxmocap.body.kinematics import (
    Frames,
    Sites,
    forward,
    jacobian,
    joined_sites,
    landmark_sites,
    site_positions,
)
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, retract
from jaxmocap.body.proportions import scaled
from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.geometry.rotations import HIGHEST, quaternion_multiply, quaternion_to_matrix

# Name of a measurement -> arrays; what a term does not find there it has no residuals of.
Measurements = Mapping[str, Any]


class PosedBody(NamedTuple):
    """The body as a pose puts it: all that terms look at.

    Attributes:
        markers: (M, 3) points on bones where markers sit, world, metres.
        landmarks: (L, 3) world, metres.
        R_world_pelvis: (3, 3).
        centre_of_gravity: (3,) world, metres.
        pose: that puts it there.
        frames: of the bones, for Jacobians; None where nobody has them yet.
    """

    markers: Array
    landmarks: Array
    R_world_pelvis: Array
    centre_of_gravity: Array
    pose: Pose
    frames: Frames | None = None


class Term(ABC):
    """A kind of evidence or of prior knowledge; subclasses are settings (``compilation.settings``).

    Attributes:
        errors_last: whether what is wrong with it stays wrong for a while (somebody who stands
            unusually goes on doing so), so that many frames tell no more than few.
    """

    errors_last: ClassVar[bool] = False

    @abstractmethod
    def residual(self, model: Model, body: PosedBody, measured: Measurements) -> Array:
        """Whitened residuals (...): of unit variance where model and measurements are right.

        Args:
            model: of the person, the markers and the cameras.
            body: as the pose puts it.
            measured: of this moment.
        """

    def jacobian(self, model: Model, body: PosedBody, measured: Measurements) -> Array | None:
        """Derivatives (..., 6 + D) of the residual by the tangent vector of ``retract``.

        None, as here, has them found by automatic differentiation. It is for what is solved often
        and has a short formula.
        """
        return None

    def curvature(
        self, model: Model, body: PosedBody, measured: Measurements, weights: Array
    ) -> Array | None:
        """Second derivatives (6 + D, 6 + D) of the residual times ``weights``, of its shape.

        None, as here, has them found by automatic differentiation.
        """
        return None

    @property
    def metres_per_deviation(self) -> Array | None:
        """The length that a residual of 1 stands for; None where residuals are no lengths."""
        return None


class Linear(NamedTuple):
    """Residuals about a pose, and how they change with N = 6 + D + P unknowns.

    Attributes:
        residuals: (R,).
        jacobian: (R, N) by the tangent vector of ``retract`` and by the proportions.
        points: (3 L,) landmarks, world, metres.
        points_jacobian: (3 L, N).
    """

    residuals: Array
    jacobian: Array
    points: Array
    points_jacobian: Array


def residuals(terms: Sequence[Term], model: Model, pose: Pose, measured: Measurements) -> Array:
    """All whitened residuals (R,) of a pose."""
    return _joined(terms, model, posed_body(model, pose), measured)


def linearised(
    terms: Sequence[Term], model: Model, proportions: Array, pose: Pose, measured: Measurements
) -> Linear:
    """Residuals about a pose.

    Args:
        terms: of the evidence.
        model: its skeleton unscaled.
        proportions: (P,) of ``scaled``; P may be 0.
        pose: of the person.
        measured: of this moment.
    """

    def resized(logarithms: Array) -> Model:
        if not proportions.size:
            return model
        return replace(model, skeleton=scaled(model.skeleton, logarithms))

    def outputs(person: Model, there: Pose) -> tuple[Array, Array]:
        body = posed_body(person, there)
        return _joined(terms, person, body, measured), body.landmarks.ravel()

    still = jnp.zeros(ROOT_DOF + pose.angles.size, pose.angles.dtype)
    person = resized(proportions)
    by_pose = lambda step: outputs(person, retract(pose, step))  # noqa: E731
    (r, points), push = jax.linearize(by_pose, still)
    J, points_J = jax.vmap(push, -1, -1)(jnp.eye(still.size, dtype=still.dtype))
    if proportions.size:
        by_size = jax.jacfwd(lambda logarithms: outputs(resized(logarithms), pose))(proportions)
        J, points_J = (
            jnp.concatenate(pair, -1) for pair in zip((J, points_J), by_size, strict=True)
        )
    return Linear(r, J, points, points_J)


def linearised_term(
    term: Term, model: Model, pose: Pose, measured: Measurements
) -> tuple[Array, Array]:
    """A term's residuals (...) about a pose, and their derivatives (..., 6 + D).

    Args:
        term: of the evidence.
        model: of the person, the markers and the cameras.
        pose: of the person.
        measured: of this moment.
    """
    body = posed_body(model, pose)
    J = term.jacobian(model, body, measured)
    if J is not None:
        return term.residual(model, body, measured), J
    still = jnp.zeros(ROOT_DOF + pose.angles.size, pose.angles.dtype)

    def moved(step: Array) -> Array:
        return term.residual(model, posed_body(model, retract(pose, step)), measured)

    r, push = jax.linearize(moved, still)
    return r, jax.vmap(push, -1, -1)(jnp.eye(still.size, dtype=still.dtype))


def second_order(
    terms: Sequence[Term], model: Model, pose: Pose, measured: Measurements
) -> tuple[Array, Array, Array]:
    """All residuals (R,), Jacobian (R, N) and sum of second derivatives times residuals (N, N).

    Args:
        terms: of the evidence.
        model: of the person, the markers and the cameras.
        pose: of the person; N = 6 + D.
        measured: of this moment.
    """
    body, N = posed_body(model, pose), ROOT_DOF + pose.angles.size
    body = body._replace(frames=forward(model.skeleton, pose))
    still, each = jnp.zeros(N, pose.angles.dtype), []
    bending = jnp.zeros((N, N), still.dtype)
    for term in terms:
        r, J = term.residual(model, body, measured), term.jacobian(model, body, measured)
        S = None if J is None else term.curvature(model, body, measured, r)
        if J is None or S is None:
            each.append((r.ravel(), None))
        else:
            each.append((r.ravel(), J.reshape(-1, N)))
            bending = bending + S
    others = [term for term, (_, J) in zip(terms, each, strict=True) if J is None]
    if others:
        # Those without formulas at one go, and then back in the terms' order.
        def moved(step: Array) -> Array:
            return residuals(others, model, retract(pose, step), measured)

        r, push = jax.linearize(moved, still)
        rows = jax.vmap(push, -1, -1)(jnp.eye(N, dtype=still.dtype))
        ends = np.cumsum([r.size for r, J in each if J is None])[:-1]
        left = iter(jnp.split(rows, ends))
        each = [(r, next(left) if J is None else J) for r, J in each]
        S = jax.jacfwd(partial(pull, others, model, pose, measured, r))(still)
        bending = bending + (S + S.T) / 2
    r, J = (jnp.concatenate(parts) for parts in zip(*each, strict=True))
    return r, J, bending


def pull(
    terms: Sequence[Term],
    model: Model,
    pose: Pose,
    measured: Measurements,
    weights: Array,
    step: Array,
) -> Array:
    """Derivative (6 + D,) of residuals times weights (R,), where a step from a pose leads."""
    there = retract(pose, step)

    def weighed(further: Array) -> Array:
        return jnp.vdot(residuals(terms, model, retract(there, further), measured), weights)

    return jax.grad(weighed)(jnp.zeros_like(step))


def posed_body(model: Model, pose: Pose) -> PosedBody:
    """The body as a pose puts it; its derivative by the pose is the geometric Jacobian."""
    skeleton, markers = model.skeleton, len(model.markers.bone_indices)
    every = np.arange(len(skeleton.tree.bones))
    centres = Sites(every, skeleton.centres, jnp.zeros((len(every), 3), skeleton.centres.dtype))
    sites = joined_sites(joined_sites(model.markers, landmark_sites(skeleton)), centres)
    points = points_on(skeleton, pose, sites)
    on_markers, landmarks, in_bones = jnp.split(points, [markers, markers + len(LANDMARKS)])
    shares = skeleton.masses / jnp.sum(skeleton.masses)
    gravity = jnp.matmul(shares, in_bones, precision=HIGHEST)
    return PosedBody(on_markers, landmarks, quaternion_to_matrix(pose.quaternion), gravity, pose)


@jax.custom_jvp
def points_on(skeleton: Skeleton, pose: Pose, sites: Sites) -> Array:
    """Points (M, 3) on bones in the world, metres, with the geometric Jacobian as derivative.

    The same as pushing tangents along the tree, at a fifth of the time.
    """
    return site_positions(skeleton, forward(skeleton, pose), sites)


def _points_on_jvp(primals: tuple, tangents: tuple) -> tuple[Array, Array]:
    skeleton, pose, sites = primals
    frames = forward(skeleton, pose)
    points = site_positions(skeleton, frames, sites)
    change = jnp.zeros_like(points)
    if not _is_zero(tangents[1]):
        shift, spin, turns = _filled(tangents[1])
        back = pose.quaternion * jnp.array([1.0, -1.0, -1.0, -1.0], spin.dtype)
        step = jnp.concatenate([shift, 2 * quaternion_multiply(spin, back)[1:], turns])
        J = jacobian(skeleton, frames, sites.bones, points)
        change = jnp.einsum("mij,j->mi", J, step, precision=HIGHEST)
    # Bodies and markers have tangents only where somebody differentiates a solution by them.
    others = (tangents[0], tangents[2])
    if not _is_zero(others):

        def along_the_tree(skeleton: Skeleton, sites: Sites) -> Array:
            return site_positions(skeleton, forward(skeleton, pose), sites)

        change = change + jax.jvp(along_the_tree, (skeleton, sites), _filled(others))[1]
    return points, change


points_on.defjvp(_points_on_jvp, symbolic_zeros=True)


def _symbolic(leaf: Any) -> bool:
    return isinstance(leaf, SymbolicZero)


def _is_zero(tangents: Any) -> bool:
    return all(map(_symbolic, jax.tree.leaves(tangents, is_leaf=_symbolic)))


def _filled(tangents: Any) -> Any:
    """Tangents with symbolic zeros as arrays."""

    def fill(leaf: Any) -> Array:
        return jnp.zeros(leaf.shape, leaf.dtype) if _symbolic(leaf) else leaf

    return jax.tree.map(fill, tangents, is_leaf=_symbolic)


def _joined(terms: Sequence[Term], model: Model, body: PosedBody, measured: Measurements) -> Array:
    return jnp.concatenate([term.residual(model, body, measured).ravel() for term in terms])
