"""``python -m bench.people RECORDINGS [--only PERSON,...] [--json FILE]``: real people's markers.

Six people walk and turn without a camera. Head and wrists carry markers, or ankles too; their
bodies are stated by height and mass, or by a static trial. The reference is Plug-in Gait's joint
centres. What walkers do (``body/data/walking.toml``) is learned of the others, for each of them;
``--learn FILE`` writes it, learned of all. ``--causal`` tracks as a live run would, without what
walkers do.

INPUTS: recordings, with ``people/``. OUTPUTS: mean position errors of joints, centimetres; the
elbows' acceleration as a multiple of the reference's; how many coordinates of the truth 90 %
intervals hold, of joints; Metrics.
"""

import tomllib
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from unittest.mock import patch

import numpy as np

from bench import command
from bench.figures import Metric, write_json
from jaxmocap.body.skeleton import landmark_rows
from jaxmocap.capture.timeline import Mode
from jaxmocap.evaluation.errors import evaluate, interval_coverage
from jaxmocap.evaluation.series import second_difference
from jaxmocap.evaluation.tables import align_columns
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.trc import read_trc
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.pipelines.progress import progress_bar
from jaxmocap.pipelines.tracking.track import track
from jaxmocap.smoothing import markers_alone
from jaxmocap.smoothing.facing import average_over_time, unit
from jaxmocap.smoothing.walking import MIRRORS, Habit, Habits, Walk

MARKERS, BODIES = ("three", "five"), ("height", "static")
MOVEMENTS = ("straight", "turn")
JOINTS = ("elbow", "shoulder", "hip", "knee", "neck")
# Landmark -> its name in the reference.
PAIRS = {
    f"{joint}_{side}": f"{side.upper()}{joint.title()}" for joint in JOINTS[:-1] for side in "lr"
} | {"neck": "Neck"}
# How many coordinates 90 % intervals hold.
HELD = tuple(f"{joint} within, %" for joint in JOINTS)
FIGURES = (*(f"{joint}, cm" for joint in JOINTS), "acceleration, x", *HELD)
# Slopes are drawn to 0 by this share of their features' variance: six people are few.
RIDGE = 0.01
# Habits that are learned, and what of them is usual: of feet and pelvis the markers and the ground
# have the height.
USUAL_AXES = {"elbow": (1, 1, 1), "ankle": (1, 1, 0), "pelvis": (1, 1, 0)}

# Habit -> features (N, F) and places (N, 3) of one walk.
Samples = Mapping[str, tuple[np.ndarray, np.ndarray]]


def measure(recording: Path, habits: Habits | None = None, mode: Mode = "own") -> np.ndarray:
    """The ``FIGURES`` of one recording, by habits of walkers other than those of the package."""
    other = patch.object(markers_alone, "usual_habits", lambda: habits)
    with other if habits else nullcontext():
        motion = track(Recording.load(recording), mode=mode)
    truth = read_trc(recording.with_name(recording.name.split("_")[1] + ".trc"))
    errors = evaluate(motion, truth, PAIRS)
    off = dict(zip(errors.joints, errors.statistics()["mean"], strict=True))
    means = [np.mean([off[name] for name in PAIRS if name.startswith(j)]) for j in JOINTS]
    assert motion.report is not None
    # Samples of both are the same.
    stated = motion.report.landmarks_std[:, landmark_rows(PAIRS)]
    shares = interval_coverage(errors.offsets, stated).share.mean(-1)
    share_of = dict(zip(PAIRS, shares, strict=True))
    held = [np.mean([share_of[name] for name in PAIRS if name.startswith(j)]) for j in JOINTS]
    elbows = [name for name in PAIRS if "elbow" in name]
    points, joints = truth.points(), motion.joints()
    shaking, reference = (
        np.mean([_acceleration(times, each) for each in every])
        for times, every in (
            (motion.times, [joints[name] for name in elbows]),
            (truth.times, [points[PAIRS[name]] for name in elbows]),
        )
    )
    return np.array([*(100 * m for m in means), shaking / reference, *(100 * h for h in held)])


def _acceleration(times: np.ndarray, points: np.ndarray) -> float:
    """Root mean square, m/s^2, of points (T, 3)."""
    return float(np.sqrt(np.nanmean(np.sum(second_difference(times, points) ** 2, -1))))


# What walkers do, learned -----------------------------------------------------------------------


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


def main() -> None:
    """Track, print."""
    parser = command("bench.people", __doc__)
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--causal", action="store_true", help="as a live run would have it")
    parser.add_argument("--only", metavar="PERSON,...", help="default: all")
    parser.add_argument("--learn", metavar="FILE", help="write what all of them do, and end")
    options = parser.parse_args()
    folders = sorted((options.recordings / "people").glob("person_*"))
    walked = {folder.name: walks(folder) for folder in folders}
    if options.learn:
        Path(options.learn).write_text(as_toml(learned(list(walked.values()))))
        return
    keep_compiled()
    if options.only:
        folders = [folder for folder in folders if folder.name in options.only.split(",")]
    habits = {
        folder.name: learned([own for name, own in walked.items() if name != folder.name])
        for folder in folders
    }
    mode: Mode = "causal" if options.causal else "own"
    cases = [(m, b) for m in MARKERS for b in BODIES]
    rows, metrics = [["markers, body", "", *FIGURES]], []
    with progress_bar("tracking", True) as show:
        for i, (markers, body) in enumerate(cases):
            found = []
            for folder in folders:
                own = [
                    measure(
                        folder / f"recording_{movement}_{markers}_{body}.toml",
                        habits[folder.name],
                        mode,
                    )
                    for movement in MOVEMENTS
                ]
                found.append(np.mean(own, 0))
                rows.append([f"{markers}, {body}", folder.name, *map("{:.1f}".format, found[-1])])
                show(i * len(folders) + len(found), len(cases) * len(folders))
            mean, count = np.mean(found, 0), len(found)
            for what, figures in (("mean", mean), ("least", np.min(found, 0))):
                own = map("{:.2f}".format, figures)
                rows.append([f"{markers}, {body}", f"{what} of {count}", *own])
            metrics += [
                Metric(f"{markers}, {body}: {name}", float(figure), name.split(", ")[-1])
                for name, figure in zip(FIGURES, mean, strict=True)
            ]
    print(align_columns(rows))
    write_json(metrics, options.json)


if __name__ == "__main__":
    main()
