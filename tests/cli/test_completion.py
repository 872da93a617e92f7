"""Completion by the shell: the scripts are the shells', and complete commands, files, choices."""

import os
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from jaxmocap.cli.command import name_of
from jaxmocap.cli.completion import SHELLS, completion_script
from jaxmocap.cli.program import COMMANDS, GROUPS, main, make_parser
from jaxmocap.cli.recording_options import REFINEMENTS

BASH = shutil.which("bash")
needs_bash = pytest.mark.skipif(BASH is None, reason="there is no bash here")
# Presses the tabulator at the end of a line: prints what may follow.
PRESS_TAB = """
source {script}
COMP_WORDS=({line}) COMP_CWORD=$(({count} - 1)) COMP_POINT=0
$(complete -p jaxmocap | sed 's/.*-F \\([^ ]*\\).*/\\1/') jaxmocap {last} ''
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


@pytest.fixture(scope="module")
def script(tmp_path_factory) -> Path:
    """The script of bash, in a file."""
    path = tmp_path_factory.mktemp("bash") / "jaxmocap"
    path.write_text(completion_script(make_parser(), "bash"))
    return path


@pytest.fixture
def home(tmp_path, monkeypatch) -> Path:
    """An empty home, without XDG's variables."""
    for name in ("XDG_DATA_HOME", "XDG_CONFIG_HOME", "BASH_COMPLETION_USER_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    return tmp_path


def offered(script: Path, folder: Path, *words: str) -> set[str]:
    """What bash offers for the last of the words that follow ``jaxmocap``."""
    line = " ".join(map(shlex.quote, ("jaxmocap", *words)))
    code = PRESS_TAB.format(
        script=shlex.quote(str(script)), line=line, count=len(words) + 1, last=f"'{words[-1]}'"
    )
    done = subprocess.run(
        [str(BASH), "--norc", "-c", code], cwd=folder, capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    return set(done.stdout.split())


def ended(capsys, *arguments: str) -> tuple[int, str, str]:
    """The exit code of a command that ends by itself, and what it printed."""
    with pytest.raises(SystemExit) as done:
        main(arguments)
    printed = capsys.readouterr()
    return int(done.value.code or 0), printed.out, printed.err


@needs_bash
def test_the_script_is_one_that_bash_reads(script):
    done = subprocess.run([str(BASH), "-n", str(script)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@needs_bash
def test_commands_and_their_kinds_are_offered(script, tmp_path):
    every = {name_of(command) for command in COMMANDS} | set(GROUPS)
    assert every <= offered(script, tmp_path, "")
    assert offered(script, tmp_path, "re") == {"retarget"}
    assert offered(script, tmp_path, "silhouette", "mo") == {"model"}


@needs_bash
def test_options_and_choices_are_offered(script, tmp_path):
    assert "--causal" in offered(script, tmp_path, "track", "--c")
    assert offered(script, tmp_path, "track", "--refine", "") == set(REFINEMENTS)
    assert offered(script, tmp_path, "help", "start_v") == {"start_vr"}
    assert offered(script, tmp_path, "--show-completion", "z") == {"zsh"}


@needs_bash
def test_files_are_offered_by_their_kind(script, tmp_path):
    for name in ("recording.toml", "markers.trc", "video.mp4", "points.csv"):
        (tmp_path / name).touch()
    (tmp_path / "tracked").mkdir()
    assert offered(script, tmp_path, "track", "") >= {"recording.toml", "tracked"}
    assert not offered(script, tmp_path, "track", "") & {"markers.trc", "video.mp4", "points.csv"}
    assert offered(script, tmp_path, "convert", "mark") == {"markers.trc"}
    assert offered(script, tmp_path, "evaluate", "") == {"tracked"}
    extrinsics = "calibrate", "extrinsics", "image.png", "--points"
    assert offered(script, tmp_path, *extrinsics, "p") == {"points.csv"}


@pytest.mark.parametrize("shell", SHELLS)
def test_every_shell_has_a_script_that_names_every_command(shell, capsys):
    code, script, _ = ended(capsys, "--show-completion", shell)
    assert code == 0 and script == completion_script(make_parser(), shell) + "\n"
    assert all(name_of(command) in script for command in COMMANDS)


@pytest.mark.parametrize(
    ("shell", "place"),
    [
        ("bash", ".local/share/bash-completion/completions/jaxmocap"),
        ("zsh", ".local/share/zsh/site-functions/_jaxmocap"),
        ("fish", ".config/fish/completions/jaxmocap.fish"),
    ],
)
def test_the_script_goes_into_the_users_own_folder(shell, place, home, capsys, monkeypatch):
    monkeypatch.setenv("SHELL", f"/usr/bin/{shell}")
    for _ in range(2):
        code, printed, _ = ended(capsys, "--install-completion")
        assert code == 0 and printed.splitlines()[0] == f"written  {home / place}"
        assert "new terminal" in printed
    assert (home / place).read_text() == completion_script(make_parser(), shell) + "\n"
    assert os.listdir((home / place).parent) == [Path(place).name]


def test_xdgs_folders_are_used_where_they_are_named(home, capsys, monkeypatch):
    monkeypatch.setenv("XDG_DATA_HOME", str(home / "data"))
    monkeypatch.setenv("XDG_CONFIG_HOME", "not/absolute")
    ended(capsys, "--install-completion", "bash")
    assert (home / "data/bash-completion/completions/jaxmocap").is_file()
    ended(capsys, "--install-completion", "fish")
    assert (home / ".config/fish/completions/jaxmocap.fish").is_file()


def test_another_shell_is_refused_with_those_that_there_are(home, capsys, monkeypatch):
    monkeypatch.setenv("SHELL", "/bin/tcsh")
    code, printed, error = ended(capsys, "--install-completion")
    assert (code, printed, error.count("\n")) == (2, "", 1)
    assert "$SHELL: found tcsh, expected --install-completion bash or" in error
    assert not list(home.iterdir())


def test_a_home_that_is_no_folder_is_one_sentence(home, capsys, monkeypatch):
    (home / "file").touch()
    monkeypatch.setenv("HOME", str(home / "file"))
    code, printed, error = ended(capsys, "--install-completion", "zsh")
    assert (code, printed, error.count("\n")) == (2, "", 1)
    assert "file is a file" in error
