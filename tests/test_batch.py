"""A corpus, tracked by several processes: what fails, what is kept, what the table says."""

import csv
import json
import os
import shutil
import signal
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict, replace
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import dask
import distributed
import numpy as np
import pytest
from small_recording import SAMPLES, write_small_recording

from jaxmocap.body.motion import Motion
from jaxmocap.cli import main
from jaxmocap.formats.errors import InputError
from jaxmocap.formats.npz import load_motion
from jaxmocap.outputs.report import write_report
from jaxmocap.run import batch, cluster, corpus
from jaxmocap.run.batch import Job, Wanted, jobs_of, row_of, track_corpus, track_one
from jaxmocap.run.corpus import find_recordings, fingerprint, inputs_of

MARKERS_ONLY = Wanted(refine="none")
BROKEN = "broken/recording.toml"
OUTPUTS = {"joints.trc", "motion.npz", "report.json", "recording.rrd", "batch.json"}


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    """A small recording's folder."""
    folder = tmp_path_factory.mktemp("small")
    write_small_recording(folder)
    return folder


@pytest.fixture
def whole(recording, tmp_path) -> Path:
    """A corpus of three: one below another, one whose markers are no markers."""
    for name in ("one", "deeper/two", "broken"):
        shutil.copytree(recording, tmp_path / "corpus" / name)
    (tmp_path / "corpus" / "broken" / "markers.trc").write_text("nothing")
    return tmp_path / "corpus"


class Ran(NamedTuple):
    """What the command left and said."""

    out: Path
    code: int
    printed: str
    said: str


@pytest.fixture(scope="module")
def ran(recording, tmp_path_factory) -> Ran:
    """The command, with one process, on one recording without video and on a broken one."""
    folder = tmp_path_factory.mktemp("ran")
    for name in ("one", "broken"):
        shutil.copytree(recording, folder / "corpus" / name)
    text = (recording / "recording.toml").read_text()
    video = text[text.index("[[video]]") : text.index("[calibration]")]
    (folder / "corpus" / "one" / "recording.toml").write_text(text.replace(video, ""))
    (folder / "corpus" / "broken" / "markers.trc").write_text("nothing")
    arguments = ["batch", str(folder / "corpus"), "--out", str(folder / "out")]
    with redirect_stdout(StringIO()) as printed, redirect_stderr(StringIO()) as said:
        code = main([*arguments, "--refine", "none", "--workers", "1", "--json", "-"])
    return Ran(folder / "out", code, printed.getvalue(), said.getvalue())


@pytest.fixture(scope="module")
def tracked(ran) -> Motion:
    return load_motion(ran.out / "one/recording/motion.npz")


@pytest.fixture
def here(monkeypatch, tracked):
    """Jobs are done in this process, by a tracker that tells the same of all."""

    def each_done(client, function, jobs):
        for job in jobs:
            yield cluster.Done(job, function(job), None)

    def written(motion, recording, folder, settings):
        write_report(folder / "report.json", motion)

    class Nobody:
        def __init__(self, scheduler, workers): ...
        def __enter__(self): ...
        def __exit__(self, *problem): ...

    monkeypatch.setattr(batch, "connected", Nobody)
    monkeypatch.setattr(batch, "each_done", each_done)
    monkeypatch.setattr(batch, "track", lambda recording, settings, mode: tracked)
    monkeypatch.setattr(batch, "write_outputs", written)


def table(out: Path) -> list[dict[str, str]]:
    with (out / "corpus.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def failures(out: Path) -> dict[str, str]:
    return json.loads((out / "failures.json").read_text())


# With processes ----------------------------------------------------------------------------------


def dies_or_answers(number: int) -> int:
    """Dies at 0, as a process does that is ended for want of memory."""
    if not number:
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def test_one_failure_leaves_the_others_and_is_told(ran):
    assert ran.code == 0
    assert list(failures(ran.out)) == [BROKEN] and "markers.trc" in failures(ran.out)[BROKEN]
    assert [row["recording"] for row in table(ran.out)] == ["one/recording.toml"]
    figures = json.loads(ran.printed)
    assert figures["tracked"] == 1 and figures["earlier"] == 0
    assert "recordings: 100%" in ran.said and f"{BROKEN}: " in ran.said
    assert {path.name for path in (ran.out / "one/recording").iterdir()} >= OUTPUTS
    assert [path.name for path in ran.out.iterdir() if path.is_dir()] == ["one"]


def test_a_cluster_is_used_by_its_address_and_goes_on_when_a_process_dies(whole, tmp_path):
    jobs = jobs_of(whole, tmp_path / "out", MARKERS_ONLY)
    with (
        dask.config.set(cluster.OWN | {"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(n_workers=1, **cluster.HERE) as elsewhere,
        cluster.connected(elsewhere.scheduler_address, None) as client,
    ):
        answers = {done.job: done for done in cluster.each_done(client, dies_or_answers, range(4))}
        (broken,) = cluster.each_done(client, track_one, jobs[:1])
    assert [answers[number].result for number in range(4)] == [None, 2, 4, 6]
    assert "its process died" in answers[0].problem and answers[1].problem is None
    assert broken.job.name == BROKEN and "markers.trc" in broken.result.problem


def test_a_scheduler_that_is_not_there_is_bad_input(monkeypatch):
    monkeypatch.setattr(cluster, "PATIENCE_S", 0.2)
    for address in ("tcp://127.0.0.1:9", "nonsense://"):
        with pytest.raises(InputError, match="no scheduler answers"):
            cluster.connected(address, None).__enter__()


# One after the other -----------------------------------------------------------------------------


def test_what_an_earlier_run_did_is_not_done_again(whole, tmp_path, here):
    out = tmp_path / "out"
    first = track_corpus(whole, out, MARKERS_ONLY)
    assert (len(first.rows), first.earlier, list(first.failures)) == (2, 0, [BROKEN])
    shutil.copy(whole / "one" / "markers.trc", whole / "broken" / "markers.trc")
    written = (out / "one/recording/report.json").stat().st_mtime_ns
    again = track_corpus(whole, out, MARKERS_ONLY)
    assert (len(again.rows), again.earlier, again.failures) == (3, 2, {})
    assert (out / "one/recording/report.json").stat().st_mtime_ns == written
    assert {row.recording: row for row in first.rows}.items() <= {
        row.recording: row for row in again.rows
    }.items()
    assert failures(out) == {}


def test_interrupted_it_tells_what_is_done_and_goes_on_there(whole, tmp_path, here, monkeypatch):
    own = batch.each_done

    def interrupted(client, function, jobs):
        yield next(own(client, function, jobs[1:]))
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(batch, "each_done", interrupted)
        track_corpus(whole, tmp_path, MARKERS_ONLY)
    assert [row["recording"] for row in table(tmp_path)] == ["deeper/two/recording.toml"]
    assert track_corpus(whole, tmp_path, MARKERS_ONLY).earlier == 1


def test_a_row_says_how_long_how_good_and_what_is_missing(tmp_path, tracked):
    report = tracked.report
    errors, confidence = report.marker_errors.copy(), np.full((SAMPLES, 2), np.nan)
    errors[3, 1], confidence[4:7] = np.nan, [[0.2, 0.5], [0.3, 0.6], [0.9, 0.7]]
    # Frames of which only some fall on a sample.
    spent = report.milliseconds | {"observe": np.ones(5), "frame": np.array([2.0, 4.0, 9.0])}
    told = replace(report, marker_errors=errors, confidence=confidence, milliseconds=spent)
    job = Job("a/b.toml", tmp_path / "a/b.toml", tmp_path / "out/a/b", MARKERS_ONLY)
    row = row_of(job, replace(tracked, report=told), 1.5)
    expected = corpus.Row(
        "a/b.toml", SAMPLES, 0.383333, 4.0, 1.5, 0.3, 0.6, round(1 / SAMPLES / 5, 6), "a/b"
    )
    assert row == expected
    unseen = row_of(job, tracked, 1.5)
    assert unseen.confidence_left is unseen.confidence_right is None and unseen.missing == 0
    corpus.write_rows(tmp_path / "corpus.csv", [unseen, row])
    first, second = table(tmp_path)
    assert list(first) == list(asdict(row)) and first["confidence_left"] == ""
    assert second["confidence_left"] == "0.3" and int(second["frames"]) == SAMPLES


# What counts as done -----------------------------------------------------------------------------


def done_before(folder: Path, mark: str) -> bool:
    return corpus.kept(folder, mark) is not None


def test_outputs_that_are_not_whole_or_of_something_else_do_not_count(tmp_path):
    row = corpus.Row("a.toml", 3, 0.1, 2.0, 1.0, None, 0.5, 0.0, "a")
    (tmp_path / "report.json").write_text("{}")
    corpus.keep(tmp_path, "mark", row)
    assert corpus.kept(tmp_path, "mark") == row
    assert not done_before(tmp_path, "other")
    (tmp_path / "report.json").write_text('{"frames": 3')
    assert not done_before(tmp_path, "mark")
    (tmp_path / "report.json").unlink()
    assert not done_before(tmp_path, "mark")


@pytest.mark.parametrize("changed", ["markers.trc", "cam.mp4", "calibration.toml", "told"])
def test_other_inputs_and_settings_are_something_else(recording, tmp_path, changed):
    folder = shutil.copytree(recording, tmp_path / "copy")
    path, told = folder / "recording.toml", asdict(MARKERS_ONLY)
    before = fingerprint(path, told)
    assert fingerprint(recording / "recording.toml", told) == before
    if changed == "told":
        told["mode"] = "causal"
    else:
        (folder / changed).write_bytes((folder / changed).read_bytes() + b" ")
    assert fingerprint(path, told) != before


def test_inputs_are_what_the_files_name_wherever_it_lies(tmp_path):
    (tmp_path / "points").mkdir()
    for name in ("m.trc", "static.trc", "points/1.json", "unnamed.trc"):
        (tmp_path / name).write_text(name)
    (tmp_path / "subject.toml").write_text('static = "static.trc"\nup = "z"\n')
    path = tmp_path / "recording.toml"
    path.write_text(
        '[markers]\nfile = "m.trc"\n[subject]\nfile = "subject.toml"\n'
        '[[video]]\nkeypoints = "points"\nfile = "gone.mp4"\n'
    )
    assert [each.relative_to(tmp_path).as_posix() for each in inputs_of(path)] == [
        "m.trc", "points/1.json", "recording.toml", "static.trc", "subject.toml",
    ]  # fmt: skip


def test_recordings_are_toml_files_with_markers_at_any_depth(tmp_path):
    for name in ("b/recording.toml", "a.toml", "out/x/recording.toml", "b/other.toml", "no.toml"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("[markers]" if name != "no.toml" else "[camera]")
    (tmp_path / "damaged.toml").write_text("[markers")
    found = [
        path.relative_to(tmp_path.resolve()).as_posix()
        for path in find_recordings(tmp_path, tmp_path / "out")
    ]
    assert found == ["a.toml", "b/other.toml", "b/recording.toml", "damaged.toml"]
    folders = [
        job.folder.relative_to(tmp_path.resolve() / "out").as_posix()
        for job in jobs_of(tmp_path, tmp_path / "out", MARKERS_ONLY)
    ]
    assert folders == ["a", "b/other", "b/recording", "damaged"]


def test_a_corpus_without_recordings_is_bad_input(tmp_path):
    with pytest.raises(InputError, match="found no recording, expected"):
        find_recordings(tmp_path, tmp_path / "out")
    with pytest.raises(InputError, match="no such folder"):
        find_recordings(tmp_path / "none", tmp_path / "out")
