"""A corpus, tracked by several processes: what fails, what is kept, what the table says."""

import csv
import json
import os
import shutil
import signal
import time
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import asdict, replace
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import dask
import distributed
import numpy as np
import pytest
from conftest import complaint
from small_recording import SAMPLES, write_small_recording

from jaxmocap.body.motion import Motion
from jaxmocap.body.skeleton import ELBOWS
from jaxmocap.cli.program import main
from jaxmocap.formats.files.output_folder import OutputFolder
from jaxmocap.formats.motion_npz import load_motion
from jaxmocap.hybrid.settings import Settings
from jaxmocap.outputs.report import plain, summarise, write_figures
from jaxmocap.pipelines.batch import batch, cluster, corpus
from jaxmocap.pipelines.batch.batch import Job, jobs_of, row_of, track_corpus, track_one
from jaxmocap.pipelines.batch.corpus import find_recordings, fingerprint, readable_inputs

MARKERS_ONLY = Settings(refine="none")
BROKEN = "broken/recording.toml"
OUTPUTS = {"joints.trc", "motion.npz", "report.json", "recording.rrd", "batch.json", "outputs.json"}


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    """A small recording's folder."""
    folder = tmp_path_factory.mktemp("small")
    write_small_recording(folder)
    return folder


@pytest.fixture
def finished_run(recording, tmp_path) -> Path:
    """A corpus of three: one below another, one whose markers are no markers."""
    for name in ("one", "deeper/two", "broken"):
        shutil.copytree(recording, tmp_path / "corpus" / name)
    (tmp_path / "corpus" / "broken" / "markers.trc").write_text("nothing")
    return tmp_path / "corpus"


class Ran(NamedTuple):
    """What the command wrote and printed."""

    out: Path
    code: int
    printed: str
    stderr: str


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
    with redirect_stdout(StringIO()) as printed, redirect_stderr(StringIO()) as stderr:
        code = main([*arguments, "--refine", "none", "--workers", "1", "--json", "-"])
    return Ran(folder / "out", code, printed.getvalue(), stderr.getvalue())


@pytest.fixture(scope="module")
def tracked(ran) -> Motion:
    return load_motion(ran.out / "one/recording/motion.npz")


@pytest.fixture
def here(monkeypatch, tracked):
    """Jobs are done in this process, by a tracker that tells the same of all."""

    def each_done(client, function, jobs, timeout_s):
        for job in jobs:
            yield job, function(job), None

    def written(motion, recording, folder, settings, progress):
        write_figures(summarise(motion), folder / "report.json")

    class Nobody:
        def __init__(self, scheduler, workers): ...
        def __enter__(self): ...
        def __exit__(self, *problem): ...

    monkeypatch.setattr(batch, "cluster_client", Nobody)
    monkeypatch.setattr(batch, "results_as_completed", each_done)
    monkeypatch.setattr(
        batch, "track_both", lambda recording, *_, **__: (tracked, tracked, recording)
    )
    monkeypatch.setattr(batch, "write_tracked", written)


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


def test_one_failure_leaves_the_others_and_is_reported(ran):
    assert ran.code == 1 and ran.stderr.endswith("jaxmocap batch: 1 recordings failed\n")
    assert list(failures(ran.out)) == [BROKEN] and "markers.trc" in failures(ran.out)[BROKEN]
    assert [row["recording"] for row in table(ran.out)] == ["one/recording.toml"]
    figures = json.loads(ran.printed)
    assert figures["tracked"] == 1 and figures["earlier"] == 0
    assert "recordings: 100%" in ran.stderr and f"{BROKEN}: " in ran.stderr
    assert {path.name for path in (ran.out / "one/recording").iterdir()} >= OUTPUTS
    assert [path.name for path in ran.out.iterdir() if path.is_dir()] == ["one"]


def test_a_cluster_is_used_by_its_address_and_goes_on_when_a_process_dies(finished_run, tmp_path):
    jobs = jobs_of(finished_run, tmp_path / "out", MARKERS_ONLY, "own")
    with (
        dask.config.set(cluster.CLUSTER_CONFIG | {"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(n_workers=1, **cluster.LOCAL_CLUSTER) as elsewhere,
        cluster.cluster_client(elsewhere.scheduler_address, None) as client,
    ):
        answers = {
            number: done
            for number, *done in cluster.results_as_completed(client, dies_or_answers, range(4))
        }
        ((broken, why, _),) = cluster.results_as_completed(client, track_one, jobs[:1])
    assert [answers[number] for number in range(1, 4)] == [[2, None], [4, None], [6, None]]
    assert answers[0][0] is None and "its process died" in answers[0][1]
    assert broken.name == BROKEN and "markers.trc" in why


def test_a_scheduler_that_is_not_there_is_bad_input(monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT_S", 0.2)
    for address in ("tcp://127.0.0.1:9", "nonsense://"):
        assert "no scheduler answers" in complaint(cluster.cluster_client(address, None).__enter__)


def test_a_job_that_does_not_come_back_is_ended_and_the_others_are_done():
    # Its own code goes to the worker, which need not import this file in its time.
    def sleeps_or_answers(number: int) -> int:
        if not number:
            time.sleep(600)
        return 2 * number

    with cluster.cluster_client(None, 1) as client:
        jobs = cluster.results_as_completed(client, sleeps_or_answers, range(3), timeout_s=6.0)
        answers = {number: done for number, *done in jobs}
    took = "took longer than 6 s (--job-timeout)"
    assert answers == {0: [None, took], 1: [2, None], 2: [4, None]}


# What is never lost ------------------------------------------------------------------------------


def files_of(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def test_a_batch_into_its_own_inputs_is_refused_and_nothing_is_lost(recording, tmp_path, refusal):
    corpus_folder = tmp_path / "corpus"
    shutil.copytree(recording, corpus_folder / "walk")
    (corpus_folder / "walk.toml").write_text(
        (recording / "recording.toml").read_text().replace('file = "', 'file = "walk/')
    )
    (corpus_folder / "walk" / "recording.toml").unlink()
    before = files_of(tmp_path)
    for out in (corpus_folder, tmp_path, corpus_folder / "walk"):
        stderr = refusal("batch", corpus_folder, "--out", out)
        assert "which is read; expected a folder of its own" in stderr
    assert files_of(tmp_path) == before


@pytest.mark.parametrize(
    "names", [("walk.toml", "walk/run.toml"), ("Walk.toml", "walk.toml"), ("corpus.csv.toml",)]
)
def test_recordings_whose_outputs_would_lie_in_one_another_are_refused(names, tmp_path, refusal):
    for name in names:
        path = tmp_path / "corpus" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("[markers]")
    stderr = refusal("batch", tmp_path / "corpus", "--out", tmp_path / "out")
    assert "would lie within one another" in stderr and names[0] in stderr
    assert not (tmp_path / "out").exists()


def test_a_foreign_file_in_an_output_folder_stays(finished_run, tmp_path, here):
    notes = tmp_path / "out/one/recording/notes.txt"
    notes.parent.mkdir(parents=True)
    notes.write_text("mine")
    track_corpus(finished_run, tmp_path / "out", MARKERS_ONLY)
    (finished_run / "one" / "markers.trc").write_text(
        (finished_run / "one/markers.trc").read_text() + "\n"
    )
    assert track_corpus(finished_run, tmp_path / "out", MARKERS_ONLY).earlier_count == 1
    assert notes.read_text() == "mine"


def test_an_output_that_was_edited_is_not_replaced_but_reported(finished_run, tmp_path, here):
    track_corpus(finished_run, tmp_path / "out", MARKERS_ONLY)
    edited = tmp_path / "out/one/recording/report.json"
    edited.write_text("mine")
    actual = track_corpus(finished_run, tmp_path / "out", MARKERS_ONLY)
    assert "has changed since an earlier run wrote it" in actual.failures["one/recording.toml"]
    assert edited.read_text() == "mine" and actual.earlier_count == 1


def test_what_is_no_file_fails_alone(recording, tmp_path, here):
    corpus_folder = tmp_path / "corpus"
    for name in ("good", "pipe", "device", "folder"):
        shutil.copytree(recording, corpus_folder / name)
    (corpus_folder / "pipe/cam.mp4").unlink()
    os.mkfifo(corpus_folder / "pipe/cam.mp4")
    for name, old, new in (
        ("device", 'file = "cam.mp4"', 'file = "/dev/zero"'),
        ("folder", 'camera = "cam"', 'camera = "cam"\nkeypoints = "/"'),
    ):
        path = corpus_folder / name / "recording.toml"
        path.write_text(path.read_text().replace(old, new))
    actual = track_corpus(corpus_folder, tmp_path / "out")
    assert "good/recording.toml" in {row.recording for row in actual.rows}
    assert {"pipe/recording.toml", "device/recording.toml"} <= set(actual.failures)


# One after the other -----------------------------------------------------------------------------


def test_what_an_earlier_run_did_is_not_done_again(finished_run, tmp_path, here):
    out = tmp_path / "out"
    first = track_corpus(finished_run, out, MARKERS_ONLY)
    assert (len(first.rows), first.earlier_count, list(first.failures)) == (2, 0, [BROKEN])
    shutil.copy(finished_run / "one" / "markers.trc", finished_run / "broken" / "markers.trc")
    written = (out / "one/recording/report.json").stat().st_mtime_ns
    again = track_corpus(finished_run, out, MARKERS_ONLY)
    assert (len(again.rows), again.earlier_count, again.failures) == (3, 2, {})
    assert (out / "one/recording/report.json").stat().st_mtime_ns == written
    assert {row.recording: row for row in first.rows}.items() <= {
        row.recording: row for row in again.rows
    }.items()
    assert failures(out) == {}


def test_interrupted_it_tells_what_is_done_and_goes_on_there(
    finished_run, tmp_path, here, monkeypatch
):
    own = batch.results_as_completed

    def interrupted(client, function, jobs, timeout_s):
        yield next(own(client, function, jobs[1:], timeout_s))
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(batch, "results_as_completed", interrupted)
        track_corpus(finished_run, tmp_path / "out", MARKERS_ONLY)
    assert [row["recording"] for row in table(tmp_path / "out")] == ["deeper/two/recording.toml"]
    assert track_corpus(finished_run, tmp_path / "out", MARKERS_ONLY).earlier_count == 1


def test_a_row_says_how_long_how_good_and_what_is_missing(tmp_path, tracked):
    report = tracked.report
    errors, deviations = report.marker_errors.copy(), np.full_like(report.landmarks_std, np.nan)
    errors[3, 1], deviations[4:7] = np.nan, 0.0
    deviations[4:7, ELBOWS, 0] = [[0.2, 0.5], [0.3, 0.6], [0.9, 0.7]]
    # Frames of which only some fall on a sample.
    spent = report.milliseconds | {"frame": np.array([2.0, 4.0, 9.0])}
    run = replace(report.run, video_frames=3, seconds={"first pass": 0.012})
    changed_report = replace(
        report,
        marker_errors=errors,
        landmarks_std=deviations,
        milliseconds=spent,
        run=run,
    )
    job = Job("a/b.toml", tmp_path / "a/b.toml", tmp_path / "out/a/b", MARKERS_ONLY, "own")
    row = row_of(job, replace(tracked, report=changed_report), 1.5)
    expected = corpus.CorpusRow(
        "a/b.toml", SAMPLES, 0.383333, 4.0, 1.5, 0.3, 0.6, round(1 / SAMPLES / 5, 6), "a/b"
    )
    assert row == expected
    smoothed = row_of(job, tracked, 1.5)
    assert 0 < smoothed.deviation_left_m < 1 and 0 < smoothed.deviation_right_m < 1
    unseen = row_of(replace(job, settings=replace(MARKERS_ONLY, smooth=False)), tracked, 1.5)
    assert unseen.deviation_left_m is unseen.deviation_right_m is None and unseen.missing == 0
    corpus.write_rows(tmp_path / "corpus.csv", [unseen, row])
    first, second = table(tmp_path)
    assert list(first) == list(asdict(row)) and first["deviation_left_m"] == ""
    assert second["deviation_left_m"] == "0.3" and int(second["frames"]) == SAMPLES


# What counts as done -----------------------------------------------------------------------------


def done_before(folder: Path, mark: str) -> bool:
    return corpus.read_record(folder, mark) is not None


def test_outputs_that_are_not_whole_or_of_something_else_do_not_count(tmp_path):
    row = corpus.CorpusRow("a.toml", 3, 0.1, 2.0, 1.0, None, 0.5, 0.0, "a")
    with OutputFolder(tmp_path, "motion").writing() as stage:
        (stage / "report.json").write_text("{}")
        corpus.write_record(stage, "mark", row)
    assert corpus.read_record(tmp_path, "mark") == row
    assert not done_before(tmp_path, "other")
    (tmp_path / "report.json").write_text('{"frames": 3')
    assert not done_before(tmp_path, "mark")
    (tmp_path / "report.json").unlink()
    assert not done_before(tmp_path, "mark")


@pytest.mark.parametrize("changed", ["markers.trc", "cam.mp4", "calibration.toml", "options"])
def test_other_inputs_and_settings_are_something_else(recording, tmp_path, changed):
    folder = shutil.copytree(recording, tmp_path / "copy")
    path, options = folder / "recording.toml", {"settings": plain(MARKERS_ONLY), "mode": "own"}
    before = fingerprint(path, options)
    assert fingerprint(recording / "recording.toml", options) == before
    if changed == "options":
        options["mode"] = "causal"
    else:
        (folder / changed).write_bytes((folder / changed).read_bytes() + b" ")
    assert fingerprint(path, options) != before


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
    assert [each.relative_to(tmp_path).as_posix() for each in readable_inputs(path)] == [
        "gone.mp4", "m.trc", "points/1.json", "recording.toml", "static.trc", "subject.toml",
    ]  # fmt: skip


def test_recordings_are_toml_files_with_markers_at_any_depth(tmp_path):
    for name in ("b/recording.toml", "a.toml", "out/x/recording.toml", "b/other.toml", "no.toml"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("[markers]" if name != "no.toml" else "[camera]")
    (tmp_path / "damaged.toml").write_text("[markers")
    live = '[markers.on]\nHmd = { bone = "head" }\n[vmc]\nsend = "127.0.0.1:39539"\n'
    (tmp_path / "b" / "live.toml").write_text(live)
    # A recording, if a wrong one.
    (tmp_path / "misspelt.toml").write_text('[markers]\nfiel = "a.trc"\n' + live)
    actual = [
        path.relative_to(tmp_path.resolve()).as_posix()
        for path in find_recordings(tmp_path, tmp_path / "out")
    ]
    found = ["a", "b/other", "b/recording", "damaged", "misspelt"]
    assert actual == [f"{name}.toml" for name in found]
    folders = [
        job.folder.relative_to(tmp_path.resolve() / "out").as_posix()
        for job in jobs_of(tmp_path, tmp_path / "out", MARKERS_ONLY, "own")
    ]
    assert folders == found


def test_a_corpus_without_recordings_is_bad_input(tmp_path):
    assert "found no recording, expected" in complaint(find_recordings, tmp_path, tmp_path / "out")
    assert "no such folder" in complaint(find_recordings, tmp_path / "none", tmp_path / "out")
