"""``jaxmocap check``: mistakes in a recording's file, as ``track`` looks for them.

INPUTS: a recording. OUTPUTS: who moves, the markers, what each camera sees of them, problems.
"""

import argparse

from jaxmocap.cli.command import report

PURPOSE = "look for mistakes in a recording's file"
EXAMPLE = "jaxmocap check recording.toml"


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", metavar="RECORDING.toml")


def run(options: argparse.Namespace) -> None:
    from jaxmocap.formats.recordings.recording import load_recording
    from jaxmocap.pipelines.check import check

    result = check(load_recording(options.recording))
    report(options, result.text(), result.figures())
    result.raise_if_fatal()
