"""``jaxmocap check``: mistakes in a recording's file, as ``track`` looks for them.

INPUTS: a recording. OUTPUTS: who moves, the markers, what each camera sees of them, problems.
"""

import argparse

from jaxmocap.cli.command import Command, report


def _add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", metavar="RECORDING.toml")


def _run(options: argparse.Namespace) -> None:
    from jaxmocap.formats.recordings.recording import load_recording
    from jaxmocap.pipelines.check import check

    result = check(load_recording(options.recording))
    report(options, result.text(), result.figures())
    result.raise_if_fatal()


COMMAND = Command(
    name="check",
    purpose="look for mistakes in a recording's file",
    run=_run,
    add_options=_add_options,
    example="jaxmocap check recording.toml",
)
