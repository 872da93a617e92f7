"""Files kept for later starts: only what this user wrote is read, and JAX's entries are checked."""

import os
from collections.abc import Iterator
from pathlib import Path

import jax
import numpy as np
import pytest

import jaxmocap
from jaxmocap.compilation.programs import Program
from jaxmocap.formats.files.writing import temporary_beside
from jaxmocap.pipelines import kept_programs
from jaxmocap.pipelines.kept_programs import PrivateCache, keep_compiled
from jaxmocap.pipelines.warmup import counting_compilations

NUMBERS = np.arange(7, dtype=np.float32)
ON_POSIX = pytest.mark.skipif(
    not hasattr(os, "geteuid"), reason="files on Windows have no owner as on POSIX"
)


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The cache's folder during a test; afterwards this process keeps what it kept before."""
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "cache"))
    kept_programs._warn.cache_clear()
    yield tmp_path / "cache"
    monkeypatch.undo()
    keep_compiled()


def compiled(factor: float) -> tuple[list[float], int, int]:
    """What a program that is new to this process returns; programs compiled, and those found."""
    with counting_compilations("") as warmed:
        actual = jax.jit(lambda x: x * factor)(NUMBERS)
    return np.asarray(actual).tolist(), warmed.programs, warmed.from_cache


def tripled() -> Program:
    """A program, new as after a start."""
    return Program(lambda x: 3 * x, "tripled")


def entries(root: Path) -> list[Path]:
    # For a GPU XLA keeps beside them, in folders, what it tuned.
    return sorted(path for path in (root / "compiled").iterdir() if path.is_file())


def test_what_one_key_wrote_is_read_by_it_alone(tmp_path: Path) -> None:
    files = PrivateCache(tmp_path, "kept")
    files.write("name", "key", b"content")
    assert files.read("name", "key") == b"content"
    assert files.read("name", "other key") is None
    assert files.read("other name", "key") is None
    files.write("name", "key", b"")
    assert files.read("name", "key") == b""


def test_to_keep_a_file_takes_no_longer_among_thousands(tmp_path: Path, monkeypatch) -> None:
    """The folder is not gone through, nor is the disk waited for."""
    files = PrivateCache(tmp_path, "kept")
    with monkeypatch.context() as patched:
        patched.delattr(os, "scandir")
        patched.delattr(os, "fsync")
        files.write("name", "key", b"content")
    assert files.read("name", "key") == b"content"
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["name"]


@pytest.mark.parametrize("name", ["programs", "compiled"])
def test_what_a_start_that_was_killed_left_is_removed_by_the_next(root: Path, name: str) -> None:
    keep_compiled()
    mine = temporary_beside(root / name / "a.program")
    gone = mine.with_name(mine.name.replace(f"-{os.getpid()}-", "-999999999-"))
    for path in (mine, gone):
        path.write_text("")
    keep_compiled()
    assert mine.exists() and not gone.exists()


def test_an_executable_is_found_by_the_next_start(root: Path) -> None:
    keep_compiled()
    assert compiled(3.0) == ((3 * NUMBERS).tolist(), 1, 0)
    assert compiled(3.0) == ((3 * NUMBERS).tolist(), 1, 1)
    assert len(entries(root)) == 1


@pytest.mark.parametrize(
    "spoilt",
    [
        lambda intact: intact[:-9] + bytes([intact[-9] ^ 4]) + intact[-8:],
        lambda intact: bytes([intact[0] ^ 1]) + intact[1:],
        lambda intact: intact[: len(intact) // 2],
        lambda intact: b"",
        lambda intact: b"\x80\x04N.",
    ],
    ids=["flipped", "flipped at the start", "cut off", "empty", "a pickle"],
)
def test_an_executable_that_is_broken_is_made_again(root: Path, spoilt) -> None:
    keep_compiled()
    compiled(3.0)
    (file,) = entries(root)
    intact = file.read_bytes()
    file.write_bytes(spoilt(intact))
    assert compiled(3.0) == ((3 * NUMBERS).tolist(), 1, 0)
    assert compiled(3.0) == ((3 * NUMBERS).tolist(), 1, 1)
    assert entries(root) == [file]


def test_executables_that_were_exchanged_are_made_again(root: Path) -> None:
    keep_compiled()
    compiled(3.0)
    compiled(5.0)
    first, second = entries(root)
    contents = first.read_bytes(), second.read_bytes()
    first.write_bytes(contents[1])
    second.write_bytes(contents[0])
    for actual in (0, 1):
        assert compiled(3.0) == ((3 * NUMBERS).tolist(), 1, actual)
        assert compiled(5.0) == ((5 * NUMBERS).tolist(), 1, actual)


@ON_POSIX
def test_what_is_kept_is_its_users_alone(root: Path) -> None:
    before = os.umask(0)
    try:
        keep_compiled()
        compiled(3.0)
        tripled()(NUMBERS)
    finally:
        os.umask(before)
    folders = root, root / "compiled", root / "programs"
    assert [path.stat().st_mode & 0o777 for path in folders] == [0o700] * 3
    files = [*entries(root), *(root / "programs").iterdir()]
    assert len(files) > 1 and {path.stat().st_mode & 0o777 for path in files} == {0o600}


def given_away(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make a file or folder another user's."""
    if os.geteuid() == 0:
        os.chown(path, 12345, 12345)
        return
    stat = os.stat

    def with_other_owner(asked, *args, **kwargs):
        actual = stat(asked, *args, **kwargs)
        is_it = os.fspath(asked) == os.fspath(path)
        return os.stat_result([*actual[:4], 12345, *actual[5:]]) if is_it else actual

    monkeypatch.setattr(os, "stat", with_other_owner)


@ON_POSIX
@pytest.mark.parametrize("name", [".", "programs", "compiled"])
@pytest.mark.parametrize("way", ["writable by others", "of another user"])
def test_a_folder_that_others_can_write_to_is_neither_read_nor_written(
    root: Path, name: str, way: str, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    keep_compiled()
    compiled(3.0)
    tripled()(NUMBERS)
    kept = {path: path.read_bytes() for path in root.rglob("*") if path.is_file()}
    if way == "of another user":
        given_away(root / name, monkeypatch)
    else:
        (root / name).chmod(0o777)
    assert not capsys.readouterr().err
    keep_compiled()
    keep_compiled()
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1 and f"warning: {root / name}: " in printed
    assert "JAX_COMPILATION_CACHE_DIR" in printed
    assert ("chmod go-w" in printed) == (way == "writable by others")
    assert compiled(3.0) == ((3 * NUMBERS).tolist(), 1, 0)
    assert compiled(7.0)[1:] == (1, 0)
    np.testing.assert_array_equal(tripled()(NUMBERS), 3 * NUMBERS)
    assert {path: path.read_bytes() for path in root.rglob("*") if path.is_file()} == kept


@ON_POSIX
@pytest.mark.parametrize("way", ["writable by others", "of another user"])
def test_a_file_that_others_could_write_is_made_again_and_this_is_printed(
    root: Path, way: str, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    keep_compiled()
    compiled(3.0)
    (file,) = entries(root)
    if way == "of another user":
        given_away(file, monkeypatch)
    else:
        file.chmod(0o666)
    assert compiled(3.0) == ((3 * NUMBERS).tolist(), 1, 0)
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1 and f"warning: {file}: " in printed
    monkeypatch.undo()
    assert PrivateCache(root, "compiled").read(file.name, file.stem) is not None


def test_a_folder_that_cannot_be_made_is_printed_once_and_nothing_fails(root: Path, capsys) -> None:
    root.write_text("a file in its place")
    assert jaxmocap.keep_compiled() == root
    jaxmocap.keep_compiled()
    printed = capsys.readouterr().err
    assert printed.count("\n") == 1 and f"warning: {root}: cannot be written to" in printed
    assert compiled(3.0) == ((3 * NUMBERS).tolist(), 1, 0)


def test_a_jax_that_takes_no_other_cache_keeps_nothing(
    root: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    monkeypatch.delattr("jax._src.compilation_cache_interface.CacheInterface")
    keep_compiled()
    monkeypatch.undo()
    assert "takes no cache but its own" in capsys.readouterr().err
    assert jax.config.jax_compilation_cache_dir is None
    assert compiled(3.0) == ((3 * NUMBERS).tolist(), 1, 0)
    assert not entries(root)
