"""Derivatives of what frames and sights cost, and how they follow what was stated: batches of each.

Everything is by a step (N + P,): of the pose as ``retract`` takes it, then of the proportions.

INPUTS: what was stated, poses, what is known of frames, sights.
OUTPUTS: gradients, Hessians; changes forwards and backwards.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.body.kinematics import Sites, forward, landmarks
from jaxmocap.body.pose import Pose, retract
from jaxmocap.body.proportions import scaled
from jaxmocap.body.skeleton import ROOT_DOF, Skeleton
from jaxmocap.evidence.residuals import Known, residuals
from jaxmocap.evidence.silhouettes import Sight, drawn, drawn_fit
from jaxmocap.geometry.cameras import Camera
from jaxmocap.geometry.outlines import Discs
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.images.silhouette_grid import OUTLINE_NUMBERS
from jaxmocap.smoothing.linearise import Problem
from jaxmocap.smoothing.settings import SmoothingSettings


class Stated(NamedTuple):
    """What a recording states, and what the derivative is by.

    Attributes:
        skeleton: of the person.
        cameras: C, stacked.
        offsets: (M, 3) of the markers, metres, in their bones' frames.
    """

    skeleton: Skeleton
    cameras: Camera
    offsets: Array

    @classmethod
    def of(cls, problem: Problem) -> "Stated":
        """What a problem states."""
        return cls(problem.skeleton, problem.cameras, problem.markers.offsets)

    def put_into(self, problem: Problem) -> Problem:
        """The same recording with this stated instead."""
        markers = problem.markers._replace(offsets=self.offsets)
        return replace(problem, skeleton=self.skeleton, cameras=self.cameras, markers=markers)


def _frame_half(
    stated: Stated, fixed: tuple[Any, ...], pose: Pose, known: Known, pull: Array, step: Array
) -> tuple[Array, Array]:
    """Half a frame's cost, the prior's pull at its landmarks included, and the landmarks (L * 3,).

    Args:
        stated: of the recording.
        fixed: markers, settings, proportions.
        pose: to be moved.
        known: of the frame.
        pull: (L * 3,).
        step: (N + P,) of pose and proportions.
    """
    markers, settings, proportions = fixed
    n = ROOT_DOF + pose.angles.size
    person = scaled(stated.skeleton, proportions + step[n:])
    there = retract(pose, step[:n])
    r = residuals(person, markers._replace(offsets=stated.offsets), settings, there, known)
    points = landmarks(person, there).ravel()
    return jnp.sum(r**2) / 2 + points @ pull, points


def _drawn_by(
    skeleton: Skeleton, proportions: Array, camera: Camera, pose: Pose, sight: Sight, step: Array
) -> tuple[Array, Array]:
    """Limbs (K, 6) of a person moved by a step (N + P,), and how much of a forearm is seen."""
    n = ROOT_DOF + pose.angles.size
    person = scaled(skeleton, proportions + step[n:])
    frames = forward(person, retract(pose, step[:n]))
    discs, visible = drawn(person, frames, camera, sight)
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
    stated: Stated, markers: Sites, settings: SmoothingSettings, proportions: Array, poses: Pose,
    known: Known, pull: Array,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Hessians, gradients and the landmarks' derivatives of a batch of frames."""
    fixed = (markers, settings, proportions)

    def of_frame(pose: Pose, one: Known, pull: Array) -> tuple[Array, Array, Array]:
        def half(step: Array) -> tuple[Array, Array]:
            return _frame_half(stated, fixed, pose, one, pull, step)

        def uphill(step: Array) -> tuple[Array, Array]:
            slope = jax.grad(half, has_aux=True)(step)[0]
            return slope, slope

        still = _still(pose, proportions)
        hessian, slope = jax.jacfwd(uphill, has_aux=True)(still)
        return hessian, slope, jax.jacfwd(lambda step: half(step)[1])(still)

    return jax.vmap(of_frame)(poses, known, pull)


def _frame_uphill(
    fixed: tuple[Any, ...], pose: Pose, known: Known, pull: Array
) -> Callable[[Stated], tuple[Array, Array]]:
    """What a frame's gradient and landmarks are, as functions of what was stated."""

    def uphill(stated: Stated) -> tuple[Array, Array]:
        def half(step: Array) -> tuple[Array, Array]:
            return _frame_half(stated, fixed, pose, known, pull, step)

        return jax.grad(half, has_aux=True)(_still(pose, fixed[2]))

    return uphill


def _sight_uphill(
    drawing: tuple[Array, Array], pose: Pose, sight: Sight
) -> Callable[[Skeleton, Camera], Array]:
    """What half a sight's cost rises by with a step, as a function of person and camera."""
    proportions, softness = drawing

    def uphill(skeleton: Skeleton, camera: Camera) -> Array:
        def limbs(step: Array) -> tuple[Array, Array]:
            return _drawn_by(skeleton, proportions, camera, pose, sight, step)

        flat, back, visible = jax.vjp(limbs, _still(pose, proportions), has_aux=True)
        fit = drawn_fit(skeleton.tree, _discs(flat), visible, sight, softness)
        return back(fit.gradient)[0]

    return uphill


@jax.jit
def frames_forwards(
    stated: Stated, change: Stated, markers: Sites, settings: SmoothingSettings,
    proportions: Array, poses: Pose, known: Known, pull: Array,
) -> tuple[Array, Array]:  # fmt: skip
    """How gradients and landmarks of a batch of frames change."""

    def of_frame(pose: Pose, one: Known, pull: Array) -> tuple[Array, Array]:
        uphill = _frame_uphill((markers, settings, proportions), pose, one, pull)
        return jax.jvp(uphill, (stated,), (change,))[1]

    return jax.vmap(of_frame)(poses, known, pull)


@jax.jit
def frames_backwards(
    stated: Stated, markers: Sites, settings: SmoothingSettings, proportions: Array, poses: Pose,
    known: Known, pull: Array, by_uphill: Array, by_points: Array,
) -> tuple[Skeleton, Array]:  # fmt: skip
    """What a batch of frames' gradients and landmarks pass back to person and offsets, each."""

    def of_frame(pose: Pose, one: Known, pull: Array, *back: Array) -> tuple[Skeleton, Array]:
        uphill = _frame_uphill((markers, settings, proportions), pose, one, pull)
        (passed,) = jax.vjp(uphill, stated)[1](back)
        return passed.skeleton, passed.offsets

    return jax.vmap(of_frame)(poses, known, pull, by_uphill, by_points)


@jax.jit
def sights_slopes(
    skeleton: Skeleton, proportions: Array, softness: Array, poses: Pose, cameras: Camera,
    sights: Sight,
) -> tuple[Array, Array]:  # fmt: skip
    """Hessians and gradients of a batch of sights."""

    def of_sight(each: tuple[Pose, Camera, Sight]) -> tuple[Array, Array]:
        pose, camera, sight = each
        still = _still(pose, proportions)

        def limbs(step: Array) -> Array:
            return _drawn_by(skeleton, proportions, camera, pose, sight, step)[0]

        def uphill(flat: Array) -> Array:
            fit = drawn_fit(skeleton.tree, _discs(flat), visible, sight, softness)
            return fit.gradient

        def row(way: Array) -> Array:
            return jax.jvp(uphill, (flat,), (jnp.broadcast_to(way, flat.shape),))[1]

        flat, visible = _drawn_by(skeleton, proportions, camera, pose, sight, still)
        slope = uphill(flat)
        # No cell belongs to two limbs: one direction of all limbs at once gives a row of each.
        blocks = jax.vmap(row)(jnp.eye(OUTLINE_NUMBERS, dtype=still.dtype))
        L = jax.jacfwd(limbs)(still)
        bent = jax.hessian(lambda step: jnp.sum(slope * limbs(step)))(still)
        hessian = jnp.einsum("kia,ikj,kjb->ab", L, blocks, L, precision=HIGHEST) + bent
        return hessian, jnp.einsum("ki,kia->a", slope, L, precision=HIGHEST)

    return jax.lax.map(of_sight, (poses, cameras, sights))


def _discs(flat: Array) -> Discs:
    return Discs(flat[:, :2], flat[:, 2:4], flat[:, 4:])


@jax.jit
def sights_forwards(
    skeleton: Skeleton, change: Skeleton, proportions: Array, softness: Array, poses: Pose,
    cameras: Camera, sights: Sight, changes: Camera,
) -> Array:  # fmt: skip
    """How gradients of a batch of sights change."""

    def of_sight(each: tuple[Pose, Camera, Sight, Camera]) -> Array:
        pose, camera, sight, turn = each
        uphill = _sight_uphill((proportions, softness), pose, sight)
        return jax.jvp(uphill, (skeleton, camera), (change, turn))[1]

    return jax.lax.map(of_sight, (poses, cameras, sights, changes))


@jax.jit
def sights_backwards(
    skeleton: Skeleton, proportions: Array, softness: Array, poses: Pose, cameras: Camera,
    sights: Sight, by_uphill: Array,
) -> tuple[Skeleton, Camera]:  # fmt: skip
    """What a batch of sights' gradients pass back to person and camera, each."""

    def of_sight(each: tuple[Pose, Camera, Sight, Array]) -> tuple[Skeleton, Camera]:
        pose, camera, sight, back = each
        uphill = _sight_uphill((proportions, softness), pose, sight)
        return jax.vjp(uphill, skeleton, camera)[1](back)

    return jax.lax.map(of_sight, (poses, cameras, sights, by_uphill))
