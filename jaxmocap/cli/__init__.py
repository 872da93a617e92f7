"""The command line: parse, and leave with an exit code; ``commands`` calls and prints.

Exit codes: 0 done, 1 not done or done in part, 2 bad input, 130 interrupted, 143 terminated. But
for 0 one sentence on stderr says why.
"""

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, NoReturn

from jaxmocap import __version__
from jaxmocap.cli import arguments as run_arguments
from jaxmocap.cli import commands, setup_arguments, silhouette_arguments
from jaxmocap.cli.process_exit import leave
from jaxmocap.cli.reporting import check_report
from jaxmocap.cli.setup_arguments import with_signs
from jaxmocap.formats.files.errors import InputError, OutputError, printable, shortened
from jaxmocap.pipelines.signals import Terminated, raised_on_sigterm

DONE, NOT_DONE, BAD_INPUT, INTERRUPTED, TERMINATED = 0, 1, 2, 130, 143


class Command(NamedTuple):
    """One command.

    Attributes:
        name: of it.
        purpose: in a line.
        run: what it does; an exit code, or None for 0.
        add: adds its options to a parser.
        example: how it is called.
        figures: whether it reports some, which --json writes.
    """

    name: str
    purpose: str
    run: Callable[[argparse.Namespace], int | None]
    add: Callable[[argparse.ArgumentParser], None]
    example: str
    figures: bool = True


COMMANDS = (
    Command(
        "demo", "make a synthetic recording and track it", commands.demo, run_arguments.add_demo,
        "jaxmocap demo --out jaxmocap-demo",
    ),
    Command(
        "check", "look for mistakes in a recording's file", commands.check,
        run_arguments.add_check, "jaxmocap check recording.toml",
    ),
    Command(
        "track", "track a recording", commands.track, run_arguments.add_track,
        "jaxmocap track recording.toml --out tracked",
    ),
    Command(
        "batch", "track every recording in a folder, side by side", commands.batch,
        run_arguments.add_batch, "jaxmocap batch recordings --out tracked --workers 2",
    ),
    Command(
        "warmup", "compile what tracking and a live run will need", commands.warmup,
        run_arguments.add_warmup, "jaxmocap warmup recording.toml",
    ),
    Command(
        "sync", "find the videos' offsets from the motion itself", commands.sync,
        run_arguments.add_sync, "jaxmocap sync recording.toml",
    ),
    Command(
        "evaluate", "compare tracked joints with a reference", commands.evaluate,
        run_arguments.add_evaluate,
        "jaxmocap evaluate tracked truth.trc --match elbow_l=LElbow elbow_r=RElbow",
    ),
    Command(
        "view", "show what track wrote in the rerun viewer", commands.view,
        run_arguments.add_view, "jaxmocap view tracked", figures=False,
    ),
    Command(
        "live", "track markers and cameras as they come", commands.live, run_arguments.add_live,
        "jaxmocap live live.toml --out session",
    ),
    Command(
        "convert", "make a file into another that carries the same", commands.convert,
        run_arguments.add_convert, "jaxmocap convert tracked/motion.npz motion.bvh --unit cm",
        figures=False,
    ),
    Command(
        "retarget", "play a tracked motion with another person's body", commands.retarget,
        run_arguments.add_retarget, "jaxmocap retarget tracked --onto subject.toml --out played",
    ),
    Command(
        "scale", "write a person's body to a file", commands.scale, setup_arguments.add_scale,
        "jaxmocap scale --height 1.80 --mass 75 --out subject.toml",
    ),
    Command(
        "offsets", "find where devices sit in the hands", commands.offsets,
        setup_arguments.add_offsets, "jaxmocap offsets turning.toml --turning 5,20 --still 0,3",
    ),
)  # fmt: skip
# A command that is several, and what it is about.
CALIBRATE = "calibrate a camera by a chessboard", (
    Command(
        "intrinsics", "find focal length and lens", commands.calibrate_intrinsics,
        setup_arguments.add_intrinsics,
        "jaxmocap calibrate intrinsics board*.jpg --board 4x7 --square 0.06 "
        "--camera cam_01 --out calibration.toml --pictures checked",
    ),
    Command(
        "extrinsics", "find where a camera stands", commands.calibrate_extrinsics,
        setup_arguments.add_extrinsics,
        "jaxmocap calibrate extrinsics floor.jpg --board 4x7 --square 0.06 "
        "--pose 0.5,1.2,0,0,0,90 --camera cam_01 --out calibration.toml --pictures checked",
    ),
)  # fmt: skip
SILHOUETTE = "track a person without markers, by silhouettes", (
    Command(
        "track", "track a recording of one to four cameras", commands.silhouette_track,
        silhouette_arguments.add_silhouette_track,
        "jaxmocap silhouette track recording.toml --out tracked --at 0,0,90",
    ),
    Command(
        "demo", "make a synthetic recording by four cameras and track it",
        commands.silhouette_demo, silhouette_arguments.add_silhouette_demo,
        "jaxmocap silhouette demo --out jaxmocap-silhouettes",
    ),
    Command(
        "model", "make a person's own model of four photographs", commands.silhouette_model,
        silhouette_arguments.add_silhouette_model,
        "jaxmocap silhouette model --front front.png --side side.png --joint joint.png "
        "--arm-side arm_side.png --calibration calibration.toml --out model",
    ),
)  # fmt: skip
GROUPS = {"calibrate": CALIBRATE, "silhouette": SILHOUETTE}


class Parser(argparse.ArgumentParser):
    """Says in one line what is wrong, and leaves examples in theirs."""

    def __init__(self, **options: Any):
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **options)

    def error(self, message: str) -> NoReturn:
        """Print one sentence and leave with 2."""
        self.exit(2, f"{self.prog}: {shortened(printable(message))}\n")


def enter() -> NoReturn:
    """The program: run the command that its arguments name, and end the process."""
    leave(main())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; its exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    parser = make_parser()
    if any("\0" in each for each in given):
        parser.error("an argument holds a NUL, which no file's name does")
    options = parser.parse_args(with_signs(given))
    try:
        with raised_on_sigterm():
            check_report(options)
            code = options.run(options) or DONE
            # What cannot be printed is noticed here, not when the process has ended.
            sys.stdout.flush()
            return code
    except (Exception, KeyboardInterrupt, Terminated) as error:
        code, problem = _ended_by(error)
        _print_last(f"jaxmocap {options.command}: {problem}")
        return code


def _ended_by(error: BaseException) -> tuple[int, str]:
    """The exit code and the sentence for whatever ended a command; what is a fault goes on."""
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
            named = error.filename or "the system"
            return NOT_DONE, shortened(printable(f"{named}: {error.strerror or error}"))
    raise error


def _print_last(sentence: str) -> None:
    """Say how it ended, if anybody can still be told."""
    try:
        print(sentence, file=sys.stderr, flush=True)
        sys.stdout.flush()
    except OSError:
        # Python would complain once more when it ends.
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):
            os.dup2(nowhere, stream.fileno())


def make_parser() -> Parser:
    """All commands and their options."""
    parser = Parser(
        prog="jaxmocap",
        description="Human motion capture from three tracked points and one ordinary camera.",
        epilog=f"example: {COMMANDS[0].example}",
    )
    parser.add_argument("--version", action="version", version=__version__)
    known = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for command in COMMANDS:
        _add(known, command)
    for name, (purpose, kinds) in GROUPS.items():
        group = _described(known, name, purpose, f"jaxmocap {name} {kinds[0].name} --help")
        inside = group.add_subparsers(dest="kind", required=True, metavar="KIND")
        for command in kinds:
            _add(inside, command)
    return parser


def _add(known: Any, command: Command) -> None:
    """A command among others."""
    parser = _described(known, command.name, command.purpose, command.example)
    parser.set_defaults(run=command.run)
    command.add(parser)
    if command.figures:
        parser.add_argument(
            "--json", metavar="FILE", help="write the figures as JSON; - for standard output"
        )


def _described(known: Any, name: str, purpose: str, example: str) -> Parser:
    described = f"{purpose}.".capitalize()
    return known.add_parser(name, help=purpose, description=described, epilog=f"example: {example}")
