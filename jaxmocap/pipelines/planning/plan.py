"""Cameras placed by gradient, for a movement that was recorded by markers or is drawn.

    who moves ── information of markers and priors ── best places, one after the other ── results

INPUTS: a Recording or the name of a movement and a height; Requirements. OUTPUTS: a CameraPlan.
"""

from collections.abc import Sequence
from functools import partial

import jax.numpy as jnp
import numpy as np

from jaxmocap.body.skeleton import LANDMARKS, landmark_rows
from jaxmocap.body.subject import skeleton_stature
from jaxmocap.calibration.fitting.camera_plan.expected import Information, of_markers, with_camera
from jaxmocap.calibration.fitting.camera_plan.placement import (
    Goal,
    best_place,
    camera_at,
    frame_of,
    mean_deviation,
    ring_about,
)
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.geometry.cameras import Camera
from jaxmocap.hybrid.settings import Settings
from jaxmocap.pipelines.planning.requirements import Requirements, fov_deg
from jaxmocap.pipelines.planning.results import CameraPlan
from jaxmocap.pipelines.planning.subject import (
    SECONDS,
    SEED,
    drawn_subject,
    movement_of,
    recorded_subject,
    settings_for,
)
from jaxmocap.pipelines.progress import Progress, progress_bar
from jaxmocap.synthetic.movements.motions import MOTIONS

# What else could be worn -> the landmarks that it holds.
TRACKERS = {
    "a waist tracker": ("pelvis",),
    "ankle trackers": ("ankle_l", "ankle_r"),
    "elbow trackers": ("elbow_l", "elbow_r"),
}


def plan_cameras(
    recording: Recording | None,
    required: Requirements | None = None,
    *,
    movement: str = "tennis",
    height: float = 1.75,
    progress: Progress | bool | None = None,
) -> CameraPlan:
    """Where cameras are worth most, and what else would help.

    The movement is that of the recording's markers, whose cameras stand already, or one of
    ``MOTIONS`` by somebody of a height, metres. What is expected is what a report would state
    (``smoothing.uncertainty``): a limb that is lost errs by more.

    Raises:
        InputError: a recording without markers, or one that is too short; requirements that
            leave no place.
    """
    required, settings = required or Requirements(), Settings()
    bounds, rows = required.bounds(), landmark_rows(required.landmarks())
    weights = np.zeros(len(LANDMARKS), np.float32)
    weights[rows] = 1 / len(rows)
    if recording is None:
        try:
            performance = MOTIONS[movement](SECONDS, SEED, height=height)
        except ValueError as error:
            raise InputError("--height", str(error)) from None
        subject = drawn_subject(performance, height)
    else:
        subject = recorded_subject(recording, settings, progress)
    lens, zoom = required.lens(subject.cameras)
    bounds = bounds._replace(largest=bounds.largest._replace(zoom=zoom))
    model, skeleton = subject.model, subject.model.skeleton
    moments = movement_of(subject)
    smoothing = settings_for(model, settings.smoothing, moments)
    rate, weights = jnp.asarray(required.rate), jnp.asarray(weights)

    def with_cameras(information: Information, cameras: Sequence[Camera]) -> Information:
        for camera in cameras:
            information = with_camera(skeleton, smoothing, information, camera, rate)
        return information

    def error_of(information: Information, cameras: Sequence[Camera] = ()) -> float:
        return float(mean_deviation(smoothing, with_cameras(information, cameras), weights))

    information = of_markers(model, smoothing, moments)
    frame = frame_of(information, np.asarray(moments.measured.facing))
    goal = Goal(skeleton, smoothing, information, frame, lens, rate, weights)
    best, rings, placed, stature = [], [], [], skeleton_stature(skeleton)
    with progress_bar("placing cameras", progress, "compiling") as show:
        for number in range(required.cameras):

            def show_share(before: int, share: float) -> None:
                show(round(50 * (before + share)), 100 * required.cameras)

            rings.append(ring_about(goal, bounds, stature, partial(show_share, 2 * number)))
            of_descent = partial(show_share, 2 * number + 1)
            best.append(best_place(goal, bounds, rings[-1], of_descent))
            placed.append(camera_at(lens, frame, best[-1].place))
            goal = goal._replace(information=with_cameras(goal.information, placed[-1:]))
    with_trackers = {}
    for name, landmarks in TRACKERS.items():
        if (more := subject.with_markers_at(landmarks)) is not None:
            of_more = of_markers(more.model, smoothing, movement_of(more))
            with_trackers[name] = error_of(of_more, placed[:1])
    return CameraPlan(
        joints=required.joints,
        markers_alone=error_of(information),
        present=error_of(information, subject.cameras) if subject.cameras else None,
        best=tuple(best),
        fields_of_view=tuple(map(fov_deg, placed)),
        fields_across=tuple(fov_deg(camera, across=True) for camera in placed),
        with_trackers=with_trackers,
        ring=rings[0],
        bounds=bounds,
    )
