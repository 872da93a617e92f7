"""``python -m bench [--quick] [--json FILE] [--gate]``: speed, in one table.

Everything runs on one core, so that figures do not depend on what the others do. Ratios are of
times that were taken in turn; ``--gate`` holds them against ``baseline.json``.
"""

import argparse
import os
import platform
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from bench.command_line import command

# What is worse than the baseline is measured again: a neighbour on the machine is no regression.
ATTEMPTS = 3
PARTS = ("frame rate", "rivals", "growth", "headline")


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = command("bench", __doc__)
    add = result.add_argument
    add("--quick", action="store_true", help="less than a minute: what the gate needs")
    add("--json", metavar="FILE", help="write the metrics")
    add("--gate", action="store_true", help="exit 1 where a ratio stays worse than the baseline's")
    add("--only", choices=PARTS, help="one part; not with --gate")
    add("--recordings", metavar="DIR", type=Path, help="real recordings, for the headline's errors")
    add("--detector-python", metavar="PYTHON", help="of an environment with mediapipe 0.10.21")
    add("--all-cores", action="store_true", help="do not keep to one core")
    add("--samples", type=int, metavar="N", help="of the long run; 100000 takes minutes")
    return result


def keep_to_one_core() -> None:
    """This process and its threads, where the system can do that."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def main(arguments: Sequence[str] | None = None) -> None:
    command_line = parser()
    options = command_line.parse_args(arguments)
    if options.gate and options.only:
        command_line.error("--gate needs all parts: leave --only out")
    if not options.all_cores:
        keep_to_one_core()
    # XLA counts the cores when it is loaded.
    from bench.gate import best, failures, read_baseline
    from bench.growth import SAMPLES
    from bench.metrics import Metric, table, write_json
    from bench.parts import run
    from jaxmocap.pipelines.kept_programs import keep_compiled

    keep_compiled()
    mode = "quick" if options.quick else "full"
    cores = "all cores" if options.all_cores else "one core"
    print(f"{mode}, {cores} of {os.cpu_count()}, {platform.machine()}", flush=True)
    baseline = read_baseline(mode)
    runs: list[list[Metric]] = []
    for attempt in range(ATTEMPTS):
        with tempfile.TemporaryDirectory() as folder:
            metrics, skipped = run(
                Path(folder), options.quick, options.only, options.samples or SAMPLES,
                options.recordings, options.detector_python,
            )  # fmt: skip
        runs.append(metrics)
        print(table(metrics, baseline))
        if options.json and not attempt:
            write_json(metrics, options.json)
        if not options.gate or not (problems := failures(best(runs), baseline, skipped)):
            return
        print("\n".join(problems), file=sys.stderr)
    sys.exit(f"the gate: worse than the baseline in each of {ATTEMPTS} runs")


if __name__ == "__main__":
    main()
