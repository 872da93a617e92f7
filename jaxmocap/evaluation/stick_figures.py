"""People as stick figures, side by side, with the height of their feet over time.

INPUTS: Motions by name. OUTPUTS: a picture file, by its suffix.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from jaxmocap.body.motion import Motion
from jaxmocap.evaluation.plots import new_panels, save_figure

# Figures of each person, at most.
INSTANTS = 6
# Landmarks that lines join.
TRUNK_CHAIN = ("pelvis", "neck", "head", "vertex")
ARM_CHAIN = ("neck", "shoulder", "elbow", "wrist", "hand")
LEG_CHAIN = ("pelvis", "hip", "knee", "ankle", "toe")
# Of the left and the right side.
COLOURS = {"l": "#1557b0", "r": "#c62828"}


def plot_stick_figures(path: str | Path, people: Mapping[str, Motion]) -> None:
    """Draw each person at the same instants seen from the side, and how high their feet are.

    Args:
        path: of the picture (.png, .svg, .pdf).
        people: name -> motion; their times are the same.
    """
    figure, axes = new_panels(len(people), 2, (6.4, 2.2), sharex="col", sharey="col")
    joints = {name: motion.joints() for name, motion in people.items()}
    highest = max(float(each["vertex"][:, 2].max()) for each in joints.values())
    for (name, motion), (stand, heights) in zip(people.items(), axes, strict=True):
        _draw_figures(stand, joints[name], highest)
        stand.set_ylabel(f"{name} [m]")
        for side, colour in COLOURS.items():
            for end, style in (("ankle", "-"), ("toe", ":")):
                height = 100 * joints[name][f"{end}_{side}"][:, 2]
                heights.plot(motion.times, height, style, color=colour, label=f"{end}, {side}")
        heights.set_ylabel("height [cm]")
    axes[-1, 1].set_xlabel("time [s]")
    axes[0, 1].legend(frameon=False, ncols=4, fontsize="small")
    save_figure(figure, path, "")


def _draw_figures(panel, joints: dict[str, np.ndarray], highest: float) -> None:
    """Figures at instants evenly over time, each beside the last, seen from the side."""
    count = len(joints["pelvis"])
    for k, row in enumerate(np.linspace(0, count - 1, min(INSTANTS, count)).round().astype(int)):
        ahead = np.cross(joints["hip_l"][row] - joints["hip_r"][row], [0.0, 0.0, 1.0])
        ahead = ahead / max(float(np.linalg.norm(ahead)), 1e-6)
        at = {mark: points[row] - joints["pelvis"][row] for mark, points in joints.items()}
        chains: list[tuple[tuple[str, ...], str]] = [(TRUNK_CHAIN, "#222222")]
        for side, colour in COLOURS.items():
            for limb in (ARM_CHAIN, LEG_CHAIN):
                names = [limb[0], *(f"{name}_{side}" for name in limb[1:])]
                chains.append((tuple(names), colour))
        for names, colour in chains:
            across = [0.8 * highest * k + at[name] @ ahead for name in names]
            panel.plot(across, [joints[name][row, 2] for name in names], color=colour)
    panel.axhline(0, color="#888888", linewidth=0.6)
    panel.set_aspect("equal", adjustable="box")
    panel.set_xticks([])
    panel.margins(0.03)
