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
from typing import Any

import numpy as np

from jaxmocap.formats.files.arrays import float_array
from jaxmocap.formats.files.errors import InputError, short_repr
from jaxmocap.formats.files.json_text import parse_json
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
    content = parse_json(file, text, MAX_FILE_BYTES, True, MAX_FILE_PARTS)
    if isinstance(content, dict) and "people" in content:
        yield KeypointFrame(_number_in_name(file), _people(file, content["people"]), None, file)
        return
    names, where = None, ""
    if isinstance(content, dict) and "instance_info" in content:
        # The points' names in MMPose's description of its model, where there is one.
        by_id = _entry(content.get("meta_info"), "keypoint_id2name")
        if isinstance(by_id, dict) and by_id:
            names = tuple(str(by_id.get(str(i), "")) for i in range(len(by_id)))
        content, where = content["instance_info"], "instance_info"
    if not isinstance(content, list):
        expected = "'people' (OpenPose), 'instance_info' or a list (MMPose)"
        raise InputError(file, f"found no key points, expected {expected}")
    if not any(_entry(entry, "instances") is not None for entry in content):
        yield KeypointFrame(_number_in_name(file), _instances(file, where, content), names, file)
        return
    for i, entry in enumerate(content):
        number, at = _entry(entry, "frame_id"), f"{where}[{i}]"
        is_integer = isinstance(number, int) and not isinstance(number, bool)
        if not is_integer or abs(number) > LARGEST_FRAME_NUMBER:
            expected = f"expected a whole number within {LARGEST_FRAME_NUMBER}"
            raise InputError(file, f"{at}.frame_id: found {short_repr(number)}, {expected}")
        people = _instances(file, f"{at}.instances", _entry(entry, "instances"))
        yield KeypointFrame(number, people, names, file)


def _number_in_name(file: Path) -> int:
    match = _NUMBER.search(file.stem)
    if match is None or int(match[0]) > LARGEST_FRAME_NUMBER:
        raise InputError(file, "found no frame number in its name, such as in cam_000123.json")
    return int(match[0])


def _people(file: Path, people: Any) -> list[np.ndarray]:
    """(K, 3) of each of OpenPose's people; whoever has but a face or hands is left out."""
    arrays = []
    for i, person in enumerate(_list(file, "people", people)):
        where = f"people[{i}].pose_keypoints_2d"
        array = _array(file, where, _entry(person, "pose_keypoints_2d"))
        if array.size % 3:
            raise InputError(file, f"{where}: found {array.size} numbers, expected x, y, c of each")
        if array.size:
            arrays.append(_with_missing_as_nan(array.reshape(-1, 3)))
    return arrays


def _instances(file: Path, where: str, instances: Any) -> list[np.ndarray]:
    """(K, 3) of each of MMPose's instances, or (K, 6) with its joints."""
    arrays = []
    for i, instance in enumerate(_list(file, where, instances)):
        at = f"{where}[{i}]"
        points = _array(file, f"{at}.keypoints", _entry(instance, "keypoints"))
        scores = _entry(instance, "keypoint_scores")
        if scores is not None:
            scores = _array(file, f"{at}.keypoint_scores", scores)
        if scores is not None and points.shape[1:] == (2,):
            if scores.shape != points.shape[:1]:
                problem = f"found shape {scores.shape}, expected one score for each key point"
                raise InputError(file, f"{at}.keypoint_scores: {problem} ({len(points)})")
            points = np.column_stack([points, scores])
        if points.shape[1:] != (3,):
            expected = "[x, y] of each with 'keypoint_scores', or [x, y, score]"
            problem = f"{at}.keypoints: found shape {points.shape}, expected {expected}"
            raise InputError(file, problem)
        if scores is not None and not np.array_equal(points[:, 2], scores, equal_nan=True):
            # MMPose's joints in space, which are no pixels.
            problem = "found [x, y, z] with 'keypoint_scores', expected [x, y] in pixels"
            raise InputError(file, f"{at}.keypoints: {problem}")
        points = _with_missing_as_nan(points)
        joints = _entry(instance, "keypoints_3d")
        if joints is not None:
            joints = _array(file, f"{at}.keypoints_3d", joints, LARGEST_METRES, "metres")
            if joints.shape != points.shape:
                problem = f"found shape {joints.shape}, expected [x, y, z] of each key point"
                raise InputError(file, f"{at}.keypoints_3d: {problem} ({len(points)})")
            points = np.column_stack([points, joints])
        arrays.append(points)
    return arrays


def _with_missing_as_nan(points: np.ndarray) -> np.ndarray:
    """(K, 3) with NaN, NaN, 0 where there is no point, and no confidence above 1."""
    is_detected = np.isfinite(points).all(-1, keepdims=True) & (points[:, 2:] > 0)
    return np.minimum(np.where(is_detected, points, [np.nan, np.nan, 0.0]), [np.inf, np.inf, 1.0])


def _entry(entry: Any, key: str) -> Any:
    return entry.get(key) if isinstance(entry, dict) else None


def _list(file: Path, where: str, value: Any) -> list:
    if not isinstance(value, list):
        raise InputError(file, f"{where}: found {short_repr(value)}, expected a list".lstrip(": "))
    return value


def _array(
    file: Path, where: str, values: Any, limit: float = LARGEST_PIXEL, unit: str = "pixels"
) -> np.ndarray:
    values = _list(file, where, values)
    try:
        # A null becomes NaN, which is what it means.
        array = float_array(values)
    except (TypeError, ValueError, OverflowError):
        raise InputError(file, f"{where}: found other than equally long lists of numbers") from None
    if (largest := np.abs(array[np.isfinite(array)]).max(initial=0.0)) > limit:
        problem = f"found {largest:g}, expected {unit} within {limit:g}"
        raise InputError(file, f"{where}: {problem}")
    return array
