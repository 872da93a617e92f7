"""Folders that a command writes: a run owns a list of its files, and replaces nothing else.

    out/
      outputs.json            the list: every file, its SHA-256, and what kind of run wrote it
      joints.trc, ...
      .jaxmocap-...           while a run goes on: everything that it has written so far

INPUTS: the folder, the names that will be written, the files that are read. OUTPUTS: a hidden
folder to write to; when all is complete it is moved into place at once, and what an earlier run of
the kind wrote and this one did not is removed. A run may write several times; what is removed goes
at its last. A file that the list does not name, or that has changed since, is never touched.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from jaxmocap import __version__
from jaxmocap.formats.files.errors import FileError, InputError, OutputError
from jaxmocap.formats.files.reading import read_bytes
from jaxmocap.formats.files.writing import (
    as_output_error,
    check_file_name,
    check_folder_writable,
    flush_to_disk,
    remove_stale_temporaries,
    temporary_beside,
    write_text,
)

LIST_NAME = "outputs.json"
# A list of so many bytes at most is read.
MAX_LIST_BYTES = 16 * 2**20


class ListedFile(NamedTuple):
    """What the list says of a file."""

    kind: str  # of run that wrote it
    digests: tuple[str, ...]  # SHA-256 that it may have: two while one version replaces the other


class OutputFolder:
    """One folder for one run.

    Attributes:
        path: of the folder.
        kind: of run; runs of one kind replace each other's files.
    """

    def __init__(
        self,
        directory: str | Path,
        kind: str,
        names: Iterable[str] = (),
        inputs: Iterable[str | Path] = (),
    ):
        """Look whether a folder can be used, before any work; nothing is made.

        Args:
            directory: of the outputs.
            kind: of run.
            names: files that the run may write there; where it does not, earlier ones go.
            inputs: files that it reads, which the folder must not hold.

        Raises:
            InputError: it cannot be used, or has a file of these names that no earlier run wrote.
        """
        self.path, self.kind, self._names = Path(directory), kind, tuple(names)
        self._written: dict[str, ListedFile] = {}
        check_file_name(self.path)
        check_folder_writable(self.path)
        # Not ``resolve``: a loop of links is no error here.
        real = Path(os.path.realpath(self.path))
        for each in inputs:
            if Path(os.path.realpath(each)).is_relative_to(real):
                problem = f"holds {each}, which is read; expected a folder of its own for outputs"
                raise InputError(self.path, problem)
        self._check_free(self._names)

    @contextmanager
    def writing(self, more_follows: bool = False) -> Iterator[Path]:
        """Write everything, then move it into place; after an error nothing has changed.

        Args:
            more_follows: the run writes again: an earlier run's files stay until then.

        Yields:
            A hidden folder within this one: what is written there is this run's.

        Raises:
            OutputError: the disk is full, or a file that is not ours has appeared in between.
        """
        there = self.path.is_dir()
        with as_output_error(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
            remove_stale_temporaries(self.path)
            stage = temporary_beside(self.path / "outputs")
            stage.mkdir()
        try:
            yield stage
            with as_output_error(self.path):
                self._move_into_place(stage, more_follows)
        except FileError as error:
            # A file of the hidden folder is named as it would be called in the end.
            path, hidden = (Path(os.path.realpath(each)) for each in (error.path, stage))
            if not path.is_relative_to(hidden):
                raise
            raise type(error)(self.path / path.relative_to(hidden), error.problem) from None
        finally:
            shutil.rmtree(stage, ignore_errors=True)
            if not there:
                # Only where nothing was written does it go again.
                with suppress(OSError):
                    self.path.rmdir()

    def write(
        self, files: Callable[[Path], Iterable[Path]], more_follows: bool = False
    ) -> list[Path]:
        """The same by a function that writes files into a folder; their paths once in place."""
        with self.writing(more_follows) as stage:
            written = files(stage)
        return [self.path / path.relative_to(stage) for path in written]

    def is_complete(self) -> bool:
        """Is every file of the list there as it was written?"""
        try:
            listed = read_list(self.path)
            return bool(listed) and all(
                _is_unchanged(self.path / name, entry) for name, entry in listed.items()
            )
        except (InputError, OSError):
            return False

    def _check_free(self, names: Iterable[str]) -> None:
        """InputError where one of the names is a file that no earlier run wrote as it is."""
        listed = read_list(self.path)
        for name in names:
            path = self.path / name
            if not os.path.lexists(path) or (name in listed and _is_unchanged(path, listed[name])):
                continue
            problem = "has changed since an earlier run wrote it"
            if name not in listed:
                problem = "is there and no earlier run wrote it"
            raise InputError(path, f"{problem}; move it away, or write to another folder")

    def _move_into_place(self, stage: Path, more_follows: bool) -> None:
        """Replace what the list names, then remove what is left of it unless more follows.

        Whenever this is cut off, every file is complete and in the list.
        """
        staged = sorted(path for path in stage.rglob("*") if path.is_file())
        new = {path.relative_to(stage).as_posix(): path for path in staged}
        for path in staged:
            flush_to_disk(path)
        try:
            self._check_free(new)
            listed = read_list(self.path)
        except InputError as error:
            raise OutputError(error.path, error.problem) from None
        wrote = self._written | {
            name: ListedFile(self.kind, (_digest(path),)) for name, path in new.items()
        }
        ours = {
            name: entry
            for name, entry in listed.items()
            if entry.kind == self.kind or name in self._names
        }
        others = {name: entry for name, entry in listed.items() if name not in ours}
        # Each file as either of the lists has it.
        both = dict(listed)
        for name, entry in wrote.items():
            before = listed[name].digests if name in listed else ()
            both[name] = ListedFile(entry.kind, (*before, *entry.digests))
        _write_list(self.path, both)
        for name, path in new.items():
            (self.path / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(path, self.path / name)
        if more_follows:
            _write_list(self.path, listed | wrote)
        else:
            for name in set(ours) - set(wrote):
                if _is_unchanged(self.path / name, ours[name]):
                    (self.path / name).unlink()
            _write_list(self.path, others | wrote)
        self._written = wrote


def refuse_outputs(path: str | Path) -> None:
    """InputError where a file is a list of outputs, or in the list of one of its folders."""
    real = Path(os.path.realpath(path))
    if real.name == LIST_NAME:
        raise InputError(path, "is the name of a list of outputs, expected another")
    for folder in real.parents:
        try:
            listed = read_list(folder)
        except (InputError, OSError):
            continue
        if real.relative_to(folder).as_posix() in listed:
            raise InputError(path, f"is in the list {folder / LIST_NAME}, expected another file")


def read_list(folder: Path) -> dict[str, ListedFile]:
    """Name -> what a folder's list says of it, nothing without one; InputError for no such list."""
    path = folder / LIST_NAME
    if not os.path.lexists(path):
        return {}
    try:
        files = json.loads(read_bytes(path, MAX_LIST_BYTES))["files"]
        return {
            _checked_name(name): ListedFile(str(entry["kind"]), tuple(map(str, entry["sha256"])))
            for name, entry in files.items()
        }
    except InputError:
        raise
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        problem = "is no list of files that jaxmocap wrote, expected another folder"
        raise InputError(path, problem) from None


def _write_list(folder: Path, entries: Mapping[str, ListedFile]) -> None:
    files = {
        name: {"kind": entry.kind, "sha256": list(entry.digests)}
        for name, entry in sorted(entries.items())
    }
    content = {"written by": f"jaxmocap {__version__}", "files": files}
    write_text(folder / LIST_NAME, json.dumps(content, indent=2, ensure_ascii=False) + "\n")


def _checked_name(name: str) -> str:
    """A name of a list; ValueError where it leads out of the folder."""
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or not path.parts or "\0" in name:
        raise ValueError(name)
    return str(path)


def _is_unchanged(path: Path, entry: ListedFile) -> bool:
    """Is there a file as a run wrote it?"""
    return path.is_file() and not path.is_symlink() and _digest(path) in entry.digests


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
