"""2-D key points of a video, as pose detectors write them.

INPUTS: a folder with one JSON file per frame (OpenPose, Pose2Sim, MMPose from images), or one file
for the whole video (MMPose), in a folder or by itself.
OUTPUTS: Detections: pixels and confidences of the landmarks that the detector's model has, of
everybody in every frame.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from jaxmocap.body.skeleton import other_side
from jaxmocap.formats.files.errors import InputError, comma_list, short_repr
from jaxmocap.formats.files.reading import regular_file
from jaxmocap.formats.recordings.keypoint_files import (
    KeypointFrame,
    json_files,
    read_keypoint_frames,
)
from jaxmocap.formats.recordings.keypoint_models import MODELS, landmark_indices, model_by_faces

# Of everybody in all frames, 0.4 GB: half an hour of four people with 25 points at 60 Hz.
MAX_POINTS = 16_000_000
# OpenPose can write fractions of the image, and others do, of legs below it as well.
_LARGEST_FRACTION = 4.0
# A frame, or a person in it, takes as much memory as so many points, however few it has.
_OVERHEAD_POINTS = 8


@dataclass(frozen=True)
class Detections:
    """What a detector saw in F frames, of at most N people in each."""

    numbers: np.ndarray  # (F,) frame numbers as the files count them, ascending
    landmarks: tuple[str, ...]  # names of the P points, landmarks of ours
    pixels_xy: np.ndarray  # (F, N, P, 2) pixels of the video; NaN where missing
    confidences: np.ndarray  # (F, N, P) between 0 and 1; 0 where missing
    name: str = "key points in memory"  # the folder or file, for messages
    warnings: tuple[str, ...] = ()  # sentences that a user should see
    # (F, N, P, 3) metres about the hips' middle, in the camera's axes, where the detector estimates
    # them; NaN where missing.
    joints_cam: np.ndarray | None = None

    def __post_init__(self):
        """Check that the parts fit, wherever they came from."""
        pixels, confidences = np.shape(self.pixels_xy), np.shape(self.confidences)
        ends = (len(self.numbers), len(self.landmarks))
        if len(pixels) != 4 or pixels != (*confidences, 2) or (pixels[0], pixels[2]) != ends:
            raise InputError(
                self.name,
                f"key points: found pixels of shape {pixels} and confidences of shape "
                f"{confidences} for {ends[0]} frames and {ends[1]} landmarks",
            )
        if self.joints_cam is not None and np.shape(self.joints_cam) != (*confidences, 3):
            found = f"joints of shape {np.shape(self.joints_cam)} for confidences of {confidences}"
            raise InputError(self.name, f"key points: found {found}")
        if (np.diff(self.numbers) <= 0).any():
            raise InputError(self.name, "key points: the frame numbers do not ascend")

    def at_frames(self, rows: np.ndarray) -> "Detections":
        """Those of some of the frames, by rows (T,); of -1 none: NaN, and confidences of 0."""
        return self._take(np.arange(len(rows)), lambda part, none: _rows(part, rows, none))

    def of_people(self, people: np.ndarray) -> "Detections":
        """One person of each frame, by numbers (F,); of -1 nobody."""
        frames = np.arange(len(people))
        rows = np.where(people >= 0, frames, -1)
        return self._take(
            self.numbers, lambda part, none: _rows(part[frames, people][:, None], rows, none)
        )

    def swap_sides(self, frames: np.ndarray) -> "Detections":
        """With left taken for right in some frames, (F,) bool."""
        sides = other_side(self.landmarks)

        def swap(part: np.ndarray, _: float) -> np.ndarray:
            part = part.copy()
            part[frames] = part[frames][:, :, sides]
            return part

        return self._take(self.numbers, swap)

    def _take(
        self, numbers: np.ndarray, take: Callable[[np.ndarray, float], np.ndarray]
    ) -> "Detections":
        """With what a function takes of each array and of what stands for a missing point."""
        joints = self.joints_cam
        return replace(
            self,
            numbers=numbers,
            pixels_xy=take(self.pixels_xy, np.nan),
            confidences=take(self.confidences, 0.0),
            joints_cam=None if joints is None else take(joints, np.nan),
        )


def _rows(part: np.ndarray, rows: np.ndarray, missing: float) -> np.ndarray:
    """(T, ...) rows of an array; ``missing`` where a row is -1."""
    is_there = np.reshape(rows >= 0, (-1, *[1] * (part.ndim - 1)))
    return np.where(is_there, part[rows], missing)


def read_keypoints(path: str | Path, model: str | None = None) -> Detections:
    """Read the key points of one video.

    A confidence of 0, or a coordinate that is no number, is a missing point. RTMPose's
    confidences can exceed 1 and are cut off there.

    Args:
        path: folder of .json files, or one such file.
        model: whose points they are, a name in ``MODELS``. None takes the names that the file
            gives, or infers the model from the number of points. BODY_25 and BODY_25B both have 25:
            the faces decide between them where that is safe.

    Raises:
        InputError: no such folder, a file that is no JSON of one of these layouts, a frame without
            a number or with two files, nobody in any frame, or a model that is unknown, does not
            fit, or cannot be inferred.
    """
    path = Path(path)
    frames = sorted(_frames(path), key=lambda frame: frame.number)
    for before, after in pairwise(frames):
        if before.number == after.number:
            raise InputError(after.file, f"frame {after.number} is in {before.file.name} as well")
    people = _stacked_people(path, frames)
    names, warnings = _names(path, frames[0], people, model)
    landmarks = landmark_indices(names)
    if not landmarks:
        raise InputError(path, f"none of the points {comma_list(names)} is a landmark of ours")
    count = max(len(frame.people) for frame in frames)
    check_keypoint_count(path, len(frames), count, len(landmarks))
    table = np.full((len(frames), count, len(landmarks), people.shape[2]), np.nan)
    table[..., 2] = 0.0
    place = [(i, j) for i, frame in enumerate(frames) for j in range(len(frame.people))]
    table[tuple(np.transpose(place))] = people[:, list(landmarks.values())]
    numbers = np.array([frame.number for frame in frames])
    joints = table[..., 3:] if people.shape[2] > 3 else None
    return Detections(
        numbers, tuple(landmarks), table[..., :2], table[..., 2], str(path), warnings, joints
    )


def check_keypoint_count(path: str | Path, frames: int, people: int, landmarks: int) -> None:
    """InputError where a table of so many people in every frame is too large for memory."""
    if frames * people * landmarks > MAX_POINTS:
        problem = f"found up to {people} people in {frames} frames, {landmarks} points of each"
        raise InputError(path, f"{problem}, expected at most {MAX_POINTS} points")


def _frames(path: Path) -> Iterator[KeypointFrame]:
    """All frames of all files, as many as fit into memory."""
    files = json_files(path) if os.path.isdir(path) else [regular_file(path)]
    if not files:
        raise InputError(path, "found no .json file, expected one per frame or one for the video")
    total = 0
    for file in files:
        for frame in read_keypoint_frames(file):
            total += _OVERHEAD_POINTS + sum(
                _OVERHEAD_POINTS + person.size // 3 for person in frame.people
            )
            if total > MAX_POINTS:
                raise InputError(file, f"found more than {MAX_POINTS} key points so far")
            yield frame


def _stacked_people(path: Path, frames: Sequence[KeypointFrame]) -> np.ndarray:
    """(N, K, 3) the people of all frames one after the other; (N, K, 6) where some have joints."""
    files = [frame.file for frame in frames for _ in frame.people]
    people = [person for frame in frames for person in frame.people]
    if not people:
        raise InputError(path, "found nobody in any frame")
    for file, person in zip(files, people, strict=True):
        if len(person) != len(people[0]):
            problem = f"found {len(person)} points, but {len(people[0])} in {files[0].name}"
            raise InputError(file, problem)
    width = max(person.shape[1] for person in people)
    stacked = np.full((len(people), len(people[0]), width), np.nan)
    for row, person in zip(stacked, people, strict=True):
        row[:, : person.shape[1]] = person
    detected_xy = stacked[stacked[..., 2] > 0, :2]
    if detected_xy.size and np.abs(detected_xy).max() <= _LARGEST_FRACTION:
        problem = f"found no coordinate beyond {_LARGEST_FRACTION:g}"
        raise InputError(path, f"{problem}, expected pixels (--keypoint_scale 0)")
    return stacked


def _names(
    path: Path, first: KeypointFrame, people: np.ndarray, model: str | None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the K points of (N, K, 3) people, and what a user should know of the choice."""
    count = people.shape[1]
    if model is not None and model not in MODELS:
        raise InputError(path, f"unknown model {short_repr(model)}, expected {', '.join(MODELS)}")
    names = first.points if model is None else MODELS[model]
    if names is not None:
        if len(names) != count:
            problem = f"found {count} points, but {model or 'meta_info'} names {len(names)}"
            raise InputError(path, problem)
        return names, ()
    fitting = tuple(name for name, points in MODELS.items() if len(points) == count)
    if not fitting:
        models = ", ".join(f"{name} ({len(points)})" for name, points in MODELS.items())
        raise InputError(path, f"found {count} points, expected those of {models}")
    if len(fitting) == 1:
        return MODELS[fitting[0]], ()
    guessed = model_by_faces(people[..., :2], fitting)
    if guessed is None:
        choice = " or ".join(f'"{name}"' for name in fitting)
        problem = f"{count} points may be of {' or '.join(fitting)}, and the faces do not decide"
        raise InputError(path, f"{problem}; state keypoints_model = {choice} in [[video]]")
    taken = f"{path}: {count} points, taken as {guessed} by where the faces are"
    return MODELS[guessed], (f'{taken}; keypoints_model = "{guessed}" in [[video]] states it',)
