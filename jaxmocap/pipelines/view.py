"""The rerun viewer, of a recording or a live run, in a window or in a browser.

INPUTS: a folder that ``track`` wrote. OUTPUTS: a viewer's process, and a sentence about it.

Whatever is opened listens to this machine alone.
"""

import atexit
import importlib.util
import os
import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep
from typing import NamedTuple
from urllib.parse import quote, urlsplit

from jaxmocap.formats.files.errors import InputError
from jaxmocap.pipelines.signals import signals_deferred

LOOPBACK = "127.0.0.1"
# A viewer that does not stop within so many seconds is killed.
VIEWER_STOP_TIMEOUT_S = 5.0
# One that does not answer within so many seconds is not waited for.
VIEWER_START_TIMEOUT_S = 30.0


class Viewer(NamedTuple):
    """A viewer that is open, where it takes data, and the page for a browser; None for a window."""

    process: subprocess.Popen
    url: str
    page: str | None

    def until_interrupted(self, announce: Callable[[], None]) -> None:
        """Wait for the viewer to end, or for Ctrl-C; whatever comes, the viewer has then ended.

        ``announce`` says where it is open. SIGTERM and what else is raised meanwhile goes on.
        """
        try:
            with suppress(KeyboardInterrupt):
                announce()
                self.process.wait()
        finally:
            self.end()

    @property
    def is_open(self) -> bool:
        """Is it still there?"""
        return self.process.poll() is None

    def end(self) -> None:
        """End it, and wait until it has ended."""
        self.process.terminate()
        try:
            self.process.wait(VIEWER_STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


def recording_in(directory: str | Path) -> Path:
    """The folder's recording.rrd; InputError where there is none."""
    path = Path(directory) / "recording.rrd"
    if not path.is_file():
        raise InputError(path, "no such file, expected a folder that 'jaxmocap track' wrote")
    return path


def has_display() -> bool:
    """Whether a window can be shown: on Linux a display server must be named."""
    if not sys.platform.startswith("linux"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def open_viewer(path: Path) -> str:
    """Open a recording in a viewer of its own where there is a display; a sentence about it."""
    if not has_display():
        return f"{path}\nno display here; in a browser: jaxmocap view {path.parent} --web"
    start_viewer([str(path)])
    return f"{path}\nopened in the rerun viewer"


def serve_page(path: Path, port: int) -> Viewer:
    """Serve a recording (.rrd) to a browser, from a process that ends with this one.

    Raises:
        InputError: the port is taken, or the viewer cannot be opened.
    """
    if not _is_free(port):
        problem = f"is taken, perhaps by another viewer; another one by --port {free_port()}"
        raise InputError(f"port {port}", problem)
    from jaxmocap.outputs.recorder import send_recording

    # A server that reads the file itself keeps a core busy for ever (rerun 0.41). Older ones must.
    sends = importlib.util.find_spec("rerun.chunk") is not None
    files = [] if sends else [str(path)]
    viewer = start_viewer(files, web=True, web_port=port, stay=False)
    try:
        # Until the page and its data are served.
        data_port = urlsplit(viewer.url.partition("+")[2]).port or 0
        end = monotonic() + VIEWER_START_TIMEOUT_S
        for each in (port, data_port):
            while not _answers(each):
                if not viewer.is_open or monotonic() > end:
                    problem = "the viewer could not be opened there; another one by"
                    raise InputError(f"port {port}", f"{problem} --port {free_port()}")
                sleep(0.05)
        if sends:
            send_recording(path, viewer.url)
    except BaseException:
        viewer.end()
        raise
    return viewer


def _is_free(port: int) -> bool:
    """Whether this machine's address can be had at a port."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except OSError:
            return False
    return True


def _answers(port: int) -> bool:
    try:
        socket.create_connection((LOOPBACK, port), 1.0).close()
    except OSError:
        return False
    return True


def start_viewer(
    arguments: list[str], web: bool = False, web_port: int = 0, stay: bool = True
) -> Viewer:
    """Start a viewer.

    Args:
        arguments: files, or options of rerun's.
        web: serve it to a browser, in place of a window.
        web_port: of the page; 0 takes a free one.
        stay: the viewer outlives this process; else it ends with it, at the latest.
    """
    port = free_port()
    options = ["--bind", LOOPBACK, "--port", str(port)]
    url, page = f"rerun+http://{LOOPBACK}:{port}/proxy", None
    if web:
        web_port = web_port or free_port()
        options += ["--serve-web", "--web-viewer-port", str(web_port)]
        page = f"http://{LOOPBACK}:{web_port}/?url={quote(url, safe='')}"
    command = [*viewer_command(), *options, *arguments]
    with signals_deferred():
        process = subprocess.Popen(
            command,
            start_new_session=stay,
            # Ctrl-C is for this process, which then ends the viewer.
            process_group=None if stay else 0,
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        viewer = Viewer(process, url, page)
        if not stay:
            atexit.register(viewer.end)
    return viewer


def viewer_command() -> list[str]:
    """What starts the viewer: its program itself, for what wraps it would end without it."""
    spec = importlib.util.find_spec("rerun_cli")
    for folder in (spec.submodule_search_locations or ()) if spec else ():
        for name in ("Rerun.app/Contents/MacOS/Rerun", "rerun", "rerun.exe"):
            if (program := Path(folder) / name).is_file():
                return [str(program)]
    return [sys.executable, "-m", "rerun"]


def free_port() -> int:
    """A port of TCP that nobody listens to on this machine."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return probe.getsockname()[1]
