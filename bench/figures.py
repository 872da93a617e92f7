"""The figures that pages cite: what some commands measured, each with its command and day.

    python -m bench.paper --json found.json
    python -m bench.figures paper found.json --command "python -m bench.paper"

A page links to ``bench/figures.json#paper/bare``: the group, and the beginning of the figures'
names as ``slug`` writes them. ``tests/docs/test_figures.py`` compares the link's text with them.

INPUTS: what ``--json`` of a benchmark or of a command of jaxmocap wrote; ``figures.json``.
OUTPUTS: ``figures.json`` with that run's figures.
"""

import json
import re
from collections.abc import Iterator, Sequence
from datetime import date
from pathlib import Path
from typing import Any

from bench.command_line import command

FIGURES = Path(__file__).with_name("figures.json")
TIMES = ("s", "ms", "1/s")


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
    parser = command("bench.figures", __doc__)
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
