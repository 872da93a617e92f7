"""Time series in a recording for the rerun viewer.

INPUTS: a recording stream, a Motion with its report. OUTPUTS: none; one root entity for each kind
of series, one entity below it for each line.
"""

from collections.abc import Iterable, Mapping

import numpy as np
import rerun as rr

from jaxmocap.body.motion import Motion, Report
from jaxmocap.body.tree import Tree
from jaxmocap.outputs.layout import ANGLES, DEVIATIONS, entity_path
from jaxmocap.outputs.recorder import COLOURS, at_times

SIDES = ("left", "right")
# Joints whose angles are shown, as angles.mot names them.
SHOWN_JOINTS = ("elbow_flex_l", "elbow_flex_r", "knee_flexion_l", "knee_flexion_r")
# Of a body that has none of these, so many joints.
MOST_JOINTS = 4
# RGB of a plot's lines that are of no side.
LINE_COLOURS = (
    (200, 60, 120), (60, 150, 90), (230, 170, 30), (110, 90, 200), (40, 160, 190), (140, 110, 80),
)  # fmt: skip
# Brightness of the lines of legs, to tell them from those of arms.
LEG_BRIGHTNESS = 0.6


def shown_joints(tree: Tree) -> dict[str, int]:
    """Joint -> its index among a pose's angles."""
    shown = [name for name in SHOWN_JOINTS if name in tree.joints] or tree.joints[:MOST_JOINTS]
    return {name: tree.joints.index(name) for name in shown}


def log_angles(stream: rr.RecordingStream, motion: Motion) -> None:
    """The shown joints' angles, degrees."""
    joints = shown_joints(motion.skeleton.tree)
    angles = np.degrees(np.asarray(motion.poses.angles, float)[:, list(joints.values())])
    _send_series(stream, ANGLES, motion.times, joints, angles)


def log_report(stream: rr.RecordingStream, times: np.ndarray, report: Report) -> None:
    """Time series of a tracker's report, and its statuses."""
    errors = 1000 * np.asarray(report.marker_errors, float)
    _send_series(stream, "marker_errors", times, report.markers, errors)
    _send_series(stream, "arm_costs", times, SIDES, report.arm_costs)
    _send_series(stream, DEVIATIONS, times, SIDES, 100 * report.elbow_deviations)
    _send_series(stream, "swivel", times, SIDES, np.degrees(report.swivels))
    for i, (stage, spent) in enumerate(report.milliseconds.items()):
        # A stage that ran once would dwarf the rest.
        if len(spent) == 1 < len(times):
            continue
        # A stage that does not run at every sample has its calls spread evenly over the time.
        spread = np.linspace(times[0], times[-1], len(spent)) if len(spent) != len(times) else times
        _send_series(stream, "milliseconds", spread, (stage,), np.asarray(spent)[:, None], i)
    statuses = [
        (time, "; ".join(lines))
        for time, lines in zip(times, report.statuses, strict=True)
        if lines
    ]
    if statuses:
        at, texts = zip(*statuses, strict=True)
        stream.send_columns("statuses", [at_times(np.array(at))], rr.TextLog.columns(text=texts))


def _send_series(
    stream: rr.RecordingStream,
    root: str,
    times: np.ndarray,
    names: Iterable[str],
    values: np.ndarray,
    first: int = 0,
) -> None:
    """One line per column of (T, N) values; what is NaN is left out."""
    for i, (name, column) in enumerate(zip(names, np.asarray(values, float).T, strict=True)):
        is_finite = np.isfinite(column)
        if not is_finite.any():
            continue
        log_line(stream, root, name, first + i)
        columns = rr.Scalars.columns(scalars=column[is_finite])
        stream.send_columns(entity_path(root, name), [at_times(times[is_finite])], columns)


def log_line(stream: rr.RecordingStream, root: str, name: str, number: int) -> None:
    """The style of a time series' line: the body's colour of a side, others by their number."""
    colour = LINE_COLOURS[number % len(LINE_COLOURS)]
    if name in SIDES:
        colour = COLOURS[name[0]]
    elif root == ANGLES and name[-2:] in ("_l", "_r"):
        brightness = LEG_BRIGHTNESS if name.startswith(("knee", "hip")) else 1.0
        colour = tuple(round(brightness * part) for part in COLOURS[name[-1]])
    style = rr.SeriesLines(names=name, colors=colour)
    stream.log(entity_path(root, name), style, static=True)


def log_values(stream: rr.RecordingStream, root: str, values: Mapping[str, float]) -> None:
    """One point of each line of a time series, at the stream's present time."""
    for name, value in values.items():
        stream.log(entity_path(root, name), rr.Scalars(float(value)))
