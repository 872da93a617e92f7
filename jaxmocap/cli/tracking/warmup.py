"""``jaxmocap warmup``: compile ahead what tracking and a live run will need.

INPUTS: a recording, a live file, or none for the demo's. OUTPUTS: compiled programs on disk; what
they took.
"""

import argparse
from dataclasses import asdict

from jaxmocap.cli.command import report
from jaxmocap.cli.recording_options import add_settings, settings_of

PURPOSE = "compile what tracking and a live run will need"
EXAMPLE = "jaxmocap warmup recording.toml"


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "recording",
        metavar="FILE.toml",
        nargs="?",
        help="a recording, for 'track', or a live file, for 'live': whose markers and cameras; "
        "default: the demo's recording",
    )
    add_settings(parser)


def run(options: argparse.Namespace) -> None:
    from jaxmocap.formats.recordings.recording import Recording
    from jaxmocap.pipelines import warmup
    from jaxmocap.pipelines.kept_programs import cache_folder

    subject = warmup.load_or_standing(options.recording)
    if isinstance(subject, Recording):
        compilations = warmup.warm_up(subject, settings_of(options))
    else:
        # With --smooth as well, where the settings allow it.
        compilations = warmup.warm_up_live(subject, settings_of(options, smooth=False))
    folder = cache_folder()
    lines = [*(each.text() for each in compilations), f"kept in {folder}"]
    figures = {"modes": [asdict(each) for each in compilations], "kept_in": str(folder)}
    report(options, "\n".join(lines), figures)
