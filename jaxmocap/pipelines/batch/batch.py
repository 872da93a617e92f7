"""Many recordings, side by side: each is tracked by a process of its own, from its path alone.

    find_recordings ── jobs ── each_done(track_one) ── corpus.csv, failures.json
                               on any machine that reaches the files by the same paths

INPUTS: a folder of recordings. OUTPUTS: a folder per recording as ``track`` writes it, a table of
all of them, and why those that failed did.
"""

import os
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from jaxmocap.body.motion import Motion
from jaxmocap.capture.timeline import Mode
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.output_folder import LIST_NAME, OutputFolder
from jaxmocap.formats.recordings.recording import load_recording
from jaxmocap.hybrid.settings import Settings
from jaxmocap.outputs.report import plain, write_figures
from jaxmocap.pipelines.batch.cluster import cluster_client, results_as_completed
from jaxmocap.pipelines.batch.corpus import (
    RECORD_FILE,
    CorpusRow,
    find_recordings,
    fingerprint,
    read_record,
    readable_inputs,
    write_record,
    write_rows,
)
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.pipelines.progress import Progress, progress_bar
from jaxmocap.pipelines.summary import frames_per_second
from jaxmocap.pipelines.tracking.track import track_both
from jaxmocap.pipelines.writing import tracked_folder, write_tracked

# What a batch writes besides the recordings' own folders.
TABLES = ("corpus.csv", "failures.json")


@dataclass(frozen=True)
class Job:
    """One recording to be tracked; all that is sent to the process that tracks it."""

    name: str  # of the recording within the corpus
    recording: Path  # its file, an absolute path
    folder: Path  # for its outputs, an absolute path
    settings: Settings  # of the tracker
    mode: Mode  # see ``track``
    inputs: tuple[Path, ...] = ()  # all files that are read


@dataclass(frozen=True)
class Batch:
    """The results of a corpus; ``failures`` are recordings and why they failed."""

    rows: list[CorpusRow]
    earlier_count: int
    failures: dict[str, str]
    files: list[Path]

    def text(self) -> str:
        """The same as lines of text."""
        lines = [
            f"tracked  {len(self.rows)} recordings, {self.earlier_count} of them by an earlier run",
            f"failed   {len(self.failures)}",
            *(f"         {name}: {why}" for name, why in sorted(self.failures.items())),
        ]
        return "\n".join([*lines, *(f"written  {path}" for path in self.files)])

    def figures(self) -> dict:
        """The same for JSON."""
        return {
            "tracked": len(self.rows),
            "earlier": self.earlier_count,
            "failures": self.failures,
            "recordings": [asdict(row) for row in self.rows],
            "files": [str(path) for path in self.files],
        }


def track_corpus(
    corpus: str | Path,
    out: str | Path,
    settings: Settings | None = None,
    mode: Mode = "own",
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    timeout_s: float | None = None,
    progress: Progress | bool | None = None,
) -> Batch:
    """Track every recording of a folder; what an earlier run did is not done again.

    The arguments are the options of ``jaxmocap batch``; both tables are written at the end, or when
    it is interrupted.

    Raises:
        InputError: no recordings, no such folder, no scheduler; a folder for outputs that holds
            inputs, or recordings whose outputs would lie within one another.
        OutputError: the tables cannot be written.
    """
    jobs = jobs_of(corpus, out, settings or Settings(), mode)
    folder = OutputFolder(out, "batch", TABLES, [path for job in jobs for path in job.inputs])
    rows: list[CorpusRow] = []
    failures: dict[str, str] = {}
    earlier_count = 0
    most = None if workers is None else min(workers, len(jobs))
    with cluster_client(scheduler, most) as client, progress_bar("recordings", progress) as show:
        try:
            show(0, len(jobs))
            results = results_as_completed(client, track_one, jobs, timeout_s)
            for count, (job, result, problem) in enumerate(results, 1):
                if isinstance(outcome := problem or result, str):
                    failures[job.name] = outcome
                else:
                    row, is_earlier = outcome
                    rows.append(row)
                    earlier_count += is_earlier
                show(count, len(jobs))
        finally:
            # Before the cluster is closed, which may take its time.
            with folder.writing() as stage:
                write_rows(stage / TABLES[0], rows)
                write_figures(dict(sorted(failures.items())), stage / TABLES[1])
    return Batch(rows, earlier_count, failures, [folder.path / name for name in TABLES])


def jobs_of(corpus: str | Path, out: str | Path, settings: Settings, mode: Mode) -> list[Job]:
    """One for each recording.

    Raises:
        InputError: no recordings, or their outputs would lie within one another.
    """
    root, folder = (Path(os.path.realpath(path)) for path in (corpus, out))
    jobs = [
        Job(
            (name := path.relative_to(root)).as_posix(),
            path,
            folder / name.with_suffix(""),
            settings,
            mode,
            tuple(readable_inputs(path)),
        )
        for path in find_recordings(corpus, out)
    ]
    _check_apart(Path(corpus), folder, jobs)
    return jobs


def _check_apart(corpus: Path, out: Path, jobs: list[Job]) -> None:
    """InputError where folders of outputs are the same, or within one another.

    Some file systems do not tell capitals from small letters.
    """
    taken: dict[tuple[str, ...], str] = {(name,): name for name in (*TABLES, LIST_NAME)}
    for job in sorted(jobs, key=lambda job: len(job.folder.parts)):
        parts = tuple(part.casefold() for part in job.folder.relative_to(out).parts)
        for end in range(1, len(parts) + 1):
            if (other := taken.get(parts[:end])) is not None:
                problem = f"the outputs of {other} and {job.name} would lie within one another"
                raise InputError(corpus, f"{problem}, expected names that differ: rename one")
        taken[parts] = job.name


def track_one(job: Job) -> tuple[CorpusRow, bool] | str:
    """Track one recording, unless its outputs are there already.

    The outputs' folder appears complete or not at all.

    Returns:
        Its line of the table, and whether an earlier run had tracked it; or why it failed.
    """
    try:
        mark = fingerprint(job.recording, plain({"settings": job.settings, "mode": job.mode}))
        if earlier := read_record(job.folder, mark):
            return replace(earlier, recording=job.name), True
        began = perf_counter()
        keep_compiled()
        recording = load_recording(job.recording)
        folder = tracked_folder(job.folder, recording, [RECORD_FILE])
        motion, _, recording = track_both(recording, job.settings, mode=job.mode, progress=False)
        with folder.writing() as stage:
            write_tracked(motion, recording, stage, job.settings, progress=False)
            row = row_of(job, motion, perf_counter() - began)
            write_record(stage, mark, row)
        return row, False
    except (InputError, OSError) as error:
        return str(error)
    except Exception as error:  # whatever it is, the others are to go on
        return f"{type(error).__name__}: {error}"


def row_of(job: Job, motion: Motion, took_s: float) -> CorpusRow:
    """A tracked recording's line of the table."""
    report = motion.report
    assert report is not None
    # Frame by frame and without video nothing states how sure elbows are.
    is_stated = job.settings.smooth or bool(report.run.video_frames)
    deviations = report.elbow_deviations if is_stated else np.full((1, 2), np.nan)
    finite = deviations[np.isfinite(deviations).all(1)]
    left, right = np.median(finite, axis=0) if len(finite) else (np.nan, np.nan)
    return CorpusRow(
        recording=job.name,
        frames=len(motion.times),
        seconds=round(float(motion.times[-1] - motion.times[0]), 6),
        ms_per_frame=_figure(1e3 / frames_per_second(report)),
        took_s=round(took_s, 3),
        deviation_left_m=_figure(left),
        deviation_right_m=_figure(right),
        missing=round(float(np.isnan(report.marker_errors).mean()), 6),
        outputs=Path(job.name).with_suffix("").as_posix(),
    )


def _figure(value: Any) -> float | None:
    """To four digits after the point; None for NaN."""
    return round(float(value), 4) if np.isfinite(value) else None
