"""``jaxmocap warmup``: compile ahead what tracking and a live run will need.

INPUTS: a recording, a live file, or none for the demo's. OUTPUTS: compiled programs on disk; what
they took.
"""

import argparse

from jaxmocap.cli.command import Command
from jaxmocap.cli.recording_options import add_settings, settings_of
from jaxmocap.cli.reporting import report


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "recording",
        metavar="FILE.toml",
        nargs="?",
        help="a recording, for 'track', or a live file, for 'live': whose markers and cameras; "
        "default: the demo's recording",
    )
    add_settings(parser)


def _run(options: argparse.Namespace) -> None:
    from jaxmocap.formats.recordings.recording import Recording
    from jaxmocap.pipelines import warmup

    subject = warmup.load_or_standing(options.recording)
    settings = settings_of(options)
    if isinstance(subject, Recording):
        compilations = warmup.warm_up(subject, settings)
    else:
        compilations = warmup.warm_up_live(subject, settings)
    report(options, warmup.compilation_text(compilations), warmup.compilation_figures(compilations))


COMMAND = Command(
    name="warmup",
    purpose="compile what tracking and a live run will need",
    run=_run,
    add_options=_add_options,
    example="jaxmocap warmup recording.toml",
)
