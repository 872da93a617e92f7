"""Figures that a benchmark reports; the baseline they are held against; those that pages cite.

Milliseconds depend on the machine; a ratio of two times that were taken in turn hardly does. So
only ratios (unit "x") are held against ``baseline.json``, each to its own tolerance. How far they
scatter, and new values to commit:

    for i in 1 2 3 4 5; do python -m bench --quick --json run$i.json; done
    python -m bench.figures baseline quick run*.json          # the spread
    python -m bench.figures baseline quick run*.json --write  # medians to baseline.json

What some commands measured is kept in ``figures.json``, each with its command and day:

    python -m bench.paper --json found.json
    python -m bench.figures cite paper found.json --command "python -m bench.paper"

A page links to ``bench/figures.json#paper/bare``: the group, and the beginning of the figures'
names as ``slug`` writes them. ``tests/docs/test_figures.py`` compares the link's text with them.

INPUTS: numbers; what ``--json`` of a benchmark or of a command of jaxmocap wrote.
OUTPUTS: Metrics; text; {"metrics": [...]}; sentences on what is worse; both files.
"""

import json
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bench import command
from jaxmocap.evaluation.tables import align_columns

MEDIAN, LATE = ", median", ", 99 %"
# A ratio to another program's time changes with that program's version and with the machine: on
# unchanged code by 143 % at most so far. So it fails only where ours has become 2.5 times as slow.
OF_OTHERS = 1.5
FIGURES = Path(__file__).with_name("figures.json")
BASELINE = Path(__file__).with_name("baseline.json")
RATIO = "x"
Mode = Literal["quick", "full"]
TIMES = ("s", "ms", "1/s")


@dataclass(frozen=True)
class Metric:
    """One figure, and which way it should move.

    Attributes:
        name: what was measured.
        value: in ``unit``.
        unit: ms, s, 1/s, cm, MiB, % or x (a ratio).
        direction: whether lower or higher is better.
        tolerance: relative change against a baseline that may be chance.
    """

    name: str
    value: float
    unit: str
    direction: Literal["lower", "higher"] = "lower"
    tolerance: float = 0.5


def stage_metrics(name: str, milliseconds: Sequence[float] | np.ndarray) -> list[Metric]:
    """Median and 99th percentile; chance moves the latter further."""
    median, p99 = np.percentile(milliseconds, [50, 99])
    return [
        Metric(f"{name}{MEDIAN}", float(median), "ms"),
        Metric(f"{name}{LATE}", float(p99), "ms", tolerance=1.0),
    ]


def write_json(metrics: Iterable[Metric], path: str | Path | None) -> None:
    """Write the metrics where a baseline can be held against them; nothing without a path."""
    if path is None:
        return
    entries = [asdict(metric) for metric in metrics]
    text = json.dumps({"metrics": entries}, indent=2, allow_nan=False)
    Path(path).write_text(text + "\n", encoding="utf-8")


def read_json(path: str | Path) -> list[Metric]:
    """Metrics that were written."""
    entries = json.loads(Path(path).read_text(encoding="utf-8"))["metrics"]
    return [Metric(**entry) for entry in entries]


def table(metrics: Iterable[Metric], baseline: Iterable[Metric] = ()) -> str:
    """One row for each figure, with its 99th percentile and the committed value beside it."""
    measured, committed = list(metrics), {metric.name: metric for metric in baseline}
    late = {m.name.removesuffix(LATE): m for m in measured if m.name.endswith(LATE)}
    rows = [["", "median", "99 %", "unit", "baseline"]]
    for metric in measured:
        if metric.name.endswith(LATE):
            continue
        name = metric.name.removesuffix(MEDIAN)
        cells = [metric, late.get(name), committed.get(metric.name)]
        value, p99, before = (f"{cell.value:.3g}" if cell else "" for cell in cells)
        rows.append([name, value, p99, metric.unit, before])
    return align_columns(rows)


def slug(name: str) -> str:
    """A figure's name as a link has it: ``bare, right elbow`` is ``bare-right-elbow``."""
    return re.sub(r"[^\w.]+", "-", name.lower()).strip("-")


def figures_of(run: Any, name: str = "") -> Iterator[tuple[str, float, str]]:
    """Names, values and units of a run: its Metrics, or all numbers by their keys.

    A command's keys name their units, so there the unit is empty.
    """
    if isinstance(run, dict) and "metrics" in run:
        yield from ((m["name"], m["value"], m["unit"]) for m in run["metrics"])
    elif isinstance(run, dict):
        for key, value in run.items():
            yield from figures_of(value, f"{name} {key}")
    elif isinstance(run, float | int) and not isinstance(run, bool):
        yield name, run, ""


def record(
    group: str,
    run: Any,
    line: str,
    chosen: Sequence[str] = ("",),
    times: bool = False,
    path: Path = FIGURES,
) -> None:
    """Put a run's figures into the file in place of the group's earlier ones.

    Args:
        group: the figures' group.
        run: what ``--json`` wrote; five digits of each number are kept.
        line: the command.
        chosen: beginnings of the names, as ``slug`` writes them, that are kept.
        times: whether times are.
        path: the file.
    """
    kept = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    figures = {
        slug(name): f"{value:.5g} {unit}".strip()
        for name, value, unit in figures_of(run)
        if slug(name).startswith(tuple(chosen)) and (times or unit not in TIMES)
    }
    kept[group] = {"command": line, "date": date.today().isoformat(), "figures": figures}
    text = json.dumps(kept, indent=2, sort_keys=True, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8")


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
    return align_columns(rows)


def write_baseline(mode: Mode, metrics: Iterable[Metric], path: Path = BASELINE) -> None:
    """Put a mode's ratios into the file, and leave the other's."""
    kept = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    kept[mode] = [asdict(metric) for metric in metrics if metric.unit == RATIO]
    path.write_text(json.dumps(kept, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def main(arguments: Sequence[str] | None = None) -> None:
    """Hold runs against one another, or keep a run's figures."""
    parser = command("bench.figures", __doc__, metrics=False)
    ways = parser.add_subparsers(dest="way", required=True)
    add = ways.add_parser("baseline", help="how far ratios scatter; new medians").add_argument
    add("mode", choices=("quick", "full"))
    add("runs", nargs="+", metavar="RUN.json")
    add("--write", action="store_true", help="medians to the baseline")
    add("--file", type=Path, default=BASELINE)
    add = ways.add_parser("cite", help="put a run's figures into figures.json").add_argument
    add("group", help="of figures.json")
    add("run", type=Path, metavar="RUN.json", help="what the command's --json wrote")
    add("--command", required=True, metavar="LINE", help="that wrote it, paths as RECORDINGS")
    add("--only", default="", metavar="NAME,...", help="beginnings of the figures' names")
    add("--times", action="store_true", help="times too; only where nothing else was running")
    add("--file", type=Path, default=FIGURES)
    options = parser.parse_args(arguments)
    if options.way == "cite":
        run = json.loads(options.run.read_text(encoding="utf-8"))
        only = options.only.split(",")
        record(options.group, run, options.command, only, options.times, options.file)
        return
    runs = [read_json(path) for path in options.runs]
    print(spread(runs))
    if options.write:
        write_baseline(options.mode, medians(runs), options.file)


if __name__ == "__main__":
    main()
