"""Figures that a benchmark reports, as a table and as JSON.

INPUTS: numbers. OUTPUTS: Metrics; text; {"metrics": [...]}.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np


@dataclass(frozen=True)
class Metric:
    """One figure, and which way it should move.

    Attributes:
        name: what was measured.
        value: in ``unit``.
        unit: ms, s, 1/s, cm, % or x (a ratio).
        direction: whether lower or higher is better.
        tolerance: relative change against a baseline that may be chance.
    """

    name: str
    value: float
    unit: str
    direction: Literal["lower", "higher"] = "lower"
    tolerance: float = 0.25


def stage_metrics(name: str, milliseconds: Sequence[float] | np.ndarray) -> list[Metric]:
    """Median and 99th percentile; chance moves the latter further."""
    median, p99 = np.percentile(milliseconds, [50, 99])
    return [
        Metric(f"{name}, median", float(median), "ms"),
        Metric(f"{name}, 99 %", float(p99), "ms", tolerance=1.0),
    ]


def write_json(metrics: Iterable[Metric], path: str | Path) -> None:
    """Write the metrics where a baseline can be held against them."""
    entries = [asdict(metric) for metric in metrics]
    text = json.dumps({"metrics": entries}, indent=2, allow_nan=False)
    Path(path).write_text(text + "\n", encoding="utf-8")


def aligned(rows: Sequence[Sequence[str]]) -> str:
    """Rows as a table: first column to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = (
        "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]) for row in rows
    )
    return "\n".join(line.rstrip() for line in lines)
