"""How a live run ends: whole, soon, and with every thread and process that it began."""

import importlib
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from conftest import complaint
from pythonosc.osc_packet import OscPacket
from small_recording import PLACES
from test_live_disk import contents, live_setup
from test_live_run import Standing, small_setup

import jaxmocap.pipelines.live.loop
from jaxmocap import Recording
from jaxmocap.capture.streams import cameras
from jaxmocap.capture.streams.udp import OscTable
from jaxmocap.capture.video import open_video
from jaxmocap.cli.program import main
from jaxmocap.formats.files.addresses import Address
from jaxmocap.formats.files.errors import InputError, OutputError
from jaxmocap.outputs.senders.osc import Bundle
from jaxmocap.pipelines import view
from jaxmocap.pipelines.live import session
from jaxmocap.pipelines.live.loop import Live
from jaxmocap.pipelines.live.session import live_summary, run_live, stop_on_signals
from jaxmocap.pipelines.live.status import LiveStatus
from jaxmocap.pipelines.signals import Terminated, raise_on_sigterm, signals_deferred

posix = pytest.mark.skipif(
    os.name != "posix", reason="it sends signals, which this system lacks: Linux or macOS has them"
)
OURS = ("markers", "camera", "recording", "viewer")


@pytest.fixture(autouse=True)
def standing_in(monkeypatch):
    """No tracker: every sample finds somebody who stands still."""
    monkeypatch.setattr(jaxmocap.pipelines.live.loop, "LiveTracking", Standing)


def threads() -> list[str]:
    return [t.name for t in threading.enumerate() if t.name.startswith(OURS)]


def bundle_of_markers(unit: float = 1.0) -> bytes:
    bundle = Bundle([("/VMC/Ext/Tra/Pos", [name, *[0.0] * 7]) for name in PLACES])
    return bundle.fill(np.tile([0.1 * unit, unit, 0.2 * unit, 0, 0, 0, 1], (len(PLACES), 1)))


def send_markers(address: Address, stop: threading.Event) -> None:
    """Markers at 90 Hz until asked to stop."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        while not stop.wait(1 / 90):
            sender.sendto(bundle_of_markers(), tuple(address))


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def live_file(folder: Path, port: int, filmed: bool = True) -> Path:
    """A live run that listens at a port, of the markers alone where nobody films."""
    live_setup(folder)
    path = folder / "live.toml"
    text = path.read_text() if filmed else path.read_text().partition("[[video]]")[0]
    path.write_text(f"{text}\n[osc]\nlisten = {port}\n")
    return path


# Signals -----------------------------------------------------------------------------------------


@posix
@pytest.mark.parametrize(
    ("number", "terminated"),
    [(signal.SIGINT, False), (signal.SIGTERM, True), (signal.SIGHUP, True)],
)
def test_a_run_that_a_signal_ends_is_complete_and_reports_which(tmp_path, number, terminated):
    port = free_port()
    path = live_file(tmp_path, port)
    stop, before = threading.Event(), signal.getsignal(number)

    def play() -> None:
        threading.Thread(target=send_markers, args=(Address(port=port), stop), daemon=True).start()
        # Before that it would end this process, as it should.
        while signal.getsignal(number) == before and not stop.wait(0.05):
            pass
        if not stop.wait(1.5):
            os.kill(os.getpid(), number)

    player = threading.Thread(target=play)
    player.start()
    out = tmp_path / "out"
    try:
        figures = run_live(path, out=out, seconds=30.0, status=LiveStatus(StringIO()))
    finally:
        stop.set()
        player.join()
    assert figures["seconds"] < 20 and figures["terminated"] is terminated
    assert figures["problems"] == [] and figures["outputs"] > 20
    assert len(Recording.load(out / "recording.toml").times) > 20
    assert not threads() and "poses" in live_summary(figures)


@posix
def test_signals_that_are_ignored_stay_so_and_all_handlers_come_back():
    before = [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)]
    ignored = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with stop_on_signals() as stop:
            os.kill(os.getpid(), signal.SIGHUP)
            time.sleep(0.05)
            assert not stop.is_set()
            os.kill(os.getpid(), signal.SIGTERM)
            assert stop.wait(5.0) and stop.terminated
    finally:
        signal.signal(signal.SIGHUP, ignored)
    assert before == [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM)]


@posix
def test_a_signal_waits_until_what_was_begun_can_be_ended():
    done = []
    with pytest.raises(Terminated), raise_on_sigterm():
        with signals_deferred():
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(0.05)
            done.append("begun")
        done.append("never")
    assert done == ["begun"]


@pytest.mark.parametrize(
    ("number", "raised"), [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, Terminated)]
)
@pytest.mark.parametrize("then_s", [0.0, 1.0])
def test_a_signal_within_an_import_waits_until_it_is_done(
    tmp_path, monkeypatch, number, raised, then_s
):
    """Libraries made other errors of it, went on, or crashed."""
    (tmp_path / "imported_whole.py").write_text(f"import signal\nsignal.raise_signal({number})\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "imported_whole", raising=False)
    before, done = signal.getsignal(number), []
    with pytest.raises(raised), raise_on_sigterm():
        done.append(importlib.import_module("imported_whole"))
        time.sleep(then_s)
        done.append("slept")
    assert len(done) == (1 if then_s else 2) and signal.getsignal(number) is before


def test_a_run_outside_the_main_thread_has_no_signals():
    actual = []

    def run() -> None:
        with stop_on_signals() as stop:
            actual.append(stop.is_set())

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert actual == [False]


# Runs that come to nothing -----------------------------------------------------------------------


def test_a_run_that_received_nothing_says_so_and_leaves_nothing(tmp_path):
    setup = replace(small_setup(tmp_path), videos=())
    live = Live(setup, out=tmp_path / "out", status=LiveStatus(StringIO()))
    figures = live.run(seconds=0.3)
    (problem,) = figures["problems"]
    assert problem.startswith("no marker came in at 127.0.0.1:")
    assert figures["recording"] is None and not (tmp_path / "out").exists() and not threads()


def test_a_run_whose_packets_are_mostly_absurd_says_so(tmp_path):
    """As of a sender that counts in millimetres but for its first packets."""
    live = Live(replace(small_setup(tmp_path), videos=()), status=LiveStatus(StringIO()))
    stop = threading.Event()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for unit in (1.0, 1.0, *[1000.0] * 1000):
                sender.sendto(bundle_of_markers(unit), tuple(live.address))
                if stop.wait(1 / 90):
                    return

    threading.Thread(target=send, daemon=True).start()
    figures = live.run(seconds=1.0)
    stop.set()
    (problem,) = figures["problems"]
    assert f"{figures['ignored']['absurd']} of {figures['packets']} packets at 127.0.0.1" in problem
    assert problem.endswith("were absurd; expected positions in metres, within 100 m of the origin")


def test_a_run_whose_recording_fails_goes_on_and_says_so_once(tmp_path, monkeypatch):
    setup, output = replace(small_setup(tmp_path), videos=()), StringIO()
    live = Live(setup, out=tmp_path / "out", status=LiveStatus(output))
    assert live.recording is not None

    def full(sample) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(live.recording, "_add_sample", full)
    stop = threading.Event()
    threading.Thread(target=send_markers, args=(live.address, stop), daemon=True).start()
    figures = live.run(seconds=1.0)
    stop.set()
    assert figures["outputs"] > 20 and figures["latency_ms"]["of"] > 20
    (problem,) = figures["problems"]
    assert problem == (
        f"{tmp_path / 'out' / 'markers.csv'}: cannot be written any more (No space left on device)"
    )
    assert output.getvalue().count("cannot be written any more") == 1


def test_a_pose_that_takes_long_does_not_tell_receivers_that_nobody_is_tracked(
    tmp_path, monkeypatch
):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.setblocking(False)
        setup = small_setup(tmp_path, Address("127.0.0.1", receiver.getsockname()[1]))
        live = Live(replace(setup, videos=()), status=LiveStatus(StringIO()))
        usual, taken = live.tracking.sample, []

        def slow(sample):
            taken.append(sample)
            time.sleep(0.5 if len(taken) == 1 else 0.0)
            return usual(sample)

        monkeypatch.setattr(live.tracking, "sample", slow, raising=False)
        stop = threading.Event()
        threading.Thread(target=send_markers, args=(live.address, stop), daemon=True).start()
        live.run(seconds=1.0)
        stop.set()
        status = []
        with suppress(BlockingIOError):
            while True:
                packet = OscPacket(receiver.recv(65536))
                status += [m.message for m in packet.messages if m.message.address == "/VMC/Ext/OK"]
    is_tracked = [message.params[3] for message in status]
    assert 1 in is_tracked and 0 not in is_tracked[is_tracked.index(1) :]


def test_a_fault_within_the_run_closes_the_recording_all_the_same(tmp_path, monkeypatch):
    setup = replace(small_setup(tmp_path), videos=())
    live = Live(setup, out=tmp_path / "out", status=LiveStatus(StringIO()))
    taken = []

    def breaks(sample):
        taken.append(sample)
        if len(taken) > 30:
            raise RuntimeError("a fault")
        return []

    monkeypatch.setattr(live.tracking, "sample", breaks, raising=False)
    stop = threading.Event()
    threading.Thread(target=send_markers, args=(live.address, stop), daemon=True).start()
    with pytest.raises(RuntimeError, match="a fault"):
        live.run(seconds=20.0)
    stop.set()
    assert len(Recording.load(tmp_path / "out" / "recording.toml").times) >= 30
    assert not threads()


def test_what_cannot_be_opened_leaves_no_recording_behind(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        source = OscTable(Address(port=taken.getsockname()[1]))
        setup = replace(small_setup(tmp_path), source=source)
        assert "cannot listen there" in complaint(Live, setup, out=tmp_path / "out")
    assert not (tmp_path / "out").exists() and not threads()


def test_a_folder_that_is_taken_is_refused_before_a_viewer_is_opened(tmp_path, monkeypatch):
    live_setup(tmp_path)
    monkeypatch.setattr(session, "start_viewer", lambda *_: pytest.fail("a viewer was opened"))
    with pytest.raises(InputError, match=r"cam\.mp4.*another folder"):
        run_live(tmp_path / "live.toml", out=tmp_path, view="web")


def test_a_camera_that_never_lets_go_does_not_keep_the_run_from_ending(tmp_path, monkeypatch):
    setup = small_setup(tmp_path)
    setup = replace(setup, videos=(replace(setup.videos[0], source=0),))
    let_go = threading.Event()

    def stuck(*_):
        let_go.wait(60.0)
        yield np.zeros((72, 96), np.uint8)

    monkeypatch.setattr(cameras, "device_frames", stuck)
    live = Live(setup, status=LiveStatus(StringIO()))
    began = time.monotonic()
    live.run(seconds=0.2)
    assert time.monotonic() - began < 20 and threads() == ["camera 0"]
    let_go.set()


# Viewers -----------------------------------------------------------------------------------------


@posix
@pytest.mark.parametrize("raised", [KeyboardInterrupt, Terminated, OutputError])
def test_a_viewer_has_ended_whatever_ended_the_wait_for_it(monkeypatch, raised):
    sleeps = [sys.executable, "-c", "import time; time.sleep(600)"]
    monkeypatch.setattr(view, "viewer_command", lambda: sleeps)
    viewer = view.start_viewer([], web=True, stay=False)
    wait = viewer.process.wait

    def interrupted(timeout=None):
        monkeypatch.setattr(viewer.process, "wait", wait)
        raise raised("x", "y") if raised is OutputError else raised

    monkeypatch.setattr(viewer.process, "wait", interrupted)
    if raised is KeyboardInterrupt:
        viewer.until_interrupted(lambda: None)
    else:
        with pytest.raises(raised):
            viewer.until_interrupted(lambda: None)
    assert viewer.process.returncode == -signal.SIGTERM and not viewer.is_open


@posix
def test_a_viewer_that_does_not_listen_is_killed(monkeypatch):
    deaf = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print(); "
    deaf += "time.sleep(600)"
    monkeypatch.setattr(view, "viewer_command", lambda: [sys.executable, "-c", deaf])
    monkeypatch.setattr(view, "VIEWER_STOP_TIMEOUT_S", 0.5)
    viewer = view.start_viewer([], web=True, stay=False)
    time.sleep(1.0)
    viewer.end()
    assert viewer.process.returncode is not None


# Processes ---------------------------------------------------------------------------------------


def left(script: str, **options) -> subprocess.CompletedProcess:
    imported = "import atexit, sys, threading, time\n"
    imported += "from jaxmocap.cli import end_process"
    code = f"{imported}\n{script}"
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, **options
    )


def test_a_process_whose_thread_cannot_be_ended_leaves_all_the_same():
    done = left(
        "threading.Thread(target=time.sleep, args=(600,), daemon=True).start()\n"
        "sys.stdout.write('figures')\nend_process(3)"
    )
    assert (done.returncode, done.stdout, done.stderr) == (3, "figures", "")


def test_a_process_that_was_stopped_does_not_wait_for_what_still_compiles():
    done = left("threading.Thread(target=time.sleep, args=(600,)).start()\nend_process(143)")
    assert done.returncode == 143


def test_a_process_without_threads_ends_as_ever():
    done = left("atexit.register(print, 'at exit')\nend_process(0)")
    assert (done.returncode, done.stdout) == (0, "at exit\n")


@posix
@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "times"), [(signal.SIGINT, 20), (signal.SIGTERM, 5), (signal.SIGHUP, 5)]
)
def test_live_with_a_viewer_ends_cleanly_every_time(tmp_path, number, times):
    """The whole command: Ctrl-C goes to its process group, as a terminal sends it."""
    port, stop, codes = free_port(), threading.Event(), Counter()
    path = live_file(tmp_path, port, filmed=False)
    threading.Thread(target=send_markers, args=(Address(port=port), stop), daemon=True).start()
    for i in range(times):
        code, output = _stopped(path, tmp_path / str(i), number)
        codes[code] += 1
        assert "FATAL" not in output and "Traceback" not in output, output
        assert len(Recording.load(tmp_path / str(i) / "recording.toml").times) > 10
    stop.set()
    print(codes)
    assert set(codes) == {0 if number == signal.SIGINT else 143}


def _stopped(path: Path, out: Path, number: int) -> tuple[int, str]:
    """Exit code and standard error of a run that a signal stops at some time."""
    command = [sys.executable, "-m", "jaxmocap.cli", "live", path, "--view", "web", "--out", out]
    process = subprocess.Popen(
        command,
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )
    assert process.stderr is not None
    output = ""
    for line in process.stderr:
        output += line
        if "coming in" in line:
            break
    time.sleep(0.5 + np.random.default_rng().uniform(0, 1.5))
    os.killpg(process.pid, number)
    output += process.communicate(timeout=60)[1]
    (page,) = re.findall(r"viewer at http://127\.0\.0\.1:(\d+)/", output)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", int(page)), 5.0)
    return process.returncode, output


@posix
@pytest.mark.slow
def test_forty_kills_of_the_command_lose_nothing_and_leave_nothing_hidden(tmp_path):
    """SIGKILL at any time: while it loads, compiles, listens and records."""
    port, stop, actual = free_port(), threading.Event(), Counter()
    path = live_file(tmp_path, port)
    threading.Thread(target=send_markers, args=(Address(port=port), stop), daemon=True).start()
    listens = _seconds_until_it_listens(path)
    for i, after in enumerate(np.random.default_rng(0).uniform(0.1, 2.0, 40) * listens):
        out = tmp_path / f"out {i}"
        line = [sys.executable, "-m", "jaxmocap.cli", "live", path, "--out", out]
        process = subprocess.Popen(line, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        time.sleep(after)
        process.kill()
        process.wait()
        actual[_left_by_a_kill(path, out)] += 1
    stop.set()
    print(f"it listened after {listens:.1f} s; {dict(actual)}")
    assert sum(actual.values()) == 40 and actual["a recording"] > 5


def _seconds_until_it_listens(path: Path) -> float:
    """Of a run whose programs have been compiled before."""
    for _ in range(2):
        began = time.monotonic()
        line = [sys.executable, "-m", "jaxmocap.cli", "live", path, "--seconds", "0.1"]
        subprocess.run(line, capture_output=True, check=False)
    return time.monotonic() - began


def _left_by_a_kill(path: Path, out: Path) -> str:
    """What a run that was killed has left, in a word; the next run does not touch it."""
    before = contents(out) if out.exists() else {}
    there = {name: data for name, data in before.items() if not name.startswith(".")}
    if not there:
        return "nothing"
    assert "another folder" in complaint(run_live, path, out=out)
    assert contents(out) == there
    if "recording.toml" not in there:
        # Not a sample had come.
        assert there.get("markers.csv", b"").count(b"\n") <= 1
        return "no sample yet"
    recording = Recording.load(out / "recording.toml")
    assert there["markers.csv"].endswith(b"\n")
    for video in recording.videos:
        assert all(image is not None for _, image in open_video(video).frames())
    return "a recording"


def test_the_command_that_received_nothing_says_so_last_and_ends_with_1(tmp_path, capsys):
    path = live_file(tmp_path, free_port(), filmed=False)
    assert main(["live", str(path), "--seconds", "0.3", "--json", "-"]) == 1
    printed = capsys.readouterr()
    assert json.loads(printed.out)["problems"] and "nan" not in printed.err
    assert printed.err.splitlines()[-1].startswith("jaxmocap live: no marker came in at 127.0.0.1:")
