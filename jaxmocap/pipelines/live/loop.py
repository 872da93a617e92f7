"""The live loop: markers and cameras in, poses out, as they come.

    source ──── gathering ─┐                                    ┌── senders
                           ├─ inbox ── tracking ── Output ──────┤
    cameras ───────────────┘   (the newest ones)                └── viewer
        └── recording on disk

Each device has a thread of its own; the tracker runs in this one.

INPUTS: a LiveSetup. OUTPUTS: datagrams, a recording, figures.

Whatever ends it, all threads are stopped and joined and the recording is closed before ``run``
returns.
"""

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from jaxmocap.capture.streams.cameras import LiveCamera
from jaxmocap.capture.streams.inbox import Inbox, LiveFrame
from jaxmocap.capture.streams.sample_assembly import MarkerSample, SampleAssembler
from jaxmocap.formats.recordings.marker_places import bone_point_binder
from jaxmocap.hybrid.settings import Settings
from jaxmocap.outputs.senders.osc import DatagramSender
from jaxmocap.outputs.senders.unity import UnityBody
from jaxmocap.pipelines.live.frame_pace import FramePace
from jaxmocap.pipelines.live.marker_states import ReachState, UprightState
from jaxmocap.pipelines.live.recording import LiveRecording
from jaxmocap.pipelines.live.setup import LiveSetup
from jaxmocap.pipelines.live.status import SILENT_S, LiveStatus, stream_states
from jaxmocap.pipelines.live.tracking import LiveTracking, Output

# Samples in the queue, at most: a tenth of a second of a headset's, and two where poses wait for
# video frames anyway. Where more arrive than can be tracked, a longer queue would only add latency.
LONGEST_QUEUE, LONGEST_SMOOTHED_QUEUE = 8, 16
# Seconds between messages to the receivers of poses that nothing is tracked.
HEARTBEAT_S = 0.25
# Seconds after which Python switches threads: its default of 5 ms would add to a sample's latency.
THREAD_SWITCH_S = 5e-4
# While programs are made ready; the times are those of a first run on two cores.
COMPILING_FIRST = (
    "getting ready (a first run compiles for up to half a minute, later ones do not); what comes "
    "in until then is not tracked"
)
COMPILING_VIDEO = "poses come from the markers alone until the video's part is ready"
COMPILING_REST = "poses come; getting the rest ready"


class Live:
    """One live run."""

    def __init__(
        self,
        setup: LiveSetup,
        settings: Settings | None = None,
        *,
        smooth: bool = False,
        out: str | Path | None = None,
        viewer: Callable[[Output, dict[str, LiveFrame]], None] | None = None,
        status: LiveStatus | None = None,
    ):
        """Open everything and begin to compile; no device is read yet.

        Smoothed, poses wait for two more video frames, or for 0.1 s. A recording goes to ``out``.
        The viewer must return at once.

        Raises:
            InputError: what cannot be opened.
        """
        self.status = status or LiveStatus()
        self._setup, self._viewer = setup, viewer
        with ExitStack() as ending:
            self._open(settings or Settings(), smooth, out, ending)
            self._ending = ending.pop_all()

    def _open(
        self, settings: Settings, smooth: bool, out: str | Path | None, ending: ExitStack
    ) -> None:
        """Open everything; ``ending`` closes it."""
        setup = self._setup
        # First, so that no device is opened where it cannot be recorded.
        self.recording = LiveRecording(setup, out) if out is not None else None
        if self.recording is not None:
            ending.callback(self.recording.close)
        longest = LONGEST_SMOOTHED_QUEUE if smooth else LONGEST_QUEUE
        self._inbox = Inbox(longest, keep_turns=not smooth)
        # Smoothed, a frame takes more than all else; alone, hardly more than a sample.
        self._pace = FramePace() if smooth else None
        self._began = monotonic()
        bind = bone_point_binder(setup.skeleton, setup.places)
        gathering = SampleAssembler(
            setup.marker_names, setup.source.aliases, setup.R_world_source, self._take_sample, bind
        )
        self._gathering = gathering
        self._states = {
            "out of reach": ReachState(setup.skeleton, setup.places),
            "the vertical": UprightState(setup.skeleton, setup.places),
        }
        self._source = setup.source.open(gathering, self._now)
        ending.callback(self._source.stop)
        colour = smooth or out is not None or self._viewer is not None
        self._cameras = [
            LiveCamera(video, i, self._take_frame, colour, self._now)
            for i, video in enumerate(setup.videos)
        ]
        for camera in self._cameras:
            ending.callback(camera.stop)
        self._body, self._senders = UnityBody(setup.skeleton), []
        for table in setup.senders:
            to = DatagramSender(table.send)
            ending.callback(to.close)
            self._senders.append((table.sender(self._body), to))
        self.tracking = LiveTracking(setup, settings, smooth)
        ending.callback(self.tracking.close)
        self._deviations = np.full(2, np.nan)
        self._last_heartbeat, self._ended, self._frames_shown = 0.0, 0.0, {}

    @property
    def address(self) -> Any:
        """Where markers are received."""
        return self._source.address

    def _now(self) -> float:
        return monotonic() - self._began

    def _take_sample(self, sample: MarkerSample) -> None:
        self._inbox.put_sample(sample)
        if self.recording is not None:
            self.recording.add(sample)

    def _take_frame(self, frame: LiveFrame) -> None:
        self._inbox.put_frame(frame)
        if self.recording is not None:
            self.recording.add(frame)

    def run(self, seconds: float | None = None, stop: threading.Event | None = None) -> dict:
        """Run until stopped, or so many seconds; figures of the run."""
        stop = stop or threading.Event()
        self._began = monotonic()
        sources = (self._source, *self._cameras)
        with self._ending, _short_switch_interval():
            try:
                for each in sources:
                    each.start()
                targets = [f"{each.title} to {each.send}" for each in self._setup.senders]
                self.status.log(0.0, ", ".join([f"listening at {self.address}", *targets]))
                while not stop.is_set() and (seconds is None or self._now() < seconds):
                    self._handle_next()
            finally:
                self._ended = self._now()
                # All of them before any is joined, so that they end at the same time.
                for each in sources:
                    each.ask_to_stop()
            for each in sources:
                each.stop()
            for output in self.tracking.flush():
                self._send(output)
        return self._figures()

    def close(self) -> None:
        """Close everything that is still open; ``run`` does so itself."""
        self._ending.close()

    def _handle_next(self) -> None:
        """Take one sample, or the newest frames, from the inbox; track it; update the status."""
        began = self._now()
        taken = self._inbox.take(0.05, self._pace is None or self._pace.is_due(began))
        took = self._now()
        if isinstance(taken, MarkerSample):
            for state in self._states.values():
                state.add(taken)
            outputs = self.tracking.sample(taken)
        else:
            outputs = self.tracking.frames(taken) if taken else []
            if taken and self._pace is not None:
                self._pace.took_frame(took)
            if taken and self._viewer is not None:
                names = [video.camera_name for video in self._setup.videos]
                self._frames_shown |= {names[frame.camera]: frame for frame in taken}
        for output in outputs:
            self._send(output)
        now = self._now()
        # Not by the newest sample that was tracked: a step that takes long loses nobody.
        came = self._source.last_arrival
        is_silent = came is None or now - came > SILENT_S
        if is_silent and now - self._last_heartbeat > HEARTBEAT_S:
            self._last_heartbeat = now
            for sender, to in self._senders:
                to.send(sender.lost_messages(now))
        self._update_status(now)
        if self._pace is not None:
            self._pace.count_work(self._now() - took, self._now() - began)

    def _send(self, output: Output) -> None:
        local = self._body.local(output.pose)
        for sender, to in self._senders:
            to.send(sender.frame(output.time, local, output.deviations))
        now = self._now()
        self.status.count_output(now, now - output.arrived)
        self._deviations = output.deviations
        if self._viewer is not None:
            self._viewer(output, self._frames_shown)
            self._frames_shown = {}

    def _update_status(self, now: float) -> None:
        """Log changed states, and update the status line."""
        self.status.set_state(now, "tracking", self._progress())
        sources = self._source, self._gathering, self._cameras
        for subject, state in stream_states(*sources, now, self._setup.places):
            self.status.set_state(now, subject, state)
        for subject, each in self._states.items():
            self.status.set_state(now, subject, each.state)
        if self.recording is not None and self.recording.problem:
            self.status.set_state(now, "recording", self.recording.problem)
        received_at = {"markers": self._source.last_arrival} | {
            c.name: c.last_arrival for c in self._cameras
        }
        self.status.update_line(
            now,
            {name: None if at is None else now - at for name, at in received_at.items()},
            self._drops(),
            self._deviations,
            self.tracking.is_ready,
        )

    def _progress(self) -> str:
        """How far compiling is."""
        if self.tracking.is_ready:
            return "ready"
        if not self.tracking.has_markers_poses:
            return COMPILING_FIRST
        return COMPILING_VIDEO if self._setup.videos else COMPILING_REST

    def _drops(self) -> dict[str, int]:
        return {
            "samples": self._inbox.dropped_samples,
            "frames": self._inbox.dropped_frames,
            **({"late": self.tracking.late_events} if self.tracking.late_events else {}),
        }

    def _figures(self) -> dict[str, Any]:
        """The run's figures, once all is closed."""
        recording = self.recording
        self.status.end_line()
        return self.status.figures(self._ended) | {
            "packets": self._source.packets,
            "senders": self._source.senders.packets(),
            "ignored": {why: count for why, count in self._source.ignored.items() if count},
            "clock_jumps": self._source.senders.clock_jumps,
            "dropped": self._drops() | {"not recorded": recording.dropped if recording else 0},
            "frames": {camera.name: camera.frames for camera in self._cameras},
            "placed_again": self.tracking.placements,
            "not_sent": sum(to.failed for _, to in self._senders),
            "recording": str(recording.path) if recording and recording.path else None,
            "problems": list(self._problems()),
        }

    def _problems(self) -> Iterator[str]:
        """Why the run received or recorded nothing, or not all."""
        source = self._source
        hints = "".join(hint for why, hint in source.hints.items() if source.ignored[why])
        if source.last_arrival is None:
            reason = f": {source.problem}" if source.problem else ""
            yield f"no marker came in at {self.address}{reason}{hints}"
        elif (absurd := source.ignored["absurd"]) > source.packets_used:
            yield f"{absurd} of {source.packets} packets at {self.address} were absurd{hints}"
        if any(to.failed and not to.sent for _, to in self._senders):
            yield "no pose could be sent: the system refuses each datagram to one of the addresses"
        if self.recording is not None and self.recording.problem:
            yield self.recording.problem


@contextmanager
def _short_switch_interval() -> Iterator[None]:
    before = sys.getswitchinterval()
    sys.setswitchinterval(THREAD_SWITCH_S)
    try:
        yield
    finally:
        sys.setswitchinterval(before)
