"""Derivatives of what frames and views cost, and how they follow the model: batches of each.

Everything is by a step (N + P,): of the pose as ``retract`` takes it, then of the proportions.

INPUTS: a model, poses, what was measured of frames, views.
OUTPUTS: gradients, Hessians; changes forwards and backwards.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.body.kinematics import forward, landmarks
from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose, retract
from jaxmocap.body.proportions import scaled
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.tree import ROOT_DOF
from jaxmocap.evidence.silhouettes import SilhouetteGrids, limbs_fit, project_limbs
from jaxmocap.evidence.terms import Measurements, Term, residuals
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.outlines import Discs
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.images.silhouette_grid import OUTLINE_NUMBERS


def _frame_half(
    model: Model,
    fixed: tuple[Any, ...],
    pose: Pose,
    measured: Measurements,
    pull: Array,
    step: Array,
) -> tuple[Array, Array]:
    """Half a frame's cost, the prior's pull at its landmarks included, and the landmarks (L * 3,).

    Args:
        model: of the recording, unscaled.
        fixed: terms, proportions.
        pose: to be moved.
        measured: of the frame.
        pull: (L * 3,).
        step: (N + P,) of pose and proportions.
    """
    terms, proportions = fixed
    n = ROOT_DOF + pose.angles.size
    person = scaled(model.skeleton, proportions + step[n:])
    there = retract(pose, step[:n])
    r = residuals(terms, replace(model, skeleton=person), there, measured)
    points = landmarks(person, there).ravel()
    return jnp.sum(r**2) / 2 + points @ pull, points


def _drawn_by(
    skeleton: Skeleton,
    proportions: Array,
    camera: Camera,
    pose: Pose,
    view: SilhouetteGrids,
    step: Array,
) -> tuple[Array, Array]:
    """Limbs (K, 6) of a person moved by a step (N + P,), and the visible share of a forearm."""
    n = ROOT_DOF + pose.angles.size
    person = scaled(skeleton, proportions + step[n:])
    frames = forward(person, retract(pose, step[:n]))
    discs, visible = project_limbs(person, frames, camera, view)
    return jnp.concatenate([discs.near, discs.far, discs.radii], -1), visible


def _still(pose: Pose, proportions: Array) -> Array:
    return jnp.zeros(ROOT_DOF + pose.angles.size + proportions.size, pose.angles.dtype)


@jax.jit
def frames_landmarks(skeleton: Skeleton, proportions: Array, poses: Pose) -> Array:
    """(B, L * 3) of a batch of poses, world, metres."""
    person = scaled(skeleton, proportions)
    return jax.vmap(lambda pose: landmarks(person, pose).ravel())(poses)


@jax.jit
def frames_slopes(
    model: Model, terms: Sequence[Term], proportions: Array, poses: Pose, measured: Measurements,
    pull: Array,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Hessians, gradients and the landmarks' derivatives of a batch of frames."""
    fixed = (terms, proportions)

    def of_frame(pose: Pose, one: Measurements, pull: Array) -> tuple[Array, Array, Array]:
        def half(step: Array) -> tuple[Array, Array]:
            return _frame_half(model, fixed, pose, one, pull, step)

        def uphill(step: Array) -> tuple[Array, Array]:
            slope = jax.grad(half, has_aux=True)(step)[0]
            return slope, slope

        still = _still(pose, proportions)
        hessian, slope = jax.jacfwd(uphill, has_aux=True)(still)
        return hessian, slope, jax.jacfwd(lambda step: half(step)[1])(still)

    return jax.vmap(of_frame)(poses, measured, pull)


def _frame_uphill(
    fixed: tuple[Any, ...], pose: Pose, measured: Measurements, pull: Array
) -> Callable[[Model], tuple[Array, Array]]:
    """A frame's gradient and landmarks, as functions of the model."""

    def uphill(model: Model) -> tuple[Array, Array]:
        def half(step: Array) -> tuple[Array, Array]:
            return _frame_half(model, fixed, pose, measured, pull, step)

        return jax.grad(half, has_aux=True)(_still(pose, fixed[1]))

    return uphill


def _view_uphill(
    drawing: tuple[Array, Array], pose: Pose, view: SilhouetteGrids
) -> Callable[[Skeleton, Camera], Array]:
    """What half a view's cost rises by with a step, as a function of person and camera."""
    proportions, softness = drawing

    def uphill(skeleton: Skeleton, camera: Camera) -> Array:
        def limbs(step: Array) -> tuple[Array, Array]:
            return _drawn_by(skeleton, proportions, camera, pose, view, step)

        flat, back, visible = jax.vjp(limbs, _still(pose, proportions), has_aux=True)
        fit = limbs_fit(skeleton.tree, _discs(flat), visible, view, softness)
        return back(fit.gradient)[0]

    return uphill


@jax.jit
def frames_forwards(
    model: Model, change: Model, terms: Sequence[Term], proportions: Array, poses: Pose,
    measured: Measurements, pull: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """How gradients and landmarks of a batch of frames change."""

    def of_frame(pose: Pose, one: Measurements, pull: Array) -> tuple[Array, Array]:
        uphill = _frame_uphill((terms, proportions), pose, one, pull)
        return jax.jvp(uphill, (model,), (change,))[1]

    return jax.vmap(of_frame)(poses, measured, pull)


@jax.jit
def frames_backwards(
    model: Model, terms: Sequence[Term], proportions: Array, poses: Pose, measured: Measurements,
    pull: Array, by_uphill: Array, by_points: Array,
) -> Model:  # fmt: skip
    """What a batch of frames' gradients and landmarks pass back to the model, each."""

    def of_frame(pose: Pose, one: Measurements, pull: Array, *back: Array) -> Model:
        uphill = _frame_uphill((terms, proportions), pose, one, pull)
        (pulled_back,) = jax.vjp(uphill, model)[1](back)
        return pulled_back

    return jax.vmap(of_frame)(poses, measured, pull, by_uphill, by_points)


@jax.jit
def views_slopes(
    skeleton: Skeleton, proportions: Array, softness: Array, poses: Pose, cameras: Camera,
    views: SilhouetteGrids,
) -> tuple[Array, Array]:  # fmt: skip
    """Hessians and gradients of a batch of views."""

    def of_view(each: tuple[Pose, Camera, SilhouetteGrids]) -> tuple[Array, Array]:
        pose, camera, view = each
        still = _still(pose, proportions)

        def limbs(step: Array) -> Array:
            return _drawn_by(skeleton, proportions, camera, pose, view, step)[0]

        def uphill(flat: Array) -> Array:
            fit = limbs_fit(skeleton.tree, _discs(flat), visible, view, softness)
            return fit.gradient

        def row(way: Array) -> Array:
            return jax.jvp(uphill, (flat,), (jnp.broadcast_to(way, flat.shape),))[1]

        flat, visible = _drawn_by(skeleton, proportions, camera, pose, view, still)
        slope = uphill(flat)
        # No cell belongs to two limbs: one direction of all limbs at once gives a row of each.
        blocks = jax.vmap(row)(jnp.eye(OUTLINE_NUMBERS, dtype=still.dtype))
        L = jax.jacfwd(limbs)(still)
        bent = jax.hessian(lambda step: jnp.sum(slope * limbs(step)))(still)
        hessian = jnp.einsum("kia,ikj,kjb->ab", L, blocks, L, precision=HIGHEST) + bent
        return hessian, jnp.einsum("ki,kia->a", slope, L, precision=HIGHEST)

    return jax.lax.map(of_view, (poses, cameras, views))


def _discs(flat: Array) -> Discs:
    return Discs(flat[:, :2], flat[:, 2:4], flat[:, 4:])


@jax.jit
def views_forwards(
    skeleton: Skeleton, change: Skeleton, proportions: Array, softness: Array, poses: Pose,
    cameras: Camera, views: SilhouetteGrids, changes: Camera,
) -> Array:  # fmt: skip
    """How gradients of a batch of views change."""

    def of_view(each: tuple[Pose, Camera, SilhouetteGrids, Camera]) -> Array:
        pose, camera, view, turn = each
        uphill = _view_uphill((proportions, softness), pose, view)
        return jax.jvp(uphill, (skeleton, camera), (change, turn))[1]

    return jax.lax.map(of_view, (poses, cameras, views, changes))


@jax.jit
def views_backwards(
    skeleton: Skeleton, proportions: Array, softness: Array, poses: Pose, cameras: Camera,
    views: SilhouetteGrids, by_uphill: Array,
) -> tuple[Skeleton, Camera]:  # fmt: skip
    """What a batch of views' gradients pass back to person and camera, each."""

    def of_view(each: tuple[Pose, Camera, SilhouetteGrids, Array]) -> tuple[Skeleton, Camera]:
        pose, camera, view, back = each
        uphill = _view_uphill((proportions, softness), pose, view)
        return jax.vjp(uphill, skeleton, camera)[1](back)

    return jax.lax.map(of_view, (poses, cameras, views, by_uphill))
