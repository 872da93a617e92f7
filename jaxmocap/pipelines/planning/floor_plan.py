"""A room from above: a person, the places that were tried for a camera, the cameras.

INPUTS: a CameraPlan. OUTPUTS: a picture file.
"""

from pathlib import Path

import numpy as np

from jaxmocap.evaluation.plots import new_panels, save_figure
from jaxmocap.pipelines.planning.results import CameraPlan

# Of cameras, one after the other; of the person.
COLOURS, PERSON = ("#1557b0", "#c62828", "#2e7d32", "#6a1b9a"), "#222222"
# How far lines of sight are drawn, metres.
SIGHT_M = 1.2
# The darker the surer.
COLOURMAP = "viridis"


def plot_floor_plan(path: str | Path, plan: CameraPlan) -> None:
    """Draw the room, and beside it what each set-up is expected to give (.png, .svg, .pdf)."""
    figure, axes = new_panels(1, 2, (5.6, 4.4), sharex=False)
    floor, bars = axes[0]
    _draw_room(figure, floor, plan)
    expected, what = plan.rows(), ", ".join(plan.joints)
    rows, centimetres = range(len(expected)), [100 * error for _, error in expected]
    bars.barh(rows, centimetres, 0.62, color="#90a4ae")
    for row, value in zip(rows, centimetres, strict=True):
        bars.text(value, row, f" {value:.1f}", va="center", fontsize="small")
    bars.set_yticks(rows, [name for name, _ in expected])
    bars.invert_yaxis()
    bars.set_xlim(0, 1.15 * max(centimetres))
    bars.set_xlabel(f"expected deviation of {what} [cm]")
    save_figure(figure, path)


def _draw_room(figure, floor, plan: CameraPlan) -> None:
    """The person looks up the page, so that their left is left."""
    low, high, (places, errors) = plan.bounds.least, plan.bounds.largest, plan.ring
    behind, ahead, right, left = map(float, (low.ahead, high.ahead, low.left, high.left))
    floor.plot(
        [-left, -right, -right, -left, -left], [behind, behind, ahead, ahead, behind],
        color="#888888", linewidth=1.2,
    )  # fmt: skip
    tried, possible = np.stack([places.ahead, places.left], 1), np.isfinite(errors)
    points = floor.scatter(
        -tried[possible, 1], tried[possible, 0], c=100 * errors[possible],
        cmap=COLOURMAP, s=70, zorder=2,
    )  # fmt: skip
    label = f"{', '.join(plan.joints)}, one camera there [cm]"
    figure.colorbar(points, ax=floor, label=label, shrink=0.8)
    floor.annotate(
        "", (0, 0.55), (0, 0), arrowprops={"arrowstyle": "-|>", "color": PERSON, "lw": 1.6}
    )
    floor.plot([-0.22, 0.22], [0, 0], color=PERSON, linewidth=5, solid_capstyle="round")
    for number, (best, fov_deg) in enumerate(zip(plan.best, plan.fields_across, strict=True), 1):
        colour, place = COLOURS[(number - 1) % len(COLOURS)], best.place
        at = np.array([-place.left, place.ahead], float)
        for side in (-0.5, 0.5):
            angle = float(place.yaw) + side * np.radians(fov_deg)
            end = at + SIGHT_M * np.array([-np.sin(angle), np.cos(angle)])
            floor.plot(*np.stack([at, end]).T, color=colour, linewidth=1.2, zorder=3)
        floor.plot(*at, "s", color=colour, markersize=9, zorder=4)
        floor.annotate(
            str(number), at, color="white", ha="center", va="center", fontsize=7, zorder=5
        )
    floor.set_aspect("equal", adjustable="datalim")
    floor.set_xlabel("to the person's right [m]")
    floor.set_ylabel("ahead of the person [m]")
    floor.margins(0.06)
