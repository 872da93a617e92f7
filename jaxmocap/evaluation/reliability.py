"""Whether stated deviations say how far off a joint is, drawn.

Left, reliability: samples in groups of equal size by the deviation stated, and each group's error.
Right, risk: the error of the samples that are kept when the least sure are left out first.

INPUTS: Errors with deviations. OUTPUTS: curves; a picture file.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from jaxmocap.evaluation.errors import Errors
from jaxmocap.evaluation.plots import new_panels, save_figure

# Groups of samples, at most; each has so many samples, at least.
GROUPS, LEAST_SAMPLES = 10, 5
# Names in a column of the legend, at most.
LEGEND_ROWS = 16
STYLES = ("-", "--", ":")
COLOURS = ("#1557b0", "#c62828", "#2e7d32", "#ef8a17", "#6a1b9a", "#00838f", "#5d4037", "#777777")


def stated_and_found(errors: Errors) -> tuple[np.ndarray, np.ndarray]:
    """Deviations over the three axes and distances, (K,) each, metres, of all joints together.

    Raises:
        ValueError: no deviation was stated.
    """
    if errors.deviations is None:
        raise ValueError("nothing states how sure the joints are, expected a motion with a report")
    stated = np.linalg.norm(errors.deviations, axis=-1).ravel()
    found = errors.distances.ravel()
    both = np.isfinite(stated) & np.isfinite(found)
    if not both.any():
        raise ValueError("no joint has a deviation, expected a motion with a report")
    return stated[both], found[both]


def reliability_curve(stated: np.ndarray, found: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Root mean squares (G,) of what was stated and of what was found, in groups by the former."""
    groups = max(1, min(GROUPS, len(stated) // LEAST_SAMPLES))
    chosen = np.array_split(np.argsort(stated, kind="stable"), groups)
    return tuple(  # type: ignore[return-value]
        np.array([np.sqrt(np.mean(values[rows] ** 2)) for rows in chosen])
        for values in (stated, found)
    )


def risk_curve(stated: np.ndarray, found: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shares (K,) of the samples that are kept, the surest first, and their mean error, metres."""
    ordered = found[np.argsort(stated, kind="stable")]
    count = np.arange(1, len(ordered) + 1)
    return count / len(ordered), np.cumsum(ordered) / count


def plot_reliability(path: str | Path, runs: Mapping[str, Errors]) -> None:
    """Draw both for each run, or for each joint's own errors (.png, .svg, .pdf).

    Raises:
        ValueError: a run without deviations, or none.
    """
    if not runs:
        raise ValueError("no joint could be compared, expected a reference that shows one")
    figure, axes = new_panels(1, 2, (5.4, 4.2), sharex=False)
    left, right = axes[0]
    most = 0.0
    for number, (name, errors) in enumerate(runs.items()):
        stated, found = stated_and_found(errors)
        colour = COLOURS[number % len(COLOURS)]
        style = STYLES[number // len(COLOURS) % len(STYLES)]
        x, y = (100 * values for values in reliability_curve(stated, found))
        left.plot(x, y, style, marker="o", color=colour, label=name, linewidth=1.0)
        most = max(most, x.max(), y.max())
        share, error = risk_curve(stated, found)
        right.plot(100 * share, 100 * error, style, color=colour, label=name)
    left.plot([0, most], [0, most], color="#222222", linewidth=0.8, label="as stated")
    left.set_xlim(0, 1.05 * most)
    left.set_ylim(0, 1.05 * most)
    left.set_xlabel("stated deviation, RMS of a group [cm]")
    left.set_ylabel("error, RMS of the group [cm]")
    right.set_xlim(0, 100)
    right.set_ylim(bottom=0)
    right.set_xlabel("samples kept, the surest first [%]")
    right.set_ylabel("their mean error [cm]")
    # Beside both panels, in columns: over them it covers what is drawn.
    handles, labels = left.get_legend_handles_labels()
    columns = 1 + (len(labels) - 1) // LEGEND_ROWS
    where = "outside right center"
    figure.legend(handles, labels, loc=where, ncols=columns, frameon=False, fontsize="small")
    save_figure(figure, path)


def by_joint(errors: Errors) -> dict[str, Errors]:
    """Joint -> its own errors, of those that were compared; where any has deviations, of those."""
    stated, compared = errors.deviations, np.isfinite(errors.distances)
    if stated is not None and np.isfinite(stated).any():
        compared &= np.isfinite(stated).all(-1)
    compared = np.asarray(compared.any(0))
    return {
        name: Errors(
            (name,), errors.times, errors.offsets[:, j : j + 1],
            None if stated is None else stated[:, j : j + 1],
        )
        for j, name in enumerate(errors.joints)
        if compared[j]
    }  # fmt: skip
