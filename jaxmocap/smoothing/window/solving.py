"""All events of a window, moved to where they cost least.

All of them are linearised in each step: derivatives that were taken at poses which are no motion
would contradict one another, and the motion prior would make evidence of that. What the silhouettes
and key points of an event cost is a quadratic about the pose where they were drawn; while the event
stays near by, nothing is drawn again.

INPUTS: a Model, settings, EventArrays, a marginal prior. OUTPUTS: a Window.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxmocap.body.kinematics import landmarks
from jaxmocap.body.model import Model
from jaxmocap.body.pose import pack, retract, unpack
from jaxmocap.evidence.smoothness import REACH, second_differences
from jaxmocap.evidence.terms import Measurements
from jaxmocap.geometry.rotations import HIGHEST
from jaxmocap.smoothing.levenberg_marquardt import PRIORS_SHARE
from jaxmocap.smoothing.linearise import FramesFit, frames_fit, silhouettes_fit
from jaxmocap.smoothing.settings import SmoothingSettings
from jaxmocap.smoothing.window.elimination import Evidence, MarginalPrior, eliminate, steps_of
from jaxmocap.smoothing.window.state import Drawn, EventArrays

# Cells over which silhouettes fade.
SOFTNESS = 0.8
# A silhouette's quadratic holds while no landmark moves farther than this, metres: about half a
# cell, over which its borders fade.
NEAR_M = 0.012
# Events count as at least so far apart, seconds: single precision has no differences of less.
LEAST_APART_S = 1e-3
# Events that are linearised at once.
AT_ONCE = 4
# Share of the events' own curvature that holds them back. So many times as much, and again, where a
# step goes so far that the derivatives misplace a landmark by more than this, metres: else windows
# that late frames left far off diverge.
DAMPING, DAMPED_MORE, DAMPINGS = 1e-3, 5.0, 6
TRUSTED_M = 0.2
# One step is enough where the derivatives misplace no landmark by more, metres.
LINEAR_M = 0.005


class Window(NamedTuple):
    """E events as they were linearised last, and a step on."""

    fit: FramesFit  # of their terms, about the poses from which the step goes
    drawn: Drawn | None  # of their silhouettes, likewise; None without cameras
    marginal: MarginalPrior  # about the first two, likewise
    steps: Array  # (E, N)
    poses: Array  # (E, 7 + D) packed, where the steps lead
    misplaced: Array  # () by how much the derivatives misplace any landmark there, metres


def solve(
    model: Model,
    settings: SmoothingSettings,
    events: EventArrays,
    drawn: Drawn | None,
    marginal: MarginalPrior,
    steps: tuple[Array, Array],
) -> tuple[Window, Array]:
    """Gauss-Newton, and what all of it costs in the end but for the marginal prior's part.

    The motion prior ties three events; fewer stay where they are expected.

    Args:
        model: of the person, the markers and the cameras.
        settings: of the smoothing, weighed.
        events: about whose poses the others are.
        drawn: of the silhouettes so far.
        marginal: of the events before.
        steps: at least so many, and at most; between, as long as the derivatives tell little.
    """

    def unsettled(carry: tuple[Array, Window]) -> Array:
        count, window = carry
        return (count < fewest) | ((count < most) & (window.misplaced >= LINEAR_M))

    def step(carry: tuple[Array, Window]) -> tuple[Array, Window]:
        count, last = carry
        fit = _fits(model, settings, events, last.poses)
        drawn = last.drawn and last.drawn.about(last.steps)
        if drawn is not None:
            drawn = _draw_again(model, settings, events, drawn, fit, last.poses)
        marginal = last.marginal.about(last.steps[:REACH])
        now = last._replace(fit=fit, drawn=drawn, marginal=marginal)
        return count + 1, _move_events(model, settings, events, now)

    fewest, most = steps
    count, size = len(events.since), len(marginal.gradient) // REACH
    M = 3 * len(landmarks(model.skeleton, unpack(events.poses[0])))
    dtype, still = events.poses.dtype, jnp.zeros((count, size), events.poses.dtype)
    nothing = FramesFit(
        jnp.zeros(count, dtype), jnp.zeros((count, size, size), dtype), still,
        jnp.zeros((count, M), dtype), jnp.zeros((count, M, size), dtype),
    )  # fmt: skip
    endless = jnp.asarray(jnp.inf, dtype)
    start = Window(nothing, drawn, marginal, still, events.poses, endless)
    _, window = jax.lax.while_loop(unsettled, step, (jnp.zeros((), jnp.int32), start))
    return window, _cost(settings, events, window)


def evidence_of(
    settings: SmoothingSettings,
    events: EventArrays,
    fit: FramesFit,
    drawn: Drawn | None,
    share: Array | float = 1.0,
) -> Evidence:
    """What events cost, of the silhouettes by a share."""
    hessian, gradient = fit.hessian, fit.gradient
    if drawn is not None:
        there = jnp.einsum("eij,ej->ei", drawn.hessian, drawn.step, precision=HIGHEST)
        hessian = hessian + share * drawn.hessian
        gradient = gradient + share * (drawn.gradient - there)
    since = jnp.maximum(events.since, LEAST_APART_S)
    stencil = second_differences(jnp.cumsum(since)) / settings.acceleration
    stencil = jnp.pad(stencil, ((0, REACH), (0, 0)))
    ties = jnp.arange(len(stencil), dtype=jnp.int32) + REACH < events.filled
    stencil = jnp.where(ties[:, None], stencil, 0.0)
    return Evidence(hessian, gradient, fit.points, fit.jacobian, stencil)


def _move_events(
    model: Model, settings: SmoothingSettings, events: EventArrays, now: Window
) -> Window:
    """All events by the equations' steps, as far as the derivatives are to be trusted."""
    evidence = evidence_of(settings, events, now.fit, now.drawn)
    scale, origins = _scale(events, now.fit, evidence), unpack(now.poses)

    def far(carry: tuple[Array, Array, Array, Array]) -> Array:
        tried, *_, misplaced = carry
        return (tried < DAMPINGS) & ~(misplaced < TRUSTED_M)

    def attempt(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        tried, *_ = carry
        ridge = DAMPING * DAMPED_MORE ** tried.astype(scale.dtype) * scale
        eliminated = eliminate(evidence, now.marginal, ridge, events.filled)
        steps = steps_of(eliminated, events.filled)
        steps = jnp.where(jnp.all(jnp.isfinite(steps)) & (events.filled > REACH), steps, 0.0)
        there = retract(origins, steps)
        points = jax.vmap(landmarks, (None, 0))(model.skeleton, there).reshape(len(steps), -1)
        expected = evidence.points_at(steps)
        off = jnp.max(jnp.abs(points - expected), 1)
        return tried + 1, steps, pack(there), jnp.max(jnp.where(events.are_there, off, 0.0))

    first = jnp.zeros((), jnp.int32), now.steps, now.poses, jnp.full_like(now.misplaced, jnp.inf)
    _, steps, poses, misplaced = jax.lax.while_loop(far, attempt, first)
    return now._replace(steps=steps, poses=poses, misplaced=misplaced)


def _scale(events: EventArrays, fit: FramesFit, evidence: Evidence) -> Array:
    """(N,) what damping holds each unknown back by: the mean curvature, the motion's by a share."""
    own = jnp.diagonal(fit.hessian, axis1=1, axis2=2)
    ties = sum(jnp.roll(evidence.stencil[:, k] ** 2, k) for k in range(REACH + 1))
    stiffness = jnp.asarray(ties)[:, None] * jnp.sum(fit.jacobian**2, 1)
    each = jnp.where(events.are_there[:, None], own + PRIORS_SHARE * stiffness, 0.0)
    return jnp.sum(each, 0) / events.filled.astype(own.dtype)


def _cost(settings: SmoothingSettings, events: EventArrays, window: Window) -> Array:
    """() of all events where their steps lead, as far as the quadratics tell."""
    fit, drawn, _, steps, *_ = window
    each = fit.cost + _rise(fit.hessian, fit.gradient, steps)
    if drawn is not None:
        each += drawn.cost + _rise(drawn.hessian, drawn.gradient, steps - drawn.step)
    motion = evidence_of(settings, events, fit, drawn).accelerations(steps)
    return jnp.sum(jnp.where(events.are_there, each, 0.0)) + jnp.sum(motion**2)


def _rise(hessian: Array, gradient: Array, steps: Array) -> Array:
    """What quadratics' costs (E,) rise by over steps (E, N)."""
    along = jnp.einsum("eij,ej->ei", hessian, steps, precision=HIGHEST)
    return jnp.sum(steps * (along + 2 * gradient), 1)


def _fits(
    model: Model, settings: SmoothingSettings, events: EventArrays, poses: Array
) -> FramesFit:
    """Of the terms of all events, about packed poses (E, 7 + D)."""
    nothing = jnp.zeros(0, poses.dtype)

    def some(poses: Array, measured: Measurements) -> FramesFit:
        return frames_fit(settings.terms, model, nothing, unpack(poses), measured)

    return _in_parts(some, events.filled, (poses, events.measured))


def _in_parts(call: Callable, count: Array, stacked: tuple) -> Any:
    """``call`` of the first so many of E entries, ``AT_ONCE`` at a time; 0 for the others."""

    def part(first: Array | int) -> tuple:
        def rows(entries: Array) -> Array:
            return jax.lax.dynamic_slice_in_dim(jnp.asarray(entries), first, AT_ONCE)

        return jax.tree.map(rows, stacked)

    def one(i: Array, found: Any) -> Any:
        def placed(every: Array, some: Array) -> Array:
            return jax.lax.dynamic_update_slice_in_dim(every, some, i * AT_ONCE, 0)

        return jax.tree.map(placed, found, call(*part(i * AT_ONCE)))

    entries = len(jax.tree.leaves(stacked)[0])
    like = jax.eval_shape(lambda: call(*part(0)))
    nothing = jax.tree.map(lambda own: jnp.zeros((entries, *own.shape[1:]), own.dtype), like)
    return jax.lax.fori_loop(0, (count + AT_ONCE - 1) // AT_ONCE, one, nothing)


def _draw_again(
    model: Model,
    settings: SmoothingSettings,
    events: EventArrays,
    drawn: Drawn,
    fit: FramesFit,
    poses: Array,
) -> Drawn:
    """What cameras have of events no longer near where it was drawn, about poses (E, 7 + D)."""
    away = jnp.max(jnp.abs(fit.points - drawn.points), 1)
    is_stale = events.have_frames & ~(away <= NEAR_M)
    soft, nothing = jnp.asarray(SOFTNESS, poses.dtype), jnp.zeros(0, poses.dtype)

    def one(i: Array, drawn: Drawn) -> Drawn:
        def there() -> Drawn:
            grids = jax.tree.map(lambda part: part[i], events.grids)
            shown, pose = jnp.asarray(events.shown)[i], unpack(poses[i])
            parts = silhouettes_fit(model, settings.silhouettes, pose, shown, grids, soft)[:3]
            if events.lines is not None:
                own = jax.tree.map(lambda part: jnp.asarray(part)[i], events.lines)
                pose, own = jax.tree.map(
                    lambda part: part[None], (pose, Measurements(sight_lines=own))
                )
                points = frames_fit((settings.keypoints,), model, nothing, pose, own)[:3]
                parts = (one + other[0] for one, other in zip(parts, points, strict=True))
            cost, H, slope = parts
            return Drawn(cost, H, slope, fit.points[i], jnp.zeros_like(slope))

        here = jax.tree.map(lambda part: part[i], drawn)
        now = jax.lax.cond(is_stale[i], there, lambda: here)
        return jax.tree.map(lambda every, own: every.at[i].set(own), drawn, now)

    return jax.lax.fori_loop(0, events.filled, one, drawn)
