"""Where a recording's key points put the tracked person, at the events of a run.

INPUTS: a recording, its videos' key points; the poses that markers alone gave.
OUTPUTS: lines of sight of every event.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import numpy as np

from jaxmocap.body.motion import landmarks_over_time
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import landmark_rows
from jaxmocap.capture.keypoints import Keypoints, marked_landmarks, select_person
from jaxmocap.capture.timeline import Timeline
from jaxmocap.evidence.keypoints import SightLines, lines_of_sight
from jaxmocap.formats.recordings.recording import Recording, VideoSource


def lines_at_events(
    recording: Recording,
    keypoints: Sequence[Keypoints | None],
    timeline: Timeline,
    marker_poses: Pose,
) -> SightLines | None:
    """Lines of sight of the cameras with key points to the tracked person's landmarks.

    Args:
        recording: that the videos are of.
        keypoints: of each video.
        timeline: E events.
        marker_poses: (E, ...) of the markers alone, which separate the person from others.

    Returns:
        (E, ...) of all these cameras; None where there is none.
    """
    points_world = landmarks_over_time(recording.skeleton, marker_poses)
    lines = [
        _lines(recording, source, each, timeline, frames, points_world)
        for source, each, frames in zip(
            recording.videos, keypoints, timeline.frame_index.T, strict=True
        )
        if each is not None
    ]
    return jax.tree.map(lambda *parts: np.concatenate(parts, 1), *lines) if lines else None


def _lines(
    recording: Recording,
    source: VideoSource,
    keypoints: Keypoints,
    timeline: Timeline,
    frames: np.ndarray,
    points_world: np.ndarray,
) -> SightLines:
    """One camera's lines (E, 1, ...), of its frames (E,) or -1."""
    names = keypoints.landmarks
    marked = marked_landmarks(recording, names, timeline.event_times)
    # Markers identify a person better than a pose, where they sit on enough of the landmarks.
    enough = np.isfinite(marked).all(-1).sum(1) >= 2
    posed = points_world[:, landmark_rows(names)]
    expected = np.where(enough[:, None, None], marked, posed)
    expected[frames < 0] = np.nan
    at_events = replace(
        keypoints, pixels_xy=keypoints.pixels_xy[frames], confidences=keypoints.confidences[frames]
    )
    return lines_of_sight(source.camera, names, *select_person(at_events, source.camera, expected))
