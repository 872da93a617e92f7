"""What walkers do, learned: the numbers of ``body/data/walking.toml``.

INPUTS: folders of people, each with a height and joints over time. OUTPUTS: Habits; TOML.
"""

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from jaxmocap.formats.time_series.trc import read_trc
from jaxmocap.smoothing.facing import average_over_time, unit
from jaxmocap.smoothing.walking import MIRRORS, Habit, Habits, Walk

MOVEMENTS = ("straight", "turn")
# Slopes are drawn to 0 by this share of their features' variance: six people are few.
RIDGE = 0.01
# Habits that are learned, and what of them is usual: of feet and pelvis the markers and the ground
# have the height.
USUAL_AXES = {"elbow": (1, 1, 1), "ankle": (1, 1, 0), "pelvis": (1, 1, 0)}

# Habit -> features (N, F) and places (N, 3) of one walk.
Samples = Mapping[str, tuple[np.ndarray, np.ndarray]]


def walks(folder: Path) -> list[Samples]:
    """A person's walks, by either side."""
    person = tomllib.loads((folder / "person.toml").read_text())
    above = np.array([0.0, 0.0, person["head_markers_below_crown"]])
    return [
        each
        for movement in MOVEMENTS
        for each in _walk(folder / f"{movement}.trc", person["height"], above)
    ]


def _walk(path: Path, stature: float, above: np.ndarray) -> list[Samples]:
    markers = read_trc(path)
    times, points = markers.times, markers.points()
    crown, wrists = points["Head"] + above, [points["LWrist"], points["RWrist"]]
    across = wrists[0] - wrists[1]
    ahead = unit(np.stack([across[:, 1], -across[:, 0]], -1))
    ahead = unit(average_over_time(ahead, times))
    walk = Walk.of(times, ahead, crown, wrists, stature)
    hips = (points["LHip"] + points["RHip"]) / 2
    found = []
    for i, side in enumerate("LR"):
        joints = {"elbow": points[f"{side}Elbow"], "ankle": points[f"{side}Ankle"], "pelvis": hips}
        features = {"elbow": walk.hands[i], "ankle": walk.swing[i], "pelvis": walk.swing[i]}
        places = {
            name: np.einsum("tij,tj->ti", walk.axes, joint - crown) / stature * MIRRORS[i]
            for name, joint in joints.items()
        }
        found.append({name: (features[name], places[name]) for name in joints})
    return found


def learned(people: Sequence[Sequence[Samples]]) -> Habits:
    """What these people's walks (two people or more) have in common."""
    habits = {}
    for name, axes in USUAL_AXES.items():
        errors = []
        for left_out, own in enumerate(people):
            constant, slopes = _line([p for i, p in enumerate(people) if i != left_out], name)
            errors += [np.mean((constant + x @ slopes - y) ** 2, 0) for x, y in _each(own, name)]
        deviations = np.where(axes, np.sqrt(np.mean(errors, 0)), np.inf)
        habits[name] = Habit(*_line(people, name), deviations)
    hands = np.concatenate([x for own in people for x, _ in _each(own, "elbow")])
    return Habits(**habits, hand=np.stack([hands.mean(0), hands.std(0)]))


def _each(own: Sequence[Samples], name: str) -> list[tuple[np.ndarray, np.ndarray]]:
    return [walk[name] for walk in own]


def _line(people: Sequence[Sequence[Samples]], name: str) -> tuple[np.ndarray, np.ndarray]:
    """The constant and the slopes that are least off over all samples."""
    x, y = (
        np.concatenate(part)
        for part in zip(*(pair for own in people for pair in _each(own, name)), strict=True)
    )
    middle, spread = x.mean(0), x.std(0)
    scaled = (x - middle) / spread
    weights = scaled.T @ scaled + RIDGE * len(x) * np.eye(len(spread))
    slopes = np.linalg.solve(weights, scaled.T @ (y - y.mean(0))) / spread[:, None]
    return y.mean(0) - middle @ slopes, slopes


def as_toml(habits: Habits) -> str:
    """The tables of ``walking.toml``, to four digits after the point."""
    tables = {name: getattr(habits, name)._asdict() for name in USUAL_AXES}
    tables["hand"] = dict(zip(("place", "deviations"), habits.hand, strict=True))
    return "\n".join(
        f"[{table}]\n" + "".join(f"{key} = {_text(value)}\n" for key, value in rows.items())
        for table, rows in tables.items()
    )


def _text(values: np.ndarray) -> str:
    if values.ndim > 1:
        return "[\n" + "".join(f"    {_text(row)},\n" for row in values) + "]"
    return f"[{', '.join(f'{value:.4f}' for value in np.round(values, 4) + 0.0)}]"
