"""A picture of estimates: what was known before, what is known now, and what to make of it.

INPUTS: intervals. OUTPUTS: a picture file, by its suffix.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from jaxmocap.formats.files.writing import replacing

COLOURS = ("#1557b0", "#ef8e19", "#9e9e9e")


class Interval(NamedTuple):
    """One estimate, as a change against what was stated: 0 is no change, 0.01 one percent.

    Attributes:
        name: beside it.
        found: the estimate.
        before: half the width of the interval about 0 that was known before.
        after: half the width of the interval about the estimate.
        said: of it; those of which the same is said look alike.
    """

    name: str
    estimate: float
    before: float
    after: float
    verdict: str


def plot_intervals(
    path: str | Path, intervals: Sequence[Interval], kinds: Sequence[str], title: str = ""
) -> None:
    """Draw estimates below one another, percent.

    Args:
        path: of the picture (.png, .svg, .pdf).
        intervals: from top to bottom.
        kinds: all that may be said of one, at most three, from the best to the worst.
        title: above them.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 1.2 + 0.48 * len(intervals)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    rows = range(len(intervals))
    widths = [200 * interval.before for interval in intervals]
    axes.barh(rows, widths, 0.62, [-w / 2 for w in widths], color="#e4e4e4", label="before")
    for kind, colour in zip(kinds, COLOURS, strict=False):
        chosen = [row for row in rows if intervals[row].verdict == kind]
        if not chosen:
            continue
        axes.errorbar(
            [100 * intervals[row].estimate for row in chosen],
            chosen,
            xerr=[100 * intervals[row].after for row in chosen],
            fmt="o",
            color=colour,
            capsize=4,
            linewidth=2,
            label=kind,
        )
    axes.axvline(0, color="#888888", linewidth=0.8)
    axes.set_yticks(rows, [interval.name for interval in intervals])
    axes.invert_yaxis()
    reach = 108 * max(max(each.before, abs(each.estimate) + each.after) for each in intervals)
    axes.set_xlim(-reach, reach)
    axes.set_xlabel("change against what was stated [%], ± 2 standard deviations")
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="x", color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    figure.legend(loc="outside lower center", frameon=False, ncols=4, fontsize="small")
    if title:
        figure.suptitle(title)
    with replacing(path) as beside:
        figure.savefig(beside, dpi=130)
