"""The newest frames of a trajectory: a few are solved again and again, the past is condensed.

Frames that leave the window leave what they told, as a quadratic of the two frames that the prior
ties them to. Nothing is forgotten, and the window stays as short as its frames need to settle.

INPUTS: the window's frames as in ``trajectory``, what the past told.
OUTPUTS: better states, what the past tells without the oldest frame, variances.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from jaxmocap.evidence.smoothness import REACH, Smoothness
from jaxmocap.smoothing.levenberg_marquardt import DEFAULTS, Linearised, Settings, normal_equations
from jaxmocap.solvers import banded
from jaxmocap.solvers.arrow import Equations

# Damping after a step that led uphill is at least this.
HEAVIER = 0.1


class Past(NamedTuple):
    """What the frames before a window tell of its first two, as a quadratic of their offset.

    In tangent directions, from where the two stood when it was made.

    Attributes:
        hessian: (2 N, 2 N).
        gradient: (2 N,) half the cost's derivative at no offset.
    """

    hessian: np.ndarray
    gradient: np.ndarray

    def cost(self, offset: np.ndarray) -> float:
        """At an offset (2 N,), but for a constant."""
        return float(offset @ self.hessian @ offset + 2 * self.gradient @ offset)


class Improved(NamedTuple):
    """Where some steps led.

    Attributes:
        x: the states.
        linear: the frames there.
        cost: there, the prior's and the past's included.
    """

    x: Any
    linear: Linearised
    cost: float


def with_past(equations: Equations, past: Past | None, offset: np.ndarray) -> Equations:
    """A window's equations, and what the past tells of its first two frames."""
    if past is None:
        return equations
    rows, gradient = equations.rows.copy(), equations.gradient.copy()
    size = rows.shape[1]
    pull = past.gradient + past.hessian @ offset
    gradient[:REACH] += pull.reshape(REACH, size)
    rows[0, :, : 2 * size] += past.hessian[:size]
    rows[1, :, :size] += past.hessian[size:, size:]
    return equations._replace(rows=rows, gradient=gradient)


def condensed(
    equations: Equations, past: Past | None, offset: np.ndarray, settings: Settings = DEFAULTS
) -> Past:
    """The past of a window without all but the last two of its frames, about where those stand.

    Args:
        equations: of three frames or more, the first of the window (``leaving``).
        past: of the window as it is.
        offset: (2 N,) of its first two frames from where that was made.
        settings: of the solve.
    """
    equations = with_past(equations, past, offset)
    frames, size = equations.gradient.shape
    whole = np.zeros((frames * size, (frames + REACH) * size))
    for row, block in enumerate(equations.rows):
        whole[row * size : (row + 1) * size, row * size : (row + REACH + 1) * size] = block
    whole = np.triu(whole[:, : frames * size])
    gone = (frames - REACH) * size
    left, pull = whole[gone:, gone:], equations.gradient.ravel()
    right = np.column_stack([whole[:gone, gone:], pull[:gone]])
    own = _mirrored(whole[:gone, :gone]) + settings.floor * np.eye(gone)
    tied = right[:, :-1].T @ np.linalg.solve(own, right)
    return Past(_mirrored(left) - (tied[:, :-1] + tied[:, :-1].T) / 2, pull[gone:] - tied[:, -1])


def leaving(linear: Linearised, prior: Smoothness) -> Equations:
    """What a window's first frames tell that leaves it with all of them but the last two.

    Args:
        linear: of the window, about its present states.
        prior: of those first frames.
    """
    parts = [np.array(part, float)[: prior.frames] for part in linear[:5]]
    # The last two frames' own terms stay in the window.
    for own in parts[1:3]:
        own[-REACH:] = 0
    return normal_equations(Linearised(*parts), prior)


def weakened(equations: Equations, hessian: np.ndarray) -> Equations:
    """The same with the first frames' own terms less by (T, N, N) of their Hessians."""
    rows = equations.rows.copy()
    size = rows.shape[1]
    rows[: len(hessian), :, :size] -= hessian
    return equations._replace(rows=rows)


def _mirrored(upper: np.ndarray) -> np.ndarray:
    """A symmetric matrix by its upper triangle."""
    return upper + np.triu(upper, 1).T


def improve(
    linearise: Callable[[Any], Linearised],
    move: Callable[[Any, np.ndarray], Any],
    offset: Callable[[Any], np.ndarray],
    start: Any,
    prior: Smoothness,
    past: Past | None,
    settings: Settings = DEFAULTS,
) -> Improved:
    """A few steps of Levenberg-Marquardt over a window.

    Where a step led is linearised at once: mostly it was right, and the next step begins there.

    Args:
        linearise: states to their ``Linearised``.
        move: states and steps (T, N) to states.
        offset: states to the offset (2 N,) of the first two from where the past was made.
        start: T states.
        prior: of the points' motion in the window.
        past: what earlier frames told; None where there are none.
        settings: of the solve.
    """

    def at(x: Any) -> Improved:
        linear = linearise(x)
        cost = float(np.sum(linear.cost)) + prior.cost(np.asarray(linear.points, float))
        cost += 0.0 if past is None else past.cost(offset(x))
        return Improved(x, linear, cost)

    here, damping = at(start), settings.damping
    for _ in range(settings.iterations):
        equations = normal_equations(here.linear, prior)
        equations = with_past(equations, past, offset(here.x))
        there = None
        for _ in range(settings.attempts):
            try:
                step = equations.step(damping, settings.floor).frames
            except banded.NotPositiveDefinite:
                damping = 10 * max(damping, HEAVIER)
                continue
            tried = at(move(here.x, step))
            if tried.cost < here.cost:
                there = tried
                break
            damping = 10 * max(damping, HEAVIER)
        if there is None:
            break
        fall, here = here.cost - there.cost, there
        damping = max(damping / 3, settings.damping)
        if fall <= settings.relative * abs(here.cost):
            break
    return here


def window_variances(
    equations: Equations,
    jacobian: np.ndarray,
    past: Past | None,
    frames: np.ndarray,
    settings: Settings = DEFAULTS,
) -> np.ndarray:
    """Variances (F, M) of the points of some of a window's frames, given window and past.

    Infinite where the equations do not determine them.

    Args:
        equations: of the window.
        jacobian: (T, M, N) of the points.
        past: what earlier frames told.
        frames: which.
        settings: of the solve.
    """
    chosen = np.asarray(jacobian, float)[frames]
    equations = with_past(equations, past, np.zeros(REACH * chosen.shape[2]))
    try:
        factor = banded.factorise(equations.rows, settings.floor)
    except banded.NotPositiveDefinite:
        return np.full(chosen.shape[:2], np.inf)
    covariances = banded.inverse_blocks(factor, int(np.min(frames)))[frames]
    return np.maximum(np.sum(chosen @ covariances * chosen, 2), 0.0)
