"""What the benchmarks' command lines have in common.

INPUTS: a module's name and docstring. OUTPUTS: an argument parser; lists of numbers from text.
"""

import argparse


def command(name: str, about: str | None, epilog: str | None = None) -> argparse.ArgumentParser:
    """A parser for ``python -m NAME`` that shows the module's docstring as it is written."""
    return argparse.ArgumentParser(
        prog=f"python -m {name}",
        description=about,
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def add_rendered(parser: argparse.ArgumentParser) -> None:
    """Who does rendered exercises, for how long, and where they and the metrics go."""
    add = parser.add_argument
    add("--seeds", type=seeds, default=seeds("0"), metavar="0-2", help="default: 0")
    add("--people", default="man", metavar="WHO,...", help="of person.npz; default: %(default)s")
    add("--seconds", type=float, default=3.0, help="of a rendered recording; default: %(default)s")
    add("--keep", metavar="DIR", help="keep rendered recordings here, rendered once")
    add("--json", metavar="FILE", help="write the metrics")


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
