"""Which files a recording is made of: its fields' files and no others."""

import os
import time

import pytest
from conftest import complaint

from jaxmocap.formats.recordings.recording_files import input_files

TEXT = """
[markers]
file = "m.trc"
[markers.on]
Head = { bone = "head" }
"notes.txt" = { bone = "/etc" }
[[video]]
file = "gone.mp4"
background = "room.png"
keypoints = "points"
camera = "notes.txt"
[calibration]
file = "c.toml"
[subject]
file = "subject.toml"
"""


@pytest.fixture
def folder(tmp_path):
    """A recording whose files hold nothing, beside others that it does not name."""
    (tmp_path / "points" / "deeper").mkdir(parents=True)
    for name in (
        *("m.trc", "room.png", "c.toml", "static.trc", "notes.txt"),
        *("points/1.json", "points/notes.txt", "points/.2.json", "points/deeper/3.json"),
    ):
        (tmp_path / name).write_text("")
    (tmp_path / "subject.toml").write_text('static = "static.trc"\nup = "notes.txt"\n')
    (tmp_path / "recording.toml").write_text(TEXT)
    return tmp_path


def listed(folder) -> list[str]:
    files = input_files(folder / "recording.toml")
    return [path.relative_to(folder).as_posix() for path in files]


def test_the_files_of_documented_fields_are_found_and_no_others(folder):
    assert listed(folder) == [
        *("c.toml", "gone.mp4", "m.trc", "points/1.json"),
        *("recording.toml", "room.png", "static.trc", "subject.toml"),
    ]


@pytest.mark.parametrize("text", ["/dev", "/usr", "/dev/zero", "a\\u0000b", "x" * 5000, "pipe"])
def test_devices_system_folders_and_names_of_no_file_are_passed_over_at_once(folder, text):
    os.mkfifo(folder / "pipe")
    (folder / "points" / "4.json").unlink(missing_ok=True)
    os.mkfifo(folder / "points" / "4.json")
    fields = f'[[video]]\nfile = "{text}"\nkeypoints = "{text}"\n[subject]\nfile = "{text}"\n'
    (folder / "recording.toml").write_text(fields)
    begun = time.monotonic()
    assert listed(folder) == ["recording.toml"]
    assert time.monotonic() - begun < 5


def test_fields_of_the_wrong_kind_are_passed_over(folder):
    (folder / "recording.toml").write_text("markers = 1\nvideo = 2\nsubject = []\n")
    assert listed(folder) == ["recording.toml"]


def test_a_recording_that_is_not_there_is_refused(tmp_path):
    assert "no such file" in complaint(input_files, tmp_path / "recording.toml")
