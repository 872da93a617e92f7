"""Figures that a benchmark reports, as a table and as JSON, and those that pages cite.

What some commands measured is kept in ``figures.json``, each with its command and day:

    python -m bench.paper --json found.json
    python -m bench.figures paper found.json --command "python -m bench.paper"

A page links to ``bench/figures.json#paper/bare``: the group, and the beginning of the figures'
names as ``slug`` writes them. ``tests/docs/test_figures.py`` compares the link's text with them.

INPUTS: numbers; what ``--json`` of a benchmark or of a command of jaxmocap wrote.
OUTPUTS: Metrics; text; {"metrics": [...]}; ``figures.json`` with that run's figures.
"""

import json
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path
from typing import Any, Literal

import numpy as np

from bench import command

MEDIAN, LATE = ", median", ", 99 %"
# A ratio to another program's time changes with that program's version and with the machine: on
# unchanged code by 143 % at most so far. So it fails only where ours has become 2.5 times as slow.
OF_OTHERS = 1.5
FIGURES = Path(__file__).with_name("figures.json")
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
    return aligned(rows)


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Rows as a table: first column to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = (
        "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]) for row in rows
    )
    return "\n".join(line.rstrip() for line in lines)


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


def main(arguments: Sequence[str] | None = None) -> None:
    parser = command("bench.figures", __doc__, metrics=False)
    add = parser.add_argument
    add("group", help="of figures.json")
    add("run", type=Path, metavar="RUN.json", help="what the command's --json wrote")
    add("--command", required=True, metavar="LINE", help="that wrote it, paths as RECORDINGS")
    add("--only", default="", metavar="NAME,...", help="beginnings of the figures' names")
    add("--times", action="store_true", help="times too; only where nothing else was running")
    add("--file", type=Path, default=FIGURES)
    options = parser.parse_args(arguments)
    run = json.loads(options.run.read_text(encoding="utf-8"))
    only = options.only.split(",")
    record(options.group, run, options.command, only, options.times, options.file)


if __name__ == "__main__":
    main()
