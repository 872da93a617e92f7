"""``jaxmocap retarget``: a tracked motion played with another person's body.

INPUTS: what ``track`` wrote, another body. OUTPUTS: a folder with that body's motion.
"""

import argparse

from jaxmocap.cli.command import report

PURPOSE = "play a tracked motion with another person's body"
EXAMPLE = "jaxmocap retarget tracked --onto subject.toml --out played"


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("source", metavar="DIR", help="that 'track' wrote, or a motion.npz")
    parser.add_argument(
        "--onto",
        metavar="PERSON",
        required=True,
        help="a subject file, as 'scale' writes, or a folder that 'silhouette model' wrote",
    )
    parser.add_argument("--out", metavar="DIR", required=True, help="where to write")


def run(options: argparse.Namespace) -> None:
    from jaxmocap.pipelines.retarget import retarget, retarget_folder, write_retargeted

    folder = retarget_folder(options.out, options.source, options.onto)
    result = retarget(options.source, options.onto)
    warnings: list[str] = []
    files = write_retargeted(result, folder, warnings.append)
    lines = [result.text(files), *(f"warning        {sentence}" for sentence in warnings)]
    written = {"files": [str(path) for path in files], "warnings": warnings}
    report(options, "\n".join(lines), result.figures() | written)
