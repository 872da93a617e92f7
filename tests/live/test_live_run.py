"""A live run: its file, its recording on disk, cameras, and the whole of it over real sockets."""

import json
import os
import signal
import socket
import threading
import time
from dataclasses import replace
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from conftest import wait_for
from pythonosc.osc_packet import OscPacket
from small_recording import small_recording, write_small_recording

import jaxmocap.pipelines.live.loop
from jaxmocap import Recording
from jaxmocap.body.pose import Pose, relaxed_pose
from jaxmocap.capture.streams import cameras
from jaxmocap.capture.streams.cameras import LiveCamera, LiveVideo
from jaxmocap.capture.streams.inbox import LiveFrame
from jaxmocap.capture.streams.lsl import LslTable
from jaxmocap.capture.streams.sample_assembly import (
    MarkerMeasurements,
    MarkerSample,
    SampleAssembler,
)
from jaxmocap.capture.streams.udp import DEFAULT_LISTEN, OscTable
from jaxmocap.capture.video import open_video
from jaxmocap.formats.files.addresses import Address
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.recordings.filters import OneEuroSettings
from jaxmocap.formats.time_series.axes import R_WORLD_UNITY
from jaxmocap.outputs.senders.osc import Bundle
from jaxmocap.outputs.senders.unity import to_unity
from jaxmocap.outputs.senders.vmc import DEFAULT_SEND, VmcTable
from jaxmocap.outputs.senders.vrchat import VrchatTable
from jaxmocap.pipelines.live.loop import Live
from jaxmocap.pipelines.live.recording import LiveRecording
from jaxmocap.pipelines.live.session import live_summary, stop_on_signals
from jaxmocap.pipelines.live.setup import LiveSetup, load_live
from jaxmocap.pipelines.live.status import LiveStatus, stream_states
from jaxmocap.pipelines.live.tracking import Output

FILE = """
[markers.on]
Hmd = { bone = "head", at = 0.7, offset = [0.1, 0.0, 0.0] }
1 = { bone = "hand_l", at = 0.6 }

[osc]
listen = "0.0.0.0:5000"
from = ["192.168.1.0/24", "127.0.0.1"]
names = { "LHR-1" = "1" }

[[video]]
device = 2
camera = "cam"
offset = -0.04

[[video]]
url = "rtsp://somewhere/stream"
camera = "other"

[calibration]
file = "two.toml"

[subject]
height = 1.6

[vrchat]
trackers = ["hip", "foot_l"]
"""


def write_file(folder: Path, text: str = FILE) -> Path:
    write_small_recording(folder)
    camera = (folder / "calibration.toml").read_text()
    (folder / "two.toml").write_text(camera + camera.replace("[cam]", "[other]"))
    path = folder / "live.toml"
    path.write_text(text)
    return path


def small_setup(folder: Path, vmc: Address = DEFAULT_SEND) -> LiveSetup:
    """The small recording as a live run, its video played from a file."""
    toml = write_small_recording(folder)
    recording = Recording.load(toml)
    source = recording.videos[0]
    assert source.path is not None
    return LiveSetup(
        toml,
        recording.skeleton,
        recording.places,
        R_WORLD_UNITY,
        (LiveVideo("cam", source.camera, source.path),),
        OscTable(Address(port=0)),
        (VmcTable(vmc), VrchatTable(vmc)),
        calibration=folder / "calibration.toml",
        subject={"height": 1.75},
    )


def packets_of(names):
    """Places (M, 3) in the world -> the packet that brings the markers there, unturned."""
    bundle = Bundle([("/VMC/Ext/Tra/Pos", [name, *[0.0] * 7]) for name in names])
    turns = np.tile([0.0, 0, 0, 1], (len(names), 1))
    return lambda points: bundle.fill(np.hstack([to_unity(points), turns]))


# The file ----------------------------------------------------------------------------------------


def test_the_file_of_a_live_run_is_read(tmp_path):
    setup = load_live(write_file(tmp_path))
    assert setup.marker_names == ("Hmd", "1") and setup.source.aliases == {"LHR-1": "1"}
    assert setup.source.listen == Address("0.0.0.0", 5000)
    vrchat = VrchatTable(Address("127.0.0.1", 9000), ("hip", "foot_l"))
    assert setup.senders == (VmcTable(DEFAULT_SEND), vrchat)
    assert [video.source for video in setup.videos] == [2, "rtsp://somewhere/stream"]
    assert setup.videos[0].offset == -0.04
    np.testing.assert_array_equal(setup.R_world_source, R_WORLD_UNITY)


def test_defaults_are_loopback_and_unitys_axes(tmp_path):
    path = write_file(tmp_path, "[markers.on]\nHmd = { bone = 'head' }\n")
    setup = load_live(path)
    assert setup.source == OscTable(DEFAULT_LISTEN) and setup.senders == (VmcTable(DEFAULT_SEND),)
    assert DEFAULT_LISTEN.host == DEFAULT_SEND.host == "127.0.0.1"
    assert "no [subject]" in setup.warnings[0]
    assert setup.one_euro is None
    text = (
        "[markers]\nup = 'y'\nfilters = { one_euro = true }\n[markers.on]\nHmd = { bone = 'head' }"
    )
    y_up = write_file(tmp_path, text)
    assert load_live(y_up).one_euro == OneEuroSettings()
    assert np.linalg.det(load_live(y_up).R_world_source) > 0


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("device = 2", "device = 1.5", "device"),
        ("device = 2", "device = 2\nfile = 'cam.mp4'", "device and file"),
        ("device = 2\n", "", "one of device, file, url"),
        ('"0.0.0.0:5000"', '"0.0.0.0:x"', r"\[osc\] listen"),
        ('= "1" }', '= "3" }', "no marker '3'"),
        ('["hip", "foot_l"]', '["hip", "nose"]', "trackers"),
        ('bone = "head"', 'bone = "skull"', "unknown bone 'skull'"),
        ('camera = "other"', 'camera = "cam"', "another camera"),
        ("[osc]", "[markers.filters]\nbutterworth = 6.0\n[osc]", "expected one_euro"),
        ("[osc]", "[lsl]\nstream = 'mocap'\n[osc]", "one source"),
        ("device = 2", "device = 1e300", "device"),
        ("-0.04", "-1e9", r"offset: found.*from -60 to 60"),
        ("rtsp://somewhere/stream", "/dev/zero", "url: found.*rtsp"),
        ("rtsp://somewhere/stream", "file:///dev/zero", "url: found"),
        ('camera = "other"', 'camera = "CAM"', "another camera|CAM"),
        ('["hip", "foot_l"]', '["hip", "hip"]', "each once"),
        ('["hip", "foot_l"]', "[[]]", "each once"),
        ("Hmd = {", '"a\\nb" = { bone = "head" }\nHmd = {', "printable characters"),
        ("Hmd = {", '" Hmd" = { bone = "head" }\nHmd = {', "printable characters"),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path, old, new, problem):
    assert old in FILE
    with pytest.raises(InputError, match=problem):
        load_live(write_file(tmp_path, FILE.replace(old, new)))


# On disk -----------------------------------------------------------------------------------------


def test_what_was_recorded_live_is_read_like_any_recording(tmp_path):
    recording = small_recording()
    setup = small_setup(tmp_path)
    written = LiveRecording(setup, tmp_path / "out")
    positions = recording.positions_world.copy()
    positions[5, 2] = np.nan
    for time_s, points in zip(recording.times + 3.0, positions, strict=True):
        written.add(MarkerSample(time_s, points, time_s))
    frames = recording.videos[0].frames
    assert frames is not None
    moments = 3.1 + np.cumsum(np.linspace(0.03, 0.05, len(frames[1])))
    for at, image in zip(moments, frames[1], strict=True):
        written.add(LiveFrame(0, at, image, at))
    again = Recording.load(written.close())
    assert written.dropped == 0
    np.testing.assert_allclose(again.times, recording.times + 3.0, atol=1e-8)
    np.testing.assert_allclose(again.positions_world, positions, atol=1e-6)
    assert again.places == recording.places
    np.testing.assert_allclose(again.skeleton.lengths, recording.skeleton.lengths, rtol=1e-6)
    video = open_video(again.videos[0])
    np.testing.assert_allclose(video.times, moments, atol=1e-4)
    for (_, image), expected in zip(video.frames(), frames[1], strict=True):
        assert image is not None and np.abs(image.astype(float) - expected).mean() < 12
    with pytest.raises(InputError, match=r"holds markers\.csv, recording\.toml.* already"):
        LiveRecording(setup, tmp_path / "out")


@pytest.mark.parametrize("source", [OscTable(), LslTable("mocap")])
def test_orientations_of_either_source_are_recorded(tmp_path, source):
    setup = small_setup(tmp_path)
    turned = replace(setup.places[0], offset_in="marker", offset=(0.0, 0.1, 0.0))
    setup = replace(setup, places=(turned, *setup.places[1:]), source=source)
    recording = LiveRecording(setup, tmp_path / "out")
    positions = small_recording().positions_world
    # A quarter turn about the vertical: the marker's y is the world's -x.
    R = np.tile([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]], (len(positions[0]), 1, 1))
    for time_s, points in zip(small_recording().times, positions, strict=True):
        measured = MarkerMeasurements(points, R)
        recording.add(MarkerSample(time_s, points, time_s, measured))
    again = Recording.load(recording.close())
    assert again.places[0].name == turned.name
    moved = again.positions_world[:, 0] - positions[:, 0]
    np.testing.assert_allclose(moved, np.tile([0.1, 0, 0], (len(moved), 1)), atol=1e-5)


def test_a_marker_that_never_has_the_orientation_it_needs_is_left_out(tmp_path):
    setup = small_setup(tmp_path)
    turned = replace(setup.places[0], offset_in="marker", offset=(0.0, 0.1, 0.0))
    recording = LiveRecording(replace(setup, places=(turned, *setup.places[1:])), tmp_path / "out")
    for time_s, points in zip(
        small_recording().times, small_recording().positions_world, strict=True
    ):
        measured = MarkerMeasurements(points, np.full((len(points), 3, 3), np.nan))
        recording.add(MarkerSample(time_s, points, time_s, measured))
    again = Recording.load(recording.close())
    assert [place.name for place in again.places] == [place.name for place in setup.places[1:]]


# Cameras -----------------------------------------------------------------------------------------


def test_a_file_is_played_at_its_own_pace_and_then_ends(tmp_path):
    setup = small_setup(tmp_path)
    frames: list[LiveFrame] = []
    camera = LiveCamera(setup.videos[0], 0, frames.append, colour=True)
    began = time.monotonic()
    camera.start()
    wait_for(lambda: camera.status == "ended", 10.0)
    assert len(frames) == camera.frames == 12 and frames[0].image.shape == (72, 96, 3)
    # 11 intervals of 1/30 s; a busy machine may deliver late, the first frame too, never early.
    assert frames[-1].time - began > 11 / 30 - 0.05


def test_a_device_that_is_not_there_is_reported_and_one_that_leaves_is_asked_for_again(
    tmp_path, monkeypatch
):
    setup = small_setup(tmp_path)
    video = replace(setup.videos[0], source=0)
    opened: list[int] = []

    def device(index, size, colour):
        opened.append(index)
        if len(opened) == 2:
            raise InputError(f"camera {index}", "no such device")
        return (np.zeros((72, 96), np.uint8) for _ in range(3))

    monkeypatch.setattr(cameras, "device_frames", device)
    monkeypatch.setattr(cameras, "RETRY_S", 0.01)
    frames: list[LiveFrame] = []
    camera = LiveCamera(video, 0, frames.append, colour=False)
    camera.start()
    wait_for(lambda: len(frames) >= 6)
    camera.stop()
    assert len(opened) >= 3


def test_a_driver_that_fails_is_asked_again_and_quiet_cameras_are_listed(tmp_path, monkeypatch):
    """Grey images of a device, and OpenCV's own error in between."""
    opened: list[int] = []

    class Capture:
        def __init__(self, device):
            opened.append(device)
            self.left = 3

        def read(self):
            self.left -= 1
            if self.left < 0:
                raise cv2.error("driver")
            return True, np.zeros((72, 96), np.uint8)

        isOpened = release = set = lambda self, *_: True  # noqa: N815

    monkeypatch.setattr(cv2, "VideoCapture", Capture)
    monkeypatch.setattr(cameras, "RETRY_S", 0.01)
    video, frames = replace(small_setup(tmp_path).videos[0], source=0), []
    camera = LiveCamera(video, 0, frames.append, colour=True)
    camera.start()
    wait_for(lambda: len(frames) >= 6)
    camera.stop()
    assert len(opened) >= 2 and frames[0].image.shape == (72, 96, 3)
    assert camera.reason in (None, "its driver has failed")
    camera.status = "on"
    markers = SimpleNamespace(
        problem=None, last_arrival=None, ignored={}, hints={}, who_may_send="",
        senders=SimpleNamespace(clock_rate=None, clock_jumps=0, refused_hosts=set()),
    )  # fmt: skip
    assembler = SampleAssembler(("a",), {}, np.eye(3), lambda _: None)
    for later, expected in ((0.5, "on"), (10.0, "nothing comes in")):
        now = camera.last_arrival + later
        states = dict(stream_states(markers, assembler, [camera], now))
        assert states[camera.name].startswith(expected)


def test_images_of_another_size_than_calibrated_are_not_used(tmp_path, monkeypatch):
    setup = small_setup(tmp_path)
    large = np.zeros((480, 640), np.uint8)
    monkeypatch.setattr(cameras, "device_frames", lambda *_: (image for image in [large]))
    camera = LiveCamera(replace(setup.videos[0], source=0), 0, lambda _: None, colour=False)
    camera.start()
    camera._thread.join(2.0)
    assert camera.frames == 0 and "640 × 480 pixels, calibrated for 96 × 72" in str(camera.problem)


def test_why_a_camera_does_not_come_is_reported(tmp_path, monkeypatch):
    monkeypatch.setattr(cameras, "RETRY_S", 0.01)
    video = replace(small_setup(tmp_path).videos[0], source="tcp://127.0.0.1:9")
    camera = LiveCamera(video, 0, lambda _: None, colour=False)
    camera.start()
    wait_for(lambda: camera.reason is not None, 20.0)
    camera.stop()
    assert camera.status == "waiting" and "refused" in str(camera.reason)


# All of it ---------------------------------------------------------------------------------------


class Standing:
    """Stands in for the tracker: every sample finds somebody who stands still."""

    needs_colour, placements, late_events, is_ready = False, 0, 0, True

    def __init__(self, setup, settings, smooth):
        pose = relaxed_pose(setup.skeleton)
        self.pose = Pose(*(np.asarray(part) for part in pose))  # type: ignore[arg-type]

    def sample(self, sample: MarkerSample) -> list[Output]:
        return [Output(sample.time, self.pose, np.ones(2), sample.arrived)]

    def frames(self, frames) -> list[Output]:
        return []

    def flush(self) -> list[Output]:
        return []

    def close(self) -> None:
        pass


def test_markers_in_poses_out_and_a_recording_until_ctrl_c(tmp_path, monkeypatch):
    monkeypatch.setattr(jaxmocap.pipelines.live.loop, "LiveTracking", Standing)
    receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    receiver.bind(("127.0.0.1", 0))
    vmc = Address(port=receiver.getsockname()[1])
    setup, output = small_setup(tmp_path, vmc), StringIO()
    status = LiveStatus(output)
    live = Live(setup, out=tmp_path / "out", status=status)
    recording = small_recording()
    packet_of = packets_of(recording.marker_names)

    def play() -> None:
        sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        time.sleep(0.2)
        for _ in range(2):
            for points in recording.positions_world:
                sender.sendto(b"garbage", tuple(live.address))
                sender.sendto(packet_of(points), tuple(live.address))
                time.sleep(1 / 60)
            # One hand's place is absurd from then on; at the end nothing comes.
            recording.positions_world[:, 1] = 1e6
            time.sleep(0.5)
        os.kill(os.getpid(), signal.SIGINT)

    received: list[bytes] = []

    def listen() -> None:
        # While it runs, for a socket keeps few datagrams.
        while not received or received[-1] != b"end":
            received.append(receiver.recv(65536))

    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    player = threading.Thread(target=play)
    with stop_on_signals() as stop:
        player.start()
        figures = live.run(seconds=30.0, stop=stop)
    player.join()
    receiver.sendto(b"end", receiver.getsockname())
    listener.join(5.0)
    receiver.close()
    assert stop.is_set() and figures["seconds"] < 25
    poses, trackers, lost = 0, 0, 0
    for datagram in received[:-1]:
        messages = [timed.message for timed in OscPacket(datagram).messages]
        poses += len(messages) > 2 and messages[-3].address == "/VMC/Ext/Root/Pos"
        trackers += messages[0].address.startswith("/tracking/trackers")
        lost += messages[0].params == [1, 3, 0, 0]
    assert poses == trackers == figures["outputs"] >= 20 and lost >= 1
    assert figures["ignored"]["malformed"] == 48 and figures["frames"]["cam"] == 12
    assert figures["ignored"]["absurd"] == 24
    assert "markers: coming in" in output.getvalue()
    assert "markers: nothing comes in" in output.getvalue() and "cam: ended" in output.getvalue()
    again = Recording.load(figures["recording"])
    assert len(again.times) == 48 and len(open_video(again.videos[0])) == 12
    json.dumps(figures)
    assert f"{figures['outputs']}" in live_summary(figures)
