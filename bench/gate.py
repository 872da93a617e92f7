"""The gate: a run's ratios against the committed ones.

Milliseconds depend on the machine; a ratio of two times that were taken in turn hardly does. So
only ratios (unit "x") are held against ``baseline.json``, each to its own tolerance. How far they
scatter, and new values to commit:

    for i in 1 2 3 4 5; do python -m bench --quick --json run$i.json; done
    python -m bench.gate run*.json --mode quick          # the spread
    python -m bench.gate run*.json --mode quick --write  # medians to baseline.json

INPUTS: Metrics of a run; ``baseline.json``, which has ``quick`` and ``full`` lists of Metrics.
OUTPUTS: sentences on what is worse.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Literal

import numpy as np

from bench import command
from bench.figures import Metric, aligned, read_json

BASELINE = Path(__file__).with_name("baseline.json")
RATIO = "x"
Mode = Literal["quick", "full"]


def read_baseline(mode: Mode, path: Path = BASELINE) -> list[Metric]:
    """The committed ratios of quick or of full runs."""
    return [Metric(**entry) for entry in json.loads(path.read_text(encoding="utf-8"))[mode]]


def worsening(measured: Metric, committed: Metric) -> float:
    """By what share a figure is worse than the committed one; negative where it is better."""
    better, worse = (committed.value, measured.value)
    if committed.direction == "higher":
        better, worse = worse, better
    return worse / better - 1


def failures(
    measured: Iterable[Metric], baseline: Iterable[Metric], skipped: Sequence[str] = ()
) -> list[str]:
    """What keeps a run from passing: a sentence for each ratio that is worse, or missing.

    Args:
        measured: in the run.
        baseline: committed.
        skipped: parts of the names of ratios that may be missing, such as rivals not installed.
    """
    by_name = {metric.name: metric for metric in measured}
    sentences = []
    for committed in baseline:
        metric = by_name.get(committed.name)
        if metric is None:
            if not any(rival in committed.name for rival in skipped):
                sentences.append(f"{committed.name}: not measured, expected {committed.value:.3g}")
        elif (change := worsening(metric, committed)) > committed.tolerance:
            sentences.append(
                f"{committed.name}: {metric.value:.3g}, {change:.0%} worse than the baseline's "
                f"{committed.value:.3g}; {committed.tolerance:.0%} may be chance"
            )
    return sentences


def best(runs: Sequence[Iterable[Metric]]) -> list[Metric]:
    """Each figure of several runs at its best: interruptions only ever make one worse."""
    kept: dict[str, Metric] = {}
    for metric in (metric for run in runs for metric in run):
        other = kept.setdefault(metric.name, metric)
        if worsening(metric, other) < 0:
            kept[metric.name] = metric
    return list(kept.values())


def medians(runs: Sequence[Iterable[Metric]]) -> list[Metric]:
    """Each ratio that all runs have, with its median."""
    by_name = [{m.name: m for m in run if m.unit == RATIO} for run in runs]
    return [
        replace(metric, value=round(float(np.median([run[name].value for run in by_name])), 4))
        for name, metric in by_name[0].items()
        if all(name in run for run in by_name)
    ]


def spread(runs: Sequence[Iterable[Metric]]) -> str:
    """How far each ratio scatters over the runs: a table."""
    kept = [list(run) for run in runs]
    rows = [["ratio", "median", "least", "most", "farthest, %", "tolerance, %"]]
    for middle in medians(kept):
        values = [metric.value for run in kept for metric in run if metric.name == middle.name]
        off = max(worsening(replace(middle, value=value), middle) for value in values)
        figures = [f"{v:.3g}" for v in (middle.value, min(values), max(values))]
        rows.append([middle.name, *figures, f"{100 * off:.0f}", f"{100 * middle.tolerance:.0f}"])
    return aligned(rows)


def write_baseline(mode: Mode, metrics: Iterable[Metric], path: Path = BASELINE) -> None:
    """Put a mode's ratios into the file, and leave the other's."""
    kept = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    kept[mode] = [asdict(metric) for metric in metrics if metric.unit == RATIO]
    path.write_text(json.dumps(kept, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = command("bench.gate", __doc__, metrics=False)
    parser.add_argument("runs", nargs="+", metavar="RUN.json")
    parser.add_argument("--mode", choices=("quick", "full"), required=True)
    parser.add_argument("--write", action="store_true", help="medians to the baseline")
    parser.add_argument("--baseline", type=Path, default=BASELINE, metavar="FILE")
    options = parser.parse_args(arguments)
    runs = [read_json(path) for path in options.runs]
    print(spread(runs))
    if options.write:
        write_baseline(options.mode, medians(runs), options.baseline)


if __name__ == "__main__":
    main()
