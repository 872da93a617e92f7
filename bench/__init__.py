"""Benchmarks: ``python -m bench`` for speed, others by name; ``README.md`` has their questions.

Here is what their command lines have in common.

INPUTS: a module's name and docstring. OUTPUTS: an argument parser; numbers from text; a folder.
"""

import argparse
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def command(
    name: str, about: str | None, epilog: str | None = None, metrics: bool = True
) -> argparse.ArgumentParser:
    """A parser for ``python -m NAME`` that shows the module's docstring as it is written.

    Args:
        name: of the module.
        about: its docstring.
        epilog: what follows the options.
        metrics: whether there is ``--json``.
    """
    parser = argparse.ArgumentParser(
        prog=f"python -m {name}",
        description=about,
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if metrics:
        parser.add_argument("--json", metavar="FILE", help="write the metrics")
    return parser


def add_rendered(parser: argparse.ArgumentParser) -> None:
    """Who does rendered exercises, for how long, and where they go."""
    add = parser.add_argument
    add("--seeds", type=seeds, default=seeds("0"), metavar="0-2", help="default: 0")
    add("--people", default="man", metavar="WHO,...", help="of person.npz; default: %(default)s")
    add("--seconds", type=float, default=3.0, help="of a rendered recording; default: %(default)s")
    add("--keep", metavar="DIR", help="keep rendered recordings here, rendered once")


@contextmanager
def kept(folder: str | None) -> Iterator[Path]:
    """Where rendered recordings go: the folder of ``--keep``, or one that goes away."""
    with tempfile.TemporaryDirectory() as scratch:
        yield Path(folder or scratch)


def seeds(text: str) -> list[int]:
    """Such as ``0-9`` or ``3`` or ``0,4-6``."""
    result: list[int] = []
    for part in text.split(","):
        first, _, last = part.partition("-")
        result += range(int(first), int(last or first) + 1)
    return result


def numbers(text: str) -> list[float]:
    """Such as ``0,-60,60``."""
    return [float(part) for part in text.split(",")]


def keep_to_one_core() -> None:
    """This process and its threads, where the system can do that."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
