"""``python -m bench [--quick] [--json FILE] [--gate]``: speed, in one table.

Everything runs on one core, so that figures do not depend on what the others do. Ratios are of
times that were taken in turn; ``--gate`` holds them against ``baseline.json``.
"""

import argparse
import os
import platform
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bench import command, keep_to_one_core

if TYPE_CHECKING:
    from bench.figures import Metric

# What is worse than the baseline is measured again: a neighbour on the machine is no regression.
ATTEMPTS = 3
PARTS = ("frame rate", "rivals", "headline")
# Seconds of the clip: quickly, and in full.
CLIP_S = {True: 1.5, False: 2.0}


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = command("bench", __doc__)
    add = result.add_argument
    add("--quick", action="store_true", help="what the gate needs: half a minute of one core")
    add("--gate", action="store_true", help="exit 1 where a ratio stays worse than the baseline's")
    add("--only", choices=PARTS, help="one part; not with --gate")
    add("--recordings", metavar="DIR", type=Path, help="real recordings, for the headline's errors")
    add("--detector-python", metavar="PYTHON", help="of an environment with mediapipe 0.10.21")
    add("--all-cores", action="store_true", help="do not keep to one core")
    return result


def measured(options: argparse.Namespace, folder: Path) -> "tuple[list[Metric], list[str]]":
    """All parts, or one; the headline by its name alone.

    Args:
        options: of the command line.
        folder: to put recordings in.

    Returns:
        The figures, and parts of the names of ratios that rivals not installed leave out.
    """
    import cv2

    from bench import frame_rate, headline, rivals
    from bench.clips import film

    cv2.setNumThreads(1)
    quick, only = options.quick, options.only
    metrics: list[Metric] = []
    absent: list[str] = []
    if only == "headline":
        found = headline.measure(folder, options.recordings, options.detector_python)
        return list(shown(only, found)), []
    footage = film(folder, CLIP_S[quick])
    if only in (None, "frame rate"):
        metrics += shown("frame rate", frame_rate.measure(footage, quick))
    if only in (None, "rivals"):
        absent = rivals.missing()
        metrics += shown("rivals", rivals.measure(quick, absent))
    return metrics, rivals.unmeasured(absent)


def shown(part: str, metrics: "Iterator[Metric]") -> "Iterator[Metric]":
    """The same, with how far it has come on stderr."""
    from tqdm import tqdm

    with tqdm(metrics, desc=part, unit=" figures") as bar:
        for metric in bar:
            bar.set_postfix_str(metric.name)
            yield metric


def main(arguments: Sequence[str] | None = None) -> None:
    command_line = parser()
    options = command_line.parse_args(arguments)
    if options.gate and options.only:
        command_line.error("--gate needs all parts: leave --only out")
    if not options.all_cores:
        keep_to_one_core()
    # XLA counts the cores when it is loaded.
    from bench.figures import best, failures, read_baseline, table, write_json
    from jaxmocap.pipelines.kept_programs import keep_compiled

    keep_compiled()
    mode = "quick" if options.quick else "full"
    cores = "all cores" if options.all_cores else "one core"
    print(f"{mode}, {cores} of {os.cpu_count()}, {platform.machine()}", flush=True)
    baseline = read_baseline(mode)
    runs: list[list[Metric]] = []
    for attempt in range(ATTEMPTS):
        with tempfile.TemporaryDirectory() as folder:
            metrics, skipped = measured(options, Path(folder))
        runs.append(metrics)
        print(table(metrics, baseline))
        if not attempt:
            write_json(metrics, options.json)
        if not options.gate or not (problems := failures(best(runs), baseline, skipped)):
            return
        print("\n".join(problems), file=sys.stderr)
    sys.exit(f"the gate: worse than the baseline in each of {ATTEMPTS} runs")


if __name__ == "__main__":
    main()
