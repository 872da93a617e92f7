"""A room from above: a person, the places that were tried for a camera, the cameras.

INPUTS: a FloorPlan and what each set-up is expected to give. OUTPUTS: a picture file.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxmocap.evaluation.plots import new_panels, save_figure

# Of cameras, one after the other; of the person.
COLOURS, PERSON = ("#1557b0", "#c62828", "#2e7d32", "#6a1b9a"), "#222222"
# How far lines of sight are drawn, metres.
SIGHT_M = 1.2
# The darker the surer.
COLOURMAP = "viridis"


class PlacedCamera(NamedTuple):
    """A camera from above, in the person's frame.

    Attributes:
        ahead: metres.
        left: metres.
        yaw: of the line of sight, to the left of where the person faces, radians.
        fov: horizontal field of view, radians.
    """

    ahead: float
    left: float
    yaw: float
    fov: float


class FloorPlan(NamedTuple):
    """A room from above, in the person's frame.

    Attributes:
        walls: least and largest place ahead, least and largest place to the left, metres.
        tried: (K, 2) places ahead and to the left, metres.
        errors: (K,) metres; infinite where no camera could stand.
        cameras: that were placed.
    """

    walls: tuple[float, float, float, float]
    tried: np.ndarray
    errors: np.ndarray
    cameras: tuple[PlacedCamera, ...]


def plot_floor_plan(
    path: str | Path, room: FloorPlan, expected: Sequence[tuple[str, float]], what: str
) -> None:
    """Draw the room, and beside it what each set-up is expected to give.

    Args:
        path: of the picture (.png, .svg, .pdf).
        room: from above.
        expected: set-up and deviation, metres.
        what: of which joints.
    """
    figure, axes = new_panels(1, 2, (5.6, 4.4), sharex=False)
    floor, bars = axes[0]
    _draw_room(figure, floor, room, what)
    rows, centimetres = range(len(expected)), [100 * error for _, error in expected]
    bars.barh(rows, centimetres, 0.62, color="#90a4ae")
    for row, value in zip(rows, centimetres, strict=True):
        bars.text(value, row, f" {value:.1f}", va="center", fontsize="small")
    bars.set_yticks(rows, [name for name, _ in expected])
    bars.invert_yaxis()
    bars.set_xlim(0, 1.15 * max(centimetres))
    bars.set_xlabel(f"expected deviation of {what} [cm]")
    save_figure(figure, path, "")


def _draw_room(figure, floor, room: FloorPlan, what: str) -> None:
    """The person looks up the page, so that their left is left."""
    behind, ahead, right, left = room.walls
    floor.plot(
        [-left, -right, -right, -left, -left], [behind, behind, ahead, ahead, behind],
        color="#888888", linewidth=1.2,
    )  # fmt: skip
    possible = np.isfinite(room.errors)
    points = floor.scatter(
        -room.tried[possible, 1], room.tried[possible, 0], c=100 * room.errors[possible],
        cmap=COLOURMAP, s=70, zorder=2,
    )  # fmt: skip
    figure.colorbar(points, ax=floor, label=f"{what}, one camera there [cm]", shrink=0.8)
    floor.annotate(
        "", (0, 0.55), (0, 0), arrowprops={"arrowstyle": "-|>", "color": PERSON, "lw": 1.6}
    )
    floor.plot([-0.22, 0.22], [0, 0], color=PERSON, linewidth=5, solid_capstyle="round")
    for number, camera in enumerate(room.cameras, 1):
        colour, at = COLOURS[(number - 1) % len(COLOURS)], np.array([-camera.left, camera.ahead])
        for side in (-0.5, 0.5):
            angle = camera.yaw + side * camera.fov
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
