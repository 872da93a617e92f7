"""What commands print, and where they write their figures.

INPUTS: parsed options, text, figures. OUTPUTS: lines on standard output; JSON; exit codes.
"""

import argparse
import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TextIO

from jaxmocap.formats.files.errors import InputError, printable, shortened
from jaxmocap.formats.files.output_folder import refuse_outputs
from jaxmocap.formats.files.writing import check_target
from jaxmocap.formats.recordings.recording_files import input_files

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
    from jaxmocap.pipelines.summary import write_figures

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
    sentence = shortened(printable("; ".join(problems)))
    print(f"jaxmocap {options.command}: {sentence}", file=sys.stderr)
    return 1
