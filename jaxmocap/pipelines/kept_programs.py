"""Compiled programs, kept on disk from one run to the next.

INPUTS: the environment. OUTPUTS: JAX's persistent compilation cache and our own, turned on, in a
folder that only its user can write to; else a warning on stderr.
"""

import os
import sys
from pathlib import Path
from typing import Any

import jax

from jaxmocap.compilation.programs import keep_in
from jaxmocap.formats.private_cache import PrivateCache, others_can_write

# Folder in the cache's folder: what tracing made.
TRACED_FOLDER = "programs"
# Folder in the cache's folder: what the compiler made.
COMPILED_FOLDER = "compiled"
EXECUTABLE_SUFFIX = ".executable"
# Warnings that were printed already.
_warned: set[str] = set()


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


def _warn(sentence: str) -> None:
    """Print a warning on stderr, once."""
    if sentence not in _warned:
        _warned.add(sentence)
        print(f"warning: {sentence}", file=sys.stderr)
