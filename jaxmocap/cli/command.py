"""What a command of the command line is, and how the values of its options are read.

INPUTS: none; the text of an option. OUTPUTS: what the files of the rooms below have; the ``type``
functions of argparse: a value, ArgumentTypeError where it is none; what commands print and where
they write their figures.
"""

import argparse
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol, TextIO, TypeVar

from jaxmocap.formats.files.errors import InputError, printable, shorten_text
from jaxmocap.formats.files.output_folder import refuse_outputs
from jaxmocap.formats.files.writing import check_target
from jaxmocap.formats.recordings.recording_files import input_files

# A whole number has at most so many digits: a longer one would not fit into 32 bits.
MOST_DIGITS = 9
LARGEST_PORT = 65_535
T = TypeVar("T")


class Command(Protocol):
    """A command's module, which has its name."""

    __name__: str

    @property
    def PURPOSE(self) -> str:  # noqa: N802
        """One line of the help."""
        ...

    @property
    def EXAMPLE(self) -> str:  # noqa: N802
        """A command line of it."""
        ...

    def add_options(self, parser: argparse.ArgumentParser, /) -> None:
        """Add its options to a parser."""

    def run(self, options: argparse.Namespace, /) -> int | None:
        """Run it with the parsed options; an exit code, or None for 0."""


def name_of(command: Command) -> str:
    """As it is typed."""
    return command.__name__.rpartition(".")[2]


def _reader(
    expected: str, read: Callable[[str], T], fits: Callable[[T], Any] = lambda value: True
) -> Callable[[str], T]:
    """Reads an option's text, where it can and what it reads fits; else that is expected."""

    def read_option(text: str) -> T:
        with suppress(ValueError):
            if fits(value := read(text)):
                return value
        raise argparse.ArgumentTypeError(f"found {text!r}, expected {expected}")

    return read_option


def _whole(text: str) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) <= MOST_DIGITS):
        raise ValueError
    return int(text)


def _product(text: str) -> tuple[int, int]:
    """Two whole numbers with x between them."""
    first, second = map(_whole, text.lower().split("x"))
    return first, second


def _dictionary_and_side(text: str) -> tuple[str, float]:
    dictionary, side = text.split(",", 1)
    return dictionary.strip(), positive_number(side)


positive_number = _reader("a positive number", float, lambda value: 0 < value < math.inf)
finite_number = _reader("a finite number", float, math.isfinite)
whole_number = _reader("a whole number from 0 on", _whole)
positive_whole_number = _reader("a whole number above 0", _whole, bool)
port_number = _reader(f"a port, 0 to {LARGEST_PORT}", _whole, LARGEST_PORT.__ge__)
inner_corners = _reader("inner corners such as 4x7", _product)
picture_size = _reader("pixels such as 1920x1080", _product, min)
charuco_markers = _reader("a dictionary and metres such as 5X5_100,0.045", _dictionary_and_side)


def names(text: str) -> list[str]:
    """Names between commas."""
    return [name.strip() for name in text.split(",")]


def numbers(count: int, expected: str | None = None) -> Callable[[str], tuple[float, ...]]:
    """Reads so many finite numbers between commas; ``expected`` is their form, as in messages."""
    return _reader(
        expected or f"{count} numbers",
        lambda text: tuple(map(float, text.split(","))),
        lambda values: len(values) == count and all(map(math.isfinite, values)),
    )


def pair(expected: str) -> Callable[[str], tuple[str, str]]:
    """Reads two names with = between them; ``expected`` is their form, such as JOINT=MARKER."""

    def read(text: str) -> tuple[str, str]:
        left, _, right = text.partition("=")
        return left, right

    return _reader(expected, read, all)


class PairsAction(argparse.Action):
    """Stores what ``pair`` read as a dictionary; a left name that stands twice is refused."""

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, *_: Any
    ) -> None:
        """Called by argparse."""
        left = [name for name, _ in values]
        twice = [name for name in left if left.count(name) > 1]
        if twice:
            raise argparse.ArgumentError(self, f"found {twice[0]} twice, expected each name once")
        setattr(namespace, self.dest, dict(values))


# Options that name what is written.
_OUTPUT_OPTIONS = ("out", "json", "pictures", "target")


def files_read(options: argparse.Namespace) -> list[Path]:
    """Every file that the options name as one to read, with those that a recording names."""
    files: list[Path] = []
    for text in _texts({k: v for k, v in vars(options).items() if k not in _OUTPUT_OPTIONS}):
        # Most options are no files.
        with suppress(OSError, ValueError):
            if (path := Path(text)).is_file():
                files.append(path)
                if path.suffix == ".toml":
                    with suppress(InputError):
                        files += input_files(path)
    return files


def _texts(value: object) -> Iterator[str]:
    """All texts in dicts and lists."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, (list, tuple)):
        for each in value:
            yield from _texts(each)
    elif isinstance(value, (str, Path)):
        yield str(value)


def check_report(options: argparse.Namespace) -> None:
    """InputError where the file of --json cannot be written, is read, or is an output itself."""
    if (name := getattr(options, "json", None)) in (None, "-"):
        return
    path = check_target(name, files_read(options))
    refuse_outputs(path)
    path = Path(os.path.realpath(path))
    for other in (getattr(options, key, None) for key in _OUTPUT_OPTIONS if key != "json"):
        out = path if other is None else Path(os.path.realpath(other))
        is_inside = out in path.parents and (path.suffix != ".json" or path.name == "report.json")
        if other is not None and (path == out or is_inside):
            raise InputError(name, "is an output of this command, expected another file for --json")


def report(options: argparse.Namespace, text: str, figures: dict) -> None:
    """Print the text, and write the figures where --json says; - leaves standard output to them."""
    from jaxmocap.outputs.report import write_figures

    if options.json == "-":
        print_lines(text.split("\n"), sys.stderr)
        print(write_figures(figures))
        return
    print_lines(text.split("\n"))
    if options.json:
        # The run's outputs have names now.
        check_report(options)
        write_figures(figures, options.json)


def print_lines(lines: Iterable[str], stream: TextIO | None = None) -> None:
    """Print lines; control characters of names in files are escaped, as Python writes them."""
    print("\n".join(map(printable, lines)), file=stream)


def exit_code(options: argparse.Namespace, problems: Sequence[str]) -> int:
    """0, or 1 where there are problems, which the last line on stderr then states."""
    if not problems:
        return 0
    sentence = shorten_text(printable("; ".join(problems)))
    print(f"jaxmocap {options.command}: {sentence}", file=sys.stderr)
    return 1
