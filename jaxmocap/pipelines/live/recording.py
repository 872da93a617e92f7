"""A live run on disk, as a recording that ``track`` reads.

INPUTS: samples and frames, as they come. OUTPUTS: markers.csv, CAMERA.mp4, copies of the
calibration and of the subject's static trial, recording.toml.

A thread writes as things come, and recording.toml as soon as there is something to read: a run that
is killed leaves a recording that lacks its last half second. What is in the folder is never
overwritten, so that nothing of such a run is lost to the next.
"""

import csv
import io
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from queue import Empty, Full, Queue
from threading import Event, Thread
from time import monotonic
from typing import Any

import numpy as np
from av.error import FFmpegError

from jaxmocap.body.orientations import quaternions
from jaxmocap.body.skeleton import has_wrists
from jaxmocap.capture.streams.inbox import LiveFrame
from jaxmocap.capture.streams.sample_assembly import MarkerSample
from jaxmocap.formats.files.errors import InputError, comma_list
from jaxmocap.formats.files.reading import read_bytes
from jaxmocap.formats.files.toml import read_toml
from jaxmocap.formats.files.writing import (
    as_output_error,
    check_file_name,
    check_folder_writable,
    remove_stale_temporaries,
    write_bytes,
)
from jaxmocap.formats.recordings.marker_places import MarkerPlace
from jaxmocap.formats.recordings.recording import write_recording
from jaxmocap.formats.recordings.subject import DEFAULT_HEIGHT
from jaxmocap.formats.time_series.tables import row_texts
from jaxmocap.pipelines.live.files import GrowingVideo, LineFile
from jaxmocap.pipelines.live.setup import LiveSetup

# Samples and frames in the queue, at most, a tenth of them frames; more are dropped and counted.
LONGEST_QUEUE = 600
# Seconds between writes of lines.
FLUSH_INTERVAL_S = 0.2
# A disk that has not written the queue within so many seconds has stopped working.
CLOSE_TIMEOUT_S = 30.0
MARKERS_FILE = "markers.csv"
RECORDING_FILE = "recording.toml"


class LiveRecording:
    """Writes one run; ``dropped`` counts what could not be written, or not in time."""

    def __init__(self, setup: LiveSetup, folder: str | Path):
        """Make the folder and begin.

        Raises:
            InputError: it holds something that would be overwritten, or cannot be written to.
            OutputError: the disk is full.
        """
        self.folder, self.dropped = Path(folder), 0
        self.path: Path | None = None
        self._setup, (self._subject, self._copies) = setup, _subject_and_copies(setup)
        check_free(setup, self.folder)
        self._created_folder = not self.folder.exists()
        self._problems: dict[str, str] = {}
        self._videos: dict[int, GrowingVideo] = {}
        self._written_state: Any = None
        # Markers whose orientation has been measured.
        self._oriented = np.zeros(len(setup.places), bool)
        try:
            with as_output_error(self.folder):
                self.folder.mkdir(parents=True, exist_ok=True)
            for name, source in self._copies.items():
                write_bytes(self.folder / name, read_bytes(source))
            self._lines = LineFile(self.folder / MARKERS_FILE, self._header())
        except BaseException:
            self._remove(self._copies)
            raise
        self._flushed = monotonic()
        self._queue: Queue[MarkerSample | LiveFrame | None] = Queue(LONGEST_QUEUE)
        self._ending = Event()
        self._closed = False
        self._thread = Thread(target=self._write, name="recording", daemon=True)
        self._thread.start()

    @property
    def problem(self) -> str | None:
        """What could not be written and why, in a sentence; or None."""
        # The thread that writes may add to it meanwhile.
        if not (failed := list(self._problems)):
            return None
        first, *rest = failed
        files = ", ".join([str(self.folder / first), *rest])
        return f"{files}: cannot be written any more ({self._problems[first]})"

    def add(self, event: MarkerSample | LiveFrame) -> None:
        """Write a sample or a frame, soon."""
        full = self._queue.qsize() > LONGEST_QUEUE // 10 and isinstance(event, LiveFrame)
        try:
            if full:
                raise Full
            self._queue.put_nowait(event)
        except Full:
            self.dropped += 1

    def close(self) -> Path | None:
        """Write what waits; the path of recording.toml, or None where nothing came in."""
        if self._closed:
            return self.path
        self._closed = True
        self._ending.set()
        with suppress(Full):
            self._queue.put_nowait(None)
        self._thread.join(CLOSE_TIMEOUT_S)
        if self._thread.is_alive():
            self._problems[MARKERS_FILE] = "the disk does not answer"
            return self.path
        videos_on_disk = ((video.path.name, video.close) for video in self._videos.values())
        for name, close in ((MARKERS_FILE, self._lines.close), *videos_on_disk):
            try:
                close()
            except (OSError, FFmpegError, ValueError) as error:
                self._problems.setdefault(name, _reason(error))
        self.dropped += self._lines.lost_count
        # There may be room for it now.
        self._problems.pop(RECORDING_FILE, None)
        self._write_recording(again=True)
        self._remove(self._empty_files())
        self.path = self.path if self.path and self.path.exists() else None
        return self.path

    def _header(self) -> str:
        parts = (*"xyz", "qw", "qx", "qy", "qz")
        columns = [f"{name}.{part}" for name in self._setup.marker_names for part in parts]
        text = io.StringIO()
        csv.writer(text, lineterminator="").writerow(["time", *columns])
        return text.getvalue()

    def _write(self) -> None:
        """What the thread does."""
        while True:
            try:
                event = self._queue.get(timeout=FLUSH_INTERVAL_S)
            except Empty:
                event = None
            if isinstance(event, LiveFrame):
                name = _video_name(self._setup, event.camera)
                self.dropped += not self._try_write(name, self._add_frame, event)
            elif event is not None:
                self.dropped += not self._try_write(MARKERS_FILE, self._add_sample, event)
            elif self._ending.is_set() and self._queue.empty():
                return
            if monotonic() - self._flushed >= FLUSH_INTERVAL_S:
                self._flushed = monotonic()
                # In this order: no row is ever on disk without the file that says what it is.
                self._write_recording()
                self._try_write(MARKERS_FILE, self._lines.flush)

    def _try_write(self, name: str, act: Callable[..., Any], *arguments: Any) -> bool:
        """Write to one file, if that has not failed before; whether it was written.

        A full disk must not end the run, and no other file's writing.
        """
        if name in self._problems:
            return False
        try:
            act(*arguments)
        except (OSError, FFmpegError, ValueError) as error:
            self._problems[name] = _reason(error)
            return False
        return True

    def _add_sample(self, sample: MarkerSample) -> None:
        measurements = sample.measurements
        columns = sample.positions_world if measurements is None else measurements.positions_world
        wxyz = np.full((len(columns), 4), np.nan)
        if measurements is not None:
            wxyz = quaternions(measurements.orientations_world)
            self._oriented |= np.isfinite(wxyz).all(-1)
        columns = np.hstack([columns, wxyz])
        cells = next(row_texts(columns.reshape(1, -1), ","))
        self._lines.add(f"{sample.time:.9f},{cells}")

    def _add_frame(self, frame: LiveFrame) -> None:
        if frame.camera not in self._videos:
            path = self.folder / _video_name(self._setup, frame.camera)
            self._videos[frame.camera] = GrowingVideo(path, frame)
        self._videos[frame.camera].add(frame)

    def _write_recording(self, again: bool = False) -> None:
        """Write recording.toml, if there is more to read than it says, or once again."""
        videos_on_disk = [
            (i, video) for i, video in sorted(self._videos.items()) if video.is_readable
        ]
        there = self._lines.has_lines, [i for i, _ in videos_on_disk], self._oriented.sum()
        if there[:2] == (False, []) or (there == self._written_state and not again):
            return
        videos = [
            {
                "file": video.path.name,
                "camera": self._setup.videos[i].camera_name,
                "offset": video.first_time,
            }
            for i, video in videos_on_disk
        ]
        on = {
            place.name: _marker_entry(place, bool(has_orientation))
            for place, has_orientation in zip(self._setup.places, self._oriented, strict=True)
            # Without it the marker has no place on the bone.
            if has_orientation or place.offset_in != "marker"
        }
        markers = MARKERS_FILE if there[0] else None
        calibration = next((name for name in self._copies if name.startswith("calib")), None)
        content = markers, on, videos, calibration if videos else None, self._subject
        if self._try_write(RECORDING_FILE, write_recording, self.folder, *content):
            self.path, self._written_state = self.folder / RECORDING_FILE, there

    def _empty_files(self) -> Iterator[str]:
        """Files of the run that hold nothing, so that none refers to them."""
        empty = [video.path.name for video in self._videos.values() if not video.is_readable]
        if not self._lines.line_count:
            yield MARKERS_FILE
        yield from empty
        if not self._lines.line_count and len(empty) == len(self._videos):
            yield from (RECORDING_FILE, *self._copies)

    def _remove(self, names: Iterable[str]) -> None:
        """Remove files of this run, and the folder where it made it and it is empty."""
        for name in names:
            with suppress(OSError):
                (self.folder / name).unlink(missing_ok=True)
        if self._created_folder:
            with suppress(OSError):
                self.folder.rmdir()


def check_free(setup: LiveSetup, folder: str | Path) -> None:
    """Look whether a run can be recorded in a folder, before anything is opened.

    Raises:
        InputError: a file that the run would write is there, or none can be.
    """
    folder = Path(folder)
    check_file_name(folder)
    check_folder_writable(folder)
    remove_stale_temporaries(folder)
    videos = (_video_name(setup, i) for i in range(len(setup.videos)))
    names = (MARKERS_FILE, RECORDING_FILE, *videos, *_subject_and_copies(setup)[1])
    if taken := [name for name in names if os.path.lexists(folder / name)]:
        problem = f"holds {comma_list(taken)} already, which is not overwritten"
        raise InputError(folder, f"{problem}; expected another folder")


def _video_name(setup: LiveSetup, camera: int) -> str:
    return f"{setup.videos[camera].camera_name}.mp4"


def _subject_and_copies(setup: LiveSetup) -> tuple[dict[str, Any] | None, dict[str, Path]]:
    """The recording's table [subject], and name in the folder -> file that is copied there.

    What a [subject] of its own file states is in the table, the static trial beside the recording,
    so that it can be moved as a whole.
    """
    copies = {}
    if setup.videos and setup.calibration is not None:
        copies[f"calibration{setup.calibration.suffix.lower()}"] = setup.calibration
    table, folder = dict(setup.subject or {}), setup.path.parent
    if "file" in table:
        file = folder / table.pop("file")
        table, folder = read_toml(file) | table, file.parent
    if "static" in table:
        static = folder / table["static"]
        table["static"] = f"static{static.suffix.lower()}"
        copies[table["static"]] = static
    if has_wrists(setup.skeleton):
        table = (table or {"height": DEFAULT_HEIGHT}) | {"wrists": True}
    return table or None, copies


def _marker_entry(place: MarkerPlace, has_orientation: bool) -> dict[str, Any]:
    """The entry of [markers.on], without what is usual or has not been measured."""
    entry: dict[str, Any] = {"bone": place.bone, "at": place.at, "offset": list(place.offset)}
    if place.offset_in == "marker":
        entry["offset_in"] = place.offset_in
    if place.orientation is not None and has_orientation:
        entry |= {"turn": list(place.orientation), "lever": place.lever}
    return entry


def _reason(error: Exception) -> str:
    strerror = error.strerror if isinstance(error, OSError) else None
    return strerror or getattr(error, "problem", None) or str(error) or type(error).__name__
