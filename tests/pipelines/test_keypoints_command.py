"""``jaxmocap keypoints``: a detector's process, an ONNX model, what is written and refused."""

import errno
import json
import re
import sys
from codecs import BOM_UTF8
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import TensorProto, helper
from small_recording import FRAMES, SIZE, write_small_recording

from jaxmocap.capture.video import open_video
from jaxmocap.cli.program import main
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.keypoints import read_keypoints
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.images.regions import crop_image
from jaxmocap.pipelines.keypoints.by_mediapipe import mediapipe_detector
from jaxmocap.pipelines.keypoints.by_onnx import onnx_detector
from jaxmocap.pipelines.keypoints.detect import _boxes

# Stands in for the package in the detector's environment: point n lies at (n, 2 n) hundredths.
STUB = """
class Mark:
    def __init__(self, n):
        self.x, self.y, self.z, self.visibility = n / 100, n / 50, -n / 200, 0.5 + n / 100
class Found:
    landmark = [Mark(n) for n in range(33)]
class Pose:
    def __init__(self, model_complexity): self.frames = 0
    def process(self, image):
        self.frames += 1
        if self.frames == {dies}: raise RuntimeError("out of something")
        result = type("Result", (), {{}})()
        result.pose_landmarks = None if self.frames == {nobody} or {never} else Found
        result.pose_world_landmarks = result.pose_landmarks
        return result
class solutions:
    class pose:
        Pose = Pose
"""
COCO_OF_MEDIAPIPE = [0, 2, 5, 7, 8, 11, 12, 13, 14, 15, 16, 23, 24, 25, 26, 27, 28]


@pytest.fixture
def recording(tmp_path) -> Path:
    path = write_small_recording(tmp_path)
    path.write_text("# swaying\n" + path.read_text("utf-8"), encoding="utf-8")
    return path


@pytest.fixture
def environment(tmp_path, monkeypatch):
    """Puts a stand-in beside this Python; its processes find it."""

    def put(nobody: int = 0, dies: int = 0, never: bool = False) -> None:
        text = STUB.format(nobody=nobody, dies=dies, never=never)
        (tmp_path / "stand_in").mkdir()
        (tmp_path / "stand_in" / "mediapipe.py").write_text(text, encoding="utf-8")
        monkeypatch.setenv("PYTHONPATH", str(tmp_path / "stand_in"))

    return put


def detect(recording: Path, *more: str, detector: str = "mediapipe") -> int:
    return main(["keypoints", str(recording), "--detector", detector, *more])


def test_a_process_detects_and_the_recording_uses_it(recording, environment, capsys):
    environment(nobody=3)
    assert detect(recording, "--python", sys.executable, "--write") == 0
    printed = capsys.readouterr().out
    assert f"found in {FRAMES - 1} of {FRAMES} frames" in printed
    text = recording.read_text("utf-8")
    assert text.startswith("# swaying\n") and 'keypoints = "keypoints/cam.json"' in text
    source = Recording.load(recording).videos[0].keypoints
    found = read_keypoints(source)
    assert found.numbers.tolist() == list(range(FRAMES))
    elbow = found.landmarks.index("elbow_l")
    number = COCO_OF_MEDIAPIPE[7]
    there = np.array([number / 100 * SIZE[0], number / 50 * SIZE[1]]) - 0.5
    np.testing.assert_allclose(found.pixels_xy[0, 0, elbow], there, atol=0.01)
    np.testing.assert_allclose(found.confidences[0, 0, elbow], 0.5 + number / 100, atol=1e-3)
    assert np.isnan(found.pixels_xy[2]).all()
    # Where it takes them to be in space, and the toes.
    assert found.joints_cam is not None
    joint = [number / 100, number / 50, -number / 200]
    np.testing.assert_allclose(found.joints_cam[0, 0, elbow], joint, atol=1e-3)
    toe = found.landmarks.index("toe_r")
    np.testing.assert_allclose(found.confidences[0, 0, toe], 0.82, atol=1e-3)
    # Again: the line stays one line, the file is replaced.
    assert detect(recording, "--python", sys.executable, "--write") == 0
    assert recording.read_text("utf-8") == text


@pytest.mark.parametrize(
    ("answers", "says"),
    [
        ("print('[[1, 2, 3], [4, 5]]')", "answered '[[1, 2, 3], [4, 5]]\\n', expected 19 times"),
        ("print('[' * 30_000_000)", "expected 19 times 6 numbers"),
        ("print('{\"a\": 1}')", "expected 19 times 6 numbers"),
        ("print([[1, 2, float('nan'), 4, 5, 6]] * 19)", "expected 19 times 6 numbers"),
        ("time.sleep(60)", "gave no answer within 2 s (--detector-timeout)"),
    ],
)
def test_a_detector_that_answers_something_else_is_one_sentence(tmp_path, answers, says):
    stand_in = tmp_path / "python"
    lines = [f"#!{sys.executable}", "import sys, time", "print('ready', flush=True)", answers]
    stand_in.write_text("\n".join([*lines, "sys.stdout.flush()", "time.sleep(60)"]))
    stand_in.chmod(0o755)
    # More than a pipe holds: it never reads.
    image = np.zeros((400, 400, 3), np.uint8)
    with (
        pytest.raises(InputError) as refused,
        mediapipe_detector(str(stand_in), 2.0).opened() as detect,
    ):
        detect(image[: 400 if "sleep" in answers else 4], np.zeros(4))
    assert says in str(refused.value) and len(str(refused.value)) < 400


def test_a_full_disk_names_the_file(recording, environment, monkeypatch, capsys):
    environment()

    def full(path, content):
        if path.suffix == ".json":  # not while it is tried
            raise OSError(errno.ENOSPC, "No space left on device")
        path.write_text("")

    monkeypatch.setattr(Path, "write_bytes", full)
    assert detect(recording, "--python", sys.executable) == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert "cam.json: cannot be written (No space left on device)" in last


def test_the_recordings_line_ends_and_byte_order_mark_stay(recording, environment):
    environment()
    recording.write_bytes(BOM_UTF8 + recording.read_bytes().replace(b"\n", b"\r\n"))
    assert detect(recording, "--python", sys.executable, "--write") == 0
    text = recording.read_bytes()
    assert text.startswith(BOM_UTF8) and b"keypoints = " in text
    assert text.count(b"\r\n") == text.count(b"\n")


def test_what_was_stated_of_other_key_points_is_stated_of_these(recording, environment):
    environment()
    (recording.parent / "old").mkdir()
    more = 'camera = "cam"\nkeypoints = "old"\nkeypoints_model = "BODY_25"\nkeypoints_first = 7'
    text = recording.read_text("utf-8").replace('camera = "cam"', more)
    recording.write_text(text, encoding="utf-8")
    assert detect(recording, "--python", sys.executable, "--write") == 0
    source = Recording.load(recording).videos[0]
    assert (source.keypoints_model, source.keypoints_first) == ("MEDIAPIPE_19", 0)
    assert len(read_keypoints(source.keypoints, source.keypoints_model).numbers) == FRAMES


def test_a_run_over_another_camera_leaves_the_first_ones_file(recording, environment):
    environment()
    assert detect(recording, "--python", sys.executable) == 0
    for name in ("recording.toml", "calibration.toml"):
        path = recording.parent / name
        path.write_text(re.sub(r"\bcam\b(?!\.mp4)", "other", path.read_text("utf-8")))
    assert detect(recording, "--python", sys.executable) == 0
    found = {path.name for path in (recording.parent / "keypoints").glob("*.json")}
    assert found == {"cam.json", "other.json", "outputs.json"}


def test_without_write_the_file_stays_and_the_line_is_printed(recording, environment, capsys):
    environment()
    before = recording.read_text("utf-8")
    assert detect(recording, "--python", sys.executable) == 0
    assert recording.read_text("utf-8") == before
    assert 'keypoints = "keypoints/cam.json"' in capsys.readouterr().out


def test_nobody_in_any_frame_is_said_and_writes_no_file(recording, environment, capsys):
    environment(never=True)
    assert detect(recording, "--python", sys.executable, "--write") == 1
    assert "cam: nobody was found in any frame" in capsys.readouterr().err
    assert not (recording.parent / "keypoints" / "cam.json").exists()
    assert "keypoints =" not in recording.read_text("utf-8")


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ((), "--detector mediapipe: found no --python, expected an environment's"),
        (("--python", "/nowhere/python"), "cannot be started (No such file or directory)"),
        (("--python", sys.executable), "No module named 'mediapipe'"),
    ],
)
def test_without_its_environment_one_sentence_says_how_to_make_it(
    recording, given, expected, capsys
):
    assert detect(recording, *given) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert expected in last and "pip install mediapipe==0.10.21" in last


def test_a_process_that_dies_leaves_everything_as_it_was(recording, environment, capsys):
    environment(dies=4)

    def files() -> set[Path]:
        # Bytecode of the stand-in is Python's own.
        every = set(recording.parent.rglob("*"))
        return {path for path in every if "__pycache__" not in path.parts}

    before = files()
    assert detect(recording, "--python", sys.executable, "--write") == 2
    assert "RuntimeError: out of something" in capsys.readouterr().err.splitlines()[-1]
    assert files() == before


@pytest.mark.parametrize(
    ("detector", "expected"),
    [("yolo", "expected mediapipe or an .onnx file"), ("lost.onnx", "lost.onnx: no such file")],
)
def test_another_detector_is_refused(recording, detector, expected, capsys):
    assert detect(recording, detector=detector) == 2
    assert expected in capsys.readouterr().err.splitlines()[-1]


def brightest(
    path: Path,
    points: int = 17,
    size: tuple[int, int] = (24, 32),
    kind: int = TensorProto.FLOAT,
    batch: str | int = "batch",
) -> Path:
    """A network all of whose points lie where the image is brightest."""
    width, height = size
    image = helper.make_tensor_value_info("image", kind, [batch, 3, height, width])
    nodes, outputs = [], []
    for name, along, count in (("x", 2, width), ("y", 3, height)):
        axes = helper.make_tensor(f"axes_{name}", TensorProto.INT64, [2], [1, along])
        many = helper.make_tensor(f"many_{name}", TensorProto.INT64, [3], [1, points, count])
        one = helper.make_tensor(f"one_{name}", TensorProto.INT64, [1], [1])
        nodes += [
            helper.make_node("Constant", [], [tensor.name], value=tensor)
            for tensor in (axes, many, one)
        ]
        nodes.append(
            helper.make_node("ReduceMax", ["image", axes.name], [f"row_{name}"], keepdims=0)
        )
        nodes.append(helper.make_node("Unsqueeze", [f"row_{name}", one.name], [f"rows_{name}"]))
        nodes.append(helper.make_node("Expand", [f"rows_{name}", many.name], [name]))
        shape = [batch, points, count]
        outputs.append(helper.make_tensor_value_info(name, kind, shape))
    graph = helper.make_graph(nodes, "brightest", [image], outputs)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=9)
    onnx.checker.check_model(model)
    onnx.save(model, str(path))
    return path


@pytest.mark.parametrize("kind", [TensorProto.FLOAT, TensorProto.FLOAT16])
def test_a_network_gives_pixels_of_the_whole_image(tmp_path, kind):
    detector = onnx_detector(brightest(tmp_path / "net.onnx", kind=kind))
    image = np.zeros((90, 120, 3), np.uint8)
    image[47:56, 67:76] = 255
    assert detector.model == "COCO_17"
    with detector.opened() as detected:
        for box in ([50, 30, 95, 80], [0, 0, 120, 90]):
            found = detected(image, np.array(box, float))
            assert found is not None and found.shape == (17, 3)
            cell = max((box[2] - box[0]) / 24, (box[3] - box[1]) / 32)
            np.testing.assert_allclose(found[:, :2], np.tile([71, 51], (17, 1)), atol=4.5 + cell)
            assert (found[:, 2] == 1).all()
        assert detected(np.zeros_like(image), np.array([0.0, 0, 120, 90])) is None


def test_of_a_network_of_133_points_those_of_the_body_are_written(recording, tmp_path):
    """With face and hands a quarter of an hour's file would be more than is read."""
    assert detect(recording, detector=str(brightest(tmp_path / "net.onnx", points=133))) == 0
    file = recording.parent / "keypoints" / "cam.json"
    people = [each["instances"] for each in json.loads(file.read_text())["instance_info"]]
    assert {len(each["keypoints"]) for person in people for each in person} == {23}
    assert "toe_l" in read_keypoints(file).landmarks


def test_the_command_takes_a_network(recording, tmp_path):
    net = brightest(tmp_path / "net.onnx", points=26)
    assert detect(recording, detector=str(net)) == 0
    found = read_keypoints(recording.parent / "keypoints" / "cam.json")
    assert "elbow_l" in found.landmarks and "toe_l" in found.landmarks


def test_the_box_is_about_the_markers_wherever_the_worlds_origin_is(recording):
    near = Recording.load(recording)
    (source,) = near.videos
    far = replace(near, origin_world=np.array([500.0, 300.0, 0.0]))
    expected, actual = (_boxes(each, source.camera, open_video(source)) for each in (near, far))
    assert (expected[:, 2:] - expected[:, :2]).max() < max(source.camera.size)
    np.testing.assert_allclose(actual, expected, atol=1e-3)


@pytest.mark.parametrize("missing", [False, True])
def test_a_frame_far_from_any_marker_is_searched_in_its_entirety(recording, missing):
    """Nobody is where they were, or will be, seconds away."""
    near = Recording.load(recording)
    (source,), times, positions = near.videos, near.times.copy(), near.positions_world.copy()
    times[12:] += 5.0
    if missing:
        # The same by markers that are lost.
        times = np.append(times, times[11] + np.arange(1, 290) / 60)
        positions = np.append(positions, np.full((289, *positions.shape[1:]), np.nan), 0)
        order = np.argsort(times)
        times, positions = times[order], positions[order]
    apart = replace(near, times=times, positions_world=positions)
    video = open_video(source)
    video.times = video.times + np.where(np.arange(len(video)) < 6, 0.0, 2.5)
    boxes = _boxes(apart, source.camera, video)
    width, height = source.camera.size
    assert (boxes[6:] == [0, 0, width, height]).all()
    assert (boxes[:6, 2] - boxes[:6, 0] < width).all()


def test_another_network_is_refused(tmp_path, recording, capsys):
    net = brightest(tmp_path / "net.onnx", points=5)
    assert detect(recording, detector=str(net)) == 2
    assert "found 5 points, expected one of 17, 26, 133" in capsys.readouterr().err
    net = brightest(tmp_path / "net.onnx", kind=TensorProto.DOUBLE)
    assert detect(recording, detector=str(net)) == 2
    assert "found inputs [('tensor(double)', 'batch', 3, 32, 24)]" in capsys.readouterr().err
    net = brightest(tmp_path / "net.onnx", batch=4)
    assert detect(recording, detector=str(net)) == 2
    assert "found inputs [('tensor(float)', 4, 3, 32, 24)]" in capsys.readouterr().err
    (tmp_path / "text.onnx").write_text("no network")
    assert detect(recording, detector=str(tmp_path / "text.onnx")) == 2
    assert "cannot be read as ONNX" in capsys.readouterr().err


@given(
    st.tuples(st.floats(-20, 90), st.floats(-20, 70), st.floats(1, 80), st.floats(1, 80)),
    st.sampled_from([(24, 32), (32, 24), (48, 48)]),
)
def test_a_crop_holds_its_box_about_its_middle(box, size):
    left, top, width, height = box
    edges = np.array([left, top, left + width, top + height])
    crop = crop_image(np.zeros((60, 80, 3), np.uint8), edges, size)
    assert crop.image.shape == (size[1], size[0], 3)
    ends = crop.pixels_of(np.array([[-0.5, -0.5], [size[0] - 0.5, size[1] - 0.5]]))
    assert (ends[0] <= edges[:2] + 1e-6).all() and (ends[1] >= edges[2:] - 1e-6).all()
    np.testing.assert_allclose(ends.mean(0), (edges[:2] + edges[2:]) / 2, atol=1e-6)
