"""Many recordings, side by side: each is tracked by a process of its own, from its path alone.

    find_recordings ── jobs ── each_done(track_one) ── corpus.csv, failures.json
                               on any machine that reaches the files by the same paths

INPUTS: a folder of recordings. OUTPUTS: a folder per recording as ``track`` writes it, a table of
all of them, and why those that failed did.
"""

import shutil
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any, Literal, NamedTuple

import numpy as np

from jaxmocap.body.motion import Motion
from jaxmocap.capture.timeline import Mode
from jaxmocap.formats.errors import InputError
from jaxmocap.formats.recording import load_recording
from jaxmocap.run.cluster import connected, each_done
from jaxmocap.run.compilation import keep_compiled
from jaxmocap.run.corpus import (
    Row,
    find_recordings,
    fingerprint,
    keep,
    kept,
    write_failures,
    write_rows,
)
from jaxmocap.run.recording import choose_settings, track
from jaxmocap.run.summary import frames_per_second
from jaxmocap.run.timing import Progress, progress_bar
from jaxmocap.run.writing import check_folder, make_folder, write_outputs


@dataclass(frozen=True)
class Wanted:
    """How recordings are to be tracked, in the words of ``track``."""

    refine: Literal["simplex", "gradient", "none"] = "simplex"
    mode: Mode = "own"
    paper: bool = False


@dataclass(frozen=True)
class Job:
    """One recording to be tracked; all that is sent to whoever does it.

    Attributes:
        name: of the recording within the corpus.
        recording: its file, an absolute path.
        folder: for its outputs, an absolute path.
        wanted: how.
    """

    name: str
    recording: Path
    folder: Path
    wanted: Wanted


class Outcome(NamedTuple):
    """What came of a job.

    Attributes:
        row: of the table, or None.
        earlier: whether an earlier run had done it already.
        problem: why there is no row, or None.
    """

    row: Row | None
    earlier: bool = False
    problem: str | None = None


@dataclass(frozen=True)
class Batch:
    """What came of a corpus.

    Attributes:
        rows: of the recordings tracked.
        earlier: how many of them an earlier run had tracked.
        failures: recording -> reason.
        files: that were written besides the recordings' own.
    """

    rows: list[Row]
    earlier: int
    failures: dict[str, str]
    files: list[Path]

    def text(self) -> str:
        """A few lines to read."""
        lines = [
            f"tracked  {len(self.rows)} recordings, {self.earlier} of them by an earlier run",
            f"failed   {len(self.failures)}",
            *(f"         {name}: {why}" for name, why in sorted(self.failures.items())),
        ]
        return "\n".join([*lines, *(f"written  {path}" for path in self.files)])

    def figures(self) -> dict:
        """What JSON takes."""
        return {
            "tracked": len(self.rows),
            "earlier": self.earlier,
            "failures": self.failures,
            "recordings": [asdict(row) for row in self.rows],
        }


def track_corpus(
    corpus: str | Path,
    out: str | Path,
    wanted: Wanted | None = None,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Progress | bool | None = None,
) -> Batch:
    """Track every recording of a folder; what an earlier run did is not done again.

    Args:
        corpus: folder; recordings are found at any depth.
        out: gets a folder for each, named as the recording is, and both tables; these are written
            when all are done, or when it is interrupted.
        wanted: how to track; defaults to ``track``'s way.
        scheduler: address of a Dask cluster whose machines reach both folders by the same paths,
            or None for processes here.
        workers: processes here; defaults to one per core.
        progress: called with the recordings done and their total; True shows a bar on stderr.

    Raises:
        InputError: no recordings, no such folder, no scheduler.
    """
    check_folder(out)
    jobs = jobs_of(corpus, out, wanted or Wanted())
    folder = make_folder(out)
    batch = Batch([], 0, {}, [folder / "corpus.csv", folder / "failures.json"])
    most = None if workers is None else min(workers, len(jobs))
    try:
        with connected(scheduler, most) as client, progress_bar("recordings", progress) as show:
            show(0, len(jobs))
            for count, done in enumerate(each_done(client, track_one, jobs), 1):
                outcome = done.result or Outcome(None, problem=done.problem)
                batch = _with(batch, done.job.name, outcome)
                show(count, len(jobs))
    finally:
        write_rows(batch.files[0], batch.rows)
        write_failures(batch.files[1], batch.failures)
    return batch


def jobs_of(corpus: str | Path, out: str | Path, wanted: Wanted) -> list[Job]:
    """One for each recording."""
    root, folder = Path(corpus).resolve(), Path(out).resolve()
    return [
        Job(
            (name := path.relative_to(root)).as_posix(), path, folder / name.with_suffix(""), wanted
        )
        for path in find_recordings(corpus, out)
    ]


def _with(batch: Batch, name: str, outcome: Outcome) -> Batch:
    if outcome.row is None:
        return replace(batch, failures=batch.failures | {name: str(outcome.problem)})
    rows, earlier = [*batch.rows, outcome.row], batch.earlier + outcome.earlier
    return replace(batch, rows=rows, earlier=earlier)


def track_one(job: Job) -> Outcome:
    """Track one recording, unless its outputs are there already; says so where it cannot.

    The outputs' folder appears whole or not at all.
    """
    try:
        mark = fingerprint(job.recording, asdict(job.wanted))
        if earlier := kept(job.folder, mark):
            return Outcome(replace(earlier, recording=job.name), earlier=True)
        return Outcome(_tracked(job, mark))
    except (InputError, OSError) as error:
        return Outcome(None, problem=str(error))
    except Exception as error:  # whatever it is, the others are to go on
        return Outcome(None, problem=f"{type(error).__name__}: {error}")


def _tracked(job: Job, mark: str) -> Row:
    """Track and write everything beside the folder, then move it into place."""
    began = perf_counter()
    keep_compiled()
    beside = job.folder.with_name(f".{job.folder.name}.part")
    shutil.rmtree(beside, ignore_errors=True)
    recording = load_recording(job.recording)
    settings = choose_settings(job.wanted.refine, job.wanted.paper)
    motion = track(recording, settings, mode=job.wanted.mode)
    write_outputs(motion, recording, beside, settings)
    row = row_of(job, motion, perf_counter() - began)
    keep(beside, mark, row)
    shutil.rmtree(job.folder, ignore_errors=True)
    beside.rename(job.folder)
    return row


def row_of(job: Job, motion: Motion, took_s: float) -> Row:
    """A tracked recording's line of the table."""
    report = motion.report
    assert report is not None
    # Frames need not fall on a sample to have been looked at.
    told = report.confidence if "observe" in report.milliseconds else np.full((1, 2), np.nan)
    known = told[np.isfinite(told).all(1)]
    left, right = np.median(known, axis=0) if len(known) else (np.nan, np.nan)
    return Row(
        recording=job.name,
        frames=len(motion.times),
        seconds=round(float(motion.times[-1] - motion.times[0]), 6),
        ms_per_frame=_figure(1e3 / frames_per_second(report)),
        took_s=round(took_s, 3),
        confidence_left=_figure(left),
        confidence_right=_figure(right),
        missing=round(float(np.isnan(report.marker_errors).mean()), 6),
        outputs=Path(job.name).with_suffix("").as_posix(),
    )


def _figure(value: Any) -> float | None:
    """To four digits after the point; None for NaN."""
    return round(float(value), 4) if np.isfinite(value) else None
