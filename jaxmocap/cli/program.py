"""The command line: it parses arguments, runs one command, and ends with an exit code.

Begin with ``tracking.track``, one command from its options to its exit code. Each command is a
file, listed below; the rooms ``calibrate`` and ``silhouette`` are commands of several kinds. A
command imports what it needs when it runs, so that ``--help`` is quick.

Exit codes: 0 done, 1 not done or done in part, 2 bad input, 130 interrupted, 143 terminated. But
for 0 one sentence on stderr says why.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from jaxmocap import __version__
from jaxmocap.cli import INTERRUPTED, calibrate, help, silhouette
from jaxmocap.cli.command import Command, check_report, name_of
from jaxmocap.cli.completion import add_completion
from jaxmocap.cli.results import convert, evaluate, retarget, view
from jaxmocap.cli.setup import check, keypoints, offsets, plan, scale, sync
from jaxmocap.cli.tracking import batch, demo, live, track, video, warmup
from jaxmocap.formats.files.errors import InputError, OutputError, printable, shorten_text
from jaxmocap.pipelines.signals import Terminated, raise_on_sigterm

DONE = 0
NOT_DONE = 1
BAD_INPUT = 2
TERMINATED = 143  # 128 and the number of SIGTERM

# In the order of --help.
COMMANDS: tuple[Command, ...] = (
    *(demo, video, check, track, batch, warmup, sync, keypoints, evaluate),
    *(view, live, convert, retarget, scale, offsets, plan, help),
)
# A command of several kinds.
GROUPS = {"calibrate": calibrate, "silhouette": silhouette}
# Options whose value may begin with a minus, which argparse would take for an option.
SIGNED_OPTIONS = frozenset(
    ("--pose", "--origin", "--at", "--room", "--heights", "--turning", "--still", "--offset")
)


class Parser(argparse.ArgumentParser):
    """Prints an error as one line, and an example in the lines it was written in."""

    def __init__(self, **options: Any):
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **options)

    def error(self, message: str) -> NoReturn:
        """Print one sentence and leave with 2."""
        self.exit(BAD_INPUT, f"{self.prog}: {shorten_text(printable(message))}\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; its exit code."""
    texts = list(sys.argv[1:] if arguments is None else arguments)
    parser = make_parser()
    if any("\0" in text for text in texts):
        parser.error("an argument holds a NUL, which no file's name does")
    options = parser.parse_args(_with_signed_values(texts))
    try:
        with raise_on_sigterm():
            check_report(options)
            code = options.run(options) or DONE
            # What cannot be printed is noticed here, not when the process has ended.
            sys.stdout.flush()
            return code
    except (Exception, KeyboardInterrupt, Terminated) as error:
        code, problem = _outcome_of(error)
        _print_last_line(f"jaxmocap {options.command}: {problem}")
        return code


def _with_signed_values(arguments: Sequence[str]) -> list[str]:
    """Arguments in which ``--pose -1,2,3`` is one, as argparse wants it."""
    joined: list[str] = []
    for argument in arguments:
        if joined and joined[-1] in SIGNED_OPTIONS and argument[:2] != "--":
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


def _outcome_of(error: BaseException) -> tuple[int, str]:
    """The exit code and the sentence for what ended a command; any other error is raised again."""
    match error:
        case InputError():
            return BAD_INPUT, str(error)
        case OutputError():
            return NOT_DONE, str(error)
        case KeyboardInterrupt():
            return INTERRUPTED, "interrupted"
        case Terminated():
            return TERMINATED, "terminated"
        case MemoryError():
            return NOT_DONE, "there is not enough memory for it"
        case OSError():
            file = error.filename or "the system"
            return NOT_DONE, shorten_text(printable(f"{file}: {error.strerror or error}"))
    raise error


def _print_last_line(sentence: str) -> None:
    """Print how it ended, unless whoever reads the output has gone."""
    try:
        print(sentence, file=sys.stderr, flush=True)
        sys.stdout.flush()
    except OSError:
        # Python would complain once more when it ends.
        null_device = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):
            os.dup2(null_device, stream.fileno())


def make_parser() -> Parser:
    """All commands and their options."""
    parser = Parser(
        prog="jaxmocap",
        description="Human motion capture from three tracked points and one ordinary camera.",
        epilog=f"example: {demo.EXAMPLE}",
    )
    parser.add_argument("--version", action="version", version=__version__)
    add_completion(parser)
    subparsers = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for command in COMMANDS:
        _add_command(subparsers, command)
    for name, kinds in GROUPS.items():
        example = f"jaxmocap {name} {name_of(kinds.COMMANDS[0])} --help"
        group = _add_parser(subparsers, name, kinds.PURPOSE, example)
        kind_parsers = group.add_subparsers(dest="kind", required=True, metavar="KIND")
        for command in kinds.COMMANDS:
            _add_command(kind_parsers, command)
    return parser


def _add_command(subparsers: Any, command: Command) -> None:
    """Add a command's parser to those of the others."""
    parser = _add_parser(subparsers, name_of(command), command.PURPOSE, command.EXAMPLE)
    parser.set_defaults(run=command.run)
    command.add_options(parser)
    # Pages have no figures.
    if command is not help:
        parser.add_argument(
            "--json", metavar="FILE", help="write the figures as JSON; - for standard output"
        )


def _add_parser(subparsers: Any, name: str, purpose: str, example: str) -> Parser:
    # What stands in capitals further on stays so.
    description = f"{purpose[0].upper()}{purpose[1:]}."
    return subparsers.add_parser(
        name, help=purpose, description=description, epilog=f"example: {example}"
    )
