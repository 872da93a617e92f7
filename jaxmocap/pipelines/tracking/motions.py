"""From a trajectory to motions: one row per marker sample, and a report on each.

INPUTS: RecordingEvents, FirstPass, a Trajectory. OUTPUTS: Motions.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxmocap.body.arms import arms_of, swivels
from jaxmocap.body.kinematics import forward, site_positions
from jaxmocap.body.model import Model
from jaxmocap.body.motion import Motion, Report, Run
from jaxmocap.body.pose import Pose, unpack
from jaxmocap.body.skeleton import ELBOWS, LANDMARKS, Skeleton
from jaxmocap.capture.filters import butterworth_low_pass
from jaxmocap.compilation.batches import in_batches
from jaxmocap.compilation.programs import program
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.pipelines.tracking.events import RecordingEvents, elbow_warnings
from jaxmocap.smoothing.fixed_lag import SmoothedPose
from jaxmocap.smoothing.problem import FirstPass, Trajectory

# RecordingEvents per call, so that they compile once.
EVENTS_A_CALL = 64


class Tracked(NamedTuple):
    """One run over a recording."""

    motion: Motion
    markers_only: Motion  # of the same steps without the video
    recording: Recording  # with its videos at the times at which they were tracked


def steps_as_trajectory(first_pass: FirstPass) -> Trajectory:
    """The steps as they are, which have deviations of the elbows only."""
    of_elbows = np.asarray(first_pass.reports.elbow_deviations)
    deviations = np.full((len(of_elbows), len(LANDMARKS), 3), np.nan)
    deviations[:, ELBOWS] = of_elbows[..., None] / np.sqrt(3)
    unknown = np.full(deviations.shape[:2], np.nan)
    return Trajectory(first_pass.poses, np.zeros(0), deviations=deviations, from_prior=unknown)


def low_pass_poses(times: np.ndarray, poses: Pose, skeleton: Skeleton, cutoff: float) -> Pose:
    """Poses (T, ...) without what changes faster than a cut-off, Hz.

    What the first paper's section 7 proposes against oscillations, by each degree of freedom, the
    pelvis' as well: angles alone would follow a pelvis that jumps.
    """
    place, turn, angles = (np.array(part) for part in poses)
    # The next of two opposite quaternions, which are one turn.
    turn[1:] *= np.cumprod(np.sign(np.sum(turn[1:] * turn[:-1], -1, keepdims=True)), 0)
    every = np.concatenate([place, turn, angles], -1)[..., None].astype(float)
    filtered = butterworth_low_pass(times, every, cutoff)[..., 0]
    place, turn, angles = unpack(filtered.astype(place.dtype))
    turn = turn / np.linalg.norm(turn, axis=-1, keepdims=True)
    return Pose(place, turn, np.clip(angles, *np.asarray(skeleton.limits).T))  # type: ignore[arg-type]


def join_outputs(final: Sequence[SmoothedPose], cameras: int) -> Trajectory:
    """What a fixed-lag smoother of so many cameras gave out of all events, in order."""
    poses = jax.tree.map(lambda *parts: np.stack(parts), *(each.pose for each in final))
    deviations, from_prior = (
        np.stack([getattr(each, name) for each in final]) for name in ("deviations", "from_prior")
    )
    unrecognised = np.zeros((len(final), cameras), bool)
    for each, own in zip(final, unrecognised, strict=True):
        own[list(each.unrecognised)] = True
    found = {"deviations": deviations, "from_prior": from_prior, "unrecognised": unrecognised}
    return Trajectory(poses, np.zeros(0, poses.angles.dtype), **found)


def motions(
    model: Model,
    events: RecordingEvents,
    first_pass: FirstPass,
    trajectory: Trajectory,
    milliseconds: dict[str, list[float]],
    run: Run,
) -> tuple[Motion, Motion]:
    """A run's motion, and that of the same steps without the video.

    They have all samples as arrays, NaN before the first one with a marker.
    """
    person = trajectory.person(model.skeleton) if len(trajectory.proportions) else model.skeleton
    # Distances (E, M) of markers from the body, metres; turns (E, 2) of elbows by the video.
    each = trajectory.poses, first_pass.reports.marker_pose, first_pass.markers_world
    each = jax.tree.map(lambda part: np.asarray(part, model.dtype), each)
    errors, turns = in_batches(partial(_compare_events, model, person), each, EVENTS_A_CALL)
    assert trajectory.deviations is not None and trajectory.from_prior is not None
    columns = {
        "marker_errors": errors,
        "arm_costs": first_pass.reports.outline_px,
        "swivels": turns,
        "landmarks_std": trajectory.deviations,
        "from_prior": trajectory.from_prior,
    }
    # In the model's precision: of a million samples twice that would be too much for memory.
    columns = {
        name: _at_samples(events, np.asarray(values, model.dtype))
        for name, values in columns.items()
    }
    report = Report(
        markers=events.recording.marker_names,
        **columns,
        statuses=(),
        milliseconds={stage: np.array(times) for stage, times in milliseconds.items()},
        run=run,
    )
    listed = _warnings(events, first_pass, trajectory.unrecognised, report.elbow_deviations)
    report = replace(report, statuses=listed)
    alone = _motion(events, model.skeleton, first_pass.reports.marker_pose)
    return _motion(events, person, trajectory.poses, report), alone


def _at_samples(events: RecordingEvents, values: np.ndarray | Array) -> np.ndarray:
    """(T, ...) of each sample, by values (E, ...) of the events; NaN before the first one."""
    values, rows = np.asarray(values), np.flatnonzero(events.timeline.sample_index >= 0)
    # Of a long recording without a video nothing is copied.
    kept = values if len(rows) == len(values) else values[rows]
    if not events.before:
        return kept
    return np.concatenate([np.full((events.before, *kept.shape[1:]), np.nan, kept.dtype), kept])


def _motion(
    events: RecordingEvents, skeleton: Skeleton, poses: Pose, report: Report | None = None
) -> Motion:
    """All samples of poses (E, ...) of the events."""
    recording, poses = events.recording, jax.tree.map(partial(_at_samples, events), poses)
    return Motion(skeleton, recording.times, poses, report, recording.origin_world)


def _warnings(
    events: RecordingEvents,
    first_pass: FirstPass,
    unrecognised: np.ndarray | None,
    elbow_deviations: np.ndarray,
) -> tuple[tuple[str, ...], ...]:
    """Of each sample, by cameras without a person (E, C), and its elbows' (T, 2) deviations, too.

    Deviations are metres.
    """
    before = (("no marker has been measured yet",),) * events.before
    of_events = [list(own) for own in first_pass.warnings]
    names = [source.camera_name for source in events.recording.videos]
    for event, camera in () if unrecognised is None else np.argwhere(unrecognised).tolist():
        if not any(own.startswith(f"{names[camera]}: ") for own in of_events[event]):
            of_events[event].append(f"{names[camera]}: nothing of the person is recognised")
    listed = events.sample_warnings(of_events)
    unsure = map(elbow_warnings, elbow_deviations[len(before) :])
    joined = ((*own, *more) for own, more in zip(listed, unsure, strict=True))
    # One of those that are equal: a marker that is missing is missing for long.
    once: dict[tuple[str, ...], tuple[str, ...]] = {}
    return before + tuple(once.setdefault(own, own) for own in joined)


@program("quick")
def _compare_events(
    model: Model, person: Skeleton, poses: Pose, alone: Pose, targets: Array
) -> tuple[Array, Array]:
    """Of a batch of events: the markers' distances, the elbows' turns."""

    def of_event(pose: Pose, before: Pose, targets: Array) -> tuple[Array, Array]:
        bones = forward(person, pose)
        off = site_positions(person, bones, model.markers) - targets
        at_first = arms_of(model.skeleton, forward(model.skeleton, before), model.grips)
        return jnp.sqrt(jnp.sum(off**2, -1)), swivels(at_first, arms_of(person, bones, model.grips))

    return jax.vmap(of_event)(poses, alone, targets)
