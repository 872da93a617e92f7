"""How a smoothed recording depends on what was stated of it: the person, cameras, marker offsets.

The trajectory x is where the gradient g(x, s) of the whole cost vanishes. With s it moves so that g
stays zero: H dx = -(dg/ds) ds, the implicit function theorem. H is the cost's whole Hessian, with
what Gauss-Newton leaves out, yet banded as the solve's own: every residual belongs to one frame,
and of the prior that joins the frames only the landmarks' curvature is new.

Held fixed: what was seen (the grids, the background and colours that they come from, where they
lie), how the cameras were found turned, the markers, what hides a forearm, facing and ankles of the
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

from jaxmocap.body.pose import Pose
from jaxmocap.compilation.batches import in_batches
from jaxmocap.evidence.silhouettes import Sight
from jaxmocap.evidence.smoothness import Smoothness
from jaxmocap.fitting.sensitivity_batches import (
    Stated,
    frames_backwards,
    frames_forwards,
    frames_landmarks,
    frames_slopes,
    sights_backwards,
    sights_forwards,
    sights_slopes,
)
from jaxmocap.geometry.cameras import Camera
from jaxmocap.smoothing.levenberg_marquardt import Linearised, normal_equations, positive
from jaxmocap.smoothing.linearise import (
    Problem,
    landmark_prior,
    sights_weight,
    softened,
)
from jaxmocap.smoothing.trajectory import UNTURNED, Trajectory, all_turned, moved_by, shared_prior
from jaxmocap.solvers.arrow import Equations

# Frames or sights per call.
A_CALL = 16


class Slopes(NamedTuple):
    """Half the whole cost's derivatives by T frames' N unknowns and P shared ones.

    Attributes:
        equations: the whole Hessian and the gradient.
        landmarks: (T, L * 3) world, metres.
        jacobian: (T, L * 3, N + P) of the landmarks.
        pull: (T, L * 3) of the prior, by the landmarks.
        exact: the Hessian is the whole one. Where that is not positive, since noisy cells that
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
    makes a ``Stated``::

        stated, pull = jax.vjp(state, numbers)
        there = Sensitivity.at(stated.put_into(problem), trajectory, softness)
        (gradient,) = pull(there.backwards(jax.grad(loss)(there.landmarks)))

    Attributes:
        problem: the recording, seen as softly as it is drawn.
        trajectory: its solution.
        softness: () of the silhouettes' borders, cells.
        prior: of the landmarks' motion.
        slopes: at the solution.
    """

    problem: Problem
    trajectory: Trajectory
    softness: Array
    prior: Smoothness
    slopes: Slopes

    @classmethod
    def at(cls, problem: Problem, trajectory: Trajectory, softness: float) -> "Sensitivity":
        """At the trajectory that ``smooth_poses`` found, with the last softness that it was given.

        The derivative is as exact as the trajectory is a minimum (``slopes.exact``: whether it is
        one); ``settled`` brings it closer. Cameras that were found turned are stated so.
        """
        cameras = all_turned(problem.cameras, trajectory.turns_cam)
        problem = replace(problem, cameras=cameras)
        trajectory = trajectory._replace(turns_cam=UNTURNED)
        seen, prior = softened(problem, softness), landmark_prior(problem)
        soft = jnp.asarray(softness, trajectory.proportions.dtype)
        return cls(seen, trajectory, soft, prior, _slopes(seen, trajectory, soft, prior))

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

    def forwards(self, change: Stated) -> np.ndarray:
        """How the landmarks (T, L, 3) follow a small change of what was stated, metres.

        Raises:
            NotPositiveDefinite: where nothing determines the trajectory.
        """
        slopes, stated, sights = self.slopes, Stated.of(self.problem), self.problem.sights
        uphill, points = _over(frames_forwards, (stated, change, *self._fixed()), self._frames())
        uphill += _times(slopes.jacobian.swapaxes(1, 2), self._stiffness(points))
        if len(sights.frame):
            fixed = (stated.skeleton, change.skeleton, *self._drawn())
            each = (*self._sights(), _chosen(change.cameras, sights.camera))
            (seen,) = _over(sights_forwards, fixed, each)
            np.add.at(uphill, sights.frame, seen * sights_weight(self.problem))
        followed = points - _times(slopes.jacobian, self._solved(uphill))
        return followed.reshape(self.landmarks.shape)

    def backwards(self, by_landmarks: np.ndarray | Array) -> Stated:
        """The gradient of a loss by all that was stated, from that (T, L, 3) by the landmarks.

        Raises:
            NotPositiveDefinite: where nothing determines the trajectory.
        """
        slopes, stated, sights = self.slopes, Stated.of(self.problem), self.problem.sights
        given = np.asarray(by_landmarks, float).reshape(slopes.landmarks.shape)
        back = self._solved(_times(slopes.jacobian.swapaxes(1, 2), given))
        given = given - self._stiffness(_times(slopes.jacobian, back))
        each = (*self._frames(), -back, given)
        parts = _over(frames_backwards, (stated, *self._fixed()), each)
        *body, offsets = (part.sum(0) for part in parts)
        lenses = [np.zeros(np.shape(leaf)) for leaf in jax.tree.leaves(stated.cameras)]
        if len(sights.frame):
            weighted = -back[sights.frame] * sights_weight(self.problem)
            fixed, each = (stated.skeleton, *self._drawn()), (*self._sights(), weighted)
            seen = _over(sights_backwards, fixed, each)
            body = [own + part.sum(0) for own, part in zip(body, seen, strict=False)]
            for lens, part in zip(lenses, seen[len(body) :], strict=True):
                np.add.at(lens, sights.camera, part)
        leaves, tree = jax.tree.flatten(stated)
        found = zip((*body, *lenses, offsets), leaves, strict=True)
        return jax.tree.unflatten(tree, [jnp.asarray(own, leaf.dtype) for own, leaf in found])

    def _solved(self, slope: np.ndarray) -> np.ndarray:
        """H^-1 times slopes (T, N + P), of which the last P add up: (T, N + P), the last alike."""
        size = self.slopes.equations.gradient.shape[1]
        own, shared = slope[:, :size], slope[:, size:].sum(0)
        step = self.slopes.equations._replace(gradient=own, shared_gradient=shared).step(0.0, 0.0)
        return -np.concatenate([step.frames, np.tile(step.shared, (len(slope), 1))], 1)

    def _stiffness(self, points: np.ndarray) -> np.ndarray:
        return self.prior.precision(points[..., None])[..., 0]

    def _fixed(self) -> tuple[Any, ...]:
        problem = self.problem
        return problem.markers, problem.settings, self.trajectory.proportions

    def _frames(self) -> tuple[Any, ...]:
        return self.trajectory.poses, self.problem.known, self.slopes.pull

    def _drawn(self) -> tuple[Any, ...]:
        return self.trajectory.proportions, self.softness

    def _sights(self) -> tuple[Any, ...]:
        return _sights_of(self.problem, self.trajectory)


def _slopes(problem: Problem, trajectory: Trajectory, softness: Array, prior: Smoothness) -> Slopes:
    """All derivatives at a trajectory."""
    stated, sights = Stated.of(problem), problem.sights
    fixed = (stated, problem.markers, problem.settings, trajectory.proportions)
    frames = (trajectory.poses, problem.known)
    (points,) = _over(frames_landmarks, (problem.skeleton, trajectory.proportions), frames[:1])
    pull = prior.precision(points[..., None])[..., 0]
    hessian, gradient, jacobian = _over(frames_slopes, fixed, (*frames, pull))
    if len(sights.frame):
        drawn = (problem.skeleton, trajectory.proportions, softness)
        seen = _over(sights_slopes, drawn, _sights_of(problem, trajectory))
        for total, part in zip((hessian, gradient), seen, strict=True):
            np.add.at(total, sights.frame, part * sights_weight(problem))
    n = gradient.shape[1] - trajectory.proportions.size
    curvature, uphill, _ = shared_prior(problem.settings, problem.sights.camera, trajectory)
    # The prior's own pull is in the frames' gradients already.
    still = np.zeros_like(points)

    def equations(hessian: np.ndarray) -> Equations:
        linear = Linearised(
            np.zeros(len(points)), hessian[:, :n, :n], gradient[:, :n], still, jacobian[:, :, :n],
            hessian[:, :n, n:], hessian[:, n:, n:] + curvature, gradient[:, n:] + uphill,
            jacobian[:, :, n:],
        )  # fmt: skip
        return normal_equations(linear, prior)

    whole = equations(hessian)
    exact = whole.determined()
    return Slopes(whole if exact else equations(positive(hessian)), points, jacobian, pull, exact)


def _sights_of(problem: Problem, trajectory: Trajectory) -> tuple[Pose, Camera, Sight]:
    """The poses, cameras and sights of all sights."""
    frame, camera, sight = problem.sights
    return _chosen(trajectory.poses, frame), _chosen(problem.cameras, camera), sight


def _chosen(stacked: Any, rows: np.ndarray) -> Any:
    return jax.tree.map(lambda part: np.asarray(part)[rows], stacked)


def _times(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return (matrices @ vectors[..., None])[..., 0]


def _over(call: Callable, fixed: tuple[Any, ...], each: tuple[Any, ...]) -> list[np.ndarray]:
    """A function of batches over all entries, float64."""
    fixed = jax.tree.map(jnp.asarray, fixed)
    dtype = np.asarray(jax.tree.leaves(each)[0]).dtype
    each = jax.tree.map(lambda part: np.asarray(part, dtype), each)
    return in_batches(lambda *batch: call(*fixed, *batch), each, A_CALL)
