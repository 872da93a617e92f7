"""The commands: parse, call, print.

Exit codes: 0 done, 2 bad input (one sentence on stderr), 130 interrupted.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from jaxmocap import __version__
from jaxmocap.formats.errors import InputError
from jaxmocap.run import arguments as run_arguments
from jaxmocap.setup import arguments as setup_arguments
from jaxmocap.setup.arguments import with_signs

EXAMPLES = {
    "demo": "jaxmocap demo --out jaxmocap-demo",
    "check": "jaxmocap check recording.toml",
    "track": "jaxmocap track recording.toml --out tracked",
    "batch": "jaxmocap batch recordings --out tracked --workers 2",
    "sync": "jaxmocap sync recording.toml",
    "warmup": "jaxmocap warmup recording.toml",
    "evaluate": "jaxmocap evaluate tracked truth.trc --match elbow_l=LElbow elbow_r=RElbow",
    "view": "jaxmocap view tracked",
    "live": "jaxmocap live live.toml --out session",
    "convert": "jaxmocap convert tracked/motion.npz motion.bvh --unit cm",
    "scale": "jaxmocap scale --height 1.80 --mass 75 --out subject.toml",
    "offsets": "jaxmocap offsets turning.toml --turning 5,20 --still 0,3",
    "calibrate": "jaxmocap calibrate intrinsics --help",
    "intrinsics": "jaxmocap calibrate intrinsics board*.jpg --board 4x7 --square 0.06 "
    "--camera cam_01 --out calibration.toml --pictures checked",
    "extrinsics": "jaxmocap calibrate extrinsics floor.jpg --board 4x7 --square 0.06 "
    "--pose 0.5,1.2,0,0,0,90 --camera cam_01 --out calibration.toml --pictures checked",
}


class Parser(argparse.ArgumentParser):
    """Says in one line what is wrong, and leaves examples in theirs."""

    def __init__(self, **options: Any):
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **options)

    def error(self, message: str) -> NoReturn:
        """Print one sentence and leave with 2."""
        self.exit(2, f"{self.prog}: {message}\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; its exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    options = make_parser().parse_args(with_signs(given))
    try:
        options.run(options)
    except InputError as error:
        print(f"jaxmocap {options.command}: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        problem = error.strerror or str(error)
        print(f"jaxmocap {options.command}: {error.filename}: {problem}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"jaxmocap {options.command}: interrupted", file=sys.stderr)
        return 130
    return 0


def make_parser() -> Parser:
    """All commands and their options."""
    parser = Parser(
        prog="jaxmocap",
        description="Human motion capture from three tracked points and one ordinary camera.",
        epilog=f"example: {EXAMPLES['demo']}",
    )
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    _with_json(
        run_arguments.add_demo,
        _command(commands, "demo", demo, "make a synthetic recording and track it"),
    )
    check_parser = _command(commands, "check", check, "look for mistakes in a recording's file")
    check_parser.add_argument("recording", metavar="RECORDING.toml")
    _add_json(check_parser)
    _with_json(run_arguments.add_track, _command(commands, "track", track, "track a recording"))
    _with_json(
        run_arguments.add_batch,
        _command(commands, "batch", batch, "track every recording in a folder, side by side"),
    )
    _with_json(
        run_arguments.add_warmup,
        _command(commands, "warmup", warmup, "compile what tracking and a live run will need"),
    )
    _with_json(
        run_arguments.add_sync,
        _command(commands, "sync", sync, "find the videos' offsets from the motion itself"),
    )
    _with_json(
        run_arguments.add_evaluate,
        _command(commands, "evaluate", evaluate, "compare tracked joints with a reference"),
    )
    run_arguments.add_view(
        _command(commands, "view", view, "show what track wrote in the rerun viewer")
    )
    live_parser = _command(commands, "live", live, "track markers and cameras as they come")
    run_arguments.add_live(live_parser)
    _add_json(live_parser)
    run_arguments.add_convert(
        _command(commands, "convert", convert, "make a file into another that carries the same")
    )
    _with_json(
        setup_arguments.add_scale,
        _command(commands, "scale", scale, "write a person's body to a file"),
    )
    offsets_parser = _command(commands, "offsets", offsets, "find where devices sit in the hands")
    setup_arguments.add_offsets(offsets_parser)
    _add_json(offsets_parser)
    calibrate = _command(commands, "calibrate", None, "calibrate a camera by a chessboard")
    kinds = calibrate.add_subparsers(dest="kind", required=True, metavar="KIND")
    inside = _command(kinds, "intrinsics", calibrate_intrinsics, "find focal length and lens")
    outside = _command(kinds, "extrinsics", calibrate_extrinsics, "find where a camera stands")
    setup_arguments.add_intrinsics(inside)
    setup_arguments.add_extrinsics(outside)
    _add_json(inside)
    _add_json(outside)
    return parser


def _command(commands: Any, name: str, run: Any, purpose: str) -> Parser:
    parser = commands.add_parser(
        name,
        help=purpose,
        description=f"{purpose}.".capitalize(),
        epilog=f"example: {EXAMPLES[name]}",
    )
    parser.set_defaults(run=run)
    return parser


def _with_json(add: Callable[[argparse.ArgumentParser], None], parser: Parser) -> None:
    add(parser)
    _add_json(parser)


def _add_json(parser: Parser) -> None:
    parser.add_argument(
        "--json", metavar="FILE", help="write the figures as JSON; - for standard output"
    )


def demo(options: argparse.Namespace) -> None:
    """Make a synthetic recording, track it and show what video brings."""
    from jaxmocap.run.compilation import keep_compiled
    from jaxmocap.run.demo import demonstrate

    keep_compiled()
    shown = demonstrate(options.out, options.seconds, options.seed, progress=True)
    files = "\n".join(f"written  {path}" for path in shown.files)
    _report(options, f"{shown.table()}\n\n{files}", shown.as_dict())


def check(options: argparse.Namespace) -> None:
    """Look for mistakes in a recording's file, as ``track`` does before it begins."""
    from jaxmocap.formats.recording import load_recording
    from jaxmocap.run.checking import check

    checked = check(load_recording(options.recording))
    _report(options, checked.text(), checked.figures())
    checked.refuse()


def track(options: argparse.Namespace) -> None:
    """Track a recording and write everything."""
    from jaxmocap.formats.recording import load_recording
    from jaxmocap.run import choosing
    from jaxmocap.run import recording as offline
    from jaxmocap.run.compilation import keep_compiled
    from jaxmocap.run.summary import figures, summary
    from jaxmocap.run.writing import check_folder, write_outputs

    keep_compiled()
    recording = load_recording(options.recording)
    if options.cameras:
        recording = choosing.select_cameras(recording, options.cameras)
    if options.height:
        recording = choosing.with_height(recording, options.height)
    settings = offline.choose_settings(options.refine, options.paper)
    check_folder(options.out)
    motion = offline.track(recording, settings, mode=options.mode, progress=True)
    files = write_outputs(motion, recording, options.out, settings, progress=True)
    _report(options, summary(motion, files), figures(motion))


def batch(options: argparse.Namespace) -> None:
    """Track a corpus; what an earlier run has done is kept."""
    from jaxmocap.run.batch import Wanted, track_corpus

    wanted = Wanted(options.refine, options.mode)
    where = {"scheduler": options.scheduler, "workers": options.workers}
    found = track_corpus(options.corpus, options.out, wanted, **where, progress=True)
    _report(options, found.text(), found.figures())


def sync(options: argparse.Namespace) -> None:
    """Find the videos' offsets; nothing is changed."""
    from dataclasses import asdict

    from jaxmocap.formats.recording import load_recording
    from jaxmocap.run import choosing
    from jaxmocap.setup.sync import sync, text

    recording = load_recording(options.recording)
    if options.cameras:
        recording = choosing.select_cameras(recording, options.cameras)
    found = sync(recording, options.search)
    _report(options, text(found), {"videos": [asdict(each) for each in found]})


def warmup(options: argparse.Namespace) -> None:
    """Compile ahead, and say what it took."""
    from jaxmocap.run import recording as offline
    from jaxmocap.run import warmup

    ways = warmup.warm_up(
        warmup.asked_for(options.recording), offline.choose_settings(options.refine)
    )
    _report(options, warmup.text(ways), warmup.figures(ways))


def evaluate(options: argparse.Namespace) -> None:
    """Compare joints.trc with a reference."""
    from jaxmocap.evaluation.errors import evaluate_directory
    from jaxmocap.evaluation.tables import format_table

    errors = evaluate_directory(
        options.directory, options.truth, dict(options.match), options.up, options.offset
    )
    _report(options, format_table(errors), errors.as_dict())


def convert(options: argparse.Namespace) -> None:
    """Make one file into another."""
    from jaxmocap.formats.convert import Options, convert

    wanted = Options(options.names, options.unit, options.rate, options.body, options.angles)
    notes = convert(options.source, options.target, wanted)
    print("\n".join([*notes, f"written: {options.target}"]))


def live(options: argparse.Namespace) -> None:
    """Track what comes in until Ctrl-C."""
    from jaxmocap.run.compilation import keep_compiled
    from jaxmocap.run.live_session import live_summary, run_live

    keep_compiled()
    figures = run_live(
        options.setup,
        out=options.out,
        smooth=options.smooth,
        refine=options.refine,
        seconds=options.seconds,
        view=options.view,
    )
    _report(options, live_summary(figures), figures)


def scale(options: argparse.Namespace) -> None:
    """Write a person's body."""
    from jaxmocap.run.scaling import scale

    stated = options.height, options.static, options.recording, dict(options.landmarks), options.up
    scaled = scale(options.out, *stated, options.mass, options.wrists, progress=True)
    _report(options, scaled.text(), scaled.figures())


def offsets(options: argparse.Namespace) -> None:
    """Find where devices sit seen from the joints they turn about."""
    from jaxmocap.setup.offsets import find_offsets
    from jaxmocap.setup.offsets_report import offsets_figures, offsets_text

    span = options.turning or (float("-inf"), float("inf"))
    found = find_offsets(options.recording, options.still, span)
    _report(options, offsets_text(found), offsets_figures(found))


def calibrate_intrinsics(options: argparse.Namespace) -> None:
    """Find a camera's intrinsics."""
    from jaxmocap.setup import calibration_report
    from jaxmocap.setup.boards import parse_board
    from jaxmocap.setup.calibrate import calibrate_intrinsics

    board = parse_board(options.board, options.square, options.charuco)
    found = calibrate_intrinsics(
        options.paths, board, options.camera, options.out, options.distortions, options.pictures
    )
    text, figures = calibration_report.intrinsics_text, calibration_report.intrinsics_figures
    _report(options, text(found), figures(found))


def calibrate_extrinsics(options: argparse.Namespace) -> None:
    """Find where a camera stands."""
    from jaxmocap.setup import calibration_report
    from jaxmocap.setup.placing import calibrate_extrinsics, measured

    seen = measured(
        options.board,
        options.square,
        options.charuco,
        options.pose,
        options.origin,
        options.points,
        options.up,
    )
    found = calibrate_extrinsics(
        options.image, seen, options.camera, options.out, options.intrinsics, options.pictures
    )
    text, figures = calibration_report.extrinsics_text, calibration_report.extrinsics_figures
    _report(options, text(found), figures(found))


def view(options: argparse.Namespace) -> None:
    """Open the viewer, or serve it until Ctrl-C."""
    from jaxmocap.run.viewing import open_viewer, recording_in, serve_page

    path = recording_in(options.directory)
    if not options.web:
        print(open_viewer(path))
        return
    served = serve_page(path, options.port)
    print(f"{path}\nat {served.page}\nuntil Ctrl-C", flush=True)
    served.until_interrupted()


def _report(options: argparse.Namespace, text: str, figures: dict) -> None:
    """Print the text, and write the figures where --json says; - leaves standard output to them."""
    from jaxmocap.run.summary import write_figures

    if options.json == "-":
        print(text, file=sys.stderr)
        print(write_figures(figures))
        return
    print(text)
    if options.json:
        write_figures(figures, options.json)


if __name__ == "__main__":
    sys.exit(main())
