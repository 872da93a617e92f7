"""A live run from its file to its end, as the command has it.

INPUTS: the file of a live run, options. OUTPUTS: figures, and their text.
"""

import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from time import monotonic, sleep
from typing import Any, Literal

import numpy as np

from jaxmocap.body.kinematics import forward
from jaxmocap.body.pose import Pose, relaxed_pose
from jaxmocap.body.skeleton import Skeleton
from jaxmocap.calibration.devices.standing import Stance
from jaxmocap.capture.streams.inbox import LiveFrame
from jaxmocap.formats.files.errors import printable, short_name
from jaxmocap.hybrid.settings import Settings
from jaxmocap.pipelines.live.calibrating import COUNTDOWN_S, calibrate_live
from jaxmocap.pipelines.live.loop import Live
from jaxmocap.pipelines.live.recording import check_free
from jaxmocap.pipelines.live.setup import LiveSetup, load_live
from jaxmocap.pipelines.live.status import LiveStatus
from jaxmocap.pipelines.live.tracking import Output
from jaxmocap.pipelines.signals import Terminated
from jaxmocap.pipelines.view import start_viewer


class Stop(threading.Event):
    """The event that ends a run.

    Attributes:
        terminated: whether by SIGTERM or a closed terminal, not by Ctrl-C.
    """

    terminated = False


@contextmanager
def stop_on_signals() -> Iterator[Stop]:
    """An event that the signals set; a second Ctrl-C interrupts as ever.

    Signals that are ignored stay so, as ``nohup`` wants it. Outside the main thread, which alone
    has signals, it is an event like any other.
    """
    stop = Stop()

    def set_stop(number: int, frame: Any) -> None:
        stop.terminated |= number != signal.SIGINT
        stop.set()
        if number == signal.SIGINT:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    signals = {signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)}
    if threading.current_thread() is not threading.main_thread():
        signals = set()
    taken = [each for each in signals if signal.getsignal(each) is not signal.SIG_IGN]
    before = {each: signal.signal(each, set_stop) for each in taken}
    try:
        yield stop
    finally:
        for each, handler in before.items():
            signal.signal(each, signal.SIG_DFL if handler is None else handler)


ViewerKind = Literal["window", "web"]
# A viewer accepts connections after about so many seconds.
VIEWER_START_S = 1.5


def run_live(
    path: str | Path,
    *,
    out: str | Path | None = None,
    smooth: bool = False,
    settings: Settings | None = None,
    seconds: float | None = None,
    view: ViewerKind | None = None,
    calibrate: Stance | None = None,
    countdown: float = COUNTDOWN_S,
    status: LiveStatus | None = None,
) -> dict[str, Any]:
    """Run until Ctrl-C or SIGTERM, or so many seconds, with the options of ``jaxmocap live``.

    Returns:
        Figures of the run; "problems" are sentences about what it did not do, and "terminated" is
        whether SIGTERM ended it.

    Raises:
        InputError: what cannot be read or opened.
        OutputError: the disk is full before it begins, or the calibration fails.
    """
    status = status or LiveStatus()
    setup = _load(path, out, status)
    calibration: dict[str, Any] = {}
    if calibrate is not None:
        with stop_on_signals() as stop:
            calibration = calibrate_live(setup, calibrate, status, stop, countdown)
        if not calibration:
            raise Terminated if stop.terminated else KeyboardInterrupt
        setup = _load(path, out, status)
    with ExitStack() as ending:
        status.log(0.0, "starting the tracker")
        viewer = _viewer(setup, view, status, ending) if view else None
        live = Live(
            setup, settings or Settings(), smooth=smooth, out=out, viewer=viewer, status=status
        )
        ending.callback(live.close)
        with stop_on_signals() as stop:
            figures = live.run(seconds, stop)
        return figures | {"terminated": stop.terminated, "calibration": calibration or None}


def _load(path: str | Path, out: str | Path | None, status: LiveStatus) -> LiveSetup:
    """The run's file, its warnings logged, with a folder that can be recorded in."""
    setup = load_live(path)
    if out is not None:
        check_free(setup, out)
    for warning in setup.warnings:
        status.log(0.0, warning)
    return setup


def _viewer(
    setup: LiveSetup, view: ViewerKind, status: LiveStatus, ending: ExitStack
) -> Callable[[Output, dict[str, LiveFrame]], None]:
    """Open a viewer; a function that shows it a pose and frames."""
    from jaxmocap.outputs.live_view import LiveSnapshot, LiveView

    viewer = start_viewer([], view == "web", stay=False)
    ending.callback(viewer.end)
    sleep(VIEWER_START_S)
    cameras = {video.camera_name: video.camera for video in setup.videos}
    live_view = LiveView(viewer.url, setup.skeleton, cameras, relaxed_pose_on_floor(setup.skeleton))
    ending.callback(live_view.close)
    status.log(0.0, f"viewer at {viewer.page}" if viewer.page else "viewer in a window")
    began = monotonic()

    def show(output: Output, frames: dict[str, LiveFrame]) -> None:
        if not viewer.is_open or live_view.problem:
            status.set_state(monotonic() - began, "viewer", live_view.problem or "closed")
            return
        images = {name: frame.image for name, frame in frames.items()}
        latency = 1e3 * status.newest_latency
        time = monotonic() - began
        live_view.show(LiveSnapshot(time, output.pose, output.deviations, latency, images))

    return show


def relaxed_pose_on_floor(skeleton: Skeleton) -> Pose:
    """The relaxed pose, facing x, with the lowest joint on the floor at the world's origin."""
    pose = relaxed_pose(skeleton)
    lowest = float(np.asarray(forward(skeleton, pose).joints_world)[:, 2].min())
    return pose._replace(position=pose.position - np.array([0.0, 0.0, lowest], np.float32))


def live_summary(figures: Mapping[str, Any]) -> str:
    """The figures of a run in a few lines."""
    latency, dropped = figures["latency_ms"], figures["dropped"]
    ignored = ", ".join(f"{count} {why}" for why, count in figures["ignored"].items())
    rows = {
        "ran": f"{figures['seconds']:.1f} s",
        "poses": f"{figures['outputs']}, {figures['rate_hz']:.1f} a second"
        + (f"; {figures['not_sent']} datagrams not sent" if figures["not_sent"] else ""),
        "latency": f"{latency['median']:.1f} ms (median), {latency['p99']:.1f} ms (99 %)"
        if np.isfinite(latency["median"])
        else "",
        "dropped": ", ".join(f"{count} {what}" for what, count in dropped.items()),
        "packets": f"{figures['packets']}" + (f"; ignored: {ignored}" if ignored else ""),
        "frames": ", ".join(
            f"{short_name(name)} {count}" for name, count in figures["frames"].items()
        ),
        "written": figures["recording"] and printable(figures["recording"]),
    }
    return "\n".join(f"{name.ljust(8)}{text}" for name, text in rows.items() if text)
