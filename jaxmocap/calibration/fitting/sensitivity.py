"""How a smoothed recording depends on what was stated of it: the person, cameras, marker offsets.

The trajectory x is where the gradient g(x, s) of the cost vanishes. With s it moves so that g
stays zero: H dx = -(dg/ds) ds, the implicit function theorem. H is the cost's full Hessian, with
what Gauss-Newton leaves out, yet banded as the solve's own: every residual belongs to one frame,
and of the prior that joins the frames only the landmarks' curvature is new.

Held fixed: the measurements (the grids, the background and colours that they come from, where they
lie), the cameras' estimated rotations, the markers, what hides a forearm, facing and ankles of the
markers' pose. Which limb reaches farthest over a cell changes in jumps, which have no derivative.

INPUTS: a recording's problem, its solution. OUTPUTS: the derivative, forwards and backwards.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.model import Model
from jaxmocap.calibration.fitting.sensitivity_batches import (
    frames_backwards,
    frames_forwards,
    frames_landmarks,
    frames_slopes,
    views_backwards,
    views_forwards,
    views_slopes,
)
from jaxmocap.compilation.batches import in_batches
from jaxmocap.evidence.smoothness import Smoothness
from jaxmocap.smoothing.levenberg_marquardt import Linearised, normal_equations, positive
from jaxmocap.smoothing.linearise import rows_of, softened, views_of
from jaxmocap.smoothing.problem import (
    UNTURNED,
    SmoothingProblem,
    Trajectory,
    all_turned,
    moved_by,
    shared_prior,
)
from jaxmocap.solvers.arrow import Equations

# Frames or views per call.
A_CALL = 16


class Slopes(NamedTuple):
    """Half the full cost's derivatives by T frames' N unknowns and P shared ones.

    Attributes:
        equations: the full Hessian and the gradient.
        landmarks: (T, L * 3) world, metres.
        jacobian: (T, L * 3, N + P) of the landmarks.
        pull: (T, L * 3) of the prior, by the landmarks.
        exact: the Hessian is the full one. Where that is not positive, since noisy cells that
            change hands make no smooth minimum, each frame's negative curvature is left out.
    """

    equations: Equations
    landmarks: np.ndarray
    jacobian: np.ndarray
    pull: np.ndarray
    exact: bool


@dataclass(frozen=True)
class Sensitivity:
    """The derivative of a smoothed trajectory, to be taken in either direction.

    The gradient of any loss of the landmarks by a few numbers of one's own, from which ``state``
    makes a Model::

        model, pull = jax.vjp(state, numbers)
        there = Sensitivity.at(replace(problem, model=model), trajectory, softness)
        (gradient,) = pull(there.backwards(jax.grad(loss)(there.landmarks)))

    Attributes:
        problem: the recording, its grids blurred as softly as they are drawn.
        trajectory: its solution.
        softness: () of the silhouettes' borders, cells.
        prior: of the landmarks' motion.
        slopes: at the solution.
    """

    problem: SmoothingProblem
    trajectory: Trajectory
    softness: Array
    prior: Smoothness
    slopes: Slopes

    @classmethod
    def at(
        cls, problem: SmoothingProblem, trajectory: Trajectory, softness: float
    ) -> "Sensitivity":
        """At the trajectory that ``smooth_poses`` found, with the last softness that it was given.

        The derivative is as exact as the trajectory is a minimum (``slopes.exact``: whether it is
        one); ``settled`` brings it closer. Cameras have their estimated rotations.
        """
        cameras = all_turned(problem.model.cameras, trajectory.turns_cam)
        problem = replace(problem, model=replace(problem.model, cameras=cameras))
        trajectory = trajectory._replace(turns_cam=UNTURNED)
        softened_problem, prior = softened(problem, softness), problem.motion_prior()
        soft = jnp.asarray(softness, trajectory.proportions.dtype)
        return cls(
            softened_problem,
            trajectory,
            soft,
            prior,
            _slopes(softened_problem, trajectory, soft, prior),
        )

    @property
    def landmarks(self) -> np.ndarray:
        """(T, L, 3) world, metres."""
        return self.slopes.landmarks.reshape(len(self.slopes.landmarks), -1, 3)

    def settled(self, steps: int = 1) -> "Sensitivity":
        """The same after Newton steps, each of which squares a small distance to the minimum."""
        if not steps:
            return self
        step = self.slopes.equations.step(0.0, 0.0)
        nearer = moved_by(self.trajectory, step.frames, step.shared)
        slopes = _slopes(self.problem, nearer, self.softness, self.prior)
        return replace(self, trajectory=nearer, slopes=slopes).settled(steps - 1)

    def forwards(self, change: Model) -> np.ndarray:
        """How the landmarks (T, L, 3) follow a small change of the model, metres.

        Raises:
            NotPositiveDefinite: where nothing determines the trajectory.
        """
        slopes, model, views = self.slopes, self.problem.model, self.problem.views
        own, moved = (replace(each, cameras=None) for each in (model, change))
        uphill, points = _over(frames_forwards, (own, moved, *self._fixed()), self._frames())
        uphill += _times(slopes.jacobian.swapaxes(1, 2), self._stiffness(points))
        if len(views.frame):
            fixed = (model.skeleton, change.skeleton, *self._drawn())
            each = (*self._views(), rows_of(change.cameras, views.camera))
            (by_view,) = _over(views_forwards, fixed, each)
            np.add.at(uphill, views.frame, by_view * self.problem.settings.silhouettes.weight)
        followed = points - _times(slopes.jacobian, self._solved(uphill))
        return followed.reshape(self.landmarks.shape)

    def backwards(self, by_landmarks: np.ndarray | Array) -> Model:
        """The gradient of a loss by the model, from that (T, L, 3) by the landmarks.

        Raises:
            NotPositiveDefinite: where nothing determines the trajectory.
        """
        slopes, model, views = self.slopes, self.problem.model, self.problem.views
        given = np.asarray(by_landmarks, float).reshape(slopes.landmarks.shape)
        back = self._solved(_times(slopes.jacobian.swapaxes(1, 2), given))
        given = given - self._stiffness(_times(slopes.jacobian, back))
        each = (*self._frames(), -back, given)
        fixed = (replace(model, cameras=None), *self._fixed())
        body = [part.sum(0) for part in _over(frames_backwards, fixed, each)]
        lenses = [np.zeros(np.shape(leaf)) for leaf in jax.tree.leaves(model.cameras)]
        if len(views.frame):
            weighted = -back[views.frame] * self.problem.settings.silhouettes.weight
            fixed, each = (model.skeleton, *self._drawn()), (*self._views(), weighted)
            by_view = _over(views_backwards, fixed, each)
            # Of the body a view looks at the skeleton alone, which comes first.
            skeleton = len(jax.tree.leaves(model.skeleton))
            for i, part in enumerate(by_view[:skeleton]):
                body[i] = body[i] + part.sum(0)
            for lens, part in zip(lenses, by_view[skeleton:], strict=True):
                np.add.at(lens, views.camera, part)
        leaves, tree = jax.tree.flatten(model)
        pairs = zip((*body, *lenses), leaves, strict=True)
        return jax.tree.unflatten(tree, [jnp.asarray(own, leaf.dtype) for own, leaf in pairs])

    def _solved(self, slope: np.ndarray) -> np.ndarray:
        """H^-1 times slopes (T, N + P), of which the last P add up: (T, N + P), the last alike."""
        size = self.slopes.equations.gradient.shape[1]
        own, shared = slope[:, :size], slope[:, size:].sum(0)
        step = self.slopes.equations._replace(gradient=own, shared_gradient=shared).step(0.0, 0.0)
        return -np.concatenate([step.frames, np.tile(step.shared, (len(slope), 1))], 1)

    def _stiffness(self, points: np.ndarray) -> np.ndarray:
        return self.prior.precision(points[..., None])[..., 0]

    def _fixed(self) -> tuple[Any, ...]:
        return self.problem.settings.terms, self.trajectory.proportions

    def _frames(self) -> tuple[Any, ...]:
        return self.trajectory.poses, self.problem.measured, self.slopes.pull

    def _drawn(self) -> tuple[Any, ...]:
        return self.trajectory.proportions, self.softness

    def _views(self) -> tuple[Any, ...]:
        return views_of(self.problem, self.trajectory)


def _slopes(
    problem: SmoothingProblem, trajectory: Trajectory, softness: Array, prior: Smoothness
) -> Slopes:
    """All derivatives at a trajectory."""
    model, views, weight = problem.model, problem.views, problem.settings.silhouettes.weight
    fixed = (replace(model, cameras=None), problem.settings.terms, trajectory.proportions)
    frames = (trajectory.poses, problem.measured)
    (points,) = _over(frames_landmarks, (model.skeleton, trajectory.proportions), frames[:1])
    pull = prior.precision(points[..., None])[..., 0]
    hessian, gradient, jacobian = _over(frames_slopes, fixed, (*frames, pull))
    if len(views.frame):
        drawn = (model.skeleton, trajectory.proportions, softness)
        by_view = _over(views_slopes, drawn, views_of(problem, trajectory))
        for total, part in zip((hessian, gradient), by_view, strict=True):
            np.add.at(total, views.frame, part * weight)
    n = gradient.shape[1] - trajectory.proportions.size
    curvature, uphill, _ = shared_prior(problem.settings, views.camera, trajectory)
    # The prior's own pull is in the frames' gradients already.
    still = np.zeros_like(points)

    def equations(hessian: np.ndarray) -> Equations:
        linear = Linearised(
            np.zeros(len(points)), hessian[:, :n, :n], gradient[:, :n], still, jacobian[:, :, :n],
            hessian[:, :n, n:], hessian[:, n:, n:] + curvature, gradient[:, n:] + uphill,
            jacobian[:, :, n:],
        )  # fmt: skip
        return normal_equations(linear, prior)

    exactly = equations(hessian)
    exact = exactly.determined()
    return Slopes(exactly if exact else equations(positive(hessian)), points, jacobian, pull, exact)


def _times(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return (matrices @ vectors[..., None])[..., 0]


def _over(call: Callable, fixed: tuple[Any, ...], each: tuple[Any, ...]) -> list[np.ndarray]:
    """A function of batches over all entries, float64."""
    fixed = jax.tree.map(jnp.asarray, fixed)
    dtype = np.asarray(jax.tree.leaves(each)[0]).dtype
    each = jax.tree.map(lambda part: np.asarray(part, dtype), each)
    return in_batches(lambda *batch: call(fixed, batch), each, A_CALL)
