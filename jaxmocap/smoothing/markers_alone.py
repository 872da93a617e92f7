"""Smoothing of a recording that no camera shows: all poses by the markers, the posture, the motion.

    some samples -> the person's proportions
    stretches of samples, each reaching into its neighbours -> poses -> deviations

INPUTS: a model, a first pass. OUTPUTS: a Trajectory with deviations.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from jaxmocap.body.model import Model
from jaxmocap.body.proportions import PROPORTIONS
from jaxmocap.compilation.batches import GatheredRows
from jaxmocap.compilation.freed_memory import give_back
from jaxmocap.smoothing.batch import FINELY, measurements_of
from jaxmocap.smoothing.linearise import rows_of, smooth_poses
from jaxmocap.smoothing.problem import UNTURNED, FirstPass, SmoothingProblem, Trajectory, Views
from jaxmocap.smoothing.settings import SmoothingSettings, mean_step, weigh_by_time, with_lasting
from jaxmocap.smoothing.uncertainty import leave_one_out, with_deviations
from jaxmocap.smoothing.walking import usual_habits, walkers_measurements

# Samples that are solved for at once: some 80 kB each.
STRETCH = 3000
# Views that a sample of markers is worth to the prior on proportions, by six walking people
# (``bench.people``): of markers alone, and with landmarks where walkers have them. Those err alike
# in all samples, and would stretch the body.
VIEWS_A_SAMPLE, VIEWS_A_USUAL_SAMPLE = 0.02, 0.3
# By so much a stretch reaches into its neighbours, seconds: farther away nothing is felt.
REACH_S = 1.0


def smooth_markers(
    model: Model,
    settings: SmoothingSettings,
    first_pass: FirstPass,
    show: Callable[[float], None],
    why: bool = False,
) -> Trajectory:
    """The poses of all events and how sure they are, by the markers alone.

    Args:
        model: of the person and the markers; its cameras take no part.
        settings: of the smoothing.
        first_pass: E events, and the poses to start from.
        show: called with the share done.
        why: also how sure they are without each part of the evidence.
    """
    model, count = replace(model, cameras=None), len(first_pass.times)
    measured = measurements_of(model, first_pass)
    usual, samples = walkers_measurements(
        model, first_pass.times, measured.markers, first_pass.reports.marker_pose,
        measured.facing, usual_habits(),
    )  # fmt: skip
    measured = measured._replace(**usual)
    views = VIEWS_A_SAMPLE * count + VIEWS_A_USUAL_SAMPLE * samples
    weighted = weigh_by_time(settings, first_pass.times)
    weighted = replace(weighted, proportions=settings.proportions * views)
    problem = SmoothingProblem(model, weighted, first_pass.times, measured, Views.no_cameras())
    start = Trajectory(first_pass.marker_poses, np.zeros(len(PROPORTIONS), model.dtype), UNTURNED)
    some = np.arange(0, count, -(-count // STRETCH))
    own, at = _among(problem, start, some)
    found = smooth_poses(own, at, FINELY).trajectory
    if why:
        # Fewer events a second share what errs alike for long.
        share = mean_step(own.times) / mean_step(first_pass.times) if count > 1 else 1.0
        fewer = replace(own, settings=with_lasting(own.settings, share**-0.5))
        found = leave_one_out(fewer, found, FINELY[-1], lambda done: show(0.5 * done))
    show(0.5 if len(some) < count else 0.9)
    if len(some) == count:
        found = with_deviations(own, found, FINELY[-1])
        show(1.0)
        return found
    start = start._replace(proportions=found.proportions, left_out=found.left_out)
    person = replace(model, skeleton=found.person(model.skeleton))
    joined = GatheredRows(count)
    for first in range(0, count, STRETCH):
        last = min(first + STRETCH, count)
        near = np.searchsorted(
            problem.times, problem.times[[first, last - 1]] + np.array([-REACH_S, REACH_S])
        )
        rows = np.arange(*near)
        own, at = _among(problem, start, rows)
        sized = replace(own, model=person), at._replace(proportions=start.proportions[:0])
        poses = smooth_poses(*sized, FINELY).trajectory.poses
        solved = with_deviations(own, at._replace(poses=poses), FINELY[-1])
        joined.put(first, _rows(solved, np.arange(first, last) - rows[0], model.dtype))
        give_back()
        show(0.5 + last / count / 2)
    poses, deviations, from_prior = joined.tree
    return start._replace(poses=poses, deviations=deviations, from_prior=from_prior)


def _among(
    problem: SmoothingProblem, trajectory: Trajectory, rows: np.ndarray
) -> tuple[SmoothingProblem, Trajectory]:
    """Some of the events."""
    measured = jax.tree.map(lambda part: part[rows], problem.measured)
    share = len(rows) / len(problem.times)
    weighted = replace(problem.settings, proportions=problem.settings.proportions * share)
    some = replace(problem, settings=weighted, times=problem.times[rows], measured=measured)
    return some, trajectory._replace(poses=rows_of(trajectory.poses, rows))


def _rows(trajectory: Trajectory, rows: np.ndarray, dtype: Any) -> tuple:
    """Poses, deviations and what comes from the prior, as precise as the report has them."""
    return jax.tree.map(
        lambda part: np.asarray(part)[rows].astype(dtype),
        (trajectory.poses, trajectory.deviations, trajectory.from_prior),
    )
