"""Folders of outputs: what a run replaces, what it never touches, and what a kill leaves."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import complaint, disk_full_at

from jaxmocap.cli.program import main
from jaxmocap.formats.files import writing
from jaxmocap.formats.files.errors import InputError, OutputError
from jaxmocap.formats.files.output_folder import LIST_NAME, OutputFolder, read_list
from jaxmocap.formats.files.writing import check_target, replacing, temporary_beside, write_text


def write(folder: Path, kind: str = "motion", names=(), **files: str) -> None:
    """One run that writes so many files."""
    with OutputFolder(folder, kind, names).writing() as stage:
        for name, text in files.items():
            (stage / name).write_text(text)


def texts(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir() if path.name != LIST_NAME}


def test_a_run_replaces_its_own_files_and_removes_those_that_it_no_longer_has(tmp_path):
    write(tmp_path, joints="1", overlay="1")
    write(tmp_path, joints="2")
    assert texts(tmp_path) == {"joints": "2"}
    assert list(json.loads((tmp_path / LIST_NAME).read_text())["files"]) == ["joints"]


def test_what_an_earlier_run_wrote_stays_until_the_last_write(tmp_path):
    """Numbers move into place before pictures are drawn: a kill in between loses no picture."""
    write(tmp_path, joints="1", overlay="1", old="1")
    folder = OutputFolder(tmp_path, "motion")
    with folder.writing(more_follows=True) as stage:
        (stage / "joints").write_text("2")
    assert texts(tmp_path) == {"joints": "2", "overlay": "1", "old": "1"}
    assert set(read_list(tmp_path)) == {"joints", "overlay", "old"}
    with folder.writing() as stage:
        (stage / "overlay").write_text("2")
    assert texts(tmp_path) == {"joints": "2", "overlay": "2"}
    assert set(read_list(tmp_path)) == {"joints", "overlay"}


def test_another_kind_of_run_in_the_same_folder_keeps_its_files(tmp_path):
    write(tmp_path, kind="pictures of cam_01", corners="1")
    write(tmp_path, kind="motion", joints="2")
    assert texts(tmp_path) == {"corners": "1", "joints": "2"}


def test_names_that_a_run_may_write_go_whoever_wrote_them(tmp_path):
    write(tmp_path, kind="refused photograph", front_refused="picture")
    write(tmp_path, kind="model", names=["front_refused"], model="1")
    assert texts(tmp_path) == {"model": "1"}


def test_a_foreign_file_is_neither_removed_nor_replaced(tmp_path):
    (tmp_path / "notes").write_text("mine")
    write(tmp_path, joints="1")
    write(tmp_path, joints="2")
    assert texts(tmp_path) == {"joints": "2", "notes": "mine"}
    with pytest.raises(InputError, match="notes: is there and no earlier run wrote it"):
        OutputFolder(tmp_path, "motion", ["notes"])
    with pytest.raises(OutputError, match="no earlier run wrote it"):
        write(tmp_path, notes="ours", joints="3")
    assert texts(tmp_path) == {"joints": "2", "notes": "mine"}


def test_an_output_that_a_user_has_edited_is_theirs(tmp_path):
    write(tmp_path, joints="1", overlay="1")
    (tmp_path / "joints").write_text("edited")
    with pytest.raises(InputError, match="joints: has changed since an earlier run wrote it"):
        OutputFolder(tmp_path, "motion", ["joints"])
    (tmp_path / "overlay").write_text("edited")
    write(tmp_path, other="2")
    assert texts(tmp_path) == {"joints": "edited", "overlay": "edited", "other": "2"}


def test_after_an_error_the_folder_is_as_it_was(tmp_path):
    write(tmp_path / "out", joints="1")
    with pytest.raises(RuntimeError), OutputFolder(tmp_path / "out", "motion").writing() as stage:
        (stage / "joints").write_text("2")
        raise RuntimeError
    assert texts(tmp_path / "out") == {"joints": "1"}
    with pytest.raises(RuntimeError), OutputFolder(tmp_path / "new", "motion").writing():
        raise RuntimeError
    assert not (tmp_path / "new").exists()


def test_what_a_run_wrote_first_stays_when_it_writes_more_and_an_earlier_runs_files_go(tmp_path):
    for names in (["small", "large"], ["small", "late"]):
        folder = OutputFolder(tmp_path, "run", names)
        for name in names:
            with folder.writing() as stage:
                (stage / name).write_text(name)
            assert (tmp_path / "small").exists()
    assert set(read_list(tmp_path)) == {"small", "late"} and folder.is_complete()
    assert {path.name for path in tmp_path.iterdir()} == {"small", "late", LIST_NAME}


@pytest.mark.parametrize("kind", [InputError, OutputError])
def test_an_error_names_the_file_as_it_would_be_called(kind, tmp_path):
    with pytest.raises(kind) as raised, OutputFolder(tmp_path, "motion").writing() as stage:
        raise kind(stage / "motion.glb", "holds no such thing")
    assert str(raised.value) == f"{tmp_path / 'motion.glb'}: holds no such thing"


def test_a_folder_that_holds_an_input_at_any_depth_is_refused(tmp_path):
    (tmp_path / "deep/er").mkdir(parents=True)
    (tmp_path / "deep/er/markers.trc").write_text("")
    for folder in (tmp_path, tmp_path / "deep", tmp_path / "deep" / ".." / "deep" / "er"):
        with pytest.raises(InputError, match="which is read; expected a folder of its own"):
            OutputFolder(folder, "motion", [], [tmp_path / "deep/er/markers.trc"])
    OutputFolder(tmp_path / "deep/out", "motion", [], [tmp_path / "deep/er/markers.trc"])


def test_a_link_to_a_folder_of_inputs_is_that_folder(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "data/markers.trc").write_text("")
    (tmp_path / "out").symlink_to(tmp_path / "data")
    with pytest.raises(InputError, match="which is read"):
        OutputFolder(tmp_path / "out", "motion", [], [tmp_path / "data/markers.trc"])


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{", '{"files": [1]}', '{"files": {"a": 1}}', '{"files": {"../../evil": {}}}',
     '{"files": {"../evil": {"kind": "motion", "sha256": []}}}',
     '{"files": {"/etc/evil": {"kind": "motion", "sha256": []}}}'],
)  # fmt: skip
def test_a_list_that_is_none_of_ours_is_refused_and_leads_nowhere_else(text, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "evil").write_text("mine")
    (tmp_path / "out" / LIST_NAME).write_text(text)
    with pytest.raises(InputError, match="no list of files that jaxmocap wrote"):
        OutputFolder(tmp_path / "out", "motion", ["joints"])
    assert (tmp_path / "evil").read_text() == "mine"


KILLED = """
import os, sys
from pathlib import Path
from jaxmocap.formats.files import output_folder
count, replace = int(sys.argv[2]), os.replace
def killed(old, new):
    global count
    if count == 0:
        os.kill(os.getpid(), 9)
    count -= 1
    replace(old, new)
os.replace = killed
with output_folder.OutputFolder(sys.argv[1], "motion").writing() as stage:
    for name in "bcde":
        (stage / name).write_text("new")
"""


@pytest.mark.parametrize("moves", range(7))
def test_a_kill_at_any_moment_leaves_whole_files_and_the_next_run_leaves_nothing_hidden(
    moves, tmp_path
):
    write(tmp_path, a="old", b="old", c="old")
    (tmp_path / "notes").write_text("mine")
    done = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path), str(moves)])
    assert (done.returncode == -9) == (moves < 6)
    actual = texts_of_files(tmp_path)
    assert actual.pop("notes") == "mine" and set(actual.values()) <= {"old", "new"}
    assert {"b", "c"} <= set(actual)
    write(tmp_path, b="newest")
    assert texts(tmp_path) == {"b": "newest", "notes": "mine"}


def texts_of_files(folder: Path) -> dict[str, str]:
    return {
        path.name: path.read_text()
        for path in folder.iterdir()
        if path.is_file() and path.name != LIST_NAME and not path.name.startswith(".")
    }


def test_what_another_process_is_writing_is_left_alone(tmp_path):
    mine = temporary_beside(tmp_path / "a.trc")
    mine.write_text("")
    gone = mine.with_name(mine.name.replace(f"-{os.getpid()}-", "-999999999-"))
    other = mine.with_name(".jaxmocap-00000000-999999999-00000000.trc")
    for path in (gone, other):
        path.write_text("")
    write_text(tmp_path / "b.txt", "b")
    assert mine.exists() and other.exists() and not gone.exists()


def test_a_device_or_a_folder_is_never_replaced(tmp_path):
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for name in ("folder", "pipe"):
        with pytest.raises(OutputError, match="found a folder or a device"):
            write_text(tmp_path / name, "text")
        assert "found a folder or a device" in complaint(check_target, tmp_path / name)
    with pytest.raises(OutputError, match="found a folder or a device"):
        write_text("/dev/null", "text")


def test_a_link_stays_and_its_file_is_replaced(tmp_path):
    (tmp_path / "there.txt").write_text("old")
    (tmp_path / "link.txt").symlink_to(tmp_path / "there.txt")
    write_text(tmp_path / "link.txt", "new")
    assert (tmp_path / "link.txt").is_symlink() and (tmp_path / "there.txt").read_text() == "new"


def test_what_is_read_is_not_written(tmp_path):
    (tmp_path / "a.trc").write_text("")
    (tmp_path / "same.trc").hardlink_to(tmp_path / "a.trc")
    for name in ("a.trc", "same.trc"):
        with pytest.raises(InputError, match="would be replaced while it is read"):
            check_target(tmp_path / name, [tmp_path / "a.trc"])


@pytest.mark.parametrize("room", [0, writing.SMALLEST_ROOM_BYTES])
def test_a_full_disk_is_one_sentence_exit_code_1_and_the_file_as_it_was(
    tmp_path, capsys, monkeypatch, room
):
    """Whether it is full before the work or becomes so."""
    monkeypatch.setattr(writing, "SMALLEST_ROOM_BYTES", room)
    subject = tmp_path / "subject.toml"
    assert main(["scale", "--height", "1.80", "--out", str(subject)]) == 0
    before = subject.read_bytes()
    capsys.readouterr()
    with disk_full_at(100):
        assert main(["scale", "--height", "1.70", "--out", str(subject)]) == 1
    problem = f"jaxmocap scale: {subject}: cannot be written (File too large)\n"
    assert capsys.readouterr().err == problem
    assert subject.read_bytes() == before and list(tmp_path.iterdir()) == [subject]


def test_a_writer_that_does_not_notice_is_checked(tmp_path):
    (tmp_path / "a.c3d").write_text("earlier")
    with (
        pytest.raises(OutputError, match="cannot be written completely"),
        replacing(tmp_path / "a.c3d", check=lambda path: path.read_text() == "whole") as beside,
    ):
        beside.write_text("who")
    assert texts(tmp_path) == {"a.c3d": "earlier"}


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write to any folder")
def test_a_folder_that_cannot_be_written_to_is_refused_before_any_work(tmp_path):
    tmp_path.chmod(0o500)
    assert "read-only" in complaint(OutputFolder, tmp_path / "out", "motion")
