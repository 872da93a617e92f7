"""``jaxmocap batch``: every recording of a folder, side by side.

INPUTS: a folder of recordings. OUTPUTS: a folder for each, a table of all; exit code 1 where one
failed. What an earlier run has tracked is kept.
"""

import argparse

from jaxmocap.cli.command import exit_code, positive_number, positive_whole_number, report
from jaxmocap.cli.recording_options import add_settings, mode_of, settings_of

PURPOSE = "track every recording in a folder, side by side"
EXAMPLE = "jaxmocap batch recordings --out tracked --workers 2"


def add_options(parser: argparse.ArgumentParser) -> None:
    add = parser.add_argument
    add("corpus", metavar="CORPUS_DIR", help="recordings, at any depth")
    add("--out", metavar="DIR", required=True, help="gets a folder for each, and corpus.csv")
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--scheduler", metavar="ADDRESS", help="a Dask cluster's, such as tcp://10.0.0.1:8786"
    )
    where.add_argument(
        "--workers",
        metavar="N",
        type=positive_whole_number,
        help="processes here; default: one per core",
    )
    add(
        "--job-timeout",
        metavar="SECONDS",
        type=positive_number,
        help="a recording that takes longer fails; default: as long as it takes",
    )
    add_settings(parser)
    add(
        "--causal",
        dest="mode",
        action="store_const",
        const="causal",
        help="see 'track'",
    )


def run(options: argparse.Namespace) -> int:
    from jaxmocap.pipelines.batch.batch import track_corpus

    settings = settings_of(options)
    batch = track_corpus(
        options.corpus,
        options.out,
        settings,
        mode_of(options, settings),
        scheduler=options.scheduler,
        workers=options.workers,
        timeout_s=options.job_timeout,
        progress=True,
    )
    report(options, batch.text(), batch.figures())
    count = len(batch.failures)
    return exit_code(options, [f"{count} recordings failed"] if count else [])
