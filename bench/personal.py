"""``python -m bench.personal RECORDINGS``: what a person's own model is worth to the tracker.

Four photographs of a person of the independent mesh make a model; rendered exercises of the same
person are then tracked by four cameras with each of

    stature  a generic body of the person's true height: what there is without photographs
    bones    a generic body with the true lengths of all bones, which nobody has
    model    the person of the photographs and of the true height

All begin at the truth's first pose, and correct the surface while they track. What the method
assumes of people's proportions it has from ``man`` and ``woman``, who therefore are not among those
that count.

INPUTS: the folder of recordings, with ``person/person.npz`` in it. OUTPUTS: a table, and Metrics.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench import add_rendered, command, kept
from bench.clips import Clip, exercises
from bench.figures import Metric, aligned, write_json
from bench.silhouette import KINDS, Result, evaluated
from jaxmocap.body.skeleton import LANDMARKS, Skeleton, with_joints
from jaxmocap.body.subject import scale_to_landmarks
from jaxmocap.body.surfaces.surface import Surface
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.trc import read_trc
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.pipelines.silhouettes.model import PHOTOGRAPHS, model_from
from jaxmocap.silhouette.first_pose import pose_at_landmarks
from jaxmocap.silhouette.modelling.personal import PersonalModel
from jaxmocap.silhouette.settings import Settings
from jaxmocap.synthetic.movements.exercises import EXERCISES
from jaxmocap.synthetic.people.rigged_mesh import Rig, load_rig
from jaxmocap.synthetic.photographs import rest_height, write_photographs

PEOPLE, EXERCISE = ("slim_woman", "broad_man"), "arm_raises"
BODIES = ("stature", "bones", "model")


class Row(NamedTuple):
    """One exercise of one person.

    Attributes:
        name: of both.
        results: body -> how well it was tracked.
    """

    name: str
    results: dict[str, Result]

    def figures(self) -> np.ndarray:
        """(3, bodies) elbows and knees, degrees, and joints, centimetres."""
        results = self.results.values()
        angles = [[result.angle(kind) for result in results] for kind in ("elbow", "knee")]
        return np.array([*angles, [result.place(*KINDS) for result in results]])


def photographed(rig: Rig, folder: Path, seed: int) -> PersonalModel:
    """The person of four photographs."""
    calibration = write_photographs(folder, rig, seed)
    files = {name: folder / f"{name}.png" for name in PHOTOGRAPHS}
    return model_from(files, calibration, folder / "model", height=rest_height(rig)).person


def tracked(clip: Clip, rig: Rig, person: PersonalModel, bodies: Sequence[str]) -> Row:
    """A clip, once with each of some bodies."""
    truth, results = read_trc(clip.truth).points(), {}
    points = np.array([truth[n][0] if n in truth else np.full(3, np.nan) for n in LANDMARKS])
    recording = Recording.load(clip.path)
    for name in bodies:
        print(f"tracking {clip.name} by {name}", file=sys.stderr, flush=True)
        skeleton, surface = built(name, recording, rig, truth, person)
        start = pose_at_landmarks(with_joints(skeleton, Settings.body), points)
        results[name] = evaluated(
            clip, replace(recording, skeleton=skeleton), start, surface=surface
        )
    return Row(clip.name, results)


def built(
    name: str, recording: Recording, rig: Rig, truth: dict[str, np.ndarray], person: PersonalModel
) -> tuple[Skeleton, Surface | None]:
    """One of ``BODIES``; a generic surface is None."""
    if name == "model":
        return person.skeleton, person.surface
    if name == "bones":
        return scale_to_landmarks(recording.skeleton, truth), None
    return Skeleton.human(rest_height(rig)), None


def text(rows: Sequence[Row]) -> str:
    """The table: a line for each exercise, and their means; degrees and centimetres."""
    bodies = list(rows[0].results)
    kinds = ("elbows deg", "knees deg", "joints cm")
    cells = [["exercise", *(f"{kind} {body}" for kind in kinds for body in bodies)]]
    figures = np.array([row.figures() for row in rows])
    named = [*(row.name for row in rows), "mean"]
    for name, row in zip(named, [*figures, figures.mean(0)], strict=True):
        cells.append([name, *(f"{value:.1f}" for value in row.ravel())])
    if "model" in bodies:
        ratios = figures.mean(0)[:, bodies.index("model"), None] / figures.mean(0)
        cells.append(["model's share", *(f"{ratio:.2f}" for ratio in ratios.ravel())])
    return aligned(cells)


def metrics(rows: Sequence[Row]) -> Iterator[Metric]:
    """Means over the rows of every body."""
    figures = np.mean([row.figures() for row in rows], 0)
    for kind, unit, line in zip(
        ("elbows bent", "knees bent", "joints"), ("deg", "deg", "cm"), figures, strict=True
    ):
        for name, value in zip(rows[0].results, line, strict=True):
            yield Metric(f"tracked by {name}, {kind}", float(value), unit, tolerance=0.1)


def bodies(names: str) -> list[str]:
    """Such as ``bones,model``."""
    chosen = names.split(",")
    if unknown := [name for name in chosen if name not in BODIES]:
        raise argparse.ArgumentTypeError(f"{unknown[0]!r}: expected of {', '.join(BODIES)}")
    return chosen


def main(arguments: Sequence[str] | None = None) -> None:
    """Photograph, render, track, compare, print."""
    parser = command("bench.personal", __doc__)
    parser.add_argument("recordings", metavar="RECORDINGS")
    parser.add_argument("--only", default=EXERCISE, help=f"of {', '.join(EXERCISES)}")
    parser.add_argument("--bodies", type=bodies, default=list(BODIES), help="default: all three")
    add_rendered(parser)
    parser.set_defaults(people=",".join(PEOPLE))
    options = parser.parse_args(arguments)
    keep_compiled()
    people, rows = Path(options.recordings) / "person" / "person.npz", []
    with kept(options.keep) as keep:
        for who in options.people.split(","):
            rig, seeds = load_rig(people, who), options.seeds
            person = photographed(rig, keep / f"photographs_{who}", seeds[0])
            names = options.only.split(",")
            for clip in exercises(people, names, seeds, [who], options.seconds, keep):
                rows.append(tracked(clip, rig, person, options.bodies))
                print(text(rows), file=sys.stderr, flush=True)
    print(text(rows))
    write_json(list(metrics(rows)), options.json)


if __name__ == "__main__":
    main()
