"""The viewer: what it shows without a click, and the page that it serves."""

import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.parse
import urllib.request

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from conftest import rerun_chunks, wait_for

from jaxmocap.body.skeleton import Skeleton
from jaxmocap.body.tree import Tree
from jaxmocap.formats.files.errors import InputError
from jaxmocap.outputs import live_view
from jaxmocap.outputs.layout import SERIES, lay_out
from jaxmocap.outputs.live_view import LiveSnapshot, LiveView
from jaxmocap.outputs.scene import BodyScene
from jaxmocap.pipelines import view
from jaxmocap.pipelines.live.session import relaxed_pose_on_floor
from jaxmocap.pipelines.view import LOOPBACK, free_port, serve_page
from jaxmocap.synthetic.drawing_camera import look_at

CAMERA = look_at((3.0, 0.6, 1.3), (0.0, 0.0, 0.95), size=(96, 72), focal=95.0, distortion=())
SCENE = BodyScene(
    Tree(("head",), (-1,), (), ()),
    np.zeros(1),
    np.eye(3)[None, None],
    np.zeros((1, 1, 3)),
    np.ones((1, 1, 3)),
    np.ones((1, 2)),
)


def visible_views(part) -> set[str]:
    """Names of the visible views: of tabs only the first."""
    if isinstance(part, rrb.Container):
        contents = list(part.contents)
        if isinstance(part, rrb.Tabs):
            contents = contents[:1]
        return set().union(*(visible_views(each) for each in contents))
    return {part.name}


@pytest.mark.parametrize("cameras", [0, 1, 4])
def test_body_images_and_two_curves_are_shown_without_a_click(cameras):
    labels = {f"cam {i}": ["edges, left", "edges, right"] for i in range(cameras)}
    visible = visible_views(lay_out(labels, SCENE).root_container)
    first = list(SERIES.values())[:2]
    # What only debugging needs is behind a tab.
    assert visible == {"Body", *labels, *first, "Statuses"}


@pytest.mark.parametrize(("live", "state"), [(False, "Playing"), (True, "Following")])
def test_a_recording_plays_from_its_start_and_a_live_run_is_followed(live, state):
    panel = lay_out({}, SCENE, live=live).time_panel
    assert state.lower() in str(panel.play_state).lower()


@pytest.fixture
def folder(tmp_path):
    """A folder with something that the viewer reads."""
    stream = rr.RecordingStream("test")
    stream.save(tmp_path / "recording.rrd")
    stream.log("points", rr.Points3D([[0.0, 0.0, 0.0]]))
    stream.disconnect()
    return tmp_path


def test_the_page_is_served_to_this_machine_and_its_data_beside_it(folder):
    served = serve_page(folder / "recording.rrd", free_port())
    try:
        page = str(served.page)
        assert page.startswith(f"http://{LOOPBACK}:") and LOOPBACK in served.url
        end = time.monotonic() + 60
        while True:
            try:
                text = urllib.request.urlopen(page, timeout=5).read().decode()
                break
            except OSError:
                assert time.monotonic() < end and served.process.poll() is None
                time.sleep(0.1)
        assert "<html" in text.lower() and "rerun" in text.lower()
    finally:
        served.process.terminate()
        served.process.wait()
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(page, timeout=5)


def test_the_page_has_the_recording_and_nothing_else(folder):
    chunks = rerun_chunks()
    served, copied = serve_page(folder / "recording.rrd", free_port()), folder / "copied.rrd"
    reader = subprocess.Popen([*view.viewer_command(), "--save", copied, served.url])
    try:
        wait_for(lambda: copied.is_file() and copied.stat().st_size, 60.0)
        time.sleep(1.0)
    finally:
        for process in (reader, served.process):
            process.terminate()
            process.wait()
    found = chunks.RrdReader(copied)
    assert len(found.recordings()) == 1
    assert "/points" in {chunk.entity_path for chunk in found.stream()}


@pytest.mark.parametrize("content", [b"", b"no recording" * 300])
def test_a_file_that_is_no_recording_is_refused(tmp_path, refusal, content):
    rerun_chunks()
    (tmp_path / "recording.rrd").write_bytes(content)
    sentence = refusal("view", tmp_path, "--web", "--port", free_port())
    assert "recording.rrd: expected a recording of rerun, found none" in sentence


# Makes standard input the terminal of a session, then becomes the program that is named. Whoever
# started the tests by nohup has them ignore the signal of a closed terminal, and all they start.
IN_TERMINAL = """
import fcntl, os, signal, sys, termios
signal.signal(signal.SIGHUP, signal.SIG_DFL)
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
os.execv(sys.argv[1], sys.argv[1:])
"""


def opened_page(folder, wrapper: str = "", **options) -> tuple[subprocess.Popen, list[int]]:
    """``view --web`` in a process of its own; it and the ports of its page and its data."""
    line = [sys.executable, "-c", wrapper] if wrapper else []
    line += [sys.executable, "-m", "jaxmocap.cli", "view", folder, "--web"]
    line += ["--port", str(free_port())]
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True} | options
    process = subprocess.Popen(line, **options)
    assert process.stdout is not None
    page = next(text.split()[1] for text in process.stdout if text.startswith("at "))
    ports = [int(number) for number in re.findall(r":(\d+)/", urllib.parse.unquote(page))]
    assert len(ports) == 2 and all(map(answers, ports))
    return process, ports


def answers(port: int) -> bool:
    try:
        socket.create_connection((LOOPBACK, port), 5.0).close()
    except ConnectionRefusedError:
        return False
    return True


@pytest.mark.skipif(
    os.name != "posix", reason="it sends signals, which this system lacks: Linux or macOS has them"
)
@pytest.mark.parametrize(
    ("number", "code", "printed"),
    [(signal.SIGINT, 0, ""), (signal.SIGTERM, 143, "jaxmocap view: terminated\n")],
)
def test_a_signal_ends_the_command_and_its_server(folder, number, code, printed):
    process, ports = opened_page(folder)
    process.send_signal(number)
    _, stderr = process.communicate(timeout=60)
    assert (process.returncode, stderr) == (code, printed)
    assert not any(map(answers, ports))


@pytest.mark.skipif(
    os.name != "posix",
    reason="it opens a terminal, which this system lacks: Linux or macOS has one",
)
def test_a_closed_terminal_ends_the_command_and_its_server(folder):
    shown, terminal = os.openpty()
    process, ports = opened_page(
        folder, wrapper=IN_TERMINAL, stdin=terminal, stderr=terminal, start_new_session=True
    )
    os.close(terminal)
    os.close(shown)
    process.wait(60)
    assert not any(map(answers, ports))


def test_a_second_viewer_on_a_port_that_is_taken_names_the_option(folder, refusal):
    first = serve_page(folder / "recording.rrd", free_port())
    try:
        port = int(re.findall(r":(\d+)/", str(first.page))[0])
        sentence = refusal("view", folder, "--web", "--port", port)
        assert f"port {port}: is taken" in sentence and "--port" in sentence
        assert first.is_open
    finally:
        first.end()


def test_a_viewer_that_ends_at_once_is_an_error_that_names_the_option(folder, monkeypatch):
    """As one does whose other port was taken in between."""
    monkeypatch.setattr(view, "viewer_command", lambda: [sys.executable, "-c", ""])
    with pytest.raises(InputError, match=r"could not be opened there; another one by --port \d+"):
        serve_page(folder / "recording.rrd", free_port())


def test_a_live_view_shows_the_newest_pose_and_image_and_keeps_up(tmp_path, monkeypatch):
    chunks = rerun_chunks()
    path = tmp_path / "live.rrd"
    monkeypatch.setattr(rr.RecordingStream, "connect_grpc", lambda self, url: self.save(path))
    skeleton = Skeleton.human(1.75)
    pose = relaxed_pose_on_floor(skeleton)
    sent = []
    monkeypatch.setattr(live_view, "INTERVAL_S", 0.02)
    view = LiveView("nowhere", skeleton, {"cam": CAMERA}, pose)
    log = view._log
    view._log = lambda snapshot: (sent.append(snapshot), log(snapshot))  # type: ignore[method-assign]
    images = [np.full((72, 96, 3), i, np.uint8) for i in range(100)]
    for i, image in enumerate(images):
        view.show(LiveSnapshot(i / 100, pose, np.array([0.2, 0.9]), 5.0, {"cam": image}))
        view.show(LiveSnapshot(i / 100 + 0.005, pose, np.array([0.2, 0.9]), 5.0, {}))
    wait_for(lambda: sent and sent[-1].time >= 0.995, 20.0)
    view.close()
    # What is not shown in time is passed over, but an image waits for the next pose.
    assert len(sent) < 100 and sent[-1].time == 0.995
    assert any(snapshot.images and (snapshot.images["cam"] == 99).all() for snapshot in sent)
    entities = {chunk.entity_path for chunk in chunks.RrdReader(path).stream()}
    assert entities >= {"/world/cameras/cam/image", "/elbow_deviations/left", "/world/body/head"}


def test_who_stands_has_the_feet_on_the_floor():
    from jaxmocap.body.kinematics import forward

    skeleton = Skeleton.human(1.75)
    joints = np.asarray(forward(skeleton, relaxed_pose_on_floor(skeleton)).joints_world)
    assert abs(joints[:, 2].min()) < 1e-5 and joints[:, 2].max() > 1.3
