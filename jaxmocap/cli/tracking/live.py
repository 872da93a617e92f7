"""``jaxmocap live``: markers and cameras, tracked as they come in, until Ctrl-C.

INPUTS: the file of a live run. OUTPUTS: poses over the network, by choice a recording; figures.
Exit code 1 where nothing came in, or mostly what is absurd, or it was not all recorded; 143 where
SIGTERM ended it.
"""

import argparse

from jaxmocap.cli.command import exit_code, positive_number, report
from jaxmocap.cli.recording_options import add_settings, settings_of
from jaxmocap.pipelines.signals import Terminated

PURPOSE = "track markers and cameras as they come"
EXAMPLE = "jaxmocap live live.toml --out session"


def add_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("setup", metavar="LIVE.toml", help="what to listen to and where to send")
    add("--out", metavar="DIR", help="record there what 'track' reads again")
    add(
        "--smooth",
        action="store_true",
        help="give each pose out, smoothed, after two more video frames, or 0.1 s without video",
    )
    add(
        "--calibrate",
        nargs="?",
        choices=("t", "i"),
        const="t",
        help="before tracking, stand still in a T pose (arms to the sides, palms down) or an I "
        "pose (arms hanging, thumbs ahead): measures height, arms and how devices are held, and "
        "puts it into LIVE.toml; t by default",
    )
    add(
        "--countdown",
        metavar="S",
        type=positive_number,
        default=5.0,
        help="seconds until that pose; default: 5",
    )
    add_settings(parser)
    add("--view", choices=("window", "web"), help="show it in rerun's viewer, or in a browser")
    add("--seconds", metavar="S", type=positive_number, help="how long; default: until Ctrl-C")


def run(options: argparse.Namespace) -> int:
    from jaxmocap.pipelines.kept_programs import keep_compiled
    from jaxmocap.pipelines.live.session import live_summary, run_live

    keep_compiled()
    figures = run_live(
        options.setup,
        out=options.out,
        smooth=options.smooth,
        settings=settings_of(options, options.smooth),
        seconds=options.seconds,
        view=options.view,
        calibrate=options.calibrate,
        countdown=options.countdown,
    )
    report(options, live_summary(figures), figures)
    if figures["terminated"]:
        raise Terminated
    return exit_code(options, figures["problems"])
