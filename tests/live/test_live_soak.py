"""Long live runs in steps of one process: memory and latency stay as they are at the beginning."""

import time
from pathlib import Path

import numpy as np
import pytest
from test_live_markers import bundle, device, message

from jaxmocap import Recording
from jaxmocap.capture.streams.inbox import Inbox
from jaxmocap.capture.streams.sample_assembly import MarkerSample, SampleAssembler
from jaxmocap.capture.streams.udp import Datagram, MarkerSocket, OscTable
from jaxmocap.formats.files.addresses import Address
from jaxmocap.hybrid.settings import Settings
from jaxmocap.outputs.senders.osc import Bundle
from jaxmocap.outputs.senders.unity import UnityBody
from jaxmocap.outputs.senders.vmc import VMC, VmcTable
from jaxmocap.pipelines.live.recording import LiveRecording
from jaxmocap.pipelines.live.setup import LiveSetup, load_live
from jaxmocap.pipelines.live.status import LiveStatus, stream_states
from jaxmocap.pipelines.live.tracking import LiveTracking

resource = pytest.importorskip(
    "resource", reason="this system does not report how much memory a process has used"
)
RATE = 90
# By so many MB the peak of memory may grow after the first tenth: of what is kept of the newest.
GROWTH_MB = 40
LIVE = """
[markers.on]
Hmd = { bone = "head", at = 0.7, offset = [0.1, 0.0, 0.0] }
LeftController = { bone = "hand_l", at = 0.6 }
RightController = { bone = "hand_r", at = 0.6 }
[subject]
height = 1.75
"""
PLACES = {"Hmd": (0.0, 1.6, 0.1), "LeftController": (-0.3, 1.0, 0.2)}
PLACES["RightController"] = (0.3, 1.0, 0.2)


@pytest.fixture
def setup(tmp_path) -> LiveSetup:
    (tmp_path / "live.toml").write_text(LIVE)
    return load_live(tmp_path / "live.toml")


class Run:
    """What ``Live`` does, without threads: packets in by a clock of its own, poses out."""

    def __init__(self, setup: LiveSetup, out: Path | None, tracking: LiveTracking | None):
        self.at, self.outputs = 0.0, 0
        self.inbox, self.status = Inbox(8), LiveStatus(open("/dev/null", "w"))  # noqa: SIM115
        self.recording = LiveRecording(setup, out) if out else None
        self.tracking, self.body = tracking, UnityBody(setup.skeleton)
        self.vmc = VMC(VmcTable(), self.body)
        names = setup.marker_names
        self.gathers = SampleAssembler(names, {}, setup.R_world_source, self.give)
        self.socket = MarkerSocket(OscTable(Address(port=0)), self.gathers, now=lambda: self.at)
        self.socket.stop()
        devices = [("/VMC/Ext/Con/Pos", [name, *[0.0] * 6, 1.0]) for name in names]
        self.packet = Bundle([("/VMC/Ext/T", [0.0]), *devices])
        self.still = np.array([PLACES[name] for name in names])
        self.noise = np.random.default_rng(0)

    def give(self, sample: MarkerSample) -> None:
        self.inbox.put_sample(sample)
        if self.recording is not None:
            while self.recording._queue.qsize() > 400:
                time.sleep(1e-4)
            self.recording.add(sample)

    def step(self, i: int) -> float:
        """One sample, now and then what is wrong; seconds that its pose took."""
        self.at = i / RATE
        sway = 0.05 * np.sin(self.at + np.arange(9).reshape(3, 3)) + self.still
        content = self.packet.fill(self.at, np.hstack([sway, np.tile([0.0, 0, 0, 1], (3, 1))]))
        packets = [Datagram(self.at, content, "127.0.0.1", 5000)]
        if i % 10 == 0:
            packets += self.trouble(i)
        began = time.perf_counter()
        self.socket.take(packets)
        while isinstance(sample := self.inbox.take(0.0), MarkerSample):
            for output in self.tracking.sample(sample) if self.tracking else []:
                self.vmc.frame(output.time, self.body.local(output.pose))
                self.outputs += 1
        taken = time.perf_counter() - began
        self.status.count_output(self.at, taken)
        for of, state in stream_states(self.socket, self.gathers, [], self.at):
            self.status.set_state(self.at, of, state)
        return taken

    def trouble(self, i: int) -> list[Datagram]:
        """Strangers, new senders with clocks of their own, names and noise, all ever new."""
        named = bundle(message("/VMC/Ext/T", float(i % 97)), device("Tra", f"who {i}", 0, 0, 0))
        return [
            Datagram(self.at, named, "127.0.0.1", 1024 + i % 60_000),
            Datagram(self.at, named, f"10.{i >> 16 & 255}.{i >> 8 & 255}.{i & 255}", 5000),
            Datagram(self.at, self.noise.bytes(40), "127.0.0.1", 5000),
        ]


def soak(run: Run, samples: int) -> None:
    """So many samples; memory and latency of the last tenth against the first."""
    latencies, tenth, early_mb = np.zeros(samples), samples // 10, 0.0
    for i in range(samples):
        latencies[i] = run.step(i)
        if i == tenth:
            early_mb = peak_mb()
    for name, part in (("first", latencies[:tenth]), ("last", latencies[-tenth:])):
        median, most = 1e3 * np.percentile(part, [50, 99])
        print(f"{name} tenth: {median:.3f} ms (median), {most:.3f} ms (99 %)")
    print(f"peak of memory: {early_mb:.0f} MB after a tenth, {peak_mb():.0f} MB at the end")
    assert peak_mb() - early_mb < GROWTH_MB
    assert len(run.status.messages) <= 1000 and run.status.message_count < 20 + samples / RATE


def peak_mb() -> float:
    """The most memory that this process has had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@pytest.mark.slow
def test_a_million_samples_come_in_and_are_recorded_in_flat_memory(setup, tmp_path):
    run = Run(setup, tmp_path / "out", None)
    soak(run, 1_000_000)
    assert run.recording is not None
    path = run.recording.close()
    assert path is not None and run.recording.dropped == 0
    with (tmp_path / "out" / "markers.csv").open("rb") as rows:
        assert sum(1 for _ in rows) == 1_000_001


@pytest.mark.slow
def test_a_hundred_thousand_samples_are_tracked_in_flat_memory(setup):
    tracking = LiveTracking(setup, Settings(refine="none"), smooth=False)
    tracking.wait_until_ready()
    run = Run(setup, None, tracking)
    soak(run, 100_000)
    assert run.outputs == 100_000


def test_some_samples_of_such_a_run_are_recorded_as_they_were_sent(setup, tmp_path):
    run = Run(setup, tmp_path / "out", None)
    for i in range(2000):
        run.step(i)
    assert run.recording is not None
    again = Recording.load(str(run.recording.close()))
    assert len(again.times) == 2000 and run.socket.ignored["stranger"] == 200
    np.testing.assert_allclose(np.diff(again.times), 1 / RATE, atol=2e-3)
