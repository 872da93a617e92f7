"""What silhouettes cannot determine: refused or warned of before, stated frame by frame after.

INPUTS: a Recording; where a pose and key points have the landmarks; a Motion.
OUTPUTS: warnings; sentences about frames in which the person is lost.
"""

from itertools import combinations

import numpy as np

from jaxmocap.body.motion import Motion
from jaxmocap.evidence.keypoints import SightLines
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.pipelines.silhouettes.keypoints import has_keypoints

# Two cameras that look along lines with less between them determine depth badly, degrees.
LEAST_ANGLE_DEG = 30.0
# Key points whose median lies farther off than this are of somebody else, or the pose is, metres.
FAR_OFF_M = 0.15
# A frame's status begins with it where the person is lost.
LOST = "lost: "


def check_determined(recording: Recording, markers: bool, guess: bool) -> tuple[str, ...]:
    """Warnings about cameras that determine depth badly.

    Args:
        recording: with its cameras.
        markers: whether its markers are followed.
        guess: whether one camera alone is tracked all the same.

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
