"""``jaxmocap demo``: a synthetic recording, tracked by markers alone and with video.

INPUTS: a folder, a duration, a seed. OUTPUTS: the recording, its tracked files, errors.
"""

import argparse

from jaxmocap.cli.command import positive_number, report, whole_number

PURPOSE = "make a synthetic recording and track it"
EXAMPLE = "jaxmocap demo --out jaxmocap-demo"


def add_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("--out", metavar="DIR", default="jaxmocap-demo", help="default: %(default)s")
    add(
        "--seconds",
        type=positive_number,
        default=6.0,
        help="of the recording, up to 3600; default: %(default)s",
    )
    add(
        "--seed",
        type=whole_number,
        default=0,
        help="of person, room, strokes and noise; default: 0",
    )


def run(options: argparse.Namespace) -> None:
    from jaxmocap.pipelines.demo import demonstrate
    from jaxmocap.pipelines.kept_programs import keep_compiled

    keep_compiled()
    demonstration = demonstrate(options.out, options.seconds, options.seed, progress=True)
    files = "\n".join(f"written  {path}" for path in demonstration.files)
    report(options, f"{demonstration.table()}\n\n{files}", demonstration.as_dict())
