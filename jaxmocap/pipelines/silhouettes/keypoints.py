"""Key points beside silhouettes: whose they are, lines of sight, where they have the person.

INPUTS: a Recording whose videos have key points, the frames that belong together.
OUTPUTS: a KeypointGuide. What silhouettes cannot determine: refused or warned of before, stated
frame by frame after.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import jax
import numpy as np

from jaxmocap.body.motion import Motion
from jaxmocap.body.pose import Pose
from jaxmocap.body.skeleton import Skeleton, landmark_rows, with_joints
from jaxmocap.capture.keypoints import follow_person, open_keypoints
from jaxmocap.capture.video import FrameSource
from jaxmocap.evidence.keypoints import SightLines
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.geometry.cameras import on_host, project
from jaxmocap.pipelines.keypoints.lines import lines_to_person
from jaxmocap.silhouette.first_pose import landmark_points
from jaxmocap.silhouette.keypoint_poses import LEAST_LINES, KeypointPoses, poses_of_lines
from jaxmocap.silhouette.settings import Settings


class KeypointGuide(NamedTuple):
    """Where the key points of F instants have the person."""

    lines: SightLines  # (F, ...) of the cameras that have key points
    poses: KeypointPoses  # (F, ...), and the bones' lengths by them
    # (F,) whether so many landmarks were detected that they say where somebody is.
    is_detected: np.ndarray
    warnings: tuple[str, ...]  # for the user

    @property
    def skeleton(self) -> Skeleton:
        """The person's."""
        return self.poses.skeleton

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
        first = None
        if start is not None:
            rows = landmark_rows(detections.landmarks)
            points = np.asarray(landmark_points(skeleton, start), float)[rows]
            first = project(on_host(source.camera), points)
        person = follow_person(detections, first)
        lines.append(lines_to_person(skeleton, source.camera, person.at_frames(frames)))
    if not lines:
        return None
    joined = jax.tree.map(lambda *parts: np.concatenate(parts, 1), *lines)
    is_detected = (joined.confidences > 0).sum((1, 2)) >= LEAST_LINES
    if not is_detected.any():
        return None
    poses = poses_of_lines(skeleton, times, joined, settings.keypoint_poses)
    return KeypointGuide(poses.lines, poses, is_detected, tuple(warnings))


# Two cameras that look along lines with less between them determine depth badly, degrees.
LEAST_ANGLE_DEG = 30.0
# Key points whose median lies farther off than this are of somebody else, or the pose is, metres.
FAR_OFF_M = 0.15
# A frame's status begins with it where the person is lost.
LOST = "lost: "


def check_determined(recording: Recording, markers: bool, guess: bool) -> tuple[str, ...]:
    """Warnings about cameras that determine depth badly; ``markers``, whether they are followed.

    Raises:
        InputError: one camera alone, and no guess.
    """
    cameras = [source.camera for source in recording.videos]
    helped = markers or has_keypoints(recording)
    if len(cameras) == 1 and not helped:
        problem = "one camera without key points or markers loses the person"
        if not guess:
            raise recording.error(
                f"{problem}: 'jaxmocap keypoints' adds key points, --markers follows the "
                "recording's markers, a second camera helps too; --guess tracks all the same"
            )
        return (f"a guess: {problem}",)
    if len(cameras) != 2:
        return ()
    names = " and ".join(source.camera_name for source in recording.videos)
    (angle,) = (_between(*pair) for pair in combinations(cameras, 2))
    if angle >= LEAST_ANGLE_DEG:
        return ()
    problem = f"{names} look along lines {angle:.0f} degrees apart"
    return (f"{problem}, expected {LEAST_ANGLE_DEG:.0f} or more: they hardly show depth",)


def _between(first, second) -> float:
    """Degrees between two cameras' optical axes, taken as lines: opposite views are alike."""
    axes = [np.asarray(camera.T_cam_world, float)[2, :3] for camera in (first, second)]
    return float(np.degrees(np.arccos(np.clip(abs(axes[0] @ axes[1]), 0, 1))))


def keypoint_distances(points_world: np.ndarray, lines: SightLines) -> np.ndarray:
    """(F,) how far landmarks lie from their lines in the median, metres; NaN where none is.

    Args:
        points_world: (F, L, 3) metres.
        lines: (F, ...) of C cameras.
    """
    is_detected = np.asarray(lines.confidences) > 0
    off = points_world[:, None] - np.asarray(lines.origin)[:, :, None]
    across = np.linalg.norm(np.cross(off, np.asarray(lines.directions)), axis=-1)
    distances = np.full(len(across), np.nan)
    for frame, (own, counts) in enumerate(zip(across, is_detected, strict=True)):
        if counts.any():
            distances[frame] = np.median(own[counts])
    return distances


def lost_status(used: np.ndarray, distance_m: float, needs_points: bool) -> tuple[str, ...]:
    """What a frame's report says where the person is lost; empty where not.

    Args:
        used: (C,) cameras whose outline the pose explains.
        distance_m: of ``keypoint_distances``; NaN without any.
        needs_points: whether key points are all that helps one camera.
    """
    problems = [] if used.any() else ["no camera's outline is explained"]
    if needs_points and np.isnan(distance_m):
        problems.append("one camera and no key points")
    if distance_m > FAR_OFF_M:
        problems.append(f"key points lie {100 * distance_m:.0f} cm off")
    return (LOST + ", ".join(problems),) if problems else ()


def lost_sentences(motion: Motion) -> list[str]:
    """A sentence where the person is lost in more than half of the frames; empty where not."""
    assert motion.report is not None
    lost = [any(s.startswith(LOST) for s in each) for each in motion.report.statuses]
    if sum(lost) <= len(lost) / 2:
        return []
    return [f"the person is lost in {sum(lost)} of {len(lost)} frames"]
