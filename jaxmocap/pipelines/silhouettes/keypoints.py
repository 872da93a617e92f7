"""Key points beside silhouettes: whose they are, lines of sight, where they have the person.

INPUTS: a Recording whose videos have key points, the frames that belong together.
OUTPUTS: a KeypointGuide.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np

from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton, landmark_rows, with_joints
from jaxmocap.capture.keypoints import follow_person, open_keypoints
from jaxmocap.capture.video import FrameSource
from jaxmocap.evidence.keypoints import SightLines, lines_of_sight
from jaxmocap.formats.recordings.keypoints import Detections
from jaxmocap.formats.recordings.recording import Recording, VideoSource
from jaxmocap.geometry.cameras import on_host, project
from jaxmocap.silhouette.first_pose import landmark_points
from jaxmocap.silhouette.keypoint_poses import LEAST_LINES, KeypointPoses, poses_of_lines
from jaxmocap.silhouette.settings import Settings


class KeypointGuide(NamedTuple):
    """Where the key points of F instants have the person.

    Attributes:
        lines: (F, ...) of the cameras that have key points.
        poses: (F, ...), and the bones' lengths by them.
        is_detected: (F,) whether so many landmarks were detected that they say where somebody is.
        warnings: for the user.
    """

    lines: SightLines
    poses: KeypointPoses
    is_detected: np.ndarray
    warnings: tuple[str, ...]

    @property
    def skeleton(self) -> Skeleton:
        """The person's."""
        return self.poses.skeleton

    def lines_at(self, instant: int) -> SightLines:
        """Those of one instant."""
        return jax.tree.map(lambda part: part[instant], self.lines)

    def pose_at(self, instant: int) -> Pose:
        """That of one instant."""
        return jax.tree.map(lambda part: part[instant], self.poses.poses)


def has_keypoints(recording: Recording) -> bool:
    """Whether any of its videos has key points."""
    return any(source.keypoints is not None for source in recording.videos)


def keypoint_guide(
    recording: Recording,
    videos: Sequence[FrameSource],
    times: np.ndarray,
    indices: np.ndarray,
    start: Pose | None,
    settings: Settings,
) -> KeypointGuide | None:
    """Where the key points have the person; None where no video has any, or nobody is detected.

    Args:
        recording: with cameras.
        videos: opened.
        times: (F,) seconds.
        indices: (F, C) frames of the videos, -1 for none.
        start: where the person is in the first frame, if that is stated.
        settings: of the tracker.

    Raises:
        InputError: key points that cannot be used with the video.
    """
    skeleton = with_joints(recording.skeleton, settings.body)
    lines, warnings = [], []
    for source, video, frames in zip(recording.videos, videos, indices.T, strict=True):
        detections = open_keypoints(source, video)
        if detections is None:
            continue
        warnings += detections.warnings
        person = follow_person(detections, _first_pixels(source, skeleton, start, detections))
        pixels_xy = np.where(frames[:, None, None] >= 0, person.pixels_xy[frames, 0], np.nan)
        sure = np.where(frames[:, None] >= 0, person.confidences[frames, 0], 0.0)
        lines.append(lines_of_sight(source.camera, person.landmarks, pixels_xy, sure))
    if not lines:
        return None
    joined = jax.tree.map(lambda *parts: np.concatenate(parts, 1), *lines)
    is_detected = (joined.confidences > 0).sum((1, 2)) >= LEAST_LINES
    if not is_detected.any():
        return None
    poses = poses_of_lines(skeleton, times, joined, settings.keypoint_poses)
    return KeypointGuide(poses.lines, poses, is_detected, tuple(warnings))


def _first_pixels(
    source: VideoSource, skeleton: Skeleton, start: Pose | None, detections: Detections
) -> np.ndarray | None:
    """(P, 2) where a camera sees the landmarks of a first pose; None without one."""
    if start is None:
        return None
    points = np.asarray(landmark_points(skeleton, start))[landmark_rows(detections.landmarks)]
    return project(on_host(source.camera), np.asarray(points, float))
