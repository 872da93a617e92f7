"""Who moves, as a plan needs it: a model, and poses over stretches of time.

INPUTS: a Recording, or the name of a movement and a height. OUTPUTS: a Subject; the movement as the
terms of evidence ask for it.
"""

from dataclasses import replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxmocap.body.kinematics import Sites, forward, joined_sites, landmark_sites, site_positions
from jaxmocap.body.model import Model, marker_sites, on_unmarked_feet
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import LANDMARKS, WINTER, Skeleton
from jaxmocap.calibration.fitting.camera_plan.expected import Movement
from jaxmocap.evidence.terms import Measurements
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.recording import MarkerPlace, Recording
from jaxmocap.geometry.cameras import Camera
from jaxmocap.hybrid.settings import Settings
from jaxmocap.pipelines.progress import Progress
from jaxmocap.pipelines.tracking.track import track
from jaxmocap.silhouette.first_pose import pose_at_landmarks
from jaxmocap.smoothing.facing import references
from jaxmocap.smoothing.problem import SmoothingProblem, Views
from jaxmocap.smoothing.settings import SmoothingSettings, weigh_by_time
from jaxmocap.smoothing.uncertainty import count_once
from jaxmocap.synthetic.movements.motions import Performance
from jaxmocap.synthetic.recording import marker_places

SECONDS, SEED = 4.0, 0
# Markers nearer than this are at one place, metres.
SAME_M = 0.08
# Stretches of a movement, moments of each, and moments a second.
STRETCHES, MOMENTS, RATE_HZ = 4, 12, 15.0


class Subject(NamedTuple):
    """Who moves, with which markers."""

    model: Model  # of the person and the markers
    times: np.ndarray  # (S, T) seconds
    poses: Pose  # (S * T, ...) at these times
    measured: np.ndarray  # (S * T, M) whether there is each marker
    cameras: tuple[Camera, ...]  # that stand already

    def with_markers_at(self, landmarks: tuple[str, ...]) -> "Subject | None":
        """The same with more markers; None where one of them is worn there already."""
        model, shape = self.model, (len(self.measured), len(landmarks))
        more = landmark_sites(model.skeleton, landmarks)
        first = jax.tree.map(lambda part: part[:1], self.poses)
        there, worn = (
            np.asarray(_sites(model.skeleton, each, first))[0] for each in (more, model.markers)
        )
        if (np.linalg.norm(there[:, None] - worn, axis=-1) < SAME_M).any():
            return None
        joined = replace(model, markers=joined_sites(model.markers, more))
        measured = np.concatenate([self.measured, np.ones(shape, bool)], 1)
        return self._replace(model=joined, measured=measured)


def _instants(first: float, last: float) -> np.ndarray:
    """Times (S, T) of stretches evenly between two, seconds."""
    span = (MOMENTS - 1) / RATE_HZ
    return np.linspace(first, last - span, STRETCHES)[:, None] + np.arange(MOMENTS) / RATE_HZ


def drawn_subject(performance: Performance, height: float, seconds: float = SECONDS) -> Subject:
    """Somebody of stated height, with headset and controllers, who moves so."""
    skeleton = Skeleton.human(height, proportions=WINTER)
    places = [
        MarkerPlace(name, on["bone"], on["at"], tuple(on["offset"]))
        for name, on in marker_places().items()
    ]
    times = _instants(0.0, seconds)
    model = on_unmarked_feet(Model.create(skeleton, marker_sites(skeleton, places)))
    at = performance.landmarks(times.ravel())
    points = np.stack([at[name] for name in LANDMARKS], 1)
    each = [pose_at_landmarks(model.skeleton, point) for point in points]
    poses = jax.tree.map(lambda *parts: np.stack([np.asarray(part) for part in parts]), *each)
    return Subject(model, times, poses, np.ones((len(points), len(places)), bool), ())


def recorded_subject(
    recording: Recording, settings: Settings, progress: Progress | bool | None
) -> Subject:
    """Who was recorded, tracked by the markers alone."""
    where = recording.path or recording.name
    if not recording.places:
        raise InputError(where, "has no markers, expected some: they show how the person moves")
    cameras = tuple(video.camera for video in recording.videos)
    alone = replace(recording, videos=())
    motion = track(alone, settings, progress=progress)
    angles = np.asarray(motion.poses.angles)
    rows = np.flatnonzero(np.isfinite(angles).all(-1))
    span = motion.times[rows[-1]] - motion.times[rows[0]] if len(rows) else 0.0
    least = (MOMENTS - 1) / RATE_HZ
    if span < least:
        raise InputError(where, f"found {span:.2f} s of movement, expected {least:.2f} s or more")
    times = _instants(*motion.times[rows[[0, -1]]])
    near = rows[np.abs(motion.times[rows] - times.reshape(-1, 1)).argmin(-1)]
    poses = jax.tree.map(lambda part: np.asarray(part)[near], motion.poses)
    model = Model.of(replace(alone, skeleton=motion.skeleton))
    measured = np.asarray(np.isfinite(recording.positions_world[near]).all(-1))
    return Subject(model, times, poses, measured, cameras)


def movement_of(subject: Subject) -> Movement:
    """The movement as the terms of its model ask for it."""
    model, poses, times = subject.model, subject.poses, subject.times
    on = np.asarray(_sites(model.skeleton, model.markers, poses))
    measured = references(model.skeleton, times.ravel(), poses)._replace(
        markers=np.where(subject.measured[..., None], on, np.nan),
        elbows=np.full((times.size, 2, 3), np.nan),
    )

    def in_stretches(part: np.ndarray) -> jax.Array:
        return jnp.asarray(part, model.dtype).reshape(*times.shape, *np.shape(part)[1:])

    stretches, each = jax.tree.map(in_stretches, (poses, measured))
    return Movement(jnp.asarray(times[0] - times[0, 0], model.dtype), stretches, each)


@jax.jit
@partial(jax.vmap, in_axes=(None, None, 0))
def _sites(skeleton: Skeleton, sites: Sites, pose: Pose) -> jax.Array:
    return site_positions(skeleton, forward(skeleton, pose), sites)


def settings_for(model: Model, settings: SmoothingSettings, moments: Movement) -> SmoothingSettings:
    """With errors that are alike counted once."""
    times = np.asarray(moments.times, float)
    weighted = weigh_by_time(settings, times)
    return count_once(SmoothingProblem(model, weighted, times, Measurements(), Views.no_cameras()))
