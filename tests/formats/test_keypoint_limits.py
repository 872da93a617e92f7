"""Folders and files of key points that no detector writes: one sentence, in bounded memory."""

import json
import os
from functools import partial

import numpy as np
import pytest
from conftest import complaint

from jaxmocap.capture.keypoints import align_detections
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings import keypoint_files, keypoints
from jaxmocap.formats.recordings.keypoints import Detections, read_keypoints

refused = partial(complaint, read_keypoints)


def person(points: int = 17) -> dict:
    return {"pose_keypoints_2d": np.arange(1.0, 3 * points + 1).tolist()}


def test_pipes_devices_and_deeper_folders_are_no_key_points(tmp_path):
    os.mkfifo(tmp_path / "1.json")
    (tmp_path / "2.json").symlink_to("/dev/zero")
    (tmp_path / "3.json").mkdir()
    (tmp_path / "deeper").mkdir()
    (tmp_path / "deeper" / "4.json").write_text("{")
    assert "found no .json file" in refused(tmp_path)
    assert "found a named pipe, expected a file" in refused(tmp_path / "1.json")
    assert "found a device, expected a file" in refused(tmp_path / "2.json")
    (tmp_path / "5.json").write_text(json.dumps({"people": [person()]}))
    assert read_keypoints(tmp_path).numbers.tolist() == [5]


@pytest.mark.parametrize("folder", ["/dev", "/usr"])
def test_a_system_folder_is_refused_at_once(folder):
    refused(folder)


def test_a_folder_of_more_files_than_frames_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(keypoint_files, "MAX_ENTRIES", 3)
    for i in range(5):
        (tmp_path / f"{i}.json").write_text("{}")
    assert "holds more than 3 files, expected one per frame" in refused(tmp_path)
    monkeypatch.undo()
    monkeypatch.setattr(keypoint_files, "MAX_FOLDER_BYTES", 9)
    assert "of .json files, expected at most" in refused(tmp_path)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[" * 1_000_000, "nested too deeply"),
        ('{"people": ' * 5000 + "1" + "}" * 5000, "nested too deeply"),
        ("[" + "0," * 12_000_001 + "0]", "numbers, expected at most 12000000 in one file"),
        ("[" + "[]," * 4_000_001 + "0]", "parts, expected at most 4000000"),
        ('[{"frame_id": ' + "9" * 5000 + ', "instances": []}]', "thousands of digits"),
        ('[{"frame_id": 1e3, "instances": []}]', "[0].frame_id: found 1000.0, expected a whole"),
        (f'[{{"frame_id": {10**13}, "instances": []}}]', "[0].frame_id: found 10000000000000"),
        ('{"people": "\\u001b[31m"}', "people: found '\\x1b[31m', expected a JSON list"),
        ('{"people": [{"pose_keypoints_2d": [1e300, 1, 1]}]}', "found 1e+300, expected pixels"),
        ('{"people": [{"pose_keypoints_2d": [true, 1, 1]}]}', "found other than equally long"),
        ('{"people": [{"pose_keypoints_2d": ["1", 1, 1]}]}', "found other than equally long"),
    ],
)
def test_json_that_would_fill_memory_or_break_the_parser_is_refused(tmp_path, text, says):
    (tmp_path / "7.json").write_text(text)
    assert says in refused(tmp_path)


def test_more_people_than_memory_holds_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(keypoints, "MAX_POINTS", 200)
    for i, count in enumerate((1, 12)):
        (tmp_path / f"{i}.json").write_text(json.dumps({"people": [person()] * count}))
    assert "found more than 200 key points so far" in refused(tmp_path)


def test_a_crowd_in_one_frame_of_a_long_video_is_refused_before_it_is_lined_up():
    crowd = Detections(np.array([0]), ("wrist_l",), np.zeros((1, 300, 1, 2)), np.ones((1, 300, 1)))
    with pytest.raises(InputError, match="found up to 300 people in 200000 frames"):
        align_detections(crowd, 200_000, 0)
