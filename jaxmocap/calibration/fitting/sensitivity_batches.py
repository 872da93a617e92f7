"""Derivatives of what frames and views cost, and how they follow the model: batches of each.

Everything is by a step (N + P,): of the pose as ``retract`` takes it, then of the proportions.

INPUTS: what is fixed, as a tuple: model or person, terms or softness, proportions; a batch of
frames or of views, as a tuple of what each has. OUTPUTS: gradients, Hessians; changes forwards and
backwards.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
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

Batch = Callable[[tuple[Any, ...], tuple[Any, ...]], Any]


def of_frames(one: Callable[..., Any]) -> Batch:
    """A function of what is fixed and of one frame, over a batch of them."""
    return jax.jit(lambda fixed, each: jax.vmap(partial(one, *fixed))(*each))


def of_views(one: Callable[..., Any]) -> Batch:
    """The same of views, one after the other."""
    return jax.jit(lambda fixed, each: jax.lax.map(lambda view: one(*fixed, *view), each))


def _moved(skeleton: Skeleton, proportions: Array, pose: Pose, step: Array) -> tuple[Any, ...]:
    """Person and pose after a step."""
    n = ROOT_DOF + pose.angles.size
    return scaled(skeleton, proportions + step[n:]), retract(pose, step[:n])


def _half(
    model: Model, terms: Sequence[Term], proportions: Array, pose: Pose, measured: Measurements,
    pull: Array, step: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """Half a frame's cost, the prior's pull (L * 3,) included, and the landmarks (L * 3,)."""
    person, there = _moved(model.skeleton, proportions, pose, step)
    r = residuals(terms, replace(model, skeleton=person), there, measured)
    points = landmarks(person, there).ravel()
    return jnp.sum(r**2) / 2 + points @ pull, points


def _limbs(
    skeleton: Skeleton, camera: Camera, proportions: Array, pose: Pose, view: SilhouetteGrids,
    step: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """Limbs (K, 6) of a person after a step, and the visible share of a forearm."""
    person, there = _moved(skeleton, proportions, pose, step)
    discs, visible = project_limbs(person, forward(person, there), camera, view)
    return jnp.concatenate([discs.near, discs.far, discs.radii], -1), visible


def _slope(
    skeleton: Skeleton, visible: Array, view: SilhouetteGrids, softness: Array, flat: Array
) -> Array:
    """(K, 6) of what half a view costs, by its limbs."""
    discs = Discs(flat[:, :2], flat[:, 2:4], flat[:, 4:])
    return limbs_fit(skeleton.tree, discs, visible, view, softness).gradient


def _still(pose: Pose, proportions: Array) -> Array:
    return jnp.zeros(ROOT_DOF + pose.angles.size + proportions.size, pose.angles.dtype)


def _frame_uphill(
    terms: Sequence[Term], proportions: Array, pose: Pose, measured: Measurements, pull: Array,
    model: Model,
) -> tuple[Array, Array]:  # fmt: skip
    """A frame's gradient and landmarks."""
    half = partial(_half, model, terms, proportions, pose, measured, pull)
    return jax.grad(half, has_aux=True)(_still(pose, proportions))


def _view_uphill(
    proportions: Array, softness: Array, pose: Pose, view: SilhouetteGrids, skeleton: Skeleton,
    camera: Camera,
) -> Array:  # fmt: skip
    """What half a view's cost rises by with a step."""
    limbs = partial(_limbs, skeleton, camera, proportions, pose, view)
    flat, back, visible = jax.vjp(limbs, _still(pose, proportions), has_aux=True)
    return back(_slope(skeleton, visible, view, softness, flat))[0]


@of_frames
def frames_landmarks(skeleton, proportions, pose):
    """(L * 3,) world, metres."""
    return landmarks(scaled(skeleton, proportions), pose).ravel()


@of_frames
def frames_slopes(model, terms, proportions, pose, measured, pull):
    """Hessian, gradient and the landmarks' derivative."""
    half = partial(_half, model, terms, proportions, pose, measured, pull)

    def uphill(step: Array) -> tuple[Array, Array]:
        slope = jax.grad(half, has_aux=True)(step)[0]
        return slope, slope

    still = _still(pose, proportions)
    hessian, slope = jax.jacfwd(uphill, has_aux=True)(still)
    return hessian, slope, jax.jacfwd(lambda step: half(step)[1])(still)


@of_frames
def frames_forwards(model, change, terms, proportions, *frame):
    """How gradient and landmarks change."""
    return jax.jvp(partial(_frame_uphill, terms, proportions, *frame), (model,), (change,))[1]


@of_frames
def frames_backwards(model, terms, proportions, pose, measured, pull, *back):
    """What gradient and landmarks pass back to the model."""
    uphill = partial(_frame_uphill, terms, proportions, pose, measured, pull)
    return jax.vjp(uphill, model)[1](back)[0]


@of_views
def views_slopes(skeleton, proportions, softness, pose, camera, view):
    """Hessian and gradient."""
    limbs = partial(_limbs, skeleton, camera, proportions, pose, view)
    still = _still(pose, proportions)
    flat, visible = limbs(still)
    uphill = partial(_slope, skeleton, visible, view, softness)

    def row(way: Array) -> Array:
        return jax.jvp(uphill, (flat,), (jnp.broadcast_to(way, flat.shape),))[1]

    slope = uphill(flat)
    # No cell belongs to two limbs: one direction of all limbs at once gives a row of each.
    blocks = jax.vmap(row)(jnp.eye(OUTLINE_NUMBERS, dtype=still.dtype))
    L = jax.jacfwd(lambda step: limbs(step)[0])(still)
    bent = jax.hessian(lambda step: jnp.sum(slope * limbs(step)[0]))(still)
    hessian = jnp.einsum("kia,ikj,kjb->ab", L, blocks, L, precision=HIGHEST) + bent
    return hessian, jnp.einsum("ki,kia->a", slope, L, precision=HIGHEST)


@of_views
def views_forwards(skeleton, change, proportions, softness, pose, camera, view, turn):
    """How the gradient changes with the person and the camera."""
    uphill = partial(_view_uphill, proportions, softness, pose, view)
    return jax.jvp(uphill, (skeleton, camera), (change, turn))[1]


@of_views
def views_backwards(skeleton, proportions, softness, pose, camera, view, back):
    """What the gradient passes back to person and camera."""
    uphill = partial(_view_uphill, proportions, softness, pose, view)
    return jax.vjp(uphill, skeleton, camera)[1](back)
