"""Plots of joint errors, drawn by matplotlib without a display.

INPUTS: times (seconds) and errors (metres). OUTPUTS: a picture file, by its suffix.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jaxmocap.body.motion import Motion
from jaxmocap.evaluation.series import HIGH_PASS_HZ, finite_mean, high_pass
from jaxmocap.formats.files.errors import InputError
from jaxmocap.formats.files.writing import check_target, replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from jaxmocap.evaluation.errors import Errors

# Kinds of picture, by their suffix.
PICTURES = (".png", ".svg", ".pdf")
# Styles of the lines.
MARKERS_ONLY = {"color": "#c62828", "linestyle": "-", "linewidth": 1.4}
WITH_VIDEO = {"color": "#1557b0", "linestyle": "--", "linewidth": 1.4}
# Of joints' sides, and of the first run and the second.
SIDE_COLOURS = {"_l": "#1f77d0", "_r": "#e07b12"}
RUN_STYLES = ({"linestyle": "-", "linewidth": 1.4}, {"linestyle": ":", "linewidth": 1.4})


def plot_elbow_errors(
    path: str | Path,
    times: np.ndarray,
    errors_markers_only: Mapping[str, np.ndarray],
    errors_with_video: Mapping[str, np.ndarray],
    title: str = "",
) -> None:
    """Draw the paper's Fig. 8 for each joint: the error, its reduction by video, its fast part.

    Args:
        path: of the picture (.png, .svg, .pdf).
        times: (N,) seconds.
        errors_markers_only: joint -> (N,) distances from the reference, metres.
        errors_with_video: the same joints with video.
        title: above the panels.
    """
    joints = list(errors_markers_only)
    figure, axes = new_panels(3, len(joints), (5.6, 2.2), sharey="row")
    for column, joint in enumerate(joints):
        before = 100 * np.asarray(errors_markers_only[joint], float)
        after = 100 * np.asarray(errors_with_video[joint], float)
        top, middle, bottom = axes[:, column]
        named = ("markers only", before, MARKERS_ONLY), ("with video", after, WITH_VIDEO)
        for name, values, style in named:
            top.plot(times, values, label=f"{name}: mean {finite_mean(values):.1f} cm", **style)
            bottom.plot(times, high_pass(times, values), **style)
        # Above the panel, where it hides no curve.
        place = {"loc": "lower center", "bbox_to_anchor": (0.5, 0.98), "ncols": 2}
        top.legend(**place, frameon=False, fontsize="small")
        top.set_title(joint.replace("_l", ", left").replace("_r", ", right"), pad=22)
        # Green where video reduces the error, red where it adds to it.
        for bound, colour in ((np.maximum, "#2e7d32"), (np.minimum, "#c62828")):
            reduction = bound(before - after, 0)
            middle.fill_between(times, 0, reduction, color=colour, alpha=0.35, linewidth=0)
        middle.plot(times, before - after, color="#222222", linewidth=1.0)
        for panel in (middle, bottom):
            panel.axhline(0, color="#888888", linewidth=0.6)
        bottom.set_xlabel("time [s]")
    labels = "error [cm]", "reduction [cm]", f"error above {HIGH_PASS_HZ} Hz [cm]"
    for row, label in zip(axes[:, 0], labels, strict=True):
        row.set_ylabel(label)
    # Once all is drawn: fixing one end of the shared axis stops it from following the curves.
    axes[0, 0].set_ylim(bottom=0)
    save_figure(figure, path, title)


def plot_joint_errors(path: str | Path, runs: Mapping[str, Errors]) -> None:
    """Draw how far joints are from the reference over time, a panel for each pair of joints.

    Args:
        path: of the picture (.png, .svg, .pdf).
        runs: name -> errors of the same joints, ``NAME_l`` and ``NAME_r``; one run or two.
    """
    first = next(iter(runs.values()))
    places = list(
        dict.fromkeys(joint.removesuffix("_l").removesuffix("_r") for joint in first.joints)
    )
    figure, axes = new_panels(-(-len(places) // 3), 3, (4.2, 2.2), sharey=True)
    for panel, place in zip(axes.flat, places, strict=False):
        for (name, errors), style in zip(runs.items(), RUN_STYLES, strict=False):
            for end, colour in SIDE_COLOURS.items():
                if place + end not in errors.joints:
                    continue
                values = 100 * errors.distances[:, errors.joints.index(place + end)]
                side = "left" if end == "_l" else "right"
                label = f"{side}: mean {finite_mean(values):.1f} cm"
                label = label if len(runs) == 1 else f"{name}, {label}"
                panel.plot(errors.times, values, color=colour, label=label, **style)
        panel.set_title(place)
        panel.legend(frameon=False, fontsize="x-small", loc="upper right")
    for panel in axes[-1]:
        panel.set_xlabel("time [s]")
    for panel in axes[:, 0]:
        panel.set_ylabel("position error [cm]")
    low, high = axes[0, 0].get_ylim()
    # Room for the legends above the curves.
    axes[0, 0].set_ylim(0, high + 0.35 * (high - low))
    save_figure(figure, path, "Position errors")


def new_panels(
    rows: int,
    columns: int,
    size: tuple[float, float],
    sharex: str | bool = True,
    sharey: str | bool = False,
) -> tuple[Figure, np.ndarray]:
    """A figure on no display, and its (rows, columns) axes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(size[0] * columns, size[1] * rows + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, sharex=sharex, sharey=sharey, squeeze=False)  # type: ignore[arg-type]
    for panel in axes.flat:
        panel.grid(color="#dddddd", linewidth=0.6)
        panel.spines[["top", "right"]].set_visible(False)
        panel.margins(x=0)
    return figure, axes


def check_picture(path: str | Path, inputs: Iterable[str | Path] = ()) -> None:
    """InputError where no picture can be written there, or a file that is read lies there."""
    suffix = check_target(path, inputs).suffix.lower()
    if suffix not in PICTURES:
        raise InputError(path, f"found {suffix!r}, expected {', '.join(PICTURES)}")


def save_figure(figure: Figure, path: str | Path, title: str = "") -> None:
    """Write a figure to a picture file, moved into place when it is complete."""
    if title:
        figure.suptitle(title)
    with replacing(path) as beside:
        figure.savefig(beside, dpi=130)


# Figures of each person, at most.
INSTANTS = 6
# Landmarks that lines join.
TRUNK_CHAIN = ("pelvis", "neck", "head", "vertex")
ARM_CHAIN = ("neck", "shoulder", "elbow", "wrist", "hand")
LEG_CHAIN = ("pelvis", "hip", "knee", "ankle", "toe")
# Of the left and the right side.
COLOURS = {"l": "#1557b0", "r": "#c62828"}


def plot_stick_figures(path: str | Path, people: Mapping[str, Motion]) -> None:
    """Draw people at the same instants from the side, and how high their feet are (.png, .svg)."""
    figure, axes = new_panels(len(people), 2, (6.4, 2.2), sharex="col", sharey="col")
    joints = {name: motion.joints() for name, motion in people.items()}
    # Floors need not be at 0: the lowest foot of each is.
    for each in joints.values():
        feet = [each[f"{end}_{side}"][:, 2] for end in ("ankle", "toe") for side in "lr"]
        lowest = float(np.nanmin(feet))
        for points in each.values():
            points[:, 2] -= lowest
    highest = max(float(np.nanmax(each["vertex"][:, 2])) for each in joints.values())
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
    save_figure(figure, path)


def _draw_figures(panel, joints: dict[str, np.ndarray], highest: float) -> None:
    """Figures at instants evenly over time, each beside the last, from the side."""
    posed = np.flatnonzero(np.isfinite(joints["pelvis"]).all(1))
    evenly = np.linspace(0, len(posed) - 1, min(INSTANTS, len(posed))).round().astype(int)
    for k, row in enumerate(posed[evenly]):
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
