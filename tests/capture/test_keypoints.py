"""2-D key points: every layout of their files, whose model, which frame, and which person."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import complaint
from hypothesis import given
from hypothesis import strategies as st
from small_recording import CAMERA, PLACES, small_recording, standing

from jaxmocap.body.skeleton import LANDMARKS, Skeleton
from jaxmocap.capture.keypoints import (
    align_detections,
    marked_landmarks,
    open_keypoints,
    person_costs,
    select_person,
)
from jaxmocap.capture.video import open_video
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.keypoint_models import (
    LANDMARK_OF,
    MODELS,
    landmark_indices,
    model_by_faces,
)
from jaxmocap.formats.recordings.keypoints import Detections, read_keypoints
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.trc import read_trc
from jaxmocap.geometry.cameras import project

PROJECT = jax.jit(project)
# A standing person seen from the front, pixels. The middle of the shoulders is no landmark.
FRONT = {
    "nose": (320, 100),
    "left_eye": (328, 92),
    "right_eye": (312, 92),
    "left_ear": (340, 96),
    "right_ear": (300, 96),
    "head": (320, 60),
    "neck": (320, 130),
    "mid_shoulder": (320, 150),
    "hip": (320, 320),
}
FRONT |= {
    f"{side}_{joint}": (320 + sign * across, down)
    for side, sign in (("left", 1), ("right", -1))
    for joint, across, down in (
        *(("shoulder", 50, 150), ("elbow", 70, 230), ("wrist", 75, 300), ("hip", 25, 320)),
        *(("knee", 28, 440), ("ankle", 30, 550), ("heel", 30, 560)),
        *(("big_toe", 40, 570), ("small_toe", 50, 570)),
    )
}


def points(model: str, shift: float = 0.0, score: float = 0.5) -> np.ndarray:
    """(K, 3) the person as a model's points, some pixels to the right."""
    actual = [(*np.add(FRONT.get(name, (0, 0)), (shift, 0)), score) for name in MODELS[model]]
    return np.array(actual, float)


def pixel(landmark: str, shift: float = 0.0) -> list[float]:
    """Where the person's landmark is."""
    (name,) = (n for n in FRONT if LANDMARK_OF.get(n) == landmark)
    return [FRONT[name][0] + shift, FRONT[name][1]]


def openpose(*people: np.ndarray) -> dict:
    return {
        "version": 1.3,
        "people": [
            {"person_id": [-1], "pose_keypoints_2d": person.ravel().tolist()} for person in people
        ],
    }


def instance(person: np.ndarray) -> dict:
    """As MMPose writes somebody."""
    return {
        "keypoints": person[:, :2].tolist(),
        "keypoint_scores": person[:, 2].tolist(),
        "bbox": [[0, 0, 9, 9]],
        "bbox_score": 0.9,
    }


def write(folder: Path, files: Mapping[str, object]) -> Path:
    folder.mkdir(exist_ok=True)
    for name, content in files.items():
        (folder / name).write_text(json.dumps(content), encoding="utf-8")
    return folder


def assert_the_person(detections: Detections, frame: int, person: int, shift: float) -> None:
    for i, landmark in enumerate(detections.landmarks):
        actual = detections.pixels_xy[frame, person, i].tolist()
        assert actual == pixel(landmark, shift), landmark


# Models ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", MODELS)
def test_every_model_knows_both_sides_of_the_joints_of_arms_and_legs(model):
    indices = landmark_indices(MODELS[model])
    assert set(indices) <= set(LANDMARKS)
    for joint in ("shoulder", "elbow", "wrist", "hip", "knee", "ankle"):
        assert {f"{joint}_l", f"{joint}_r"} <= set(indices)
    named = [name for name in MODELS[model] if name]
    assert len(set(named)) == len(named)


@pytest.mark.parametrize(
    ("model", "count", "indices"),
    [
        ("BODY_25", 25, {"shoulder_r": 2, "wrist_l": 7, "pelvis": 8, "ankle_r": 11, "toe_l": 19}),
        ("BODY_25B", 25, {"shoulder_l": 5, "elbow_r": 8, "neck": 17, "vertex": 18, "toe_r": 22}),
        ("COCO_18", 18, {"elbow_r": 3, "elbow_l": 6, "hip_r": 8, "hip_l": 11, "ankle_l": 13}),
        ("COCO_17", 17, {"shoulder_l": 5, "wrist_r": 10, "knee_l": 13, "ankle_r": 16}),
        ("HALPE_26", 26, {"elbow_l": 7, "vertex": 17, "neck": 18, "pelvis": 19, "toe_r": 21}),
        ("COCO_23", 23, {"elbow_l": 7, "ankle_r": 16, "toe_l": 17, "toe_r": 20}),
        ("COCO_133", 133, {"elbow_l": 7, "ankle_r": 16, "toe_l": 17, "toe_r": 20}),
    ],
)
def test_points_are_counted_as_their_makers_count_them(model, count, indices):
    assert len(MODELS[model]) == count
    assert {name: landmark_indices(MODELS[model])[name] for name in indices} == indices


@pytest.mark.parametrize("model", ["BODY_25", "BODY_25B"])
def test_the_faces_tell_the_two_models_of_25_points_apart(tmp_path, model):
    write(tmp_path, {f"{i}.json": openpose(points(model, i)) for i in range(3)})
    actual = read_keypoints(tmp_path)
    assert f'keypoints_model = "{model}"' in actual.warnings[0]
    assert_the_person(actual, 2, 0, 2)
    assert read_keypoints(tmp_path, model).warnings == ()


def test_where_no_face_is_seen_the_model_must_be_stated(tmp_path):
    person = points("BODY_25B")
    person[:5] = 0
    write(tmp_path, {"0.json": openpose(person)})
    assert 'state keypoints_model = "BODY_25" or "BODY_25B"' in complaint(read_keypoints, tmp_path)
    actual = read_keypoints(tmp_path, "BODY_25B")
    assert actual.pixels_xy[0, 0, actual.landmarks.index("elbow_l")].tolist() == pixel("elbow_l")


def test_people_who_disagree_do_not_tell_a_model():
    pair = np.stack([points("BODY_25")[:, :2], points("BODY_25B")[:, :2]])
    models = ("BODY_25", "BODY_25B")
    assert model_by_faces(pair, models) is None
    assert model_by_faces(np.repeat(pair, [30, 10], axis=0), models) is None
    assert model_by_faces(np.repeat(pair, [30, 1], axis=0), models) == "BODY_25"
    assert model_by_faces(np.repeat(pair, [1, 30], axis=0), models) == "BODY_25B"


@pytest.mark.parametrize(
    ("times_larger", "model"), [(3.0, "BODY_25B"), (1.5, None), (1 / 1.5, None), (1 / 3, "BODY_25")]
)
def test_a_face_must_be_clearly_smaller_to_tell_the_model(times_larger, model):
    person = points("BODY_25B")[None, :, :2]
    # Nose, eyes and ears are 0 to 4 in the one reading, 0 and 15 to 18 in the other.
    person[:, 15:19] = person[:, :1] + times_larger * (person[:, 1:5] - person[:, :1])
    assert model_by_faces(person, ("BODY_25", "BODY_25B")) == model


# Files -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "model", ["COCO_17", "COCO_18", "MEDIAPIPE_19", "COCO_23", "HALPE_26", "COCO_133"]
)
def test_openpose_files_of_every_other_count_need_no_model(tmp_path, model):
    names = [f"cam_01_{i:012d}_keypoints.json" for i in range(8, 12)]
    write(tmp_path, {name: openpose(points(model, i)) for i, name in enumerate(names)})
    actual = read_keypoints(tmp_path)
    assert actual.numbers.tolist() == [8, 9, 10, 11] and actual.warnings == ()
    assert actual.landmarks == tuple(landmark_indices(MODELS[model]))
    assert (actual.confidences == 0.5).all()
    for i in range(4):
        assert_the_person(actual, i, 0, i)


def test_frames_may_hold_many_people_one_or_none(tmp_path):
    some, other = points("COCO_17"), points("COCO_17", 200)
    faceless = {"pose_keypoints_2d": [], "face_keypoints_2d": [1, 2, 0.5]}
    nobody = {"people": [faceless]}
    write(tmp_path, {"a_2.json": openpose(other), "a_0.json": openpose(some, other)})
    write(tmp_path, {"a_1.json": nobody, "a_3.json": {"people": []}, ".a_4.json": "leavings"})
    actual = read_keypoints(tmp_path)
    assert actual.pixels_xy.shape == (4, 2, 12, 2)
    assert_the_person(actual, 0, 0, 0)
    assert_the_person(actual, 0, 1, 200)
    assert_the_person(actual, 2, 0, 200)
    missing = np.isnan(actual.pixels_xy).all((2, 3))
    assert missing.tolist() == [[False, False], [True, True], [False, True], [True, True]]
    np.testing.assert_array_equal(actual.confidences == 0, np.isnan(actual.pixels_xy[..., 0]))


@given(
    st.lists(st.sampled_from(["whole", "zero", "null", "nan", "large"]), min_size=17, max_size=17)
)
def test_what_is_missing_is_nan_with_no_confidence(tmp_path_factory, kinds):
    folder = tmp_path_factory.mktemp("keys")
    person = points("COCO_17").tolist()
    for point, kind in zip(person, kinds, strict=True):
        if kind == "zero":
            point[:] = [0, 0, 0]
        elif kind == "null":
            point[0] = None
        elif kind == "nan":
            point[1] = float("nan")
        elif kind == "large":
            point[2] = 1.3
    scores = {"keypoints": [p[:2] for p in person], "keypoint_scores": [p[2] for p in person]}
    actual = read_keypoints(write(folder, {"0.json": [scores], "1.json": [{"keypoints": person}]}))
    expected = {"whole": 0.5, "large": 1.0}
    for landmark, index in landmark_indices(MODELS["COCO_17"]).items():
        i = actual.landmarks.index(landmark)
        confidence = expected.get(kinds[index], 0.0)
        assert actual.confidences[:, 0, i].tolist() == [confidence] * 2
        is_detected = np.isfinite(actual.pixels_xy[:, 0, i])
        assert (is_detected == (confidence > 0)).all()


def test_mmpose_writes_one_file_for_a_whole_video(tmp_path):
    frames = [
        {"frame_id": i, "instances": [instance(points("HALPE_26", i))] * (i != 2)} for i in range(4)
    ]
    for folder in (write(tmp_path / "a", {"cam.json": frames}), tmp_path / "a" / "cam.json"):
        actual = read_keypoints(folder)
        assert actual.numbers.tolist() == [0, 1, 2, 3]
        assert_the_person(actual, 3, 0, 3)
        assert np.isnan(actual.pixels_xy[2]).all()
        assert actual.name == str(folder)


def test_joints_in_space_come_with_those_who_have_them(tmp_path):
    person, joints = points("COCO_17"), np.arange(51.0).reshape(17, 3) / 10
    joints[5, 2] = np.nan
    both = [{**instance(person), "keypoints_3d": joints.tolist()}, instance(person)]
    frames = [{"frame_id": i, "instances": both[: 2 - i]} for i in range(2)]
    actual = read_keypoints(write(tmp_path, {"cam.json": frames}))
    index = list(landmark_indices(MODELS["COCO_17"]).values())
    assert actual.joints_cam is not None and actual.joints_cam.shape == (2, 2, 12, 3)
    np.testing.assert_array_equal(actual.joints_cam[:, 0], [joints[index]] * 2)
    assert np.isnan(actual.joints_cam[:, 1]).all()
    chosen = align_detections(actual, 3, 0).of_people(np.array([1, 0, -1]))
    assert chosen.joints_cam is not None and np.isnan(chosen.joints_cam[[0, 2]]).all()
    np.testing.assert_array_equal(chosen.joints_cam[1, 0], joints[index])
    assert_the_person(chosen, 0, 0, 0)


@pytest.mark.parametrize(
    ("joints", "says"),
    [
        ([[1, 2, 3]] * 16, "keypoints_3d: found shape (16, 3), expected [x, y, z] of each key poi"),
        ([[1, 2]] * 17, "keypoints_3d: found shape (17, 2), expected [x, y, z] of each key point"),
        ([[1, 2, 1e3]] * 17, "keypoints_3d: found 1000, expected metres within 100"),
        ("none", "keypoints_3d: found 'none', expected a JSON list"),
    ],
)
def test_joints_that_are_none_are_refused(tmp_path, joints, says):
    person = {**instance(points("COCO_17")), "keypoints_3d": joints}
    write(tmp_path, {"cam.json": [{"frame_id": 0, "instances": [person]}]})
    assert says in complaint(read_keypoints, tmp_path)


def test_mmpose_writes_one_file_per_image(tmp_path):
    write(tmp_path, {f"img{i}.json": [instance(points("COCO_17", i))] for i in (9, 10)})
    write(tmp_path, {"img11.json": []})
    actual = read_keypoints(tmp_path)
    assert actual.numbers.tolist() == [9, 10, 11]
    assert_the_person(actual, 0, 0, 9)
    assert_the_person(actual, 1, 0, 10)


def test_names_in_the_file_come_before_the_count(tmp_path):
    # 17 points as well, but of another order than COCO's.
    names = ["root", *reversed(MODELS["COCO_17"][1:])]
    person = np.array([(*FRONT.get(name, FRONT["hip"]), 0.5) for name in names])
    meta = {"keypoint_id2name": {str(i): name for i, name in enumerate(names)}}
    frames = [{"frame_id": 1, "instances": [instance(person)]}]
    write(tmp_path, {"results_cam.json": {"meta_info": meta, "instance_info": frames}})
    actual = read_keypoints(tmp_path)
    assert actual.landmarks[0] == "pelvis" and len(actual.landmarks) == 13
    assert_the_person(actual, 0, 0, 0)
    write(tmp_path, {"results_cam.json": {"meta_info": {}, "instance_info": [instance(person)]}})
    assert "no frame number in its name" in complaint(read_keypoints, tmp_path)


COMPLETE = points("COCO_17")


def by_name(name: str, person: np.ndarray) -> dict:
    """As MMPose writes a file that names its points, or the first of them."""
    meta = {"keypoint_id2name": {"0": name}}
    return {"0.json": {"meta_info": meta, "instance_info": [instance(person)]}}


@pytest.mark.parametrize(
    ("files", "says"),
    [
        ({}, "found no .json file"),
        ({"0.json": {"people": []}}, "found nobody in any frame"),
        ({"0.json": {"bodies": []}}, "0.json: found no key points, expected 'people'"),
        ({"0.json": {"people": {}}}, "0.json: people: found {}, expected a JSON list"),
        ({"0.json": {"people": [3]}}, "people[0]: found 3, expected a JSON table"),
        ({"0.json": openpose(COMPLETE.ravel()[:-1])}, "found 50 numbers, expected x, y, c"),
        ({"0.json": openpose(COMPLETE[:14])}, "found 14 points, expected those of BODY_25 (25)"),
        ({"0.json": openpose(COMPLETE), "1.json": openpose(COMPLETE[1:])}, "1.json: found 16 poi"),
        ({"0.json": openpose(COMPLETE / 640)}, "expected pixels (--keypoint_scale 0)"),
        ({"0.json": openpose(COMPLETE / 300)}, "no coordinate beyond 4, expected pixels"),
        ({"a.json": openpose(COMPLETE)}, "a.json: found no frame number in its name"),
        ({f"{9**30}.json": openpose(COMPLETE)}, "found no frame number in its name"),
        ({"a_7.json": openpose(COMPLETE), "b_7.json": openpose(COMPLETE)}, "frame 7 is in a_7"),
        ({"0.json": [{"keypoints": [["x", 1]]}]}, "[0].keypoints: found other than equally"),
        ({"0.json": [{"keypoints": [[1, 2], [3]]}]}, "[0].keypoints: found other than equal"),
        ({"0.json": [{"keypoints": [[1, 2]]}]}, "[0].keypoints: found shape (1, 2)"),
        (
            {"0.json": [instance(COMPLETE) | {"keypoint_scores": [1.0]}]},
            "[0].keypoint_scores: found shape (1,), expected one score for each key point (17)",
        ),
        (
            {"0.json": [{"keypoints": [[1, 2, 0.3]], "keypoint_scores": [0.9]}]},
            "[0].keypoints: found [x, y, z] with 'keypoint_scores', expected [x, y] in pixels",
        ),
        ({"0.json": [{"keypoints": [], "keypoint_scores": []}]}, "[0].keypoints: found shape (0,)"),
        ({"0.json": [{"instances": []}]}, "[0].frame_id: found None, expected a whole"),
        ({"0.json": {"instance_info": [4]}}, "instance_info[0]: found 4, expected a JSON table"),
        (by_name("left_elbow", COMPLETE), "found 17 points, but meta_info names 1"),
        (by_name("tail", COMPLETE[:1]), "none of the points tail is a landmark of ours"),
    ],
)
def test_bad_files_are_refused_with_file_and_place(tmp_path, files, says):
    message = complaint(read_keypoints, write(tmp_path, files))
    assert says in message and message.startswith(str(tmp_path))


@pytest.mark.parametrize(
    ("model", "says"),
    [
        ("HALPE_26", "found 17 points, but HALPE_26 names 26"),
        ("BODY_26", "unknown model 'BODY_26', expected BODY_25, "),
    ],
)
def test_a_model_that_does_not_fit_is_refused(tmp_path, model, says):
    assert says in complaint(read_keypoints, write(tmp_path, {"0.json": openpose(COMPLETE)}), model)


@pytest.mark.parametrize("content", [b"", b'{"people": [', b"\xff\xfe\x00", b"[" * 100_000])
def test_what_is_no_json_is_refused(tmp_path, content):
    (tmp_path / "0.json").write_bytes(content)
    with pytest.raises(InputError, match=r"0\.json: .*JSON"):
        read_keypoints(tmp_path)
    assert "no such file" in complaint(read_keypoints, tmp_path / "none")


def test_detections_in_memory_are_checked_as_well():
    pixels, confidences = np.zeros((2, 1, 3, 2)), np.ones((2, 1, 3))
    names = ("wrist_l", "wrist_r", "vertex")
    assert Detections(np.array([4, 5]), names, pixels, confidences).name == "key points in memory"
    assert "do not ascend" in complaint(Detections, np.array([5, 5]), names, pixels, confidences)
    with pytest.raises(InputError, match="2 frames and 2 landmarks"):
        Detections(np.array([4, 5]), names[:2], pixels, confidences)
    with pytest.raises(InputError, match="for 2 frames"):
        Detections(np.array([4, 5]), names, pixels[..., 0], confidences)


# Frames ------------------------------------------------------------------------------------------


def detections(numbers) -> Detections:
    """One landmark, whose pixel is its frame's number."""
    numbers = np.array(numbers)
    pixels = np.repeat(numbers[:, None, None, None].astype(float), 2, -1)
    return Detections(numbers, ("wrist_l",), pixels, np.ones((len(numbers), 1, 1)), "keys")


@pytest.mark.parametrize(
    ("numbers", "frames", "stated", "first"),
    [
        (range(6), 6, None, 0),
        (range(1, 7), 6, None, 1),
        (range(100, 106), 6, None, 100),
        ([100, 103, 105], 6, None, 100),
        (range(3), 6, None, 0),
        (range(1, 4), 6, None, 1),
        ([1, 2, 6], 6, None, 1),
        (range(100, 103), 6, 98, 98),
        (range(10), 6, 3, 3),
        (range(2, 5), 6, 0, 0),
    ],
)
def test_the_first_frames_number_follows_the_rule_or_is_stated(numbers, frames, stated, first):
    actual = align_detections(detections(numbers), frames, stated)
    expected = [n if n in set(numbers) else np.nan for n in range(first, first + frames)]
    np.testing.assert_array_equal(actual.pixels_xy[:, 0, 0, 0], expected)
    np.testing.assert_array_equal(actual.confidences[:, 0, 0], np.isfinite(expected))
    count = int(np.isfinite(expected).sum())
    warning = f"keys: key points of {count} of the video's {frames} frames"
    assert actual.warnings == ((warning,) if count < frames else ())


@pytest.mark.parametrize(
    ("numbers", "stated", "says"),
    [
        (range(7), None, "frames 0 to 6 for a video of 6 frames; state keypoints_first"),
        (range(2, 5), None, "frames 2 to 4 for a video of 6 frames; state keypoints_first"),
        ([1, 7], None, "frames 1 to 7 for a video of 6 frames; state keypoints_first"),
        (range(3), 3, "frames 0 to 2, but the video has frames 3 to 8; check keypoints_first"),
    ],
)
def test_numbers_that_do_not_tell_the_first_frame_are_refused(numbers, stated, says):
    assert says in complaint(align_detections, detections(numbers), 6, stated)


def test_a_recordings_video_opens_its_key_points(tmp_path):
    source = small_recording().videos[0]
    video = open_video(source)
    assert open_keypoints(source, video) is None
    files = {f"{i:04d}.json": openpose(points("BODY_25", i)) for i in range(1, len(video) + 1)}
    folder = write(tmp_path, files)
    actual = open_keypoints(replace(source, keypoints=folder, keypoints_model="BODY_25"), video)
    assert actual is not None and actual.warnings == ()
    elbow = actual.landmarks.index("elbow_l")
    assert actual.pixels_xy[0, 0, elbow].tolist() == pixel("elbow_l", 1)
    read = read_keypoints(folder, "BODY_25")
    again = open_keypoints(replace(source, keypoints=read, keypoints_first=2), video)
    assert again is not None
    assert again.pixels_xy[0, 0, elbow].tolist() == pixel("elbow_l", 2)
    assert np.isnan(again.pixels_xy[-1]).all()


# People ------------------------------------------------------------------------------------------

NEAR, GATE = points("COCO_17")[:, :2], 60.0


def chosen_person(people: np.ndarray, predicted: np.ndarray) -> int:
    """The person whose costs are lowest, -1 where all are strangers."""
    costs = person_costs(people, predicted, GATE)
    return int(costs.argmin()) if np.isfinite(costs).any() else -1


@given(st.permutations(range(4)), st.integers(0, 99), st.floats(0.0, 0.6))
def test_the_person_nearest_to_the_prediction_is_chosen_in_any_order(order, seed, lost):
    rng = np.random.default_rng(seed)
    people = np.stack([NEAR + np.array([shift, 0]) for shift in (0, 200, -300, 900)])
    people += rng.normal(scale=4.0, size=people.shape)
    people[rng.random(people.shape[:2]) < lost] = np.nan
    predicted = np.where(rng.random((17, 1)) < 0.7, NEAR, np.nan)
    chosen = chosen_person(people[list(order)], predicted)
    shared = np.isfinite(people[0] + predicted).all(-1).sum()
    count = np.isfinite(predicted).all(-1).sum()
    expected = order.index(0) if shared >= max(1, min(2, count)) else -1
    assert chosen == expected


def test_neither_a_stray_wrist_nor_a_fragment_decides():
    complete, fragment = NEAR + 10.0, np.full_like(NEAR, np.nan)
    complete[9] = [5000, 5000]
    fragment[5:7] = NEAR[5:7]
    assert chosen_person(np.stack([fragment, complete]), NEAR) == 1
    assert chosen_person(np.stack([complete, fragment]), NEAR) == 0
    assert chosen_person(fragment[None], NEAR) == 0


def test_nobody_is_chosen_where_nobody_or_nothing_is_predicted():
    nothing = np.full_like(NEAR, np.nan)
    assert chosen_person(NEAR[None], nothing) == -1
    assert chosen_person(nothing[None], NEAR) == -1
    assert chosen_person(np.empty((0, 17, 2)), NEAR) == -1
    assert chosen_person(NEAR[None] + [GATE + 1, 0], NEAR) == -1
    assert chosen_person(NEAR[None] + [GATE - 1, 0], NEAR) == 0
    once = np.where(np.arange(17)[:, None] == 3, NEAR, np.nan)
    assert chosen_person(NEAR[None], once) == 0
    assert chosen_person(once[None], NEAR) == -1


def test_markers_on_landmarks_say_who_is_tracked():
    recording = small_recording()
    landmarks = ("elbow_l", *(landmark for _, landmark in PLACES.values()))
    times = recording.times[:3]
    predicted = marked_landmarks(recording, landmarks, times)
    assert np.isnan(predicted[:, 0]).all()
    np.testing.assert_array_equal(predicted[:, 1:], recording.positions_world[:3])
    # A second person stands a metre further, and is listed first in the second frame.
    places = [predicted + np.array([0, y, 0]) for y in (0, 1)]
    is_detected = [np.asarray(PROJECT(CAMERA, jnp.asarray(place, float))) for place in places]
    is_detected = np.stack(is_detected, 1)
    is_detected[:, :, 0] = is_detected[:, :, 1]
    is_detected[1] = is_detected[1, ::-1]
    is_detected[2, 0] = np.nan
    keypoints = Detections(
        np.arange(3), landmarks, is_detected, np.where(np.isnan(is_detected[..., 0]), 0.0, 0.8)
    )
    chosen = select_person(keypoints, CAMERA, predicted)
    pixels, confidences = chosen.pixels_xy[:, 0], chosen.confidences[:, 0]
    np.testing.assert_array_equal(pixels[0], is_detected[0, 0])
    np.testing.assert_array_equal(pixels[1], is_detected[1, 1])
    assert np.isnan(pixels[2]).all()
    assert confidences.tolist() == [[0.8] * 6, [0.8] * 6, [0.0] * 6]


def test_left_that_was_taken_for_right_is_turned_back_by_the_hands():
    """Where they are apart; and never by a small difference."""
    landmarks = ("wrist_l", "wrist_r", "hip_l", "hip_r")
    apart, together = (
        np.array([[0.0, side * y, z] for y, z in ((reach, 1.2), (0.1, 0.9)) for side in (1, -1)])
        for reach in (0.4, 0.03)
    )
    there = np.stack([apart, apart, together])
    pixels = np.array(PROJECT(CAMERA, jnp.asarray(there, float)))
    pixels[1:] = pixels[1:][:, [1, 0, 3, 2]]
    people = Detections(np.arange(3), landmarks, pixels[:, None], np.full((3, 1, 4), 0.8))
    hands = there.copy()
    hands[:, 2:] = np.nan
    chosen = select_person(people, CAMERA, hands)
    np.testing.assert_array_equal(chosen.pixels_xy[:2, 0], [pixels[0], pixels[1, [1, 0, 3, 2]]])
    np.testing.assert_array_equal(chosen.pixels_xy[2, 0], pixels[2])
    assert (chosen.confidences == 0.8).all()


def test_what_lies_behind_the_camera_predicts_nothing():
    # Both wrists behind the camera, then the left one only: the right one is all that is predicted.
    predicted = np.tile(np.array([6.0, 1.2, 1.3]), (2, 2, 1))
    predicted[1, 1] = [0.0, 0.0, 1.0]
    pixels = np.asarray(PROJECT(CAMERA, jnp.asarray(predicted, float)))[:, None]
    only_right = np.where([[[[False], [True]]]], pixels, np.nan)
    keypoints = Detections(np.arange(2), ("wrist_l", "wrist_r"), only_right, np.ones((2, 1, 2)))
    actual = select_person(keypoints, CAMERA, predicted).pixels_xy[:, 0]
    assert np.isnan(actual[0]).all()
    np.testing.assert_array_equal(actual[1], only_right[1, 0])


@pytest.mark.parametrize(
    ("bone", "at", "landmark"),
    [
        *(("radius_l", 1.0, "wrist_l"), ("hand_l", 0.0, "wrist_l"), ("head", 1.0, "vertex")),
        *(("tibia_r", 1.0, "ankle_r"), ("humerus_r", 1.0, "elbow_r"), ("hand_r", 1.0, "hand_r")),
        *(("radius_l", 0.5, None), ("head", 0.9, None), ("spine1", 0.0, "pelvis")),
    ],
)
def test_a_bones_far_end_is_the_next_ones_landmark(bone, at, landmark):
    recording = small_recording()
    places = (replace(recording.places[0], bone=bone, at=at),)
    only = Recording(
        Skeleton.human(), recording.times, recording.positions_world[:, :1], places, name="x"
    )
    predicted = marked_landmarks(only, LANDMARKS, recording.times[:1])
    there = [
        name for name, point in zip(LANDMARKS, predicted[0], strict=True) if np.isfinite(point[0])
    ]
    assert there == ([landmark] if landmark else [])
    assert landmark is None or predicted[0, LANDMARKS.index(landmark)].tolist() == pytest.approx(
        standing()[0].tolist()
    )


# The real recording ------------------------------------------------------------------------------

TRUTH = {
    f"{joint}_{side}": f"{side.upper()}{joint.capitalize()}"
    for joint in ("elbow", "shoulder", "wrist", "hip", "knee", "ankle")
    for side in "lr"
}
# The reference was triangulated from these detections with about so many pixels of error.
REAL = [("cam_01", 25), ("cam_02", 25), ("cam_03", 60), ("cam_04", 25)]


@pytest.fixture(scope="module")
def balancing(recordings) -> Recording:
    return Recording.load(recordings / "balancing" / "recording_all_cameras.toml")


@pytest.fixture(scope="module")
def reference(recordings) -> np.ndarray:
    """(60, 12, 3) the joints of TRUTH in the world, metres."""
    truth = read_trc(recordings / "balancing" / "truth.trc").points()
    return np.stack([truth[name] for name in TRUTH.values()], 1)


@pytest.mark.parametrize(("camera_name", "farthest"), REAL)
def test_the_tracked_persons_elbows_lie_on_the_projected_reference(
    balancing, reference, recordings, camera_name, farthest
):
    (source,) = (video for video in balancing.videos if video.camera_name == camera_name)
    folder = recordings / "balancing" / "keypoints" / camera_name
    video = open_video(source)
    keypoints = open_keypoints(replace(source, keypoints=folder), video)
    assert keypoints is not None and len(keypoints.pixels_xy) == len(video) == 60
    assert "taken as BODY_25B" in keypoints.warnings[0]
    predicted = marked_landmarks(balancing, keypoints.landmarks, video.times)
    chosen = select_person(keypoints, source.camera, predicted)
    pixels, confidences = chosen.pixels_xy[:, 0], chosen.confidences[:, 0]
    index = [keypoints.landmarks.index(name) for name in TRUTH]
    expected = np.asarray(PROJECT(source.camera, jnp.asarray(reference, float)))
    distances = np.linalg.norm(pixels[:, index] - expected, axis=-1)
    assert (confidences[:, index] > 0).mean() > 0.95
    assert np.nanmedian(distances[:, :2], axis=0).max() < farthest

    def without_bias(lag: int) -> float:
        """Mean distance where the detections come some frames late, a constant left out."""
        late = slice(max(lag, 0), 60 + min(lag, 0))
        early = slice(max(-lag, 0), 60 + min(-lag, 0))
        error = pixels[late][:, index] - expected[early]
        error -= np.nanmedian(error, axis=0)
        return float(np.nanmean(np.linalg.norm(error, axis=-1)))

    assert min(range(-3, 4), key=without_bias) == 0


def test_a_bystander_is_never_taken_for_the_tracked_person(balancing, recordings):
    actual = read_keypoints(recordings / "balancing" / "keypoints" / "cam_01", "BODY_25B")
    keypoints = align_detections(actual, 60)
    predicted = marked_landmarks(balancing, keypoints.landmarks, balancing.times)
    camera = balancing.videos[0].camera
    pixels = select_person(keypoints, camera, predicted).pixels_xy[:, 0]
    taken = (keypoints.pixels_xy == pixels[:, None]).any((2, 3))
    assert (taken.sum(1) == 1).all()
    others = replace(
        keypoints, pixels_xy=np.where(taken[..., None, None], np.nan, keypoints.pixels_xy)
    )
    assert np.isfinite(others.pixels_xy).any((1, 2, 3)).all()
    left = select_person(others, camera, predicted).pixels_xy[:, 0]
    # In one frame the detector tore the tracked person in two, and the other half is found.
    assert np.flatnonzero(np.isfinite(left).any((1, 2))).tolist() == [37]
    assert np.nanmedian(others.pixels_xy[..., 0]) < 100 < 400 < np.nanmedian(left[37, :, 0])
