"""A recording whose markers determine the whole body: fitted to them, and followed by them.

    some samples ── poses ── lengths and places with them ── poses of all samples

INPUTS: a HybridTracker, RecordingEvents. OUTPUTS: the tracker with the fitted model; a first pass
and its trajectory with deviations.
"""

from copy import copy
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.body.model import Model
from jaxmocap.body.pose import Pose
from jaxmocap.calibration.fitting.marker_fit import (
    FIT_PERSON,
    LANDMARK_VARIANCES,
    fitted_model,
    usual_covariance,
)
from jaxmocap.calibration.fitting.marker_poses import FAR_TAILS, FIT_POSES, TAILS, PosesFit
from jaxmocap.compilation.batches import in_batches
from jaxmocap.formats.marker_sets.sets import determine_body
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.resampling import bridge_poses
from jaxmocap.hybrid.refine import StepReport
from jaxmocap.hybrid.step import PLACE
from jaxmocap.hybrid.tracker import HybridTracker
from jaxmocap.pipelines.progress import Progress
from jaxmocap.pipelines.tracking.events import RecordingEvents
from jaxmocap.smoothing.problem import FirstPass, Trajectory

# Samples that lengths and places are fitted to; from each of them the poses are followed on.
SAMPLES = 64
# Other starts are tried for them so often at most, while one brings more than so much, nats.
ROUNDS, GAIN = 4, 1.0
# A sample has this share of the markers at least that the fullest one has.
FULL_SHARE = 0.9


class MarkedPass(NamedTuple):
    """What the markers determined."""

    tracker: HybridTracker  # with the model as fitted
    first: FirstPass  # poses of all events
    trajectory: Trajectory  # the same with deviations
    sentence: str  # what was fitted, for the report; "" where nothing was

    def recording(self, recording: Recording) -> Recording:
        """The recording with the body and the places as fitted."""
        model = self.tracker.model
        offsets = np.asarray(model.markers.offsets, float).tolist()
        places = [
            replace(place, offset=tuple(offset))
            for place, offset in zip(recording.places, offsets, strict=True)
        ]
        return replace(recording, skeleton=model.skeleton, places=tuple(places))


def is_marked(tracker: HybridTracker) -> bool:
    """Whether the markers determine the whole body; never by the first paper's way."""
    return tracker.settings.smooth and determine_body(tracker.model.skeleton, tracker.model.markers)


def follow_markers(
    events: RecordingEvents, tracker: HybridTracker, show: Progress, causal: bool = False
) -> MarkedPass:
    """Fit lengths and places where the recording wants it, and follow the markers.

    Causally nothing is fitted by later samples, and each event goes on from the one before.
    """
    markers = np.asarray(events.markers_world, tracker.model.dtype)
    chosen = np.zeros(1, int)
    if not causal:
        # Spread over the events that have nearly all markers.
        present = np.isfinite(markers).all(-1).sum(1)
        full = np.flatnonzero(present >= FULL_SHARE * present.max())
        chosen = full[np.linspace(0, len(full) - 1, SAMPLES).astype(int)]
    model, sentence = tracker.model, ""
    fit = cheapest(model, _far(tracker, markers[chosen]), markers[chosen])
    # Whoever states that lengths and places are not to be fitted knows them.
    covariance = usual_covariance(model) * float(events.recording.fit)
    if events.recording.fit and not causal:
        before = fit
        person = FIT_PERSON(model, fit.poses, markers[chosen])
        covariance = person.covariance
        model = fitted_model(model, jax.tree.map(jnp.asarray, person.person))
        fit = FIT_POSES(model, person.poses, markers[chosen], _tails(model, TAILS))
        off_cm = [100 * np.nanmedian(np.asarray(each.distances)) for each in (before, fit)]
        # Of fewer some are chosen several times.
        count = len(np.unique(chosen))
        sentence = (
            f"bone lengths and the places of {markers.shape[1]} markers, to {count} samples: "
            f"off by {off_cm[0]:.1f} cm before, {off_cm[1]:.1f} cm after (median)"
        )
    other = copy(tracker)
    other.model = model
    poses = _along(model, markers, chosen, fit.poses, show)
    if not causal:
        is_measured = np.isfinite(markers).all(-1).sum(1) > 0
        poses = bridge_poses(events.timeline.event_times, poses, is_measured)
    each = jax.tree.map(np.asarray, (poses, markers))
    (variances,) = in_batches(partial(LANDMARK_VARIANCES, model, covariance), each, SAMPLES)
    first = _first_pass(events, other, poses)
    deviations = np.sqrt(variances)
    trajectory = Trajectory(
        poses, np.zeros(0), deviations=deviations, from_prior=np.zeros(deviations.shape[:2])
    )
    return MarkedPass(other, first, trajectory, sentence)


def _far(tracker: HybridTracker, markers: np.ndarray) -> PosesFit:
    """Poses (K, ...) of markers (K, M, 3), from the relaxed one placed by them."""
    model = tracker.model
    placed = [PLACE(model, tracker.settings.ik, each)[0] for each in markers]
    start = jax.tree.map(lambda *each: np.stack(each), *placed)
    near = FIT_POSES(model, start, markers, _tails(model, FAR_TAILS))
    return FIT_POSES(model, near.poses, markers, _tails(model, TAILS))


def cheapest(model: Model, fit: PosesFit, markers: np.ndarray) -> PosesFit:
    """The same, or from other starts where that costs less (K, ...).

    An elbow that has turned through its back meets the markers as well, and no descent leaves it.
    Starts are the poses before and after, and the pose itself with its joints in their ranges.
    """
    fit = jax.tree.map(np.asarray, fit)
    for _ in range(ROUNDS):
        before = fit.cost
        for start in (_in_ranges(model, fit.poses), *_neighbours(fit.poses)):
            tried = jax.tree.map(np.asarray, FIT_POSES(model, start, markers, _tails(model, TAILS)))
            lower = tried.cost < fit.cost
            fit = jax.tree.map(
                lambda new, old, lower=lower: np.where(
                    lower.reshape(-1, *[1] * (old.ndim - 1)), new, old
                ),
                tried,
                fit,
            )
        if not (before - fit.cost > GAIN).any():
            break
    return fit


def _in_ranges(model: Model, poses: Pose) -> Pose:
    """Poses whose joints' angles are moved into their ranges, by whole turns where they can be."""
    low, high = np.asarray(model.skeleton.limits).T
    angles = np.asarray(poses.angles)
    turn = np.asarray(2 * np.pi, angles.dtype)
    near = angles - turn * np.round((angles - (low + high) / 2) / turn)
    return poses._replace(angles=np.clip(near, low, high))


def _neighbours(poses: Pose) -> tuple[Pose, Pose]:
    """Poses (K, ...) each moved on by one, and back by one; the last stays."""
    rows = np.arange(len(poses.angles))
    earlier, later = np.maximum(rows - 1, 0), np.minimum(rows + 1, rows[-1])
    before, after = (
        jax.tree.map(lambda part, r=r: np.asarray(part)[r], poses) for r in (earlier, later)
    )
    return before, after


def _tails(model: Model, tails: float) -> np.ndarray:
    return np.asarray(tails, model.dtype)


def _along(
    model: Model, markers: np.ndarray, chosen: np.ndarray, poses: Pose, show: Progress
) -> Pose:
    """Poses (E, ...), from each chosen event on."""
    count, ends = len(markers), [*chosen[1:], len(markers)]
    lanes = [np.arange(first, max(end, first + 1)) for first, end in zip(chosen, ends, strict=True)]
    lanes[0] = np.concatenate([np.arange(chosen[0])[::-1], lanes[0]])
    parts: Any = None
    for step in range(max(map(len, lanes))):
        now = np.array([lane[min(step, len(lane) - 1)] for lane in lanes])
        poses = FIT_POSES(model, poses, markers[now], _tails(model, TAILS)).poses
        found = jax.tree.map(np.asarray, poses)
        if parts is None:
            parts = jax.tree.map(lambda part: np.zeros((count, *part.shape[1:]), part.dtype), found)
        for whole, part in zip(jax.tree.leaves(parts), jax.tree.leaves(found), strict=True):
            whole[now] = part
        show(min((step + 1) * len(lanes), count), count)
    return parts


def _first_pass(events: RecordingEvents, tracker: HybridTracker, poses: Pose) -> FirstPass:
    """A first pass with these poses and nothing of the video."""
    line, dtype = events.timeline, tracker.model.dtype
    count, markers = np.shape(events.markers_world)[:2]
    errors = np.full((count, markers), np.nan, dtype)
    none, unknown = np.zeros(count, bool), np.full((count, 2), np.nan, dtype)
    each: tuple[Any, ...] = (
        poses, errors, unknown, np.zeros((count, 2), dtype), unknown,
        none, none, none, np.zeros(count, np.int32),
    )  # fmt: skip
    reports = StepReport(*each)
    return FirstPass(
        line.event_times, events.markers_world, line.frame_index, poses, reports, [()] * count
    )
