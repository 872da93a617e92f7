"""How far to trust landmarks, from what is left uncertain.

INPUTS: a problem and the trajectory that solves it, or variances with and without what the cameras
saw. OUTPUTS: deviations, and what is a guess.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.skeleton import LANDMARKS, landmark_mismatches
from jaxmocap.evidence.smoothness import Smoothness
from jaxmocap.smoothing.levenberg_marquardt import covariances, point_variances
from jaxmocap.smoothing.linearise import (
    Problem,
    Trajectory,
    landmark_prior,
    linearise_poses,
    softened,
    two_workers,
)

# What is not measured but usual; somebody who is unusual stays so for a while.
HABITS = ("ease", "lean", "facing", "ground", "footing", "balance")
# A landmark is a guess where the video leaves more than this share of its variance, unless markers
# hold it already, as they do below some HELD_M metres.
GUESSED, HELD_M = 0.7, 0.01


class Trust(NamedTuple):
    """How far to trust the landmarks of a trajectory.

    Attributes:
        deviations: (T, L, 3) standard deviations of their coordinates, world, metres.
        from_prior: (T, L) 1 where markers and video leave a landmark almost as uncertain as it is
            without them, else 0.
    """

    deviations: np.ndarray
    from_prior: np.ndarray


def trusted(told: np.ndarray, guessed: np.ndarray, mismatch: float) -> Trust:
    """What the variances of landmarks come to.

    Args:
        told: (T, L, 3) variances given all that is known.
        guessed: (T, L, 3) without what the cameras saw.
        mismatch: factor on ``landmark_mismatches``; none where a marker holds.
    """
    loose = told / (told + HELD_M**2)
    deviations = np.sqrt(told + loose * (mismatch * landmark_mismatches()) ** 2)
    from_prior = told.sum(-1) > GUESSED * guessed.sum(-1)
    markers_hold = guessed.sum(-1) < 9 * HELD_M**2
    return Trust(deviations, (from_prior & ~markers_hold).astype(float))


def trust_in(problem: Problem, trajectory: Trajectory, softness: float) -> Trust:
    """How far to trust a trajectory that a solve with this softness ended with."""
    prior, seen = landmark_prior(problem), softened(problem, softness)
    with two_workers() as workers:
        alike = _alike(seen)
        told = _variances(alike, softness, workers, trajectory, prior)
        guessed = _variances(_unseen(alike), softness, workers, trajectory, prior)
    return trusted(told, guessed, float(problem.settings.mismatch))


def _variances(
    problem: Problem,
    softness: float,
    workers: ThreadPoolExecutor,
    trajectory: Trajectory,
    prior: Smoothness,
) -> np.ndarray:
    """(T, L, 3) of the landmarks' coordinates."""
    linear = linearise_poses(problem, softness, workers, trajectory)
    found = point_variances(linear.jacobian, covariances(linear, prior), linear.shared_jacobian)
    return found.reshape(-1, len(LANDMARKS), 3)


def _alike(problem: Problem) -> Problem:
    """The same with errors that are alike counted once: those of cells, those of habits."""
    settings = problem.settings
    cells = settings.silhouette * jnp.sqrt(settings.redundancy)
    changed = lasting_habits(problem) | {"silhouette": cells}
    return replace(problem, settings=replace(settings, **changed))


def lasting_habits(problem: Problem) -> dict[str, Array]:
    """Deviations of ``HABITS`` with which all frames of a while together count once."""
    settings, times = problem.settings, problem.times
    step = np.median(np.diff(times)) if len(times) > 1 else 1.0
    for_long = jnp.sqrt(jnp.maximum(settings.habit / float(step), 1.0))
    return {name: getattr(settings, name) * for_long for name in HABITS}


def _unseen(problem: Problem) -> Problem:
    """The same without what the cameras saw."""
    blind = jax.tree.map(lambda part: part[:0], problem.sights)
    return replace(problem, sights=blind, known=problem.known._replace(lines=None))
