"""Figures that a benchmark reports, as a table and as JSON.

INPUTS: numbers. OUTPUTS: Metrics; text; {"metrics": [...]}.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np

MEDIAN, LATE = ", median", ", 99 %"
# A ratio to another program's time changes with that program's version and with the machine: on
# unchanged code by 143 % at most so far. So it fails only where ours has become 2.5 times as slow.
OF_OTHERS = 1.5


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


def write_json(metrics: Iterable[Metric], path: str | Path) -> None:
    """Write the metrics where a baseline can be held against them."""
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
