"""A corpus: the recordings in a folder, what each was tracked from, and its results.

INPUTS: a folder; the files that recordings name.
OUTPUTS: paths of recordings; fingerprints; corpus.csv and failures.json, complete or not at all.
"""

import csv
import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from jaxmocap import __version__
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.output_folder import OutputFolder
from jaxmocap.formats.files.reading import read_bytes
from jaxmocap.formats.files.toml import read_toml
from jaxmocap.formats.files.writing import replacing
from jaxmocap.formats.recordings.recording_files import input_files
from jaxmocap.outputs.report import write_figures
from jaxmocap.pipelines.live.setup import LIVE_MARKERS_KEYS
from jaxmocap.pipelines.writing import MOTION

# In a tracked recording's folder: a fingerprint of what it was tracked from, and its row.
RECORD_FILE = "batch.json"


@dataclass(frozen=True)
class CorpusRow:
    """One recording's results."""

    recording: str  # its path within the corpus
    frames: int  # marker samples
    seconds: float  # from the first sample to the last
    # Tracking by the video's frames (samples without video), milliseconds.
    ms_per_frame: float | None
    took_s: float  # from reading its file to the last output
    # Median standard deviation of the left elbow, metres; None frame by frame without video.
    deviation_left_m: float | None
    deviation_right_m: float | None  # of the right elbow
    missing: float  # share of the markers' positions
    outputs: str  # their folder, within the folder of the batch


def find_recordings(corpus: str | Path, out: str | Path) -> list[Path]:
    """All TOML files with [markers] in a folder and below, but for those of outputs and live runs.

    What is not TOML at all is taken for a recording, whose tracking then says what is wrong.

    Raises:
        InputError: no such folder, or no recording in it.
    """
    corpus, out = (Path(os.path.realpath(path)) for path in (corpus, out))
    if not corpus.is_dir():
        raise InputError(corpus, "no such folder, expected one with recordings")
    there = (path for path in sorted(corpus.rglob("*.toml")) if path.is_file())
    below = out != corpus and out.is_relative_to(corpus)
    recordings = [
        path for path in there if not (below and path.is_relative_to(out)) and _is_recording(path)
    ]
    if not recordings:
        raise InputError(corpus, "found no recording, expected .toml files with [markers]")
    return recordings


def _is_recording(path: Path) -> bool:
    try:
        content = read_toml(path)
    except InputError:
        return True
    # That of a live run says where markers sit, and nothing that only a recording says.
    markers = content.get("markers", {})
    is_live = isinstance(markers, dict) and {"on"} <= set(markers) <= set(LIVE_MARKERS_KEYS)
    return "markers" in content and not is_live


def readable_inputs(recording: Path) -> list[Path]:
    """The recording's file and every file that its fields name; itself alone if it is broken."""
    try:
        return input_files(recording)
    except InputError:
        return [recording]


def fingerprint(recording: Path, options: Mapping[str, Any]) -> str:
    """Of all that the outputs depend on: the inputs' contents, the options, the version."""
    digest = hashlib.sha256(json.dumps([__version__, dict(options)], sort_keys=True).encode())
    for path in filter(Path.is_file, readable_inputs(recording)):
        with path.open("rb") as file:
            content = hashlib.file_digest(file, "sha256").hexdigest()
        digest.update(f"{os.path.relpath(path, recording.parent)} {content} ".encode())
    return digest.hexdigest()


def write_record(folder: Path, mark: str, row: CorpusRow) -> None:
    """Write into the outputs' folder what they were made from, and their row."""
    write_figures({"fingerprint": mark, "row": row}, folder / RECORD_FILE)


def read_record(folder: Path, mark: str) -> CorpusRow | None:
    """The row of outputs that are complete and were made from the same, or None."""
    try:
        record = json.loads(read_bytes(folder / RECORD_FILE))
        if record["fingerprint"] != mark or not OutputFolder(folder, MOTION).is_complete():
            return None
        return CorpusRow(**record["row"])
    except (ValueError, TypeError, KeyError, RecursionError):
        return None


def write_rows(path: Path, rows: Sequence[CorpusRow]) -> None:
    """Write corpus.csv: a line of names, and one line per recording, by path."""
    with replacing(path) as beside, beside.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, [field.name for field in fields(CorpusRow)])
        table.writeheader()
        table.writerows(asdict(row) for row in sorted(rows, key=lambda row: row.recording))
