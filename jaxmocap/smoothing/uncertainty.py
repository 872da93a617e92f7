"""How sure landmarks are: standard deviations of what a solve leaves uncertain, and why.

INPUTS: a problem and the trajectory that solves it, or variances with and without what the cameras
show. OUTPUTS: deviations, and which landmarks come from the prior; deviations without each marker,
camera and prior.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields, replace
from typing import Any

import jax
import numpy as np

from jaxmocap.body.skeleton import LANDMARKS, landmark_mismatches
from jaxmocap.compilation.arrays import Numbers, namespace
from jaxmocap.evidence.keypoints import KeyPoints
from jaxmocap.evidence.markers import ElbowGoals, MarkerPositions
from jaxmocap.evidence.smoothness import Smoothness
from jaxmocap.evidence.terms import Term
from jaxmocap.smoothing.levenberg_marquardt import covariances, point_variances
from jaxmocap.smoothing.linearise import linearise_problem, rows_of, soften_grids, two_workers
from jaxmocap.smoothing.problem import LeftOut, SmoothingProblem, Trajectory
from jaxmocap.smoothing.settings import LASTING_HZ, SmoothingSettings, mean_step, with_lasting

# A landmark comes from the prior where the video leaves more than this share of its variance,
GUESSED = 0.7
# unless markers hold it already: below about so many metres.
HELD_M = 0.01
# Of a longer recording so many events in its middle stand for all.
MOST_EVENTS = 1000
# Deviations times this count for nothing.
NOTHING = 1e4
# What changes a deviation by a smaller share is not listed beside it.
LEAST_EFFECT = 0.01
# Terms that are left out by themselves, or that have no part in the last solve.
OTHER_TERMS = (MarkerPositions, KeyPoints, ElbowGoals)


def landmark_deviations(
    variances: Numbers, without_video: Numbers, mismatch: Numbers
) -> tuple[Numbers, Numbers]:
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
    off = namespace(variances).asarray(landmark_mismatches(), variances.dtype)
    return (variances + loose * (mismatch * off) ** 2) ** 0.5


def with_deviations(
    problem: SmoothingProblem, trajectory: Trajectory, softness: float
) -> Trajectory:
    """A trajectory that a solve with this softness ended with, and how sure it is."""
    prior, soft = problem.motion_prior(), soften_grids(problem, softness)
    with two_workers() as workers:
        alike = replace(soft, settings=count_once(soft))
        measured = _variances(alike, softness, workers, trajectory, prior)
        guessed = measured
        if len(alike.views.frame) or alike.measured.sight_lines is not None:
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


def count_once(problem: SmoothingProblem) -> SmoothingSettings:
    """Settings with errors that are alike counted once: of cells, and of what is usual."""
    often = np.asarray(frames_a_moment(_frame_step(problem)), np.float32)
    silhouettes, keypoints = problem.settings.silhouettes, problem.settings.keypoints
    cells = np.asarray(silhouettes.deviation) * np.sqrt(often * np.asarray(silhouettes.redundancy))
    lines = np.asarray(keypoints.deviation) * np.sqrt(often * np.asarray(keypoints.redundancy))
    return replace(
        lasting_errors(problem),
        silhouettes=replace(silhouettes, deviation=cells),
        keypoints=replace(keypoints, deviation=lines),
    )


def frames_a_moment(step_s: Any) -> Any:
    """How many frames, so many seconds apart, come where redundancy counts one; at least 1."""
    return namespace(step_s).maximum(1 / (LASTING_HZ * step_s), 1.0)


def _frame_step(problem: SmoothingProblem) -> float:
    """Mean seconds between the events that a camera has filmed."""
    filmed = np.zeros(len(problem.times), bool)
    filmed[problem.views.frame] = True
    if (lines := problem.measured.sight_lines) is not None:
        filmed |= (np.asarray(lines.confidences) > 0).any((1, 2))
    return float(mean_step(problem.times[filmed])) if filmed.sum() > 1 else 1 / LASTING_HZ


def lasting_errors(problem: SmoothingProblem) -> SmoothingSettings:
    """Settings whose terms with lasting errors count once for as long as people keep to habits."""
    times = float(problem.settings.persistence) * LASTING_HZ
    return with_lasting(problem.settings, np.sqrt(max(times, 1.0)))


def _without_video(problem: SmoothingProblem) -> SmoothingProblem:
    """The same without what the cameras show."""
    return replace(problem.with_measured(sight_lines=None), views=problem.views.none)


def leave_one_out(
    problem: SmoothingProblem,
    trajectory: Trajectory,
    softness: float,
    show: Callable[[float], None],
) -> Trajectory:
    """The trajectory, and how sure it is with all the evidence, and without each part of it.

    Poses stay where they are.

    Args:
        problem: of T events.
        trajectory: that solves it.
        softness: of the silhouettes' borders in the last solve, cells.
        show: called with the share done.
    """
    problem, there = _middle(problem, trajectory)
    soft = soften_grids(problem, softness)
    mismatch, result = float(problem.settings.mismatch), []
    each = list(_parts(soft))
    with two_workers() as workers:
        for done, (kind, which, without) in enumerate(each):
            show(done / len(each))
            try:
                prior = without.motion_prior()
                variances = _variances(without, softness, workers, there, prior)
            except np.linalg.LinAlgError:
                # Nothing of a few samples is determined without it.
                continue
            three = deviations_of(variances, mismatch)
            result.append(LeftOut(kind, which, np.median(np.linalg.norm(three, axis=-1), 0)))
    show(1.0)
    return trajectory._replace(left_out=tuple(result))


def deviations_without(
    left_out: Sequence[LeftOut], markers: Sequence[str], cameras: Sequence[str]
) -> dict[str, dict[str, float]]:
    """Landmark -> name of what is left out -> its deviation then, metres.

    Of what the landmark hardly depends on there is no entry.

    Args:
        left_out: of ``leave_one_out``.
        markers: their names.
        cameras: theirs.
    """
    names, result = {"marker": markers, "camera": cameras}, {name: {} for name in LANDMARKS}
    for part in left_out:
        which = names[part.kind][part.which] if isinstance(part.which, int) else part.which
        name = f"{part.kind} {which}" if which else part.kind
        for own, all_of_it, without in zip(
            result.values(), left_out[0].deviations, part.deviations, strict=True
        ):
            if part is left_out[0] or without > (1 + LEAST_EFFECT) * all_of_it:
                own[name] = float(without)
    return result if left_out else {}


def _parts(problem: SmoothingProblem) -> Iterator[tuple[str, int | str | None, SmoothingProblem]]:
    """The problem, and what it is without each part of its evidence."""
    by_itself, settings = problem.settings, count_once(problem)
    problem = replace(problem, settings=settings)
    markers, views = problem.measured.markers, problem.views
    yield "nothing", None, problem
    for marker in range(markers.shape[1]):
        fewer = np.array(markers)
        fewer[:, marker] = np.nan
        yield "marker", marker, problem.with_measured(markers=fewer)
    for camera in np.unique(views.camera):
        others = views.camera != camera
        yield "camera", int(camera), replace(problem, views=_views_of(problem, others))
    if problem.measured.sight_lines is not None:
        yield "key points", None, problem.with_measured(sight_lines=None)
    for field in fields(settings):
        term = getattr(settings, field.name)
        if isinstance(term, Term) and not isinstance(term, OTHER_TERMS):
            vain = jax.tree.map(lambda deviation: np.asarray(deviation) * NOTHING, term)
            weaker = replace(settings, **{field.name: vain})
            yield "prior", field.name, replace(problem, settings=weaker)
    # What is usual is evidence once in every moment, where none is tied to others.
    loose = np.asarray(settings.acceleration) * NOTHING
    once = {name: getattr(settings, name) for name in ("silhouettes", "keypoints")}
    apart = replace(by_itself, **once, acceleration=loose)
    yield "prior", "motion", replace(problem, settings=apart)


def _views_of(problem: SmoothingProblem, kept: np.ndarray) -> Any:
    return jax.tree.map(lambda part: np.asarray(part)[kept], problem.views)


def _middle(
    problem: SmoothingProblem, trajectory: Trajectory
) -> tuple[SmoothingProblem, Trajectory]:
    """The ``MOST_EVENTS`` in the middle."""
    if (count := len(problem.times)) <= MOST_EVENTS:
        return problem, trajectory
    first = (count - MOST_EVENTS) // 2
    rows, views = np.arange(first, first + MOST_EVENTS), problem.views
    if len(views.frame):
        views = _views_of(problem, np.isin(views.frame, rows))
        views = views._replace(frame=views.frame - first)
    part = replace(
        problem, times=problem.times[rows], measured=rows_of(problem.measured, rows), views=views
    )
    return part, trajectory._replace(poses=rows_of(trajectory.poses, rows))
