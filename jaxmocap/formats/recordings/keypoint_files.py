"""The JSON layouts of 2-D pose detectors, frame by frame.

    {"people": [{"pose_keypoints_2d": [x, y, c, ...]}, ...]}     OpenPose, Pose2Sim: one per frame
    [{"keypoints": [[x, y], ...], "keypoint_scores": [...]}, ...]   MMPose: one per image
    [{"frame_id": 0, "instances": [as above]}, ...]                 MMPose: one per video
    {"meta_info": {...}, "instance_info": one of the two lists}     MMPose's demo scripts

An instance of ``jaxmocap keypoints`` may have ``keypoints_3d`` besides: [x, y, z] of each point,
metres about the hips' middle, in the camera's axes.

INPUTS: one such file.
OUTPUTS: Frames: a number, and pixels and confidences of everybody in it; joints where it has them.
"""

import codecs
import os
import re
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxmocap.formats.files.arrays import float_array
from jaxmocap.formats.files.errors import InputError, short_repr
from jaxmocap.formats.files.json_text import JsonPart, parse_json
from jaxmocap.formats.files.reading import read_bytes

# The last number in a file's name is its frame's: cam_01_000000000123_keypoints.json.
_NUMBER = re.compile(r"\d+(?!.*\d)")
LARGEST_FRAME_NUMBER = 10**12
# Pixels: no picture is so large, and no detector guesses so far out of it. Metres: nor a person.
LARGEST_PIXEL, LARGEST_METRES = 1e7, 100.0
# An hour at 120 frames a second is 432,000 of them.
MAX_ENTRIES = 500_000
# Of one file: half an hour of two people with 17 points takes 100 MB, 2 million lists. Of all that
# are in a folder: OpenPose takes 2 to 10 KB for a frame.
MAX_FILE_BYTES = 128 * 2**20
MAX_FILE_PARTS = 4_000_000
MAX_FILE_NUMBERS = 12_000_000
MAX_FOLDER_BYTES = 2**30


@dataclass(frozen=True)
class KeypointFrame:
    """Everybody in one frame."""

    number: int  # of the frame, as its file counts
    # (K, 3) pixels x, y and confidence of each; NaN, NaN, 0 where missing. (K, 6) where the file
    # has joints: x, y, z about the hips' middle, in the camera's axes, metres.
    people: list[np.ndarray]
    points: tuple[str, ...] | None  # names of the K points where the file gives them
    file: Path  # that it is in


def json_files(folder: Path) -> list[Path]:
    """The regular .json files in a folder itself, by name; no hidden ones of another system.

    InputError where it cannot be read, or holds more than any detector writes.
    """
    files, total = [], 0
    try:
        for count, entry in enumerate(os.scandir(folder), 1):
            if count > MAX_ENTRIES:
                problem = f"holds more than {MAX_ENTRIES} files, expected one per frame"
                raise InputError(folder, problem)
            if not entry.name.endswith(".json") or entry.name.startswith("."):
                continue
            status = entry.stat()
            if stat.S_ISREG(status.st_mode):
                files.append(entry.name)
                total += status.st_size
    except OSError as error:
        raise InputError(folder, f"cannot be read ({error.strerror})") from None
    if total > MAX_FOLDER_BYTES:
        problem = f"found {total / 2**20:.0f} MB of .json files"
        raise InputError(folder, f"{problem}, expected at most {MAX_FOLDER_BYTES / 2**20:g} MB")
    return [folder / name for name in sorted(files)]


def read_keypoint_frames(file: Path) -> Iterator[KeypointFrame]:
    """The frames of a file, whose layout follows from its keys; InputError names the entry."""
    text = read_bytes(file, MAX_FILE_BYTES).removeprefix(codecs.BOM_UTF8)
    if (numbers := text.count(b",")) > MAX_FILE_NUMBERS:
        problem = f"found {numbers} numbers, expected at most {MAX_FILE_NUMBERS} in one file"
        raise InputError(file, problem)
    document = JsonPart(file, "", parse_json(file, text, MAX_FILE_BYTES, True, MAX_FILE_PARTS))
    if document.has("people"):
        yield KeypointFrame(_number_in_name(file), _people(document["people"]), None, file)
        return
    names = None
    if document.has("instance_info"):
        # The points' names in MMPose's description of its model, where there is one.
        about = document["meta_info"]
        by_id = about["keypoint_id2name"].value if about.has("keypoint_id2name") else None
        if isinstance(by_id, dict) and by_id:
            names = tuple(str(by_id.get(str(i), "")) for i in range(len(by_id)))
        document = document["instance_info"]
    if not isinstance(document.value, list):
        expected = "'people' (OpenPose), 'instance_info' or a list (MMPose)"
        raise InputError(file, f"found no key points, expected {expected}")
    if not any(entry.has("instances") for entry in document.parts()):
        yield KeypointFrame(_number_in_name(file), _instances(document), names, file)
        return
    for entry in document.parts():
        number = entry["frame_id"].value
        is_integer = isinstance(number, int) and not isinstance(number, bool)
        if not is_integer or abs(number) > LARGEST_FRAME_NUMBER:
            expected = f"expected a whole number within {LARGEST_FRAME_NUMBER}"
            raise entry["frame_id"].error(f"found {short_repr(number)}, {expected}")
        yield KeypointFrame(number, _instances(entry["instances"]), names, file)


def _number_in_name(file: Path) -> int:
    match = _NUMBER.search(file.stem)
    if match is None or int(match[0]) > LARGEST_FRAME_NUMBER:
        raise InputError(file, "found no frame number in its name, such as in cam_000123.json")
    return int(match[0])


def _people(people: JsonPart) -> list[np.ndarray]:
    """(K, 3) of each of OpenPose's people; whoever has but a face or hands is left out."""
    arrays = []
    for person in people.parts():
        points = person["pose_keypoints_2d"]
        array = _array(points)
        if array.size % 3:
            raise points.error(f"found {array.size} numbers, expected x, y, c of each")
        if array.size:
            arrays.append(_with_missing_as_nan(array.reshape(-1, 3)))
    return arrays


def _instances(instances: JsonPart) -> list[np.ndarray]:
    """(K, 3) of each of MMPose's instances, or (K, 6) with its joints."""
    arrays = []
    for instance in instances.parts():
        pixels, confidences = instance["keypoints"], instance["keypoint_scores"]
        points = _array(pixels)
        scores = None if confidences.value is None else _array(confidences)
        if scores is not None and points.shape[1:] == (2,):
            if scores.shape != points.shape[:1]:
                problem = f"found shape {scores.shape}, expected one score for each key point"
                raise confidences.error(f"{problem} ({len(points)})")
            points = np.column_stack([points, scores])
        if points.shape[1:] != (3,):
            expected = "[x, y] of each with 'keypoint_scores', or [x, y, score]"
            raise pixels.error(f"found shape {points.shape}, expected {expected}")
        if scores is not None and not np.array_equal(points[:, 2], scores, equal_nan=True):
            # MMPose's joints in space, which are no pixels.
            found = "found [x, y, z] with 'keypoint_scores'"
            raise pixels.error(f"{found}, expected [x, y] in pixels")
        points = _with_missing_as_nan(points)
        if (places := instance["keypoints_3d"]).value is not None:
            joints = _array(places, LARGEST_METRES, "metres")
            if joints.shape != points.shape:
                problem = f"found shape {joints.shape}, expected [x, y, z] of each key point"
                raise places.error(f"{problem} ({len(points)})")
            points = np.column_stack([points, joints])
        arrays.append(points)
    return arrays


def _with_missing_as_nan(points: np.ndarray) -> np.ndarray:
    """(K, 3) with NaN, NaN, 0 where there is no point, and no confidence above 1."""
    is_detected = np.isfinite(points).all(-1, keepdims=True) & (points[:, 2:] > 0)
    return np.minimum(np.where(is_detected, points, [np.nan, np.nan, 0.0]), [np.inf, np.inf, 1.0])


def _array(part: JsonPart, limit: float = LARGEST_PIXEL, unit: str = "pixels") -> np.ndarray:
    values = part.items()
    try:
        # A null becomes NaN, which is what it means.
        array = float_array(values)
    except (TypeError, ValueError, OverflowError):
        raise part.error("found other than equally long lists of numbers") from None
    if (largest := np.abs(array[np.isfinite(array)]).max(initial=0.0)) > limit:
        raise part.error(f"found {largest:g}, expected {unit} within {limit:g}")
    return array
