"""``python -m bench.personal RECORDINGS [--shoulders|--skin]``: what a person's own body is worth.

Four photographs of a person of the independent mesh make a model; rendered exercises of the same
person are then tracked by four cameras with each of

    stature  a generic body of the person's true height: what there is without photographs
    bones    a generic body with the true lengths of all bones, which nobody has
    model    the person of the photographs and of the true height

All begin at the truth's first pose, and correct the surface while they track. What the method
assumes of people's proportions it has from ``man`` and ``woman``, who therefore are not among those
that count.

With ``--shoulders`` people raise their arms to 150 degrees. Their shoulder girdles go along by
published angles, or stay on the chest. They are tracked with shoulders that nothing takes along,
with the joints of ``data/shoulder.toml`` alone, and with its joints and skin. Those were fitted to
the man, who is not among those that count. Bones have the lengths of the truth's landmarks as they
stand at first.

With ``--skin`` nobody is tracked. A generic body of their bones takes the pose of their landmarks;
how far its trunk's skin is off theirs between waist and neck, along its normals, less how far it is
off with hanging arms, is what a swelling should take away.

INPUTS: the folder of recordings, with ``person/person.npz`` in it. OUTPUTS: a table, and Metrics.
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
from scipy.spatial import KDTree

from bench import add_rendered, command, kept
from bench.clips import Clip, exercises
from bench.figures import Metric, write_json
from bench.silhouette import KINDS, Result, evaluated, true_start
from jaxmocap.body.kinematics import forward
from jaxmocap.body.skeleton import LANDMARKS, Skeleton, with_joints
from jaxmocap.body.subject import rest_joints, scale_to_landmarks
from jaxmocap.body.surfaces.loft import generic_surface
from jaxmocap.body.surfaces.morphing import Morphing, shoulders
from jaxmocap.body.surfaces.surface import Surface, pose_points, rest_nodes
from jaxmocap.evaluation.tables import align_columns
from jaxmocap.formats.recordings.recording import Recording
from jaxmocap.formats.time_series.trc import read_trc
from jaxmocap.pipelines.kept_programs import keep_compiled
from jaxmocap.pipelines.silhouettes.model import PHOTOGRAPHS, model_from
from jaxmocap.silhouette.first_pose import pose_at_landmarks
from jaxmocap.silhouette.modelling.personal import PersonalModel
from jaxmocap.silhouette.settings import Settings
from jaxmocap.silhouette.surfaces.morph import driver_values, moved_points
from jaxmocap.silhouette.surfaces.swelling import grid_normals, morph_around, patch_coordinates
from jaxmocap.synthetic.movements.exercises import EXERCISES, exercise
from jaxmocap.synthetic.people.rigged_mesh import Rig, load_rig
from jaxmocap.synthetic.photographs import rest_height, write_photographs

PEOPLE, EXERCISE = "slim_woman,broad_man", "arm_raises"
RAISERS, RAISED_ARMS = "woman,broad_man,tall_man,slim_woman", "overhead"
GIRDLES = {"girdles that go along": True, "girdles that stay": False}
MORPHINGS = {"off": Morphing(), "joints": Morphing(shoulders().followers), "and skin": shoulders()}
# What is compared: its name with its unit, and how it is taken off a result.
Figures = Mapping[str, Callable[[Result], float]]
OF_BODIES: Figures = {
    "elbows deg": lambda result: result.angle("elbow"),
    "knees deg": lambda result: result.angle("knee"),
    "joints cm": lambda result: result.place(*KINDS),
}
OF_SHOULDERS: Figures = {
    "shoulders cm": lambda result: result.place("shoulder"),
    "elbows cm": lambda result: result.place("elbow"),
    "elbows deg": lambda result: result.angle("elbow"),
}
# Exercise of a person -> way -> how well it was tracked.
Results = dict[str, dict[str, Result]]
# Of the raised skin: seconds and frames; of the trunk's patch, shares of the way along it.
SECONDS, FRAMES, BETWEEN = 3.0, 30, (0.4, 0.8)
# Drivers of hanging and of raised arms.
HANGING, RAISED = 0.05, 0.3
# Nearest points of the mesh face as the skin does, to this cosine, and lie within so many metres.
LEAST_COSINE, FARTHEST_M = 0.6, 0.06
# Metres that a unit between normals is worth.
NORMAL_M = 0.05
FORWARD, POSED, MOVED = jax.jit(forward), jax.jit(pose_points), jax.jit(moved_points)


def photographed(rig: Rig, folder: Path, seed: int) -> PersonalModel:
    """The person of four photographs."""
    calibration = write_photographs(folder, rig, seed)
    files = {name: folder / f"{name}.png" for name in PHOTOGRAPHS}
    return model_from(files, calibration, folder / "model", height=rest_height(rig)).person


def by_bodies(clip: Clip, rig: Rig, person: PersonalModel) -> dict[str, Result]:
    """A clip, once with each body; the surface of a generic one is None."""
    truth, recording = read_trc(clip.truth).points(), Recording.load(clip.path)
    bodies: dict[str, tuple[Skeleton, Surface | None]] = {
        "stature": (Skeleton.human(rest_height(rig)), None),
        "bones": (scale_to_landmarks(recording.skeleton, truth), None),
        "model": (person.skeleton, person.surface),
    }
    results = {}
    for name, (skeleton, surface) in bodies.items():
        print(f"tracking {clip.name} by {name}", file=sys.stderr, flush=True)
        own, start = replace(recording, skeleton=skeleton), true_start(skeleton, truth)
        results[name] = evaluated(clip, own, start, surface=surface)
    return results


def by_morphings(clip: Clip) -> dict[str, Result]:
    """A clip, once with each of ``MORPHINGS``."""
    truth, recording = read_trc(clip.truth).points(), Recording.load(clip.path)
    standing = {name: path[:1] for name, path in truth.items()}
    skeleton = scale_to_landmarks(recording.skeleton, standing)
    own, start = replace(recording, skeleton=skeleton), true_start(skeleton, truth)
    return {
        name: evaluated(clip, own, start, Settings(morphing=morphing))
        for name, morphing in MORPHINGS.items()
    }


def values(results: Results, figures: Figures) -> np.ndarray:
    """(exercises, figures, ways)."""
    return np.array(
        [
            [[take(result) for result in ways.values()] for take in figures.values()]
            for ways in results.values()
        ]
    )


def text(results: Results, figures: Figures) -> str:
    """A line for each exercise, their means, and how much these are less than the first way's."""
    ways, each = list(next(iter(results.values()))), values(results, figures)
    cells = [["exercise", *(f"{name} {way}" for name in figures for way in ways)]]
    mean = each.mean(0)
    for name, row in zip([*results, "mean"], [*each, mean], strict=True):
        cells.append([name, *(f"{value:.2f}" for value in row.ravel())])
    changes = 100 * (mean / mean[:, :1] - 1)
    return align_columns([*cells, ["change", *(f"{value:+.0f} %" for value in changes.ravel())]])


def metrics(name: str, results: Results, figures: Figures) -> Iterator[Metric]:
    """The means of every way."""
    ways = next(iter(results.values()))
    for figure, row in zip(figures, values(results, figures).mean(0), strict=True):
        for way, value in zip(ways, row, strict=True):
            kind, unit = figure.split()
            yield Metric(f"{name}, {way}, {kind}", float(value), unit, tolerance=0.1)


def offsets(nodes: np.ndarray, normals: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(N,) metres from nodes to a mesh's faces (F, 4, 3) along normals; NaN where none is near."""
    u, v = (a.ravel()[:, None, None] for a in np.meshgrid(*[np.linspace(0.17, 0.83, 3)] * 2))
    a, b, c, d = np.moveaxis(corners, 1, 0)
    points = ((1 - u) * ((1 - v) * a + v * d) + u * ((1 - v) * b + v * c)).reshape(-1, 3)
    ways = np.cross(c - a, d - b)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True) + 1e-12
    ways = np.tile(ways, (len(u), 1))
    tree = KDTree(np.concatenate([points, NORMAL_M * ways], 1))
    near = tree.query(np.concatenate([nodes, NORMAL_M * normals], 1))[1]
    way = points[near] - nodes
    alike = np.sum(ways[near] * normals, 1) > LEAST_COSINE
    close = np.linalg.norm(way, axis=1) < FARTHEST_M
    return np.where(alike & close, np.sum(way * normals, 1), np.nan)


def skin_errors(people: Path, who: str, seed: int) -> tuple[float, float]:
    """Root mean square with raised arms, without and with what swells, metres."""
    performer = exercise(load_rig(people, who, seed), "overhead", SECONDS, seed, True)
    times = np.linspace(0, SECONDS, FRAMES)
    vertices, landmarks = performer.vertices(times), performer.landmarks(times)
    standing = {name: path[:1] for name, path in landmarks.items()}
    skeleton = with_joints(scale_to_landmarks(Skeleton.human(), standing), Settings.body)
    surface, joints = generic_surface(skeleton), rest_joints(skeleton)
    patch = next(each for each in surface.patches if each.name == "torso")
    along = patch_coordinates(patch, patch.grid(rest_nodes(surface, joints)))[:, 1]
    kept = (along > BETWEEN[0]) & (along < BETWEEN[1])
    morph = morph_around(shoulders(), skeleton.tree, surface, joints)
    missing, rows, drivers = np.full((FRAMES, 3), np.nan), [], []
    marks = np.stack([landmarks.get(name, missing) for name in LANDMARKS], 1)
    for points, mesh in zip(marks, vertices, strict=True):
        pose = pose_at_landmarks(skeleton, points)
        values, frames = driver_values(morph, pose.angles), FORWARD(skeleton, pose)
        drivers.append(float(np.min(values)))
        for worn in (surface.points, MOVED(surface.points, morph.moves, values)):
            nodes = np.asarray(POSED(frames, worn), float)
            normals = grid_normals(patch.grid(nodes)).reshape(-1, 3)[kept]
            corners = mesh[performer.mesh.faces]
            rows.append(offsets(nodes[patch.nodes][kept], normals, corners))
    off = np.reshape(rows, (FRAMES, 2, -1))
    lifted = np.array(drivers)
    rest = np.nanmean(off[lifted < HANGING], 0)
    both = np.sqrt(np.nanmean((off[lifted > RAISED] - rest) ** 2, (0, 2)))
    return float(both[0]), float(both[1])


def of_models(options: argparse.Namespace, file: Path, people: Sequence[str]) -> Iterator[Metric]:
    """Photograph, render, track with each body."""
    results: Results = {}
    with kept(options.keep) as keep:
        for who in people:
            rig, names = load_rig(file, who), options.only.split(",")
            person = photographed(rig, keep / f"photographs_{who}", options.seeds[0])
            for clip in exercises(file, names, options.seeds, [who], options.seconds, keep):
                results[clip.name] = by_bodies(clip, rig, person)
    print(text(results, OF_BODIES))
    yield from metrics("tracked", results, OF_BODIES)


def of_shoulders(
    options: argparse.Namespace, file: Path, people: Sequence[str]
) -> Iterator[Metric]:
    """Render raised arms, track with what goes along."""
    for girdle, how in GIRDLES.items():
        results: Results = {}
        with kept(options.keep) as keep:
            # Everybody in clothes and rooms of their own.
            for number, who in enumerate(people, 1):
                own = [seed + number for seed in options.seeds]
                names = [RAISED_ARMS]
                for clip in exercises(file, names, own, [who], options.seconds, keep, how):
                    results[clip.name] = by_morphings(clip)
        print(f"\n{girdle}\n{text(results, OF_SHOULDERS)}", flush=True)
        yield from metrics(f"morphing of {girdle}", results, OF_SHOULDERS)


def of_skin(options: argparse.Namespace, file: Path, people: Sequence[str]) -> Iterator[Metric]:
    """Pose, compare skins."""
    off = {who: skin_errors(file, who, options.seeds[0]) for who in people}
    off["mean"] = tuple(np.mean(list(off.values()), 0))
    cells = [[who, *(f"{1000 * value:.1f}" for value in pair)] for who, pair in off.items()]
    print(align_columns([["trunk's skin, mm off", "off", "on"], *cells]))
    for state, value in zip(("off", "on"), off["mean"], strict=True):
        yield Metric(f"raised skin {state}", 1000 * value, "mm")


def main() -> None:
    """Measure, print."""
    parser = command("bench.personal", __doc__)
    parser.add_argument("recordings", metavar="RECORDINGS")
    parser.add_argument("--only", default=EXERCISE, help=f"of {', '.join(EXERCISES)}")
    add_rendered(parser)
    parser.set_defaults(people=None)
    way = parser.add_mutually_exclusive_group()
    way.add_argument("--shoulders", action="store_true", help="what goes along with raised arms")
    way.add_argument("--skin", action="store_true", help="the skin of raised arms")
    options = parser.parse_args()
    keep_compiled()
    usual, measure = (PEOPLE, of_models)
    if options.shoulders or options.skin:
        usual, measure = RAISERS, of_skin if options.skin else of_shoulders
    file = Path(options.recordings) / "person" / "person.npz"
    found = list(measure(options, file, (options.people or usual).split(",")))
    write_json(found, options.json)


if __name__ == "__main__":
    main()
