"""A live run on disk, as a recording that ``track`` reads.

INPUTS: samples and frames, as they come. OUTPUTS: markers.csv, CAMERA.mp4, calibration.toml and, at
the end, recording.toml.

A thread writes as things come, so that little is lost where a run is killed: of markers nothing but
the last lines, of videos the last second. Only recording.toml is missing then.
"""

import csv
import os
import shutil
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from queue import Full, Queue
from threading import Thread
from typing import Any

import av
import numpy as np
from av.error import FFmpegError

from jaxmocap.body.turns import quaternions
from jaxmocap.capture.gathering import Sample
from jaxmocap.capture.inbox import Frame
from jaxmocap.formats.errors import InputError
from jaxmocap.formats.live import LiveSetup
from jaxmocap.formats.places import MarkerPlace
from jaxmocap.formats.recording import write_recording
from jaxmocap.formats.tables import format_rows

# So many things wait to be written, a tenth of them frames; more are dropped and counted.
MOST_WAITING = 600
# So many samples are written at a stroke.
FLUSHED = 90
CLOCK = 90_000
# Fragments of so many microseconds: what a killed run loses of its video.
MP4 = {"movflags": "frag_keyframe+empty_moov+default_base_moof"}
QUICK = {"preset": "ultrafast", "crf": "20", "g": "30"}


class LiveRecording:
    """Writes one run.

    Attributes:
        folder: where.
        dropped: samples and frames that could not be written, or not in time.
        problem: why nothing more is written, or None.
    """

    def __init__(self, setup: LiveSetup, folder: str | Path):
        """Make the folder and begin.

        Raises:
            InputError: it holds a recording already.
        """
        self.folder, self.dropped, self.problem = Path(folder), 0, None
        if (self.folder / "recording.toml").exists():
            raise InputError(self.folder, "holds a recording already, expected another folder")
        self.folder.mkdir(parents=True, exist_ok=True)
        self._setup = setup
        self._markers = (self.folder / "markers.csv").open("w", encoding="utf-8", newline="")
        parts = (*"xyz", "qw", "qx", "qy", "qz") if setup.lsl is None else "xyz"
        columns = [f"{name}.{part}" for name in setup.marker_names for part in parts]
        csv.writer(self._markers, lineterminator="\n").writerow(["time", *columns])
        self._samples = 0
        self._films: dict[int, _Film] = {}
        self._queue: Queue[Sample | Frame | None] = Queue(MOST_WAITING)
        self._thread = Thread(target=self._write, name="recording", daemon=True)
        self._thread.start()

    def add(self, event: Sample | Frame) -> None:
        """Write a sample or a frame, soon."""
        full = self._queue.qsize() > MOST_WAITING // 10 and isinstance(event, Frame)
        try:
            if full:
                raise Full
            self._queue.put_nowait(event)
        except Full:
            self.dropped += 1

    def close(self) -> Path | None:
        """Write what waits, and recording.toml; its path, or None where there was no sample."""
        self._queue.put(None)
        self._thread.join()
        self._markers.close()
        for film in self._films.values():
            film.close()
        if not self._samples:
            return None
        videos = [
            {
                "file": film.path.name,
                "camera": self._setup.videos[i].camera_name,
                "offset": film.first,
            }
            for i, film in sorted(self._films.items())
        ]
        calibration = self._copied(self._setup.calibration) if videos else None
        return write_recording(
            self.folder,
            "markers.csv",
            {place.name: _place(place) for place in self._setup.places},
            videos,
            calibration,
            self._subject(),
        )

    def _write(self) -> None:
        while (event := self._queue.get()) is not None:
            try:
                if self.problem is None:
                    self._film(event) if isinstance(event, Frame) else self._note(event)
            except (OSError, FFmpegError) as error:
                # A full disk must not end the run.
                self.problem = f"cannot be written any more ({error.strerror or error})"
            self.dropped += self.problem is not None

    def _note(self, sample: Sample) -> None:
        measured = sample.measured
        known = sample.positions_world if measured is None else measured.positions_world
        if self._setup.lsl is None:
            nothing = np.full((len(known), 4), np.nan)
            turns = nothing if measured is None else quaternions(measured.turns_world)
            known = np.hstack([known, turns])
        cells = format_rows(known).ravel()
        self._markers.write(",".join([f"{sample.time:.9f}", *cells]) + "\n")
        self._samples += 1
        if self._samples % FLUSHED == 0:
            self._markers.flush()

    def _film(self, frame: Frame) -> None:
        if frame.camera not in self._films:
            name = self._setup.videos[frame.camera].camera_name
            self._films[frame.camera] = _Film(self.folder / f"{name}.mp4", frame)
        self._films[frame.camera].add(frame)

    def _copied(self, file: Path | None) -> str | None:
        if file is None:
            return None
        shutil.copyfile(file, self.folder / file.name)
        return file.name

    def _subject(self) -> Mapping[str, Any] | None:
        """The table [subject], its files as seen from the folder."""
        if self._setup.subject is None:
            return None
        table = dict(self._setup.subject)
        for key in {"file", "static"} & set(table):
            table[key] = _seen_from(self.folder, self._setup.path.parent / table[key])
        return table


def _place(place: MarkerPlace) -> dict[str, Any]:
    """The entry of [markers.on], without what is usual."""
    entry: dict[str, Any] = {"bone": place.bone, "at": place.at, "offset": list(place.offset)}
    if place.offset_in == "marker":
        entry["offset_in"] = place.offset_in
    if place.turn is not None:
        entry |= {"turn": list(place.turn), "lever": place.lever}
    return entry


def _seen_from(folder: Path, file: Path) -> str:
    try:
        return Path(os.path.relpath(file, folder)).as_posix()
    except ValueError:
        # Another drive.
        return file.resolve().as_posix()


class _Film:
    """One camera's video, each frame at its own time.

    Attributes:
        path: of the file.
        first: time of the first frame, seconds.
    """

    def __init__(self, path: Path, frame: Frame):
        self.path, self.first, self._last = path, frame.time, -1
        height, width = frame.image.shape[:2]
        self._container = av.open(str(path), "w", options=MP4)
        self._stream: av.VideoStream = self._container.add_stream("libx264", options=QUICK)
        # Chroma comes by twos; an odd last row or column is left out.
        self._stream.width, self._stream.height = width - width % 2, height - height % 2
        self._stream.pix_fmt = "yuv420p"
        self._stream.codec_context.time_base = self._stream.time_base = Fraction(1, CLOCK)

    def add(self, frame: Frame) -> None:
        image = frame.image[: self._stream.height, : self._stream.width]
        colours = "bgr24" if image.ndim == 3 else "gray"
        picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format=colours)
        stamp = max(round((frame.time - self.first) * CLOCK), self._last + 1)
        picture.pts, picture.time_base, self._last = stamp, Fraction(1, CLOCK), stamp
        self._container.mux(self._stream.encode(picture))

    def close(self) -> None:
        self._container.mux(self._stream.encode())
        self._container.close()
