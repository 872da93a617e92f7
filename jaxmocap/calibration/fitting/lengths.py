"""Bone lengths and girths with which a whole recording's motion costs least, and how sure they are.

For given lengths the second pass finds the poses of least cost. How this least cost changes with
the lengths is the gradient through the tracker: at the minimum the poses' own share of it vanishes
(the envelope theorem), and eliminating them from the Gauss-Newton equations leaves the Hessian, a
Schur complement. Poses and lengths are found together, which is the same descent. The inverse of
that Hessian, of the prior as well, is what remains uncertain of the lengths.

What a silhouette gets wrong it gets wrong in every frame: a recording, however long, weighs as much
as a few of its frames. What is unusual lasts, and counts once for as long: again in every frame it
would shorten limbs until their joints are at ease. Girths are free as well, since clothes would
pass for lengths. Where a forearm begins is not taken from its own picture: the end of a sleeve
moves that by more than people differ.

INPUTS: a recording's problem, a trajectory that solves it for the lengths stated.
OUTPUTS: logarithms of factors on lengths and girths, their covariances before and after.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jaxmocap.body.proportions import GIRTHS, LENGTHS, covariance_among_people
from jaxmocap.smoothing.levenberg_marquardt import covariances
from jaxmocap.smoothing.linearise import linearise_problem, smooth_poses, soften_grids, two_workers
from jaxmocap.smoothing.problem import SmoothingProblem, Trajectory
from jaxmocap.smoothing.uncertainty import lasting_errors
from jaxmocap.solvers.status import Status

# So many views at face value are worth as much as all of a recording's, whose errors are alike: on
# synthetic people with clothes the lengths' errors are then about as large as their deviations.
FRAMES_WORTH = 6.0


class LengthsFit(NamedTuple):
    """Lengths, then girths (P): ``LENGTHS`` and ``GIRTHS``."""

    logarithms: np.ndarray  # (P,) of the factors on what was stated
    covariance: np.ndarray  # (P, P) of them, given the recording
    among_people: np.ndarray  # (P, P) before
    trajectory: Trajectory  # the motion with them
    status: Status  # why the solve ended

    @property
    def before(self) -> np.ndarray:
        """(P,) standard deviations of the logarithms among people."""
        return np.sqrt(np.diag(self.among_people))

    @property
    def after(self) -> np.ndarray:
        """(P,) the same, given the recording."""
        return np.sqrt(np.diag(self.covariance))


def fit_lengths(
    problem: SmoothingProblem,
    start: Trajectory,
    softness: tuple[float, ...],
    worth: float = FRAMES_WORTH,
) -> LengthsFit:
    """Find poses and lengths of least cost.

    Args:
        problem: the recording.
        start: that solves it, or nearly, with fewer proportions free.
        softness: of the silhouettes' borders, cells, one solve after the other.
        worth: so many views at face value weigh as much as all of them.

    Raises:
        NotPositiveDefinite: where nothing determines the poses.
    """
    lasting = lasting_errors(problem)
    silhouettes = replace(lasting.silhouettes, forearms=0.0)
    settings = replace(lasting, silhouettes=silhouettes, proportions=1 / worth)
    weighed = replace(problem, settings=settings)
    # All lengths and girths are free.
    given = np.asarray(start.proportions)
    missing = len(LENGTHS) + len(GIRTHS) - given.size
    freed = start._replace(proportions=np.pad(given, (0, missing)))
    solved = smooth_poses(weighed, freed, softness)
    trajectory, count = solved.trajectory, len(LENGTHS) + len(GIRTHS)
    prior, soft = weighed.motion_prior(), soften_grids(weighed, softness[-1])
    with two_workers() as workers:
        linear = linearise_problem(soft, softness[-1], workers, trajectory)
    # The prior weighs in as many views as there are: undone, it is the prior that people have.
    views = max(len(problem.views.camera), 1) / worth
    shared = views * covariances(linear, prior).shared[:count, :count]
    logarithms = np.asarray(trajectory.proportions, float)
    people = covariance_among_people(count)
    return LengthsFit(logarithms, shared, people, trajectory, solved.status)
