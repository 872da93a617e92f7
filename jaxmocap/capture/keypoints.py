"""2-D key points of a video: lined up with its frames, and whose they are.

INPUTS: Detections (frame numbers, everybody in each frame), a video, where some landmarks of the
tracked person are predicted.
OUTPUTS: Detections, a row per frame of the video; the tracked person's own pixels and confidences.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from jaxmocap.body.skeleton import LANDMARK_PLACES, other_side
from jaxmocap.body.tree import Tree
from jaxmocap.capture.markers import interpolate_markers
from jaxmocap.capture.video import FrameSource
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.keypoints import Detections, check_keypoint_count, read_keypoints
from jaxmocap.formats.recordings.recording import MarkerPlace, Recording, VideoSource
from jaxmocap.geometry.cameras import NEAREST_M, Camera, depth, on_host, pixels_per_metre, project

# A detection further than this from where a landmark is predicted is not of that landmark.
PERSON_GATE_M = 0.25
# Nobody's points move by more than this share of their size from frame to frame.
STEP_SHARE = 0.15
# People who are followed to tell who is largest.
TRIES = 4


def open_keypoints(source: VideoSource, video: FrameSource) -> Detections | None:
    """A video's key points, or None; InputError where they are unreadable or of other frames."""
    if source.keypoints is None:
        return None
    if isinstance(source.keypoints, Detections):
        detections = source.keypoints
    else:
        detections = read_keypoints(source.keypoints, source.keypoints_model)
    return align_detections(detections, len(video), source.keypoints_first)


def align_detections(detections: Detections, frames: int, first: int | None = None) -> Detections:
    """Give every frame of a video its detections; frames then count from 0.

    Detectors count from 0 (OpenPose, Pose2Sim, MMPose's inferencer), from 1 (MMPose's demos) or,
    where images were cut out of a longer recording, from anywhere. Not stated, the first frame's
    number is the smallest one if the numbers span just as many frames as the video has; else it
    is the smallest one if that is 0 or 1 and the numbers fit into the video.

    Args:
        detections: with numbers of frames.
        frames: of the video, F.
        first: the number of the video's first frame, where it is stated.

    Raises:
        InputError: numbers from which the first frame cannot be inferred, or none of them in the
            video.
    """
    smallest, largest = detections.numbers[[0, -1]].tolist()
    if first is None:
        span = largest - smallest + 1
        if span != frames and (smallest not in (0, 1) or span > frames):
            raise InputError(
                detections.name,
                f"found key points of frames {smallest} to {largest} for a video of {frames} "
                "frames; state keypoints_first in [[video]], the number of its first frame",
            )
        first = int(smallest)
    rows = detections.numbers - first
    inside = (rows >= 0) & (rows < frames)
    if not inside.any():
        raise InputError(
            detections.name,
            f"found key points of frames {smallest} to {largest}, but the video has "
            f"frames {first} to {first + frames - 1}; check keypoints_first",
        )
    check_keypoint_count(detections.name, frames, *detections.confidences.shape[1:])
    row_of = np.full(frames, -1)
    row_of[rows[inside]] = np.flatnonzero(inside)
    warnings = detections.warnings
    if inside.sum() < frames:
        warning = f"key points of {inside.sum()} of the video's {frames} frames"
        warnings += (f"{detections.name}: {warning}",)
    return replace(detections.at_frames(row_of), warnings=warnings)


def person_costs(pixels_xy: np.ndarray, predicted_xy: np.ndarray, gate_px: float) -> np.ndarray:
    """How far each of a frame's people is from where landmarks are predicted, pixels.

    The mean distance over the predicted landmarks, where each counts at most as much as the gate,
    and as much where it was not detected: neither a swapped wrist nor a person of whom little is
    detected decides.

    Args:
        pixels_xy: (N, P, 2) the people's points; NaN where missing.
        predicted_xy: (P, 2) where the landmarks must be; NaN where there is no prediction.
        gate_px: pixels; a detection further away is not of that landmark.

    Returns:
        (N,) of each; infinite for who has not two landmarks within the gate (one, where no more
        are predicted).
    """
    is_predicted = np.isfinite(predicted_xy).all(-1)
    if not is_predicted.any():
        return np.full(len(pixels_xy), np.inf)
    distances = np.linalg.norm(pixels_xy[:, is_predicted] - predicted_xy[is_predicted], axis=-1)
    # NaN, a point that was not detected, is never near.
    near = distances <= gate_px
    costs = np.where(near, distances, gate_px).mean(-1)
    costs[near.sum(-1) < min(2, is_predicted.sum())] = np.inf
    return costs


def select_person(keypoints: Detections, camera: Camera, points_world: np.ndarray) -> Detections:
    """The tracked person's detections among everybody's, frame by frame.

    Where left and right fit what is predicted much better the other way round, they are swapped.

    Args:
        keypoints: of F frames.
        camera: that took them.
        points_world: (F, P, 3) where the key points' landmarks are at the frames' times, metres,
            as far as that is predicted: NaN elsewhere.

    Returns:
        Of F frames with one person each; NaN and 0 where the person is not among those detected.
    """
    depths = depth(on_host(camera), np.asarray(points_world, float))
    depths = np.where(depths > NEAREST_M, depths, np.nan)
    predicted_xy = project(on_host(camera), np.asarray(points_world, float))
    predicted_xy[np.isnan(depths)] = np.nan
    chosen, sides = np.full(len(depths), -1), other_side(keypoints.landmarks)
    is_swapped = np.zeros(len(depths), bool)
    for frame in np.flatnonzero(np.isfinite(depths).any(-1)):
        gate_px = PERSON_GATE_M * float(pixels_per_metre(camera, np.nanmedian(depths[frame])))
        people, predicted = keypoints.pixels_xy[frame], predicted_xy[frame]
        both = [person_costs(each, predicted, gate_px) for each in (people, people[:, sides])]
        own, other = (min(float(costs.min()), gate_px) for costs in both)
        is_swapped[frame] = own > gate_px / 2 and other < own / 2
        costs = both[int(is_swapped[frame])]
        chosen[frame] = costs.argmin() if np.isfinite(costs.min()) else -1
    return keypoints.of_people(chosen).swap_sides(is_swapped)


def follow_person(keypoints: Detections, first_xy: np.ndarray | None = None) -> Detections:
    """One person's detections, from frame to frame, where nothing but the images says who it is.

    Args:
        keypoints: of F frames.
        first_xy: (P, 2) where the person is in the first frame; without it whoever is largest is
            followed, added up over all frames.

    Returns:
        Of F frames with one person each; NaN and 0 where the person is not among those detected.
    """
    pixels_xy = np.where(keypoints.confidences[..., None] > 0, keypoints.pixels_xy, np.nan)
    sides = other_side(keypoints.landmarks)
    if first_xy is None:
        chosen = _largest_person(pixels_xy, sides)
    else:
        first_xy = np.asarray(first_xy, float)
        chosen = _follow_person(pixels_xy, sides, first_xy, range(len(pixels_xy)))
    return replace(keypoints, pixels_xy=pixels_xy).of_people(chosen)


def _largest_person(pixels_xy: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """(F,) whom of each frame's N people a few tries follow that begin with the largest ones."""
    sizes, best = _extents(pixels_xy), np.full(len(pixels_xy), -1)
    left, largest, rows = sizes.copy(), 0.0, np.arange(len(pixels_xy))
    for _ in range(TRIES):
        at, who = np.unravel_index(int(left.argmax()), left.shape)
        if left[at, who] <= 0:
            break
        chosen = np.full(len(rows), -1)
        chosen[at] = who
        for order in (range(int(at) + 1, len(rows)), range(int(at) - 1, -1, -1)):
            ahead = _follow_person(pixels_xy, sides, pixels_xy[at, who], order)
            chosen = np.where(ahead >= 0, ahead, chosen)
        found = rows[chosen >= 0]
        total = float(sizes[found, chosen[found]].sum())
        if total > largest:
            best, largest = chosen, total
        left[found, chosen[found]] = 0
    return best


def _follow_person(
    pixels_xy: np.ndarray, sides: np.ndarray, last_xy: np.ndarray, order: Iterable[int]
) -> np.ndarray:
    """(F,) who of each frame's people is the one last at (P, 2), frame by frame; -1 for nobody.

    Somebody whose left the detector suddenly takes for the right is still there: ``sides`` (P,) is
    where each point's counterpart is.
    """
    chosen = np.full(len(pixels_xy), -1)
    for frame in order:
        gate_px = STEP_SHARE * float(_extents(last_xy))
        people = np.concatenate([pixels_xy[frame], pixels_xy[frame][:, sides]])
        distances = np.linalg.norm(people - last_xy, axis=-1)
        # Of somebody else who stands beside, some points may be near.
        near = (distances <= gate_px).sum(-1) >= np.isfinite(distances).sum(-1) / 2
        among = np.where(near[:, None, None], people, np.nan)
        costs = person_costs(among, last_xy, gate_px)
        if len(costs) and np.isfinite(costs.min()):
            chosen[frame] = costs.argmin() % len(pixels_xy[frame])
            here = pixels_xy[frame, chosen[frame]]
            last_xy = np.where(np.isfinite(here), here, last_xy)
    return chosen


def _extents(pixels_xy: np.ndarray) -> np.ndarray:
    """The longer sides (...) of the boxes around (..., P, 2) points, pixels; 0 without two."""
    low = np.where(np.isnan(pixels_xy), np.inf, pixels_xy).min(-2)
    high = np.where(np.isnan(pixels_xy), -np.inf, pixels_xy).max(-2)
    return np.maximum(high - low, 0.0).max(-1)


def marked_landmarks(recording: Recording, landmarks: Sequence[str], at: np.ndarray) -> np.ndarray:
    """Where those landmarks are that a marker sits on: what the tracked person is selected by.

    Args:
        recording: with its markers; their offsets, some centimetres, are left out.
        landmarks: names of P landmarks.
        at: (F,) seconds of marker time.

    Returns:
        (F, P, 3) metres, world; NaN where there is no marker or it is missing.
    """
    positions = interpolate_markers(recording.times, recording.positions_world, at)
    points = np.full((len(at), len(landmarks), 3), np.nan)
    for marker, place in enumerate(recording.places):
        name = _landmark_at(recording.skeleton.tree, place)
        if name in landmarks:
            points[:, landmarks.index(name)] = positions[:, marker]
    return points


def _landmark_at(tree: Tree, place: MarkerPlace) -> str | None:
    """The landmark at a marker's place; a bone's far end is the near end of the next."""
    bone = tree.bone(place.bone)
    for name, (other, at) in LANDMARK_PLACES.items():
        follows = tree.parents[tree.bone(other)] == bone and (place.at, at) == (1.0, 0.0)
        if follows or (place.bone, place.at) == (other, at):
            return name
    return None
