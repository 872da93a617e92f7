"""``jaxmocap demo``: a synthetic recording, tracked by markers alone and with video.

INPUTS: a folder, a duration, a seed. OUTPUTS: the recording, its tracked files, errors.
"""

import argparse

from jaxmocap.cli.command import report
from jaxmocap.cli.recording_options import add_demo

PURPOSE = "make a synthetic recording and track it"
EXAMPLE = "jaxmocap demo --out jaxmocap-demo"


def add_options(parser: argparse.ArgumentParser) -> None:
    add_demo(parser, "jaxmocap-demo", 6.0, "person, room, strokes")


def run(options: argparse.Namespace) -> None:
    from jaxmocap.pipelines.demo import demonstrate
    from jaxmocap.pipelines.kept_programs import keep_compiled

    keep_compiled()
    demonstration = demonstrate(options.out, options.seconds, options.seed, progress=True)
    files = "\n".join(f"written  {path}" for path in demonstration.files)
    report(options, f"{demonstration.table()}\n\n{files}", demonstration.as_dict())
