"""How sure landmarks are: standard deviations of what a solve leaves uncertain.

INPUTS: a problem and the trajectory that solves it, or variances with and without what the cameras
show. OUTPUTS: deviations, and which landmarks come from the prior.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from jaxmocap.body.skeleton import LANDMARKS, landmark_mismatches
from jaxmocap.evidence.smoothness import Smoothness
from jaxmocap.evidence.terms import Term
from jaxmocap.smoothing.levenberg_marquardt import covariances, point_variances
from jaxmocap.smoothing.linearise import linearise_problem, softened, two_workers
from jaxmocap.smoothing.problem import SmoothingProblem, Trajectory
from jaxmocap.smoothing.settings import SmoothingSettings

# A landmark comes from the prior where the video leaves more than this share of its variance,
GUESSED = 0.7
# unless markers hold it already: below about so many metres.
HELD_M = 0.01


def landmark_deviations(
    variances: np.ndarray, without_video: np.ndarray, mismatch: float
) -> tuple[np.ndarray, np.ndarray]:
    """What the variances of landmarks come to.

    Args:
        variances: (T, L, 3) given all that was measured.
        without_video: (T, L, 3) without what the cameras show.
        mismatch: factor on ``landmark_mismatches``; none where a marker holds.

    Returns:
        Deviations (T, L, 3), metres; (T, L) 1 where a landmark comes from the prior, else 0.
    """
    from_prior = variances.sum(-1) > GUESSED * without_video.sum(-1)
    markers_hold = without_video.sum(-1) < 9 * HELD_M**2
    return deviations_of(variances, mismatch), (from_prior & ~markers_hold).astype(float)


def deviations_of(variances: Any, mismatch: Any) -> Any:
    """Deviations (..., L, 3), metres, of NumPy or JAX; see ``landmark_deviations``."""
    loose = variances / (variances + HELD_M**2)
    return (variances + loose * (mismatch * landmark_mismatches()) ** 2) ** 0.5


def with_deviations(
    problem: SmoothingProblem, trajectory: Trajectory, softness: float
) -> Trajectory:
    """A trajectory that a solve with this softness ended with, and how sure it is."""
    prior, soft = problem.motion_prior(), softened(problem, softness)
    with two_workers() as workers:
        alike = replace(soft, settings=counted_once(soft))
        measured = _variances(alike, softness, workers, trajectory, prior)
        guessed = measured
        if len(alike.views.frame) or "sight_lines" in alike.measured:
            blind = _without_video(alike)
            guessed = _variances(blind, softness, workers, trajectory, prior)
    mismatch = float(problem.settings.mismatch)
    deviations, from_prior = landmark_deviations(measured, guessed, mismatch)
    return trajectory._replace(deviations=deviations, from_prior=from_prior)


def _variances(
    problem: SmoothingProblem,
    softness: float,
    workers: ThreadPoolExecutor,
    trajectory: Trajectory,
    prior: Smoothness,
) -> np.ndarray:
    """(T, L, 3) of the landmarks' coordinates."""
    linear = linearise_problem(problem, softness, workers, trajectory)
    variances = point_variances(linear.jacobian, covariances(linear, prior), linear.shared_jacobian)
    return variances.reshape(-1, len(LANDMARKS), 3)


def counted_once(problem: SmoothingProblem) -> SmoothingSettings:
    """Settings with errors that are alike counted once: of cells, and of what is usual."""
    silhouettes = problem.settings.silhouettes
    cells = np.asarray(silhouettes.deviation) * np.sqrt(np.asarray(silhouettes.redundancy))
    lasting = lasting_errors(problem)
    return replace(lasting, silhouettes=replace(silhouettes, deviation=cells))


def lasting_errors(problem: SmoothingProblem) -> SmoothingSettings:
    """Settings whose terms with lasting errors count once for as long as people keep to habits."""
    settings, times = problem.settings, problem.times
    step = np.median(np.diff(times)) if len(times) > 1 else 1.0
    factor = np.sqrt(np.maximum(np.asarray(settings.persistence) / float(step), 1.0))

    def weaker(part: Any) -> Any:
        if isinstance(part, Term) and part.errors_last:
            return jax.tree.map(lambda deviation: np.asarray(deviation) * factor, part)
        return part

    return jax.tree.map(weaker, settings, is_leaf=lambda part: isinstance(part, Term))


def _without_video(problem: SmoothingProblem) -> SmoothingProblem:
    """The same without what the cameras show."""
    measured = {name: own for name, own in problem.measured.items() if name != "sight_lines"}
    return replace(problem, views=problem.views.none, measured=measured)
