"""Residuals of several terms about a pose: their Jacobian and their second derivatives.

Terms see a posed body, whose derivatives by the pose have formulas (equation (4)). So automatic
differentiation goes through each term alone, not through the tree of bones.

INPUTS: terms, a Model, a pose, what was measured. OUTPUTS: whitened residuals, their derivatives.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.kinematics import (
    curvature,
    forward,
    jacobian,
    landmark_sites,
    site_positions,
)
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose
from jaxmocap.body.proportions import scale_skeleton
from jaxmocap.body.skeleton import LANDMARKS
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.evidence.terms import (
    Measurements,
    PosedBody,
    Term,
    body_sites,
    check_measured,
    joined_residuals,
    posed_body,
    residual_of,
)
from jaxmocap.geometry.rotations import HIGHEST, hat, quaternion_multiply


class Linear(NamedTuple):
    """Residuals about a pose, and how they change with N = 6 + D + P unknowns."""

    residuals: Array  # (R,)
    jacobian: Array  # (R, N) by the tangent vector of ``retract`` and by the proportions
    points: Array  # (3 L,) landmarks, world, metres
    points_jacobian: Array  # (3 L, N)


def expand_terms(
    terms: Sequence[Term], model: Model, pose: Pose, measured: Measurements, bends: bool = True
) -> tuple[Array, Array, Array]:
    """All residuals (R,), Jacobian (R, N) and sum of second derivatives times residuals (N, N).

    Args:
        terms: of the evidence.
        model: of the person, the markers and the cameras.
        pose: of the person; N = 6 + D.
        measured: of this moment.
        bends: whether second derivatives are found; else that sum is 0.
    """
    body = posed_body(model, pose, forward(model.skeleton, pose))
    N = ROOT_DOF + pose.angles.size
    each = [_by_formulas(term, model, body, measured, bends) for term in terms]
    others = [term for term, own in zip(terms, each, strict=True) if own is None]
    bending = sum((own[2] for own in each if own), start=jnp.zeros((N, N), pose.angles.dtype))
    if others:
        # Those without formulas at one go, and then back in the terms' order.
        derivatives, bare = _Derivatives.of(model, body), body._replace(frames=None)

        def of_body(body: PosedBody) -> list[Array]:
            return [term.residual(model, body, measured).ravel() for term in others]

        def with_slope(body: PosedBody) -> tuple[list[Array], PosedBody]:
            r, pull = jax.vjp(of_body, body)
            return r, pull(jax.lax.stop_gradient(r))[0]

        if bends:
            # Both at one go: what the first derivative needs is a part of the second.
            (r, slope), push = jax.linearize(with_slope, bare)
            rows, bent = jax.vmap(push)(derivatives.each)
            S = derivatives.times(bent) + derivatives.bending(model, body, slope)
            bending = bending + (S + S.T) / 2
        else:
            r, push = jax.linearize(of_body, bare)
            rows = jax.vmap(push)(derivatives.each)
        left = iter(zip(r, (J.T for J in rows), strict=True))
        each = [next(left) if own is None else own for own in each]
    r, J = (jnp.concatenate([own[i] for own in each if own]) for i in (0, 1))
    return r, J, bending


def _by_formulas(
    term: Term, model: Model, body: PosedBody, measured: Measurements, bends: bool
) -> tuple[Array, Array, Array] | None:
    """A term's residuals (R,), Jacobian (R, N) and second derivatives (N, N); or no formulas."""
    check_measured(term, measured)
    J, N = term.jacobian(model, body, measured), model.skeleton.costs.size
    if J is None:
        return None
    r = term.residual(model, body, measured)
    S = term.curvature(model, body, measured, r) if bends else jnp.zeros((N, N), r.dtype)
    return None if S is None else (r.ravel(), J.reshape(-1, N), S)


def linearise_terms(
    terms: Sequence[Term], model: Model, proportions: Array, pose: Pose, measured: Measurements
) -> Linear:
    """Residuals about a pose.

    Args:
        terms: of the evidence.
        model: its skeleton unscaled.
        proportions: (P,) of ``scale_skeleton``; P may be 0.
        pose: of the person.
        measured: of this moment.
    """

    def resized(logarithms: Array) -> Model:
        return replace(model, skeleton=scale_skeleton(model.skeleton, logarithms))

    person = resized(proportions) if proportions.size else model
    r, J, _ = expand_terms(terms, person, pose, measured, bends=False)
    skeleton, sites = person.skeleton, landmark_sites(person.skeleton)
    frames = forward(skeleton, pose)
    points = site_positions(skeleton, frames, sites)
    points_J = jacobian(skeleton, frames, sites.bones, points).reshape(points.size, -1)
    if proportions.size:

        def outputs(logarithms: Array) -> tuple[Array, Array]:
            own = resized(logarithms)
            body = posed_body(own, pose)
            return joined_residuals(terms, own, body, measured), body.landmarks.ravel()

        by_size = jax.jacfwd(outputs)(proportions)
        J, points_J = (
            jnp.concatenate(pair, -1) for pair in zip((J, points_J), by_size, strict=True)
        )
    return Linear(r, J, points.ravel(), points_J)


def linearise_term(
    term: Term, model: Model, pose: Pose, measured: Measurements
) -> tuple[Array, Array]:
    """A term's residuals (...) about a pose, and their derivatives (..., 6 + D).

    Args:
        term: of the evidence.
        model: of the person, the markers and the cameras.
        pose: of the person.
        measured: of this moment.
    """

    def residual(pose: Pose) -> Array:
        return residual_of(term, model, posed_body(model, pose), measured)

    shape = jax.eval_shape(residual, pose).shape
    r, J, _ = expand_terms((term,), model, pose, measured, bends=False)
    return r.reshape(shape), J.reshape(*shape, J.shape[-1])


def residuals_and_pull(
    terms: Sequence[Term], model: Model, pose: Pose, measured: Measurements, weights: Array
) -> tuple[Array, Array]:
    """All residuals (R,), and the derivative (6 + D,) of the residuals times weights (R,)."""
    body = posed_body(model, pose)._replace(frames=forward(model.skeleton, pose))
    N = ROOT_DOF + pose.angles.size
    each = [residual_of(term, model, body, measured).ravel() for term in terms]
    own = jnp.split(weights, np.cumsum([r.size for r in each])[:-1])
    total, others = jnp.zeros(N, weights.dtype), []
    for term, w in zip(terms, own, strict=True):
        J = term.jacobian(model, body, measured)
        if J is None:
            others.append((term, w))
        else:
            total = total + jnp.matmul(w, J.reshape(-1, N), precision=HIGHEST)
    if others:
        left, w = [term for term, _ in others], jnp.concatenate([w for _, w in others])

        def weighed(body: PosedBody) -> Array:
            return jnp.sum(joined_residuals(left, model, body, measured) * w)

        slope = jax.grad(weighed)(body._replace(frames=None))
        total = total + _Derivatives.of(model, body).pull(slope)
    return jnp.concatenate(each), total


class _Derivatives(NamedTuple):
    """Of a posed body by the tangent vector of ``retract``."""

    points_world: Array  # (P, 3) of ``body_sites``
    shares: Array  # of the bones in the mass
    each: PosedBody  # leaves (N, ...), by one entry each; no frames

    @classmethod
    def of(cls, model: Model, body: PosedBody) -> "_Derivatives":
        skeleton, pose, frames = model.skeleton, body.pose, body.frames
        assert frames is not None
        sites = body_sites(model)
        points = site_positions(skeleton, frames, sites)
        J = jnp.moveaxis(jacobian(skeleton, frames, sites.bones, points), -1, 0)
        markers = len(body.markers)
        on_markers, landmarks, in_bones = jnp.split(J, [markers, markers + len(LANDMARKS)], 1)
        shares = skeleton.masses / jnp.sum(skeleton.masses)
        gravity = jnp.einsum("p,npi->ni", shares, in_bones, precision=HIGHEST)
        every = jnp.eye(J.shape[0], dtype=points.dtype)
        about = every[:, 3:ROOT_DOF]
        turned = jnp.matmul(hat(about), body.R_world_pelvis, precision=HIGHEST)
        half = jnp.pad(about / 2, ((0, 0), (1, 0)))
        spun = quaternion_multiply(half, jnp.broadcast_to(pose.quaternion, half.shape))
        moved = Pose(every[:, :3], spun, every[:, ROOT_DOF:])
        return cls(points, shares, PosedBody(on_markers, landmarks, turned, gravity, moved))

    def pull(self, slope: PosedBody) -> Array:
        """(N,) of a slope by the posed body."""
        return self.times(jax.tree.map(lambda part: part[None], slope))[:, 0]

    def times(self, others: PosedBody) -> Array:
        """(N, K) inner products with others, leaves (K, ...)."""
        flat = [
            jnp.concatenate([part.reshape(len(part), -1) for part in jax.tree.leaves(body)], 1)
            for body in (self.each, others)
        ]
        return jnp.matmul(flat[0], flat[1].T, precision=HIGHEST)

    def bending(self, model: Model, body: PosedBody, slope: PosedBody) -> Array:
        """Second derivatives (N, N) of the posed body times a slope by it, summed."""
        assert body.frames is not None
        in_bones = self.shares[:, None] * slope.centre_of_gravity
        forces = jnp.concatenate([slope.markers, slope.landmarks, in_bones])
        bones = body_sites(model).bones
        S = curvature(model.skeleton, body.frames, bones, self.points_world, forces)

        # A turn w of the pelvis: R -> exp(hat(w)) R, and q -> exp(w / 2) q.
        M = jnp.matmul(body.R_world_pelvis, slope.R_world_pelvis.T, precision=HIGHEST)
        even = jnp.trace(M) + jnp.sum(slope.pose.quaternion * body.pose.quaternion) / 4
        own = (M + M.T) / 2 - even * np.eye(3, dtype=S.dtype)
        return S.at[3:ROOT_DOF, 3:ROOT_DOF].add(own)
