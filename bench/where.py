"""``python -m bench.where MEASURED.json --out FILE.png``: where the time of a causal step goes.

A bar for each way of working, stage upon stage, as multiples of OpenCV's bare image chain; the line
is what was aimed at.

INPUTS: what ``python -m bench --json`` wrote. OUTPUTS: a picture.
"""

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from bench.command_line import command
from bench.metrics import read_json

# Stage -> what it is called in the picture, from the ground up.
STAGES = {
    "observe": "observe: edges, distance fields",
    "solve": "solve: inverse kinematics",
    "refine": "refine: search, simplex, balance",
    "smooth": "smooth: silhouettes, the newest frames together",
}
# Smoothed, frames are observed and refined where the smoothing asks for it: that is of the rest.
REST, LIMIT = "the rest: crossings, reports; smoothed, what is refined on demand", 2.0
COLOURS = {"observe": "C0", "solve": "C2", "refine": "C1", "smooth": "C3", "rest": "0.7"}


def stages_over_chain(figures: dict[str, float]) -> dict[str, dict[str, float]]:
    """Bar -> stage -> multiples of the image chain."""

    def bar(names: list[str], total: str) -> dict[str, float]:
        parts = {name: figures[f"{name}_over_image_chain"] for name in names}
        return parts | {"rest": max(figures[total] - sum(parts.values()), 0.0)}

    frame = ["observe", "solve", "refine"]
    return {
        "frame by frame": bar(frame, "tracker_step_over_image_chain"),
        "causal, smoothed": bar(["solve", "smooth"], "step_over_image_chain"),
    }


def draw(axes: Axes, bars: dict[str, dict[str, float]]) -> None:
    """Stacked bars with their sums, and the limit."""
    colours, named = STAGES | {"rest": REST}, set()
    for row, parts in enumerate(bars.values()):
        left = 0.0
        for stage, size in parts.items():
            label = None if stage in named else colours[stage]
            named.add(stage)
            axes.barh(row, size, left=left, color=COLOURS[stage], label=label)
            if size > 0.7:
                axes.text(left + size / 2, row, f"{size:.1f}", ha="center", va="center")
            left += size
        axes.text(left + 0.2, row, f"{left:.1f}", va="center", weight="bold")
    axes.axvline(LIMIT, color="k", linestyle="--", label=f"aimed at: {LIMIT:g}")
    axes.set_yticks(range(len(bars)), list(bars))
    axes.set_xlabel("processor time of a step with a video frame / OpenCV's bare image chain")
    axes.legend(loc="lower right", fontsize=8)
    axes.set_ylim(-1.6, len(bars) - 0.4)
    axes.margins(x=0.08)


def main() -> None:
    parser = command("bench.where", __doc__)
    parser.add_argument("measured", help="JSON of python -m bench")
    parser.add_argument("--out", required=True, help="picture to write")
    options = parser.parse_args()
    figures = {metric.name: metric.value for metric in read_json(options.measured)}
    figure, axes = plt.subplots(figsize=(9, 3.6), layout="constrained")
    draw(axes, stages_over_chain(figures))
    figure.savefig(options.out, dpi=110)


if __name__ == "__main__":
    main()
