"""Programs: functions of arrays that are traced once, for this start and for later ones.

JAX keeps on disk what the compiler made, but asks for it by the lowered program: every start would
trace and lower anew, which takes seconds for a tracker. So what tracing made (StableHLO, by
``jax.export``) is kept beside it, and is asked for by the function's name, all of this package's
code, the versions of what it is built on, and the shapes of the arguments.

INPUTS: a function of arrays, a store of files. OUTPUTS: the same function, jitted.
"""

import copy
import hashlib
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache, partial
from importlib.metadata import version
from pathlib import Path
from threading import RLock
from typing import Any, Literal, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, export

from jaxmocap.compilation.arguments import is_traced

# What has a hand in tracing, beside this package.
BUILT_ON = ("jax", "jaxlib", "numpy", "equinox", "lineax", "optimistix")

# How hard XLA tries for a CPU. Its older emitters take two thirds of the time (33 s of a first
# start came to 20), and what they make is as fast but for loops over pictures and many candidates,
# which take 8 to 20 % longer; JAX has them up to 0.11.0. Optimised little it takes a tenth less,
# and an event's solve a sixth longer. Without optimisation it takes a quarter of the time, and what
# it makes is slower by half: for what runs once.
Effort = Literal["full", "quick", "once"]
EFFORTS: dict[str, dict[str, bool | int]] = {
    "full": {},
    "quick": {"xla_cpu_use_fusion_emitters": False},
    "once": {"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0},
}


class Store(Protocol):
    """Where bytes are kept from one start to the next."""

    def read(self, name: str, key: str) -> bytes | None:
        """What was written by that name and that key; None if it is not there or not complete."""
        ...

    def write(self, name: str, key: str, content: bytes) -> None:
        """Keep bytes, in place of whatever has the name."""
        ...


@dataclass
class _Made:
    """What programs share that differ only in what comes first."""

    # Structure, shapes and types of the arguments -> what is compiled for them.
    compiled: dict[tuple, Future]
    # The jitted function, by the compiler's effort; what calls it within a program of its own
    # chooses that itself.
    by_itself: Any = None
    restored: Any = None  # the jitted function that looks up what was kept
    # One thread makes them: of two jitted functions each would be traced and compiled.
    lock: Any = field(default_factory=RLock)


class Program:
    """A jitted function; once a store is chosen (``keep_in``), what tracing it makes stays there.

    Differentiated, mapped or called by another function that is being traced, it is the function.

    Attributes:
        name: of the function, and of its files.
        jitted: the function by itself.
    """

    def __init__(self, function: Callable, name: str, static: Any = (), effort: Effort = "quick"):
        """Nothing is traced yet.

        Args:
            function: of pytrees of arrays; it may close over nothing else but what follows from
                this package's code and from ``static``.
            name: distinguishes it from others.
            static: what else it depends on; its ``repr`` distinguishes it from others.
            effort: of the compiler.
        """
        self.name, self.jitted, self._effort = name, jax.jit(function), effort
        self._function = function
        self._static, self._first, self._made = repr(static), (), _Made({})

    def after(self, *first: Any) -> "Program":
        """The same with these arguments before all others."""
        other = copy.copy(self)
        other._first = (*self._first, *first)
        return other

    def __call__(self, *arguments: Any) -> Any:
        """The function's result."""
        arguments = (*self._first, *arguments)
        if is_traced(arguments):
            return self.jitted(*arguments)
        try:
            return self._chosen()(*arguments)
        except ValueError:
            # Compiler's options are refused within another's trace, where even zeros are traced.
            if not is_traced(jnp.zeros(())):
                raise
        return self.jitted(*arguments)

    def shapes(self, *like: Any) -> Any:
        """Shapes of the result, from arguments or from what has their shapes."""
        arguments = (*self._first, *like)
        leaves, structure = jax.tree.flatten(arguments)
        can_keep = _store and _is_of_this_code(structure)
        kept = _read(*self._name_and_key(leaves, structure)) if can_keep else None
        if kept is None:
            # Not exported for this alone: it can wait until it is compiled.
            return jax.eval_shape(self.jitted, *arguments)
        shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in kept.out_avals]
        return jax.tree.unflatten(kept.out_tree, shapes)

    def beside(self, *like: Any) -> Callable[[], Callable]:
        """Traced and lowered for arguments such as these, while another thread compiles it.

        The compiler lets go of the interpreter. What is returned waits for it, and returns what
        takes such arguments and no others. It is compiled once, for all programs with other
        arguments before.
        """
        arguments = (*self._first, *like)
        leaves, structure = jax.tree.flatten(arguments)
        kind = structure, tuple((np.shape(leaf), np.dtype(leaf.dtype)) for leaf in leaves)
        if kind not in self._made.compiled:
            lowered = self._chosen().lower(*arguments)
            self._made.compiled[kind] = _compiler().submit(lowered.compile)
        compiled = self._made.compiled[kind]
        return lambda: partial(compiled.result(), *self._first)

    @property
    def kinds(self) -> int:
        """How many kinds of arguments this process has called it with, a compilation each."""
        return self._chosen()._cache_size()

    def trace(self, *like: Any) -> jax.stages.Traced:
        """Traced for arguments such as these."""
        return self._chosen().trace(*self._first, *like)

    def _chosen(self) -> Any:
        """What is jitted: the function, or what looks up what was made of it."""
        with self._made.lock:
            options = _compiler_options(self._effort)
            if _store is None:
                made = self._made.by_itself or jax.jit(self._function, compiler_options=options)
                self._made.by_itself = made
                return made
            if self._made.restored is None:

                def restored(*arguments: Any) -> Any:
                    leaves, structure = jax.tree.flatten(arguments)
                    kept = self._look_up(leaves, structure)
                    return self.jitted(*arguments) if kept is None else kept.call(*leaves)

                restored.__name__ = self.name
                self._made.restored = jax.jit(restored, compiler_options=options)
            return self._made.restored

    def _look_up(self, leaves: list[Array], structure: Any) -> export.Exported | None:
        """What an earlier start kept, or what this one makes of it; None if it cannot be kept."""
        if not _is_of_this_code(structure):
            return None
        name, key = self._name_and_key(leaves, structure)
        if (kept := _read(name, key)) is not None:
            return kept

        def flat(*leaves: Array) -> Any:
            return self.jitted(*jax.tree.unflatten(structure, leaves))

        _name_containers()
        try:
            blob = export.export(jax.jit(flat))(*_like(leaves)).serialize()
        # It calls a library by a name that JAX may change (LAPACK's products with a QR's Q), or
        # returns a container that has no name.
        except ValueError:
            return None
        if _store is not None:
            _store.write(name, key, bytes(blob))
        # Read back, so that this start compiles what later ones will ask for.
        return export.deserialize(blob)

    def _name_and_key(self, leaves: list[Array], structure: Any) -> tuple[str, str]:
        """Of the file that keeps it for such arguments."""
        key = repr((self.name, self._static, str(structure), _like(leaves), _surroundings()))
        return f"{self.name}-{_digest(key)}.program", key


_store: Store | None = None


def keep_in(store: Store | None) -> None:
    """Keep what tracing makes from now on in a store of the user's own; None keeps nothing.

    What the store returns is not checked again: it must have been written by the same name and key.
    """
    global _store
    _store = store


def program(effort: Effort) -> Callable[[Callable], Program]:
    """Decorates a function of arrays that closes over nothing."""

    def made(function: Callable) -> Program:
        file = function.__module__.rpartition(".")[2]
        return Program(function, f"{file}.{function.__name__.lstrip('_')}", effort=effort)

    return made


@lru_cache
def _compiler() -> ThreadPoolExecutor:
    """Threads that compile while others are traced."""
    return ThreadPoolExecutor(2, "compile")


@lru_cache
def _compiler_options(effort: Effort) -> dict[str, bool | int] | None:
    """Of an effort, those that this compiler has."""
    if jax.default_backend() != "cpu":
        return None
    return {name: value for name, value in EFFORTS[effort].items() if _has(name, value)} or None


def _has(name: str, value: bool | int) -> bool:
    """Whether this compiler takes an option."""
    try:
        jax.jit(lambda: 0, compiler_options={name: value}).lower().compile()
    except jax.errors.JaxRuntimeError:
        return False
    return True


def _like(leaves: list[Array]) -> list[jax.ShapeDtypeStruct]:
    """Shapes and types of arrays, or of what has them."""
    weak = (getattr(leaf, "weak_type", False) for leaf in leaves)
    return [
        jax.ShapeDtypeStruct(np.shape(leaf), leaf.dtype, weak_type=each)
        for leaf, each in zip(leaves, weak, strict=True)
    ]


def _read(name: str, key: str) -> export.Exported | None:
    """What was kept by that name; None if it is not there, or not what it should be."""
    content = _store.read(name, key) if _store else None
    if content is None:
        return None
    _name_containers()
    try:
        return export.deserialize(bytearray(content))
    # Whatever the reason, it is made again.
    except Exception:
        return None


def _name_containers() -> None:
    """Let JAX write this package's NamedTuples by their names, and find them again."""
    for kind in tuple.__subclasses__():
        if hasattr(kind, "_fields") and kind.__module__.startswith("jaxmocap."):
            # It refuses those that it has.
            with suppress(ValueError):
                name = f"{kind.__module__}:{kind.__qualname__}"
                export.register_namedtuple_serialization(kind, serialized_name=name)


def _is_of_this_code(structure: Any) -> bool:
    """Whether all classes in a structure of arguments are this package's, or containers.

    A user's own, such as a term, may change from start to start, and its code is not in the key.
    """
    kind = (structure.node_data() or (None, None))[0]
    name = getattr(kind, "__module__", "builtins")
    return name.partition(".")[0] in ("builtins", "jaxmocap") and all(
        map(_is_of_this_code, structure.children())
    )


def _surroundings() -> tuple:
    """What tracing depends on beside function and arguments."""
    names = "jax_enable_x64", "jax_default_matmul_precision"
    return _code(), jax.default_backend(), [getattr(jax.config, name) for name in names]


@lru_cache
def _code() -> str:
    """Of all of this package with its tables, and of what it is built on."""
    root = Path(__file__).parents[1]
    texts = [
        path.read_bytes() for kind in ("py", "toml") for path in sorted(root.rglob(f"*.{kind}"))
    ]
    return _digest(repr([version(name) for name in BUILT_ON])) + _digest(b"\0".join(texts))


def _digest(content: str | bytes) -> str:
    content = content.encode() if isinstance(content, str) else content
    return hashlib.sha256(content).hexdigest()[:24]
