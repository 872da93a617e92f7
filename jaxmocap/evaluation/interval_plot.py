"""A picture of estimates with their standard deviations before and after.

INPUTS: intervals. OUTPUTS: a picture file, by its suffix.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from jaxmocap.evaluation.plots import save_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Of the verdicts, from the best to the worst.
COLOURS = ("#1557b0", "#ef8e19", "#9e9e9e")


class Interval(NamedTuple):
    """One estimate, as a change against what was stated: 0 is no change, 0.01 one percent.

    Attributes:
        name: written beside it.
        estimate: of the change.
        before: half the width of the interval about 0 before.
        after: half the width of the interval about the estimate.
        verdict: about it; estimates with the same verdict have the same colour.
    """

    name: str
    estimate: float
    before: float
    after: float
    verdict: str


def plot_intervals(
    path: str | Path, intervals: Sequence[Interval], verdicts: Sequence[str], title: str = ""
) -> None:
    """Draw estimates below one another, percent.

    Args:
        path: of the picture (.png, .svg, .pdf).
        intervals: from top to bottom.
        verdicts: that there are, at most three, from the best to the worst.
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
    for verdict, colour in zip(verdicts, COLOURS, strict=False):
        _plot_estimates(axes, intervals, verdict, colour)
    axes.set_yticks(rows, [interval.name for interval in intervals])
    axes.invert_yaxis()
    half_width = 108 * max(max(i.before, abs(i.estimate) + i.after) for i in intervals)
    axes.axvline(0, color="#888888", linewidth=0.8)
    axes.set_xlim(-half_width, half_width)
    axes.set_xlabel("change against what was stated [%], ± 2 standard deviations")
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(axis="x", color="#dddddd", linewidth=0.6)
    axes.set_axisbelow(True)
    figure.legend(loc="outside lower center", frameon=False, ncols=4, fontsize="small")
    save_figure(figure, path, title)


def _plot_estimates(axes: Axes, intervals: Sequence[Interval], verdict: str, colour: str) -> None:
    """The estimates of one verdict, with their intervals, each in its row."""
    rows = [row for row, interval in enumerate(intervals) if interval.verdict == verdict]
    if not rows:
        return
    axes.errorbar(
        [100 * intervals[row].estimate for row in rows],
        rows,
        xerr=[100 * intervals[row].after for row in rows],
        fmt="o",
        color=colour,
        capsize=4,
        linewidth=2,
        label=verdict,
    )
