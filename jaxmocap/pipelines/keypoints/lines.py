"""The tracked person's key points in videos as lines of sight.

INPUTS: a skeleton, a camera, one person's Detections; or a Recording, everybody's Detections, poses
by the markers. OUTPUTS: SightLines.
"""

from collections.abc import Sequence

import jax
import numpy as np

from jaxmocap.body.motion import landmarks_over_time
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton, landmark_rows
from jaxmocap.capture.keypoints import marked_landmarks, select_person
from jaxmocap.capture.timeline import Timeline
from jaxmocap.evidence.keypoints import SightLines, estimated_depths, lines_of_sight
from jaxmocap.formats.recordings.keypoints import Detections
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.geometry.cameras import Camera


def lines_to_person(skeleton: Skeleton, camera: Camera, person: Detections) -> SightLines:
    """The lines (F, 1, ...) to the only person of F frames, with depths where there are joints."""
    joints, depths = person.joints_cam, None
    if joints is not None:
        depths = estimated_depths(skeleton, person.landmarks, joints[:, 0])
    pixels_xy, sure = person.pixels_xy[:, 0], person.confidences[:, 0]
    return lines_of_sight(camera, person.landmarks, pixels_xy, sure, depths)


def lines_at_events(
    recording: Recording,
    keypoints: Sequence[Detections | None],
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
    if all(each is None for each in keypoints):
        return None
    points_world = landmarks_over_time(recording.skeleton, marker_poses)
    lines = []
    columns = zip(recording.videos, keypoints, timeline.frame_index.T, strict=True)
    for source, each, frames in columns:
        if each is None:
            continue
        marked = marked_landmarks(recording, each.landmarks, timeline.event_times)
        # Markers identify a person better than a pose, where they sit on enough of the landmarks.
        enough = np.isfinite(marked).all(-1).sum(1) >= 2
        by_pose = points_world[:, landmark_rows(each.landmarks)]
        expected = np.where(enough[:, None, None], marked, by_pose)
        expected[frames < 0] = np.nan
        person = select_person(each.at_frames(frames), source.camera, expected)
        lines.append(lines_to_person(recording.skeleton, source.camera, person))
    return jax.tree.map(lambda *parts: np.concatenate(parts, 1), *lines)
