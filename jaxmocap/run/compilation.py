"""Compiled programs, kept on disk from one run to the next.

INPUTS: the environment. OUTPUTS: JAX's persistent compilation cache and our own, turned on.
"""

import os
from pathlib import Path

import jax

from jaxmocap.solvers.programs import keep_in


def cache_folder() -> Path:
    """JAX_COMPILATION_CACHE_DIR where it is set, else "jaxmocap" in the user's cache folder."""
    if chosen := os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        return Path(chosen)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "jaxmocap"


def keep_compiled() -> Path:
    """Turn both caches on, for everything that compiles from now on; its folder."""
    folder = cache_folder()
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    keep_in(folder / "programs")
    return folder
