"""``python -m bench.morphing RECORDINGS``: what goes along with raised arms, on and off.

Rendered people raise their arms to 150 degrees before four cameras. Their shoulder girdles go along
by published angles, or stay on the chest. They are tracked with shoulders that nothing takes along,
with the joints of ``data/shoulder.toml`` alone, and with its joints and skin. Those were fitted to
the man, who is not among those that count. Bones have the lengths of the truth's landmarks as they
stand at first; so is the first pose.

INPUTS: the folder of recordings, with ``person/person.npz`` in it. OUTPUTS: a table, and Metrics.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench import add_rendered, command, kept
from bench.clips import Clip, exercises
from bench.figures import Metric, aligned, write_json
from bench.silhouette import Result, evaluated
from jaxmocap.body.skeleton import LANDMARKS, with_joints
from jaxmocap.body.subject import scale_to_landmarks
from jaxmocap.body.surfaces.morphing import Morphing, shoulders
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.trc import read_trc
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.silhouette.first_pose import pose_at_landmarks
from jaxmocap.silhouette.settings import Settings
from jaxmocap.synthetic.people.shoulder_girdle import Girdle

EXERCISE = "overhead"
PEOPLE = ("woman", "broad_man", "tall_man", "slim_woman")
GIRDLES = {"girdles that go along": Girdle(), "girdles that stay": None}
WAYS = {
    "off": Morphing(),
    "joints": Morphing(shoulders().followers),
    "and skin": shoulders(),
}
# What is compared, and how it is taken off a result.
FIGURES = {
    "shoulders cm": lambda result: result.place("shoulder"),
    "elbows cm": lambda result: result.place("elbow"),
    "elbows deg": lambda result: result.angle("elbow"),
}


def tracked(clip: Clip, morphing: Morphing) -> Result:
    """A rendered recording, with what goes along."""
    points, recording = read_trc(clip.truth).points(), Recording.load(clip.path)
    standing = {name: path[:1] for name, path in points.items()}
    skeleton = scale_to_landmarks(recording.skeleton, standing)
    missing = np.full((1, 3), np.nan)
    first = np.concatenate([standing.get(name, missing) for name in LANDMARKS])
    start = pose_at_landmarks(with_joints(skeleton, Settings.body), first)
    settings = Settings(morphing=morphing)
    return evaluated(clip, replace(recording, skeleton=skeleton), start, settings)


def rows(results: dict[str, tuple[Result, ...]]) -> list[list[str]]:
    """Person by person, each figure by each of ``WAYS``; then the means."""
    head, below = [""], [""]
    for name in FIGURES:
        head += [name, *[""] * (len(WAYS) - 1)]
        below += WAYS
    values = {who: _figures(ways) for who, ways in results.items()}
    values["mean"] = np.mean(list(values.values()), axis=0)
    cells = [[who, *(f"{v:.2f}" for v in row.ravel())] for who, row in values.items()]
    changes = 100 * (values["mean"] / values["mean"][:, :1] - 1)
    less = [text for row in changes for text in ("", *(f"{v:+.0f} %" for v in row[1:]))]
    return [head, below, *cells, ["", *less]]


def _figures(ways: tuple[Result, ...]) -> np.ndarray:
    """(3, 3): each of ``FIGURES`` by each of ``WAYS``."""
    return np.array([[take(result) for result in ways] for take in FIGURES.values()])


def metrics(girdle: str, results: dict[str, tuple[Result, ...]]) -> Iterator[Metric]:
    """Everybody's means."""
    mean = np.mean([_figures(ways) for ways in results.values()], axis=0)
    for name, values in zip(FIGURES, mean, strict=True):
        kind, unit = name.split()
        for way, value in zip(WAYS, values, strict=True):
            text = f"morphing of {girdle}, {way}, {kind}"
            yield Metric(text, float(value), unit, tolerance=0.1)


def main(arguments: Sequence[str] | None = None) -> None:
    """Render, track, compare, print."""
    parser = command("bench.morphing", __doc__)
    parser.add_argument("recordings", metavar="RECORDINGS")
    add_rendered(parser)
    parser.set_defaults(people=",".join(PEOPLE))
    options = parser.parse_args(arguments)
    keep_compiled()
    file, every = Path(options.recordings) / "person" / "person.npz", []
    with kept(options.keep) as keep:
        for girdle, how in GIRDLES.items():
            results = {}
            # Everybody in clothes and rooms of their own.
            for number, who in enumerate(options.people.split(","), 1):
                own = [seed + number for seed in options.seeds]
                for clip in exercises(file, [EXERCISE], own, [who], options.seconds, keep, how):
                    results[clip.name] = tuple(tracked(clip, way) for way in WAYS.values())
            print(f"\n{girdle}\n{aligned(rows(results))}", flush=True)
            every += metrics(girdle, results)
    write_json(every, options.json)


if __name__ == "__main__":
    main()
