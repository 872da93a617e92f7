"""What a command of the command line is, and how the values of its options are read.

INPUTS: none; the text of an option. OUTPUTS: Command records, one in each file of the rooms below;
the ``type`` functions of argparse: a value, ArgumentTypeError where it is none.
"""

import argparse
import math
from collections.abc import Callable
from typing import NamedTuple

# A whole number has at most so many digits: a longer one would not fit into 32 bits.
MOST_DIGITS = 9
LARGEST_PORT = 65_535


class Command(NamedTuple):
    """One command.

    Attributes:
        name: as it is typed.
        purpose: one line of the help.
        run: runs it with the parsed options; an exit code, or None for 0.
        add_options: adds its options to a parser.
        example: a command line of it.
        reports_figures: whether it takes --json, a file for its figures.
    """

    name: str
    purpose: str
    run: Callable[[argparse.Namespace], int | None]
    add_options: Callable[[argparse.ArgumentParser], None]
    example: str
    reports_figures: bool = True


def positive_number(text: str) -> float:
    """A number above 0."""
    value = float(text)
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"found {text}, expected a positive number")
    return value


def finite_number(text: str) -> float:
    """Any number but infinity and NaN."""
    if not abs(value := float(text)) < math.inf:
        raise argparse.ArgumentTypeError(f"found {text}, expected a finite number")
    return value


def whole_number(text: str) -> int:
    """A whole number from 0 on."""
    if not _is_whole(text):
        raise argparse.ArgumentTypeError(f"found {text}, expected a whole number from 0 on")
    return int(text)


def positive_whole_number(text: str) -> int:
    """A whole number from 1 on."""
    if not (_is_whole(text) and int(text)):
        raise argparse.ArgumentTypeError(f"found {text}, expected a whole number above 0")
    return int(text)


def port_number(text: str) -> int:
    """A TCP port."""
    if not (_is_whole(text) and int(text) <= LARGEST_PORT):
        raise argparse.ArgumentTypeError(f"found {text}, expected a port, 0 to {LARGEST_PORT}")
    return int(text)


def _is_whole(text: str) -> bool:
    return text.isascii() and text.isdecimal() and len(text) <= MOST_DIGITS


def names(text: str) -> list[str]:
    """Names between commas."""
    return [name.strip() for name in text.split(",")]


def numbers(count: int, expected: str | None = None) -> Callable[[str], tuple[float, ...]]:
    """Reads so many finite numbers between commas; ``expected`` is their form, as in messages."""

    def read(text: str) -> tuple[float, ...]:
        try:
            values = tuple(float(part) for part in text.split(","))
        except ValueError:
            values = ()
        if len(values) != count or not all(map(math.isfinite, values)):
            raise argparse.ArgumentTypeError(
                f"found {text!r}, expected {expected or f'{count} numbers'}"
            )
        return values

    return read


def pair(expected: str) -> Callable[[str], tuple[str, str]]:
    """Reads two names with = between them; ``expected`` is their form, such as JOINT=MARKER."""

    def read(text: str) -> tuple[str, str]:
        left, equals, right = text.partition("=")
        if not (left and equals and right):
            raise argparse.ArgumentTypeError(f"found {text!r}, expected {expected}")
        return left, right

    return read


def inner_corners(text: str) -> tuple[int, int]:
    """COLUMNSxROWS of a chessboard's inner corners."""
    columns, _, rows = text.lower().partition("x")
    if not (columns.isdecimal() and rows.isdecimal()):
        raise argparse.ArgumentTypeError(f"found {text!r}, expected inner corners such as 4x7")
    return int(columns), int(rows)


def picture_size(text: str) -> tuple[int, int]:
    """WIDTHxHEIGHT of pictures."""
    width, _, height = text.lower().partition("x")
    if not (_is_whole(width) and _is_whole(height) and int(width) and int(height)):
        raise argparse.ArgumentTypeError(f"found {text!r}, expected pixels such as 1920x1080")
    return int(width), int(height)


def charuco_markers(text: str) -> tuple[str, float]:
    """DICTIONARY,METRES of a ChArUco board's markers."""
    dictionary, _, side = text.partition(",")
    return dictionary.strip(), positive_number(side)


def add_up(parser: argparse.ArgumentParser, help_text: str) -> None:
    """The option --up."""
    parser.add_argument("--up", choices=("z", "y"), help=help_text)
