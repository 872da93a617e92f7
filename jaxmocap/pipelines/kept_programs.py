"""Compiled programs, kept on disk from one run to the next.

INPUTS: the environment. OUTPUTS: JAX's persistent compilation cache and our own, turned on, in a
folder that only its user can write to; else a warning on stderr. Whatever was changed there, cut
off, exchanged or put there by another user is not read, and is made again.
"""

import hashlib
import os
import stat
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import jax

from jaxmocap.compilation.programs import keep_in
from jaxmocap.formats.files.errors import FileError
from jaxmocap.formats.files.reading import read_bytes
from jaxmocap.formats.files.writing import remove_stale_temporaries, replacing

# The file's first bytes: what it is, and which layout it has. A SHA-256 of key and content follows,
# then the content.
MAGIC = b"jaxmocap kept 1\n"
SEAL_BYTES = len(MAGIC) + hashlib.sha256().digest_size
# Of folders and files: nobody else reads or writes them.
FOLDER_MODE = 0o700
FILE_MODE = 0o600


class PrivateCache:
    """A folder of sealed files."""

    def __init__(self, root: Path, name: str, warn: Callable[[str], None] = lambda _: None):
        """A folder of that name within one of the user's; nothing is made yet.

        ``warn`` is called with a sentence where another user could have written.
        """
        self.folder, self._root, self._warn = root / name, root, warn

    def read(self, name: str, key: str) -> bytes | None:
        """What was written by that name and that key; None if it is not there or damaged."""
        path = self.folder / name
        if not self._is_own(self._root, self.folder, path):
            return None
        try:
            sealed = read_bytes(path)
        except FileError:
            return None
        seal, content = sealed[:SEAL_BYTES], sealed[SEAL_BYTES:]
        return content if seal == _seal(key, content) else None

    def write(self, name: str, key: str, content: bytes) -> None:
        """Keep bytes, in place of whatever has the name; nothing where that cannot be."""
        try:
            self.make_folder()
            if self._is_own(self._root, self.folder):
                with replacing(self.folder / name, lasting=False) as temporary:
                    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
                    with open(os.open(temporary, flags, FILE_MODE), "wb") as file:
                        file.write(_seal(key, content) + content)
        # A folder that cannot be written to keeps nothing.
        except (OSError, FileError):
            pass

    def make_folder(self) -> None:
        """Make the folder where there is none yet, for its user alone."""
        with suppress(OSError):
            for folder in (self._root, self.folder):
                folder.mkdir(FOLDER_MODE, parents=True, exist_ok=True)

    def _is_own(self, *paths: Path) -> bool:
        """Whether nobody else could have written there; else a sentence says so."""
        for path in paths:
            if (problem := others_can_write(path)) is not None:
                self._warn(f"{path}: {problem}")
                return False
        return True


def others_can_write(path: Path) -> str | None:
    """Why another user may have written to a file or folder, and what to do; None if none may."""
    if not hasattr(os, "geteuid"):
        return None
    try:
        status = os.stat(path)
    except OSError:
        return None
    elsewhere = "set JAX_COMPILATION_CACHE_DIR to a folder of your own"
    if status.st_uid != os.geteuid():
        return f"belongs to another user, so no compiled program is read from there; {elsewhere}"
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return (
            f"others can write to it, so no compiled program is read from there; chmod go-w, or "
            f"{elsewhere}"
        )
    return None


def _seal(key: str, content: bytes) -> bytes:
    """What a file begins with: another key's content has another seal."""
    digest = hashlib.sha256(hashlib.sha256(key.encode()).digest())
    digest.update(content)
    return MAGIC + digest.digest()


# Folder in the cache's folder: what tracing made.
TRACED_FOLDER = "programs"
# Folder in the cache's folder: what the compiler made.
COMPILED_FOLDER = "compiled"
EXECUTABLE_SUFFIX = ".executable"


def cache_folder() -> Path:
    """JAX_COMPILATION_CACHE_DIR where it is set, else "jaxmocap" in the user's cache folder."""
    if chosen := os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "jaxmocap"


def keep_compiled() -> Path:
    """Keep what is compiled from now on for later starts, as the commands do.

    It keeps the tracker's own programs and whatever else JAX compiles. A second call changes
    nothing. Nothing is kept where another user can write to the folder; where it cannot be used, a
    warning on stderr says so in one line.

    Returns:
        The folder: ``JAX_COMPILATION_CACHE_DIR`` where that is set, else ``jaxmocap`` in the user's
        cache folder.

    Example:
        >>> import jaxmocap
        >>> folder = jaxmocap.keep_compiled()
    """
    folder = cache_folder()
    folders = folder, folder / TRACED_FOLDER, folder / COMPILED_FOLDER
    problems = [(path, others_can_write(path)) for path in folders]
    if refused := [(path, problem) for path, problem in problems if problem]:
        _warn("{}: {}".format(*refused[0]))
        keep_in(None)
        _keep_executables(None)
        return folder
    files = PrivateCache(folder, TRACED_FOLDER, _warn)
    files.make_folder()
    if not (files.folder.is_dir() and os.access(files.folder, os.W_OK)):
        _warn(
            f"{folder}: cannot be written to, so no compiled program is kept there; "
            "set JAX_COMPILATION_CACHE_DIR to a folder of your own"
        )
    for own in folders[1:]:
        remove_stale_temporaries(own)
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    keep_in(files)
    _keep_executables(PrivateCache(folder, COMPILED_FOLDER, _warn))
    return folder


def _keep_executables(files: PrivateCache | None) -> None:
    """Let JAX keep what it compiles in these files; None keeps nothing.

    Its own cache would load whatever lies under an entry's name.
    """
    try:
        from jax.experimental.compilation_cache import compilation_cache

        compilation_cache.reset_cache()
        if files is not None:
            # Before XLA makes it, with what it tuned for a GPU.
            files.make_folder()
            _install(files)
    # JAX has no public place for another cache than its own.
    except (ImportError, AttributeError, TypeError) as error:
        files = None
        _warn(f"this release of JAX takes no cache but its own, so nothing is kept ({error})")
    jax.config.update("jax_compilation_cache_dir", None if files is None else str(files.folder))


def _install(files: PrivateCache) -> None:
    from jax._src import compilation_cache
    from jax._src.compilation_cache_interface import CacheInterface

    class ChecksummedCache(CacheInterface):
        """Entries with a checksum over key and value, so that exchanged files are detected."""

        _path = files.folder

        def get(self, key: str) -> Any:
            return files.read(f"{key}{EXECUTABLE_SUFFIX}", key)

        def put(self, key: str, value: bytes) -> None:
            files.write(f"{key}{EXECUTABLE_SUFFIX}", key, value)

    with compilation_cache._cache_initialized_mutex:
        # Read first: where one is missing, setting it would have no effect.
        _ = compilation_cache._cache, compilation_cache._cache_initialized
        compilation_cache._cache = ChecksummedCache()
        compilation_cache._cache_initialized = True


@cache
def _warn(sentence: str) -> None:
    """Print a warning on stderr, each once."""
    print(f"warning: {sentence}", file=sys.stderr)
